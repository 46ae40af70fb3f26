"""Which frames of demonstrations are pauses: from them nothing moves for a moment, by nothing but the recorded state.

People wait, and what is seen while they do is what is seen before they go on: a policy that learns both stops for good.
Nothing is assumed about what an action means.
"""

import numpy as np
from numpy.typing import NDArray

from lerobot_buds.core import IntArray

PAUSE_S = 0.25
"""How long nothing may move (s): a decision of the meta controller (ours, docs/ablations.md)."""

USUAL_PERCENTILE = 95
"""Movements of a dimension are measured by this one of its movements, which one far jump does not move (ours)."""

STILL_SHARE = 0.1
"""Less than this share of what is usual, in every dimension, is no movement (ours)."""


def is_pause(state: NDArray[np.floating], starts: IntArray, ends: IntArray, frames: int) -> NDArray[np.bool_]:
    """Finds the pauses; the last frames of an episode, behind which nothing is known, are none.

    Args:
        state: ``(N, D)`` recorded state, in any units.
        starts: ``(E,)`` row of every episode's first frame.
        ends: ``(E,)`` one past its last.
        frames: For how many nothing may move.

    Returns:
        ``(N,)``; False in rows of no episode.
    """
    moved = np.full(state.shape, np.nan)
    for start, end in zip(starts, ends, strict=True):
        known = max(start, end - frames)
        moved[start:known] = np.abs(state[start + frames : end].astype(np.float64) - state[start:known])
    rows = ~np.isnan(moved).any(axis=1)
    pauses = np.zeros(len(state), dtype=bool)
    if not rows.any():
        return pauses
    usual = np.percentile(moved[rows], USUAL_PERCENTILE, axis=0)
    usual = np.where(usual == 0, moved[rows].max(axis=0), usual)  # a gripper that hardly ever moves
    moves = usual > 0
    if moves.any():
        pauses[rows] = (moved[rows][:, moves] < STILL_SHARE * usual[moves]).all(axis=1)
    return pauses
