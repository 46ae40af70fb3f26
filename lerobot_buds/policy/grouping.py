"""Which rows of a batch belong to which of several networks, and what these compute put together again.

Rows are told apart on the host, which waits for a GPU once for each grouping; a step makes one and uses it throughout.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

Rows = Tensor | slice
"""Picks rows of a batch."""

SPREAD = 2.5
"""Standard deviations above the mean that `capacities` leave room for: some 1 % of the batches have more (ours)."""


@dataclass(frozen=True)
class Grouping:
    """Rows of a batch by the network that computes them.

    Attributes:
        numbers: Networks that compute something, in ascending order.
        rows: What each of them computes.
        back: ``(B,)`` int64 where every row of the batch is found among all that was computed; None where it is
            computed in order.
        sizes: Rows of every network that belong to it; where it computes more, the rest fills up.
    """

    numbers: tuple[int, ...]
    rows: tuple[Rows, ...]
    back: Tensor | None
    sizes: tuple[int, ...]

    @classmethod
    def whole(cls, size: int, number: int = 0) -> "Grouping":
        """One network computes all of `size` rows."""
        return cls((number,), (slice(None),), None, (size,))

    @classmethod
    def of(cls, number: Tensor) -> "Grouping":
        """Every row is computed once.

        Args:
            number: ``(B,)`` int64 network of every row, B at least 1.
        """
        here = number.cpu()
        order = torch.argsort(here, stable=True)
        numbers, counts = torch.unique_consecutive(here[order], return_counts=True)
        if len(numbers) == 1:
            return cls.whole(len(here), int(numbers))
        sizes = counts.tolist()
        rows = torch.split(_moved(order, number), sizes)
        return cls(tuple(numbers.tolist()), rows, _moved(torch.argsort(order), number), tuple(sizes))

    @classmethod
    def padded(cls, number: Tensor, capacities: Sequence[int]) -> "Grouping | None":
        """Every network computes as many rows as it has capacity for: the first row of the batch fills up.

        Of what is computed for that, `by_group` takes nothing, so that no gradient comes back either: this is exact for
        networks that compute every row for itself.

        Args:
            number: As in `of`.
            capacities: Rows of every network.

        Returns:
            None where a network has more rows than capacity.
        """
        if len(capacities) == 1:
            return cls.whole(len(number))
        here, room = number.cpu(), torch.tensor(capacities)
        counts = torch.bincount(here, minlength=len(room))
        if bool((counts > room).any()):
            return None
        order = torch.argsort(here, stable=True)
        first = room.cumsum(0) - room - (counts.cumsum(0) - counts)  # what a group's places are ahead of its order
        places = torch.arange(len(here)) + first[here[order]]
        rows = torch.zeros(int(room.sum()), dtype=torch.int64).index_copy(0, places, order)
        back = torch.empty_like(order).index_copy(0, order, places)
        split = torch.split(_moved(rows, number), list(capacities))
        return cls(tuple(range(len(room))), split, _moved(back, number), tuple(counts.tolist()))

    @property
    def tensors(self) -> tuple[Tensor, ...]:
        """What differs from batch to batch where sizes do not."""
        return () if self.back is None else (*(rows for rows in self.rows if isinstance(rows, Tensor)), self.back)

    def with_tensors(self, tensors: Sequence[Tensor]) -> "Grouping":
        """The same grouping of another batch, see `tensors`."""
        return self if self.back is None else replace(self, rows=tuple(tensors[:-1]), back=tensors[-1])


def by_group(grouping: Grouping, compute: Callable[[int, Rows], Sequence[Tensor]]) -> list[Tensor]:
    """Computes something for all rows of a batch, network by network.

    Args:
        grouping: Which network computes which rows.
        compute: Called with the number of a network and its rows; returns tensors with one row for each of them.

    Returns:
        The tensors of all networks put together, rows in the order of the batch.
    """
    parts = [compute(number, rows) for number, rows in zip(grouping.numbers, grouping.rows, strict=True)]
    if grouping.back is None:
        return list(parts[0])
    return [torch.cat(tensors)[grouping.back] for tensors in zip(*parts, strict=True)]


def capacities(counts: Tensor, batch: int) -> list[int]:
    """Says how many rows every network should have room for in batches that are drawn at random.

    Args:
        counts: ``(K,)`` int64 rows of every network among those seen so far.
        batch: Rows of a batch.
    """
    share = counts.double() / counts.sum()
    room = batch * share + SPREAD * (batch * share * (1 - share)).sqrt()
    return [min(batch, int(rows)) for rows in (room.ceil() + 1).tolist()]


def _moved(index: Tensor, like: Tensor) -> Tensor:
    return index.to(like.device, non_blocking=True)
