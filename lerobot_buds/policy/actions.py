"""Actions of any unit: what the outputs of the skills mean in the units of the dataset.

Networks learn numbers in [-1, 1]; robots take degrees, radians, metres, or one of two values. A checkpoint keeps the
bounds among its weights, so that it means the same wherever it is trained further.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor, nn

from lerobot_buds.core import ACTION, OUR_ACTION, OUR_FORMER_ACTION, OUR_STATE, ConfigError
from lerobot_buds.data import LocalDataset, dimension_names, read_table, require_finite

from .configuration_buds import BudsConfig

logger = logging.getLogger(__name__)

REACH = 0.9
"""What the bounds of the dataset are in the networks: well inside of tanh, where they can be learnt exactly (ours).

Checkpoints depend on it.
"""

TAIL, SPIKE = 1e-3, 5.0
"""Less than this share of the frames that widens the range of all others so many times is an outlier (ours)."""

_UNIT = 1 + 1e-6


@dataclass(frozen=True)
class ActionRange:
    """The actions of a dataset, dimension by dimension.

    Attributes:
        names: A names, or numbers where the dataset has none.
        low: ``(A,)`` float32 least value, in the dataset's unit.
        high: ``(A,)`` float32 greatest value.
        binary: Dimensions that take two values, again and again.
        outliers: Dimensions of which outliers were left out of `low` and `high`.
    """

    names: list[str]
    low: NDArray[np.float32]
    high: NDArray[np.float32]
    binary: list[int]
    outliers: list[int]

    @classmethod
    def read(cls, root: Path) -> Self:
        """Reads the actions of all frames.

        Args:
            root: Folder of a LeRobotDataset.

        Raises:
            DatasetError: The dataset is damaged, or an action is not finite (names episode, frame and dimension).
        """
        names = dimension_names(LocalDataset(root).features[ACTION])
        table = read_table(root, [ACTION])
        require_finite(table, ACTION, names)
        actions = table.columns[ACTION].reshape(len(table.present), -1)[table.present].astype(np.float32)
        low, high = actions.min(axis=0), actions.max(axis=0)
        inner_low, inner_high = np.quantile(actions, [TAIL, 1 - TAIL], axis=0).astype(np.float32)
        spiked = (inner_high > inner_low) & (high - low > SPIKE * (inner_high - inner_low))
        binary = [d for d, column in enumerate(actions.T) if _is_binary(column)]
        outliers = [int(d) for d in np.flatnonzero(spiked) if d not in binary]
        low[outliers], high[outliers] = inner_low[outliers], inner_high[outliers]
        return cls(names, low, high, binary, outliers)

    def named(self, dims: Sequence[int]) -> str:
        """Describes dimensions for messages, for example ``"'gripper.pos' (0 to 100)"``."""
        return ", ".join(f"{self.names[d]!r} ({self.low[d]:g} to {self.high[d]:g})" for d in dims)


def _is_binary(column: NDArray[np.float32]) -> bool:
    values, counts = np.unique(column, return_counts=True)
    return len(values) == 2 and counts.min() > 1


def choose_coding(config: BudsConfig, found: ActionRange) -> None:
    """Decides how actions are scaled and which are one of two values, where that is open.

    Recordings of our own environments, which are told by the names of state and action, keep the paper's head: a plain
    number in [-1, 1] for the gripper, too.

    Args:
        config: Changed in place; its state names are known.
        found: The actions of the dataset.

    Raises:
        ConfigError: The settings do not fit the actions.
    """
    inside = np.maximum(-found.low, found.high) <= _UNIT
    named_as_ours = tuple(config.state_names) == OUR_STATE and tuple(found.names) in (OUR_ACTION, OUR_FORMER_ACTION)
    ours = named_as_ours and bool(inside.all())
    if config.action_scaling is None:
        config.action_scaling = "none" if ours else "bounds"
    if config.binary_dims is None:
        config.binary_dims = [] if ours else found.binary
    else:
        _check_binary(config.binary_dims, found)
    scaled = [d for d in range(len(found.names)) if d not in config.binary_dims]
    beyond = [d for d in scaled if not inside[d]]
    if config.action_scaling == "none" and beyond:
        raise ConfigError(
            f"action_scaling='none' is for actions in [-1, 1]; beyond that are {found.named(beyond)}. Leave it out."
        )
    if config.binary_dims:
        logger.info("One of two values is chosen for the actions %s.", found.named(config.binary_dims))
    if config.action_scaling == "bounds":
        logger.info("Scaled to their bounds are the actions %s.", found.named(scaled))
        if outliers := [d for d in found.outliers if d in scaled]:
            logger.warning(
                "Less than %g %% of the frames reach far beyond these bounds, and are trained as if near them: %s. "
                "Such outliers are mostly faults of the recording.",
                100 * TAIL,
                found.named(outliers),
            )


def _check_binary(dims: Sequence[int], found: ActionRange) -> None:
    outside = [d for d in dims if not 0 <= d < len(found.names)]
    if outside:
        raise ConfigError(f"binary_dims: {outside} do not exist, the action has {len(found.names)} dimensions.")
    more = [d for d in dims if d not in found.binary and found.low[d] != found.high[d]]
    if more:
        raise ConfigError(f"binary_dims: {found.named(more)} take more than two values. Leave it out to have it found.")


class ActionCoding(nn.Module):
    """Translates between outputs of the skills, what they expect (in [-1, 1]) and actions of the dataset's unit.

    Of a plain dimension the expected value is tanh of the output (released code); `REACH` and -`REACH` are the bounds
    where actions are scaled, and constant ones come out exactly. Of a binary dimension the output is the logit of the
    greater value, the expected value twice its probability less 1, and the action the more probable value.

    Args:
        config: A configuration that is completed.
        found: The actions of the dataset; None where a checkpoint or a library will be loaded.
    """

    low: Tensor
    high: Tensor
    binary: Tensor

    def __init__(self, config: BudsConfig, found: ActionRange | None) -> None:
        super().__init__()
        size = int(config.action_feature.shape[0])
        self.is_scaled, self.has_binary = config.action_scaling == "bounds", bool(config.binary_dims)
        low, high = torch.full((size,), -1.0), torch.ones(size)
        if found is not None:
            low, high = torch.from_numpy(found.low.copy()), torch.from_numpy(found.high.copy())
        binary = torch.zeros(size, dtype=torch.bool)
        binary[list(config.binary_dims or [])] = True
        kept = self.is_scaled or self.has_binary  # else they say nothing
        self.register_buffer("low", low, persistent=kept)
        self.register_buffer("high", high, persistent=kept)
        self.register_buffer("binary", binary, persistent=False)

    def expected(self, output: Tensor) -> Tensor:
        """Computes what the skills expect, in [-1, 1], from their outputs; ``(..., A)`` both."""
        output = output.float()
        return torch.tanh(torch.where(self.binary, output / 2, output) if self.has_binary else output)

    def errors(self, output: Tensor, actions: Tensor) -> Tensor:
        """Computes the loss of outputs: squared errors in [-1, 1], cross-entropies of binary dimensions.

        Args:
            output: ``(..., A)`` outputs of the skills.
            actions: ``(..., A)`` actions in the dataset's unit.

        Returns:
            ``(...)`` sums over the dimensions.
        """
        errors = (self.expected(output) - self._encode(actions)).square()
        if self.has_binary:
            greater = (actions > (self.low + self.high) / 2).float()
            entropies = F.binary_cross_entropy_with_logits(output.float(), greater, reduction="none")
            errors = torch.where(self.binary, entropies, errors)
        return errors.sum(dim=-1)

    @torch.no_grad()
    def misses(self, output: Tensor, actions: Tensor) -> Tensor:
        """Computes mean absolute errors ``(...)`` of ``(..., A)`` outputs, in the dataset's unit, to be looked at."""
        return (self.decode(self.expected(output)) - actions).abs().mean(dim=-1)

    def distance(self, one: Tensor, other: Tensor) -> Tensor:
        """Computes squared distances ``(...)`` of ``(..., A)`` actions in the scale in which they are learnt."""
        return (self._encode(one) - self._encode(other)).square().sum(dim=-1)

    def decode(self, expected: Tensor) -> Tensor:
        """Turns what the skills expect into actions in the dataset's unit; ``(..., A)`` both."""
        actions = expected
        if self.is_scaled:
            actions = self.low + (self.high - self.low) * (expected / REACH + 1) / 2
        if self.has_binary:
            actions = torch.where(self.binary, torch.where(expected > 0, self.high, self.low), actions)
        return actions

    def warn_of_unreachable(self, found: ActionRange) -> None:
        """Warns of actions of a dataset that a checkpoint, which keeps its own bounds, cannot do.

        Args:
            found: The actions of the dataset.
        """
        ends = torch.ones_like(self.low)
        least, most = self.decode(-ends).cpu(), self.decode(ends).cpu()
        slack = 1e-4 * (most - least)
        low, high = torch.from_numpy(found.low), torch.from_numpy(found.high)
        beyond = ((low < least - slack) | (high > most + slack)).nonzero()[:, 0].tolist()
        if beyond:
            logger.warning(
                "The policy keeps the bounds of the actions that it was made for, and cannot reach all of %s in this "
                "dataset. Train a new policy to have others.",
                found.named(beyond),
            )

    def _encode(self, actions: Tensor) -> Tensor:
        if not self.is_scaled:
            return actions
        span = self.high - self.low
        gain = torch.where(span > 0, 2 * REACH / span, 0.0)
        return ((actions - (self.low + self.high) / 2) * gain).clamp(-1, 1)
