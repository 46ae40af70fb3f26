"""Movements as straight lines in time: what cuts a demonstration where the motion turns (ours).

A stage of a demonstration is mostly a movement from one place to another, and its ends are where the hand rests. There
the mean of the latents hardly changes, so that segments told apart by their means end in the middle of movements; the
residual of a straight line does change, because a line cannot turn.
"""

from typing import Any

import numpy as np

from lerobot_buds.core import FloatArray, IntArray

from .tree import TaskStructure, window_bounds

_ROUNDS = 4


class LineFits:
    """Answers how far latents lie from a straight line in time, for any span, from prefix sums: O(T D) memory.

    Args:
        latents: ``(T, D)`` latents of one demonstration.
    """

    def __init__(self, latents: FloatArray) -> None:
        x = latents - latents.sum(axis=0) / max(1, len(latents))
        t = np.arange(len(x), dtype=np.float64)[:, None]
        zero = np.zeros((1, x.shape[1]))
        self._x, self._tx = (np.concatenate([zero, np.cumsum(value, axis=0)]) for value in (x, t * x))
        self._xx = np.concatenate([[0.0], np.cumsum(np.square(x).sum(axis=1))])
        # A second difference sees no line, and six times the variance of the noise.
        bends = np.square(np.diff(x, n=2, axis=0)).sum(axis=1)
        self.noise = float(bends.mean()) / 6 if len(bends) else 0.0
        """Variance of the noise from frame to frame, summed over the dimensions."""
        # Demonstrations that stand still leave rounding errors, which are no movement.
        rounding = latents.size * (1e-9 * float(np.abs(latents).max(initial=0.0))) ** 2
        self.variation = float(self._xx[-1]) if self._xx[-1] > rounding else 0.0
        """Squared distances of all latents from their mean, summed; 0 where nothing moves."""

    def residual(self, start: Any, end: Any) -> Any:
        """Sums the squared distances from the best line, for one span or for ``(S,)`` starts and ends."""
        n = np.asarray(end - start, dtype=np.float64)
        x = self._x[end] - self._x[start]
        middle = np.asarray((start + end - 1) / 2)
        along = self._tx[end] - self._tx[start] - middle[..., None] * x
        steepness = np.maximum(n * (n * n - 1) / 12, 1.0)  # 0 for single frames, whose `along` is 0 as well
        level = np.square(x).sum(axis=-1) / n
        slope = np.square(along).sum(axis=-1) / steepness
        return np.maximum(self._xx[end] - self._xx[start] - level - slope, 0.0)


def line_tree(lines: LineFits, total: int, window: int) -> tuple[TaskStructure, FloatArray]:
    """Merges the neighbours that one line fits best, until one segment spans the demonstration.

    Each step merges the pair, first on ties, whose merging adds least to the summed residuals.

    Args:
        lines: The demonstration's fits.
        total: Its number of frames T, at least 1.
        window: Frames per bottom element.

    Returns:
        The tree, and what each merge added, ``(n - 1,)`` in the order of their making.
    """
    bottom = window_bounds(total, window)
    count = len(bottom)
    bounds, children, added = bottom.tolist(), [[-1, -1]] * count, []
    # As in `build_tree`: a segment lives in the slot of its first bottom element.
    nodes, starts, ends = list(range(count)), bottom[:, 0].tolist(), bottom[:, 1].tolist()
    before, after = list(range(-1, count - 1)), list(range(1, count + 1))
    own = lines.residual(bottom[:, 0], bottom[:, 1])
    joint = np.append(lines.residual(bottom[:-1, 0], bottom[1:, 1]), np.inf)
    costs = np.append(joint[:-1] - own[:-1] - own[1:], np.inf)
    for new in range(count, 2 * count - 1):
        i = int(costs.argmin())
        j = after[i]
        added.append(float(costs[i]))
        children.append([nodes[i], nodes[j]])
        bounds.append([starts[i], ends[j]])
        own[i], nodes[i], ends[i], after[i] = joint[i], new, ends[j], after[j]
        costs[i] = costs[j] = np.inf
        if after[i] < count:
            before[after[i]] = i
        changed = [left for left in (before[i], i) if left >= 0 and after[left] < count]
        for left in changed:
            right = after[left]
            joint[left] = lines.residual(starts[left], ends[right])
            costs[left] = joint[left] - own[left] - own[right]
    return TaskStructure(np.array(bounds, dtype=np.int64), np.array(children, dtype=np.int64)), np.array(added)


def settle_boundaries(lines: LineFits, bounds: IntArray, min_length: int) -> IntArray:
    """Moves each boundary, between its neighbours, to where two lines fit best; a few rounds over all of them.

    Greedy merges put a boundary at the end of what they merged first, often the edge of a rest.

    Args:
        lines: The demonstration's fits.
        bounds: ``(S, 2)`` half-open spans that tile it.
        min_length: Shortest span (frames); shorter ones stay as they are.

    Returns:
        As many spans, which tile the demonstration.
    """
    edges = [0, *bounds[:, 1].tolist()]
    going = list(range(1, len(edges) - 1))
    for _ in range(_ROUNDS):
        moved: list[int] = []
        for i in going:
            start, end = edges[i - 1], edges[i + 1]
            places = np.arange(start + min_length, end - min_length + 1)
            if not len(places):
                continue
            cost = lines.residual(start, places) + lines.residual(places, end)
            place = int(places[int(cost.argmin())])
            if place != edges[i]:
                edges[i] = place
                moved.append(i)
        # Only the neighbours of what moved may have a better place now.
        going = sorted({k for i in moved for k in (i - 1, i, i + 1) if 0 < k < len(edges) - 1})
        if not going:
            break
    return np.stack([edges[:-1], edges[1:]], axis=1).astype(np.int64).reshape(-1, 2)
