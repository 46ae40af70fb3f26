"""Subgoal vectors of frozen skills: each is computed when a batch first asks for it, and kept."""

from collections.abc import Callable

import torch
from torch import Tensor


class TargetTable:
    """One subgoal vector for every frame of a dataset. Plain data of one process, like the labels.

    Args:
        frames: Number of frames.
        width: Width d of a subgoal.
        device: Where the vectors are wanted.
    """

    def __init__(self, frames: int, width: int, device: torch.device) -> None:
        self._values = torch.full((frames, width), torch.nan, device=device)

    def lookup(self, index: Tensor, compute: Callable[[Tensor], Tensor]) -> Tensor:
        """Collects the vectors of a batch.

        Args:
            index: ``(B,)`` int64 absolute frame indices.
            compute: From ``(M,)`` int64 rows of the batch to their ``(M, d)`` vectors; called if some are missing.

        Returns:
            ``(B, d)`` float32.
        """
        missing = self._values[index, 0].isnan().nonzero()[:, 0]
        if len(missing):
            self._values[index[missing]] = compute(missing).float()
        return self._values[index]
