"""Segments of one episode, read from its per-frame label array.

The label array is the single truth: a segment is a maximal run of equal labels, half-open ``[start, end)``, so segments
always tile ``[0, T)`` and every boundary frame belongs to exactly one segment, the later one.
"""

from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]


class Segment(NamedTuple):
    """A half-open run of frames ``[start, end)`` of one episode with one label."""

    start: int
    end: int
    label: int

    @property
    def length(self) -> int:
        """Number of frames."""
        return self.end - self.start


def segments_of(labels: IntArray) -> list[Segment]:
    """Lists the runs of equal labels of one episode, in time order.

    Args:
        labels: ``(T,)`` integer labels, one per frame.
    """
    if len(labels) == 0:
        return []
    cuts = np.flatnonzero(np.diff(labels)) + 1
    bounds = [0, *cuts.tolist(), len(labels)]
    return [Segment(s, e, int(labels[s])) for s, e in pairwise(bounds)]


def labels_of(segments: list[Segment]) -> IntArray:
    """Writes segments that tile an episode back into its ``(T,)`` label array; inverse of `segments_of`."""
    parts = [np.full(s.length, s.label, dtype=np.int64) for s in segments]
    return np.concatenate(parts) if parts else np.empty(0, dtype=np.int64)


def lengths_by_label(episodes: Iterable[Iterable[Segment]]) -> dict[int, list[int]]:
    """Lists the lengths (frames) of the segments of every label that occurs, in ascending order of the labels."""
    lengths: dict[int, list[int]] = {}
    for segment in (segment for episode in episodes for segment in episode):
        lengths.setdefault(segment.label, []).append(segment.length)
    return dict(sorted(lengths.items()))


def subgoals_of(labels: IntArray, horizon: int) -> IntArray:
    """Computes every frame's subgoal ``g = min(t + H, e, T - 1)``, e being the end of the frame's segment.

    The subgoal of a segment's last frames is the *first frame of the next segment*: a skill aims at the boundary
    state without owning it (paper, section on skills; boundary rule ours).

    Args:
        labels: ``(T,)`` integer labels, one per frame.
        horizon: Subgoal horizon H (frames), at least 1.

    Returns:
        ``(T,)`` frame numbers within the episode.
    """
    total = len(labels)
    ends = np.empty(total, dtype=np.int64)
    for segment in segments_of(labels):
        ends[segment.start : segment.end] = segment.end
    subgoals: IntArray = np.minimum(np.minimum(np.arange(total) + horizon, ends), total - 1)
    return subgoals
