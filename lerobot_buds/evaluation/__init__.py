"""Scores: agreement of segmentations, statistics of rollouts."""

from .agreement import Agreement, agreement, matched_boundaries

__all__ = ["Agreement", "agreement", "matched_boundaries"]
