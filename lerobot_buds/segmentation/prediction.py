"""Cuts a demonstration where what comes next is hard to predict: the boundary of an event, as psychology has it."""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks
from sklearn.linear_model import Ridge
from sklearn.preprocessing import StandardScaler

from lerobot_buds.core import FloatArray, IntArray

from .baselines import tile

_GAUSSIAN = 1.4826
"""From the median absolute deviation to the standard deviation of a Gaussian."""


def prediction_errors(latents: Sequence[FloatArray], step: int, alpha: float = 1.0) -> list[FloatArray]:
    """Measures how well a linear model of all demonstrations predicts each frame's future.

    The model (ridge regression) sees the latents of a frame and of one step before, so that steady movement surprises
    nobody, and predicts the change until one step later. All dimensions count alike.

    Args:
        latents: ``(T, D)`` latents of every demonstration.
        step: How far it looks ahead and back (frames).
        alpha: Weight of the ridge.

    Returns:
        ``(T,)`` length of the error of every frame, in standard deviations of the latents. It is highest where movement
        turns; ends, which have no future or no past, repeat the nearest error.
    """
    scaled = StandardScaler().fit(np.concatenate(latents))
    long = [scaled.transform(episode) for episode in latents if len(episode) > 2 * step]
    if not long:
        return [np.zeros(len(episode)) for episode in latents]
    seen = [np.concatenate([x[step:-step], x[step:-step] - x[: -2 * step]], axis=1) for x in long]
    change = [x[2 * step :] - x[step:-step] for x in long]
    model = Ridge(alpha=alpha).fit(np.concatenate(seen), np.concatenate(change))
    surprises = iter(
        [np.linalg.norm(y - model.predict(x).reshape(y.shape), axis=1) for x, y in zip(seen, change, strict=True)]
    )
    return [
        np.pad(next(surprises), step, mode="edge") if len(episode) > 2 * step else np.zeros(len(episode))
        for episode in latents
    ]


def surprising_moments(
    errors: Sequence[FloatArray], min_length: int, smoothing: float, threshold: float = 1.0
) -> list[IntArray]:
    """Cuts where the error of prediction has a peak that stands out among the frames of all demonstrations.

    Args:
        errors: ``(T,)`` errors of every demonstration, see `prediction_errors`.
        min_length: Shortest segment (frames); of peaks that are nearer, the highest counts.
        smoothing: Standard deviation of the Gaussian that smooths errors (frames).
        threshold: How far above the median a peak must be, in robust standard deviations (ours, measured:
            docs/segmentation.md).

    Returns:
        ``(S, 2)`` half-open spans of every demonstration.
    """
    smooth = [gaussian_filter1d(error, smoothing, mode="nearest") for error in errors]
    pooled = np.concatenate(smooth)
    usual = float(np.median(pooled)) if len(pooled) else 0.0
    spread = _GAUSSIAN * float(np.median(np.abs(pooled - usual))) if len(pooled) else 0.0
    return [
        tile(
            find_peaks(error, height=usual + threshold * spread, distance=max(1, min_length))[0],
            len(error),
            min_length,
        )
        for error in smooth
    ]
