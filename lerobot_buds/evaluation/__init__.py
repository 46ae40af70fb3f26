"""Scores: agreement of segmentations, statistics of rollouts, distances of paths."""

from .agreement import Agreement, agreement, matched_boundaries
from .paths import warped_distances
from .rollouts import SuccessRate, read_success_rate, success_rate

__all__ = [
    "Agreement",
    "SuccessRate",
    "agreement",
    "matched_boundaries",
    "read_success_rate",
    "success_rate",
    "warped_distances",
]
