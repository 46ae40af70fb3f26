"""Scores: agreement of segmentations, statistics of rollouts, distances of paths."""

from .agreement import Agreement, agreement, label_distance, matched_boundaries
from .comparison import METHODS, Demonstrations, Result, compare
from .comparison_report import comparison_rows, comparison_table, draw_comparison
from .paths import warped_distances
from .rollouts import SuccessRate, read_success_rate, success_rate

__all__ = [
    "METHODS",
    "Agreement",
    "Demonstrations",
    "Result",
    "SuccessRate",
    "agreement",
    "compare",
    "comparison_rows",
    "comparison_table",
    "draw_comparison",
    "label_distance",
    "matched_boundaries",
    "read_success_rate",
    "success_rate",
    "warped_distances",
]
