"""Hierarchical task structure of one demonstration: windows of latents, merged pairwise into one tree.

Invariants: the bottom elements tile ``[0, T)``; every other node spans exactly its two children, earlier child first;
the last node is the root and spans ``[0, T)``.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt
from typing import Literal

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


class SegmentMeans:
    """Answers the mean latent of any span of one demonstration, from prefix sums.

    Args:
        latents: ``(T, D)`` float latents.
    """

    def __init__(self, latents: FloatArray) -> None:
        # Prefix sums of centred latents lose no digits to a common offset, and distances do not see it.
        centred = latents - latents.mean(axis=0)
        self._sums = np.concatenate([np.zeros((1, centred.shape[1])), np.cumsum(centred, axis=0)])

    def __call__(self, bounds: IntArray) -> FloatArray:
        """Averages the (centred) latents of spans.

        Args:
            bounds: ``(..., 2)`` half-open spans.

        Returns:
            ``(..., D)`` means over *all* frames of each span (paper; the released code takes three frames).
        """
        start, end = bounds[..., 0], bounds[..., 1]
        means: FloatArray = (self._sums[end] - self._sums[start]) / (end - start)[..., None]
        return means


def three_frames(latents: FloatArray) -> Callable[[IntArray], FloatArray]:
    """Makes the released code's feature: the mean latent of a span's first, middle and last frame.

    The last one is the first frame after the span, which neighbours share in the release; at the end, the last frame.
    """

    def feature(bounds: IntArray) -> FloatArray:
        start, last = bounds[..., 0], np.minimum(bounds[..., 1], len(latents) - 1)
        result: FloatArray = (latents[start] + latents[(start + last) // 2] + latents[last]) / 3
        return result

    return feature


Feature = Literal["mean", "three_frames"]
FEATURES: dict[Feature, Callable[[FloatArray], Callable[[IntArray], FloatArray]]] = {
    "mean": SegmentMeans,
    "three_frames": three_frames,
}
"""What describes a span in the tree: the paper's mean over all frames, or the released code's three."""


def adjacent_distances(latents: FloatArray, window: int, feature: Feature = "mean") -> FloatArray:
    """Measures the Euclidean distances between the features of adjacent bottom elements.

    Args:
        latents: ``(T, D)`` latents, T at least 1.
        window: Frames per bottom element.
        feature: A key of `FEATURES`.

    Returns:
        ``(n - 1,)`` distances.
    """
    means = FEATURES[feature](latents)(window_bounds(len(latents), window))
    distances: FloatArray = np.linalg.norm(np.diff(means, axis=0), axis=1)
    return distances


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
    bounds = bottom.tolist()
    children = [[-1, -1]] * count

    # The current segments in time order: their nodes, where they begin, and their features.
    nodes, edges, features = list(range(count)), [*bottom[:, 0].tolist(), len(latents)], list(describe(bottom))
    # Of segment i and segment i + 1: how far apart their features are, and how long they are together.
    distances = np.linalg.norm(np.diff(features, axis=0), axis=1)
    spans = (bottom[1:, 1] - bottom[:-1, 0]).astype(np.float64)
    for new in range(count, 2 * count - 1):
        pairs = len(nodes) - 1
        i = int((distances[:pairs] + length_penalty / len(nodes) * spans[:pairs]).argmin())
        children.append(nodes[i : i + 2])
        bounds.append([edges[i], edges[i + 2]])
        nodes[i : i + 2], features[i : i + 2], edges[i + 1 : i + 2] = [new], [describe(np.array(bounds[-1]))], []

        distances[i : pairs - 1], spans[i : pairs - 1] = distances[i + 1 : pairs], spans[i + 1 : pairs]
        for j in (i - 1, i):
            if 0 <= j < pairs - 1:
                apart = features[j] - features[j + 1]
                distances[j], spans[j] = sqrt(apart @ apart), edges[j + 2] - edges[j]
    return TaskStructure(np.array(bounds, dtype=np.int64), np.array(children, dtype=np.int64))
