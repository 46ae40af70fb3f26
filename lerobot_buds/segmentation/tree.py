"""Hierarchical task structure of one demonstration: windows of latents, merged pairwise into one tree.

Invariants: the bottom elements tile ``[0, T)``; every other node spans exactly its two children, earlier child first;
the last node is the root and spans ``[0, T)``.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import sqrt
from typing import Any, Literal

import numpy as np

from lerobot_buds.core import FloatArray, IntArray, SegmentationError


@dataclass(frozen=True)
class TaskStructure:
    """Binary tree over the frames of one demonstration, with ``n`` bottom elements and ``2 n - 1`` nodes.

    Nodes ``0 .. n-1`` are the bottom elements in time order, the others the merges in the order of their making.

    Attributes:
        bounds: ``(2n-1, 2)`` int64, the half-open span ``[start, end)`` of every node (frames).
        children: ``(2n-1, 2)`` int64, the two children of every node, earlier first; -1 for bottom elements.
    """

    bounds: IntArray
    children: IntArray

    @property
    def root(self) -> int:
        """The node that spans the whole demonstration."""
        return len(self.bounds) - 1


def window_bounds(total: int, window: int) -> IntArray:
    """Cuts a demonstration into bottom elements.

    There are ``max(1, ceil((T - 1) / W) - 1)`` of them, all ``W`` frames long but the last, which swallows the rest
    and is ``W + 2`` to ``2 W + 1`` frames long where there are several (count: released code).

    Args:
        total: Number of frames T.
        window: Frames per element W, at least 1.

    Returns:
        ``(n, 2)`` half-open spans that tile ``[0, T)``; none for T = 0.
    """
    if total == 0:
        return np.empty((0, 2), dtype=np.int64)
    count = max(1, -(-(total - 1) // window) - 1)
    edges = np.append(np.arange(count, dtype=np.int64) * window, total)
    return np.stack([edges[:-1], edges[1:]], axis=1)


Describe = Callable[[Any, Any], FloatArray]
"""From first frame and end of a span, or ``(S,)`` arrays of them, to its feature, ``(D,)`` or ``(S, D)``."""


def means(latents: FloatArray) -> Describe:
    """Makes the paper's feature: the mean of *all* latents of a span, less their overall mean, which no distance sees.

    Args:
        latents: ``(T, D)`` latents of one demonstration.
    """
    # Prefix sums of centred latents lose no digits to a common offset.
    centred = latents - latents.mean(axis=0)
    sums = np.concatenate([np.zeros((1, centred.shape[1])), np.cumsum(centred, axis=0)])

    def feature(start: Any, end: Any) -> FloatArray:
        result: FloatArray = ((sums[end] - sums[start]).T / (end - start)).T
        return result

    return feature


def three_frames(latents: FloatArray) -> Describe:
    """Makes the released code's feature: the mean latent of a span's first, middle and last frame.

    The last one is the first frame after the span, which neighbours share in the release; at the end, the last frame.

    Args:
        latents: ``(T, D)`` latents of one demonstration.
    """

    def feature(start: Any, end: Any) -> FloatArray:
        last = np.minimum(end, len(latents) - 1)
        result: FloatArray = (latents[start] + latents[(start + last) // 2] + latents[last]) / 3
        return result

    return feature


Feature = Literal["line", "mean", "three_frames"]
FEATURES: dict[Feature, Callable[[FloatArray], Describe]] = {"mean": means, "three_frames": three_frames}
"""What describes a span in the tree: the paper's mean over all frames, or the released code's three. A ``line`` is told
by its residual instead, see `lines`."""


def adjacent_distances(latents: FloatArray, window: int, feature: Feature = "mean") -> FloatArray:
    """Measures the Euclidean distances between the features of adjacent bottom elements.

    Args:
        latents: ``(T, D)`` latents, T at least 1.
        window: Frames per bottom element.
        feature: A key of `FEATURES`.

    Returns:
        ``(n - 1,)`` distances.
    """
    features = FEATURES[feature](latents)(*window_bounds(len(latents), window).T)
    distances: FloatArray = np.linalg.norm(np.diff(features, axis=0), axis=1)
    return distances


def median_distance(episodes: Sequence[FloatArray], window: int, feature: Feature) -> float:
    """Takes the unit of the length penalty from the data (ours): it must not depend on the scale of the latents.

    Args:
        episodes: ``(T, D)`` latents of every demonstration.
        window: Frames per bottom element.
        feature: A key of `FEATURES`.
    """
    distances = np.concatenate([adjacent_distances(episode, window, feature) for episode in episodes if len(episode)])
    # Episodes that stand still leave rounding errors, which are no unit.
    rounding = 1e-9 * max(float(np.abs(episode).max()) for episode in episodes if len(episode))
    moving = distances[distances > rounding]
    return float(np.median(moving)) if len(moving) else 1.0


def build_tree(
    latents: FloatArray, window: int, length_penalty: float = 0.0, feature: Feature = "mean"
) -> TaskStructure:
    """Merges the most similar neighbours until one segment spans the demonstration (paper, hierarchical clustering).

    Each step merges the pair, first on ties, with the smallest
    ``||mean_i - mean_j|| + length_penalty * (len_i + len_j) / n``, n being the current number of segments. The second
    term, which keeps the tree balanced, is the released code's; the paper has none. A merge changes two neighbouring
    distances only, so the others are kept: ``O(n)`` per merge in numpy, the same tree as a full recomputation.

    Args:
        latents: ``(T, D)`` finite latents.
        window: Frames per bottom element.
        length_penalty: Penalty per frame of merged length, in the unit of the latents; 0 is the paper's rule.
        feature: A key of `FEATURES`: what describes a segment.

    Raises:
        SegmentationError: There are no frames.
    """
    if len(latents) == 0:
        raise SegmentationError("A demonstration without frames has no task structure; remove the empty episode.")
    describe = FEATURES[feature](latents)
    bottom = window_bounds(len(latents), window)
    count = len(bottom)
    bounds, children = bottom.tolist(), [[-1, -1]] * count

    # A segment lives in the slot of its first bottom element, and begins where that does. Of slot i: its node, its end,
    # its feature, and the slots of the segments before and after it.
    nodes, ends, features = list(range(count)), bottom[:, 1].tolist(), list(describe(*bottom.T))
    before, after = list(range(-1, count - 1)), list(range(1, count + 1))
    # Of the segment in slot i and the next one: how far apart their features are, and how long they are together.
    distances = np.append(np.linalg.norm(np.diff(features, axis=0), axis=1), np.inf)
    spans = np.append(bottom[1:, 1] - bottom[:-1, 0], 0).astype(np.float64)
    costs = np.empty(count)
    for new in range(count, 2 * count - 1):
        np.multiply(spans, length_penalty / (2 * count - new), out=costs)
        costs += distances
        i = int(costs.argmin())
        j = after[i]
        children.append([nodes[i], nodes[j]])
        bounds.append([bounds[i][0], ends[j]])
        nodes[i], ends[i], after[i] = new, ends[j], after[j]
        features[i] = describe(bounds[i][0], ends[i])
        distances[i] = distances[j] = np.inf
        if after[i] < count:
            before[after[i]] = i
        for left in (before[i], i):
            if left >= 0 and (right := after[left]) < count:
                apart = features[left] - features[right]
                distances[left], spans[left] = sqrt(apart.dot(apart)), ends[right] - bounds[left][0]
    return TaskStructure(np.array(bounds, dtype=np.int64), np.array(children, dtype=np.int64))
