"""Skill partition: the temporal segments of all demonstrations, clustered into skills by their keyframes.

Everything works on one label array per demonstration, so segments tile ``[0, T)`` whatever is merged or dissolved.
Nothing here depends on the order of the demonstrations, but for the names of the labels.
"""

import logging
from collections.abc import Container, Sequence

import numpy as np

from lerobot_buds.core import FloatArray, IntArray, Segment, segments_of

from .clustering import cluster

logger = logging.getLogger(__name__)


def keyframe_features(latents: FloatArray, bounds: IntArray, num_keyframes: int) -> FloatArray:
    """Describes segments by the latents of their first, last and evenly spaced middle frames (paper).

    Args:
        latents: ``(T, D)`` latents of one demonstration.
        bounds: ``(S, 2)`` half-open spans.
        num_keyframes: Keyframes per segment k, at least 2; 3 and 5 are the released settings.

    Returns:
        ``(S, k * D)`` concatenated latents.
    """
    start, last = bounds[:, :1], bounds[:, 1:] - 1
    frames = start + (last - start) * np.arange(num_keyframes) // (num_keyframes - 1)  # (S, k)
    features: FloatArray = latents[frames].reshape(len(bounds), num_keyframes * latents.shape[1])
    return features


def pooled_features(latents: Sequence[FloatArray], bounds: Sequence[IntArray], num_keyframes: int) -> FloatArray:
    """Describes the segments of all demonstrations, ``(N, k * D)`` in order; see `keyframe_features`."""
    return np.concatenate([keyframe_features(h, b, num_keyframes) for h, b in zip(latents, bounds, strict=True)])


def frame_labels(labels: IntArray, bounds: Sequence[IntArray]) -> list[IntArray]:
    """Spreads labels of pooled segments, ``(N,)``, over their frames: ``(T,)`` for every demonstration."""
    per_episode = np.split(labels, np.cumsum([len(b) for b in bounds])[:-1])
    return [np.repeat(of_segments, b[:, 1] - b[:, 0]) for of_segments, b in zip(per_episode, bounds, strict=True)]


def spans_of(labels: IntArray) -> IntArray:
    """Lists the runs of equal labels of one episode, ``(T,)``, as ``(S, 2)`` half-open spans."""
    return _spans(segments_of(labels))


def distinct_segments(latents: Sequence[FloatArray], bounds: Sequence[IntArray], num_keyframes: int) -> int:
    """Counts the segments with different keyframes; see `pooled_features`."""
    return len(np.unique(pooled_features(latents, bounds, num_keyframes), axis=0))


def partition_segments(
    latents: Sequence[FloatArray],
    bounds: Sequence[IntArray],
    n_clusters: int,
    *,
    num_keyframes: int,
    passes: int,
    random_state: int,
    gamma: float | None = None,
) -> list[IntArray]:
    """Labels every frame with the cluster of its segment, over all demonstrations.

    Args:
        latents: ``(T, D)`` latents of every demonstration.
        bounds: ``(S, 2)`` temporal segments of every demonstration, tiling it.
        n_clusters: Clusters asked for; fewer come out where there are fewer distinct segments.
        num_keyframes: Keyframes per segment.
        passes: Times to cluster. Each further pass starts from the runs of equal labels of the last (released code: 2).
        random_state: Seed.
        gamma: Width of the clustering's kernel; None for a width taken from the segments.

    Returns:
        ``(T,)`` labels of every demonstration; values ``0 .. k-1``, all present.
    """
    for _ in range(passes):
        features = pooled_features(latents, bounds, num_keyframes)
        labels = frame_labels(cluster(features, n_clusters, random_state, gamma), bounds)
        bounds = [spans_of(episode) for episode in labels]
    return labels


def dissolve_short_skills(
    latents: Sequence[FloatArray],
    labels: Sequence[IntArray],
    min_length: int,
    num_keyframes: int,
    keep: Container[int] = (),
    least: int = 1,
) -> list[IntArray]:
    """Gives the frames of skills whose mean run is too short to their neighbours in time (released code, made exact).

    The skills are chosen once; the shortest goes first, ties by lower label; the longest stays where all are too short.
    A run takes the label of the neighbour with the nearer keyframes: one that stays if there is one, the next on ties.
    A run that is a whole demonstration takes the skill that stays whose mean keyframes are nearest.

    Args:
        latents: ``(T, D)`` latents of every demonstration.
        labels: ``(T,)`` labels of every demonstration.
        min_length: Shortest mean run that a skill may have (frames).
        num_keyframes: Keyframes per segment.
        keep: Labels that stay, however short.
        least: Leaves all labels alone where fewer than this many would stay.

    Returns:
        New ``(T,)`` labels of every demonstration, out of the labels that stay.
    """
    runs = [segments_of(episode) for episode in labels]
    features = pooled_features(latents, [_spans(episode) for episode in runs], num_keyframes)
    owners = np.array([run.label for episode in runs for run in episode])
    lengths = np.array([run.length for episode in runs for run in episode])
    mean_length = {label: float(lengths[owners == label].mean()) for label in np.unique(owners).tolist()}
    ascending = sorted(mean_length, key=lambda label: (mean_length[label], label))
    short = [label for label in ascending if mean_length[label] < min_length and label not in keep]
    if len(ascending) - len(short) < least and least > 1:
        return [episode.copy() for episode in labels]
    if len(short) == len(ascending):
        longest = short.pop()
        logger.warning(
            "All %d skills are shorter than %d frames on average; only the longest stays. To keep more of them, set "
            "the shortest mean segment of a skill (min_skill_s) to at most %d frames.",
            len(ascending),
            min_length,
            mean_length[short[-1] if short else longest],
        )
    centroids = {label: features[owners == label].mean(axis=0) for label in ascending if label not in short}
    result = [episode.copy() for episode in labels]
    for i, label in enumerate(short):
        for episode, h in zip(result, latents, strict=True):
            _dissolve(label, short[i + 1 :], episode, h, centroids, num_keyframes)
    return result


def renumber(labels: Sequence[IntArray]) -> list[IntArray]:
    """Renames labels to ``0 .. K-1`` by first appearance, through the demonstrations in order."""
    _, first, inverse = np.unique(np.concatenate(labels), return_index=True, return_inverse=True)
    names = np.argsort(np.argsort(first)).astype(np.int64)
    return np.split(names[inverse], np.cumsum([len(episode) for episode in labels])[:-1])


def _dissolve(
    label: int,
    going: list[int],
    episode: IntArray,
    latents: FloatArray,
    centroids: dict[int, FloatArray],
    num_keyframes: int,
) -> None:
    runs = segments_of(episode)
    features = _run_features(latents, runs, num_keyframes)

    def cost(j: int) -> tuple[bool, float]:
        return runs[j].label in going, float(np.linalg.norm(features[j] - features[i]))

    # Two runs of one label are never neighbours, so no decision of this loop depends on another.
    for i, run in enumerate(runs):
        if run.label != label:
            continue
        neighbors = [j for j in (i + 1, i - 1) if 0 <= j < len(runs)]  # the next first: it wins ties
        if neighbors:
            episode[run.start : run.end] = runs[min(neighbors, key=cost)].label
        else:
            episode[:] = min(centroids, key=lambda k: float(np.linalg.norm(centroids[k] - features[0])))


def _run_features(latents: FloatArray, runs: list[Segment], num_keyframes: int) -> FloatArray:
    return keyframe_features(latents, _spans(runs), num_keyframes)


def _spans(runs: list[Segment]) -> IntArray:
    return np.array([run[:2] for run in runs], dtype=np.int64).reshape(-1, 2)
