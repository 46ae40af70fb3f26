"""Scores: agreement of segmentations, statistics of rollouts."""
