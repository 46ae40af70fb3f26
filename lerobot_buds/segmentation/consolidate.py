"""Puts skills together that are pieces of one movement: they never occur apart, and one line fits both (ours).

A demonstration is cut more finely than its stages, so that no boundary is missed; the surplus is taken back here, where
all demonstrations have a say.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from lerobot_buds.core import FloatArray, IntArray, segments_of

from .lines import LineFits

TOGETHER = 0.8
"""Two skills are pieces of one where this share of the segments of both lie beside one of the other, in one order."""


def consolidate(labels: Sequence[IntArray], lines: Sequence[LineFits], slight: float) -> list[IntArray]:
    """Joins the skills that are pieces of one, those whose joining costs least first.

    Args:
        labels: ``(T,)`` skill of every frame, per demonstration.
        lines: Line fits of every demonstration.
        slight: Two are pieces of one where one line instead of two costs less than this share of what moves in a
            demonstration, in the median.

    Returns:
        New ``(T,)`` labels of every demonstration.
    """
    result = [episode.copy() for episode in labels]
    while (pair := _cheapest_pair(result, lines, slight)) is not None:
        for episode in result:
            episode[episode == pair[1]] = pair[0]
    return result


def _cheapest_pair(labels: Sequence[IntArray], lines: Sequence[LineFits], slight: float) -> tuple[int, int] | None:
    segments: dict[int, int] = {}
    costs: dict[tuple[int, int], list[FloatArray]] = {}
    for episode, fits in zip(labels, lines, strict=True):
        runs = segments_of(episode)
        for run in runs:
            segments[run.label] = segments.get(run.label, 0) + 1
        spans = np.array([run[:2] for run in runs], dtype=np.int64).reshape(-1, 2)
        own = fits.residual(spans[:, 0], spans[:, 1])
        joint = fits.residual(spans[:-1, 0], spans[1:, 1])
        shares = (joint - own[:-1] - own[1:]) / (fits.variation or 1.0)
        for (one, two), share in zip(pairwise(runs), shares, strict=True):
            costs.setdefault((one.label, two.label), []).append(share)
    found = [
        (float(np.median(shares)), pair)
        for pair, shares in costs.items()
        # Always in this order: two skills that take turns are rounds of work, and no pieces of one.
        if len(shares) >= TOGETHER * max(segments[pair[0]], segments[pair[1]])
        and len(costs.get(pair[::-1], ())) <= (1 - TOGETHER) * len(shares)
    ]
    cheapest = min(found, default=None)
    return cheapest[1] if cheapest is not None and cheapest[0] < slight else None
