"""Runs one network per group of a batch: every row by the network that its number names."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

Rows = Tensor | slice
"""Picks rows of a batch."""


def by_group(number: Tensor, compute: Callable[[int, Rows], Sequence[Tensor]]) -> list[Tensor]:
    """Computes something for all rows of a batch, group by group.

    Args:
        number: ``(B,)`` int64 group of every row, B at least 1.
        compute: Called with the number of a group and its rows; returns tensors with one row for each of them.

    Returns:
        The tensors of all groups put together, rows in the order of the batch.
    """
    if len(number) == 1:
        return list(compute(int(number), slice(None)))
    order = torch.argsort(number, stable=True)
    groups, counts = torch.unique_consecutive(number[order], return_counts=True)
    if len(groups) == 1:
        return list(compute(int(groups), slice(None)))
    parts = [
        compute(group, rows) for group, rows in zip(groups.tolist(), torch.split(order, counts.tolist()), strict=True)
    ]
    back = torch.argsort(order)
    return [torch.cat(tensors)[back] for tensors in zip(*parts, strict=True)]
