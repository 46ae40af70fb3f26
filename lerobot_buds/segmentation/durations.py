"""Lengths of windows, segments and skills, taken from the demonstrations where no setting gives them (ours)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lerobot_buds.core import FloatArray

from .lines import LineFits

WINDOWS = 50
"""Bottom elements in a demonstration of median length."""

SHORTEST_SKILL = 14
"""A skill's mean segment is at least this part of the median demonstration."""

MOVEMENT = 0.02
"""A movement of its own is what one line more explains, of all that moves in a demonstration (share)."""

CLEAR = 0.27
"""Movements are clear where the second line beyond them explains at most this part of what the last one does (median;
measured: up to 0.21 where stages are clean, 0.35 to 0.63 on recorded tasks)."""

DETAIL = 0.003
"""Where they are not, the demonstrations are cut finer, into all that explains this share, and pieces of one skill are
put together once they are known to recur (measured: docs/segmentation.md)."""

SLIGHT = 0.03
"""Pieces that never occur apart are put together where their boundary explains less than this share."""

NOISY = 4.0
"""A line must explain this many times what it would explain of mere noise, per parameter."""

MOST_SEGMENTS = 20
"""Most temporal segments that are taken from the data: twice ten skills (implementation notes)."""


@dataclass(frozen=True)
class Durations:
    """The lengths that a discovery worked with.

    Attributes:
        window: Frames per bottom element of the tree.
        min_segment_length: Nodes of the tree of this many frames or fewer are not split.
        min_skill_length: Shortest mean segment of a skill (frames).
        segments_per_episode: Temporal segments wanted per demonstration; where each is cut into its own number, the
            median.
        segment_worth: Share of what moves in a demonstration that its every segment explains; 0 where they were not
            counted by it.
    """

    window: int
    min_segment_length: int
    min_skill_length: int
    segments_per_episode: int
    segment_worth: float = 0.0


def window_of(lengths: Sequence[int]) -> int:
    """Takes the window from the lengths of the demonstrations (frames): a 50th of their median, at least two frames."""
    return max(2, round(_median(lengths) / WINDOWS))


def min_skill_of(lengths: Sequence[int]) -> int:
    """Takes the shortest mean segment of a skill from the lengths of the demonstrations (frames)."""
    return max(1, round(_median(lengths) / SHORTEST_SKILL))


def count_segments(
    lines: Sequence[LineFits], added: Sequence[FloatArray], worth: float | None = None
) -> tuple[list[int], float]:
    """Counts the temporal segments that demonstrations are worth, from what the merges of their trees cost.

    Args:
        lines: Fits of every demonstration.
        added: What each merge of its tree added to the residuals, see `line_tree`.
        worth: Share that a segment must explain; None for `MOVEMENT` where movements are clear, else `DETAIL`.

    Returns:
        The number of every demonstration, and the share that decided.
    """
    of_all: list[FloatArray] = []
    drops: list[float] = []
    for fits, costs in zip(lines, added, strict=True):
        real = costs[costs > 2 * NOISY * fits.noise] if fits.variation else costs[:0]
        shares = np.sort(real)[::-1] / (fits.variation or 1.0)
        of_all.append(shares)
        count = int((shares > MOVEMENT).sum())
        if count:
            drops.append(float(shares[count + 1] / shares[count - 1]) if count + 1 < len(shares) else 0.0)
    if worth is None:
        worth = MOVEMENT if drops and np.median(drops) <= CLEAR else DETAIL
    return [min(MOST_SEGMENTS, 1 + int((shares > worth).sum())) for shares in of_all], worth


def median_count(counts: Sequence[int]) -> int:
    """Takes the median of the demonstrations' temporal segments, half a segment upwards."""
    return max(1, int(np.median(counts) + 0.5))


def _median(lengths: Sequence[int]) -> float:
    return float(np.median([length for length in lengths if length > 0]))
