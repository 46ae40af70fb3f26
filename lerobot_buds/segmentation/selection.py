"""Chooses the number of skills: the one whose clusters part the temporal segments best."""

from collections.abc import Mapping, Sequence

import numpy as np
from sklearn.metrics import silhouette_score

from lerobot_buds.core import FloatArray, IntArray

from .clustering import cluster, spread
from .partition import pooled_features

_MAX_SCORED = 1500


def choose_n_skills(
    latents: Sequence[FloatArray],
    bounds: Sequence[IntArray],
    most: int,
    *,
    num_keyframes: int,
    random_state: int,
    gamma: float | None = None,
) -> tuple[int, dict[int, float]]:
    """Clusters the segments into every number of skills and takes the best one (ours; the paper sets it by hand).

    Best is the highest silhouette: how much nearer a segment is to its own cluster than to the next one. Of many
    segments 1,500, evenly spread, stand for all.

    Args:
        latents: ``(T, D)`` latents of every demonstration.
        bounds: ``(S, 2)`` temporal segments of every demonstration, tiling it.
        most: Most skills to try.
        num_keyframes: Keyframes per segment.
        random_state: Seed.
        gamma: Width of the clustering's kernel; None for a width taken from the segments.

    Returns:
        The number of skills, and the silhouette of every number that was tried, in [-1, 1]. Fewer than three distinct
        segments are one skill.
    """
    features = pooled_features(latents, bounds, num_keyframes)
    if len(features) > _MAX_SCORED:
        features = features[spread(features, _MAX_SCORED)]
    scores: dict[int, float] = {}
    for count in range(2, min(most, len(np.unique(features, axis=0)) - 1) + 1):
        labels = cluster(features, count, random_state, gamma)
        if labels.max() + 1 == count:
            scores[count] = float(silhouette_score(features, labels))
    return best_count(scores), scores


def best_count(scores: Mapping[int, float]) -> int:
    """Picks the number with the highest silhouette, the lower one on ties; 1 where none was tried."""
    return max(scores, key=lambda count: (scores[count], -count), default=1)
