"""How much of a segmentation holds when the demonstrations differ slightly."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from sklearn.base import clone
from sklearn.metrics import adjusted_rand_score

from lerobot_buds.core import FloatArray, SegmentationError

if TYPE_CHECKING:
    from .discovery import SkillDiscovery

NOISE = 0.01
"""Noise on the latents, as a share of their standard deviation over all frames and dimensions."""

LEFT_OUT = 0.2
"""Share of the demonstrations that each run does without."""


def stability(found: "SkillDiscovery", latents: Sequence[FloatArray], runs: int) -> float:
    """Repeats a discovery on slightly other demonstrations: noise on the latents, a fifth left out, another seed.

    Args:
        found: A fitted discovery.
        latents: ``(T, D)`` latents of every demonstration that it was fitted to.
        runs: Times to repeat it.

    Returns:
        Adjusted Rand index of both labels of the frames of the demonstrations that were kept, the mean over the runs: 1
        where nothing changes, 0 for chance.
    """
    rng = np.random.default_rng(found.random_state)
    scale = NOISE * float(np.sqrt(np.concatenate(latents).astype(np.float64).var(axis=0).mean()))
    full = [number for number, episode in enumerate(latents) if len(episode)]
    scores: list[float] = []
    for run in range(runs):
        kept = np.sort(rng.permutation(full)[: max(1, round((1 - LEFT_OUT) * len(full)))])
        other = clone(found).set_params(random_state=found.random_state + 1 + run)
        try:
            other.fit([latents[i] + scale * rng.normal(size=latents[i].shape) for i in kept])
        except SegmentationError:  # an exact number of skills that the others do not have
            scores.append(0.0)
            continue
        both = (
            np.concatenate([labels[i] for i in kept])
            for labels in (found.labels_, dict(zip(kept, other.labels_, strict=True)))
        )
        scores.append(float(adjusted_rand_score(*both)))
    return float(np.mean(scores))
