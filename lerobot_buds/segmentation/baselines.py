"""Other ways to cut a demonstration into temporal segments, to compare the tree with; the skill partition is the same.

Each takes one demonstration and returns ``(S, 2)`` int64 half-open spans in time order that tile ``[0, T)``. None is
random. Lengths are frames.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import argrelextrema
from scipy.spatial.distance import pdist

from lerobot_buds.core import ConfigError, FloatArray, IntArray, segments_of

_SAMPLE = 1000
_RESTING = 0.1
_VARIANCE_FLOOR = 1e-3
_MEDIAN_CHI_SQUARED = 0.455


def tile(cuts: Sequence[int] | IntArray, total: int, min_length: int = 1) -> IntArray:
    """Makes spans of ascending cuts; drops cuts that would leave a span, or an end, shorter than a minimum.

    Args:
        cuts: Frames at which a new segment begins.
        total: Number of frames T.
        min_length: Shortest span, at least 1; a demonstration shorter than two of them is one span.
    """
    if total == 0:
        return np.empty((0, 2), dtype=np.int64)
    edges = [0]
    for cut in cuts:
        if edges[-1] + min_length <= cut <= total - min_length:
            edges.append(int(cut))
    spans: IntArray = np.stack([edges, [*edges[1:], total]], axis=1).astype(np.int64)
    return spans


def stage_segments(stages: IntArray) -> IntArray:
    """Cuts where the true stages of the frames, ``(T,)``, change: the oracle."""
    return tile([segment.start for segment in segments_of(stages)[1:]], len(stages))


def uniform_segments(total: int, length: int) -> IntArray:
    """Cuts into windows of one length; the last one takes the rest as well."""
    return tile(range(length, total, length), total, length)


def kernel_width(episodes: Sequence[FloatArray]) -> float:
    """Chooses gamma of ``exp(-gamma ||x - y||^2)``: 1 / median squared distance of a thousand spread frames."""
    frames = np.concatenate(episodes)
    spread = frames[np.linspace(0, len(frames) - 1, min(_SAMPLE, len(frames))).astype(np.int64)]
    squared = pdist(spread, "sqeuclidean")
    moving = squared[squared > 0]
    return 1.0 / float(np.median(moving)) if len(moving) else 1.0


def kernel_change_points(latents: FloatArray, min_length: int, gamma: float, penalty: float = 3.0) -> IntArray:
    """Finds changes of distribution by kernel change-point detection (ruptures), in place of the paper's CHAMP.

    Args:
        latents: ``(T, D)`` latents.
        min_length: Shortest segment.
        gamma: Width of the Gaussian kernel, see `kernel_width`; ruptures' own choice would need ``T x T`` memory.
        penalty: Cost of a change, times ``ln T``. 3: measured on synthetic latents, see docs/segmentation.md.

    Raises:
        ConfigError: ruptures is not installed.
    """
    ruptures = _ruptures()
    if len(latents) < 2 * min_length:
        return tile([], len(latents))
    search = ruptures.KernelCPD(kernel="rbf", min_size=min_length, params={"gamma": gamma}).fit(latents)
    return tile(search.predict(pen=penalty * np.log(len(latents)))[:-1], len(latents), min_length)


def mean_change_points(latents: FloatArray, min_length: int, penalty: float = 3.0) -> IntArray:
    """Finds changes of the mean by Pelt (ruptures), with a penalty per dimension in units of the noise.

    Args:
        latents: ``(T, D)`` latents.
        min_length: Shortest segment.
        penalty: Cost of a change, times ``D ln T`` and the variance within windows of `min_length`.

    Raises:
        ConfigError: ruptures is not installed.
    """
    ruptures = _ruptures()
    if len(latents) < 2 * min_length:
        return tile([], len(latents))
    windows = [latents[s : s + min_length] for s in range(0, len(latents) - min_length + 1, min_length)]
    noise = float(np.mean([window.var(axis=0).mean() for window in windows]))
    cost = penalty * latents.shape[1] * np.log(len(latents)) * noise
    search = ruptures.Pelt(model="l2", min_size=min_length, jump=max(1, min_length // 4)).fit(latents)
    return tile(search.predict(pen=cost)[:-1], len(latents), min_length)


def map_change_points(latents: FloatArray, cell: int, mean_length: int, spread: int, min_length: int) -> IntArray:
    """Finds the most probable segmentation under CHAMP's model, exactly, by dynamic programming.

    A segment is a straight line in time with Gaussian noise in every dimension, fitted by maximum likelihood and
    charged by the Bayesian information criterion; its length has a Gaussian prior, cut off at `min_length` (Niekum et
    al. 2015, who search with particles). Observations are means over cells, because neighbouring frames are no
    independent draws.

    Args:
        latents: ``(T, D)`` latents.
        cell: Frames averaged to one observation; boundaries lie between cells.
        mean_length: Mean of the prior on lengths.
        spread: Its standard deviation.
        min_length: Shortest segment.
    """
    total = len(latents)
    starts = np.arange(0, total - cell + 1, cell)
    least, most = max(1, -(-min_length // cell)), (mean_length + 4 * spread) // cell
    if len(starts) < 2 * least:
        return tile([], total)
    observed = np.add.reduceat(latents, starts) / np.diff([*starts, total])[:, None]
    score = np.full(len(observed) + 1, -np.inf)
    score[0] = 0.0
    before = np.zeros(len(observed) + 1, dtype=np.int64)
    lines = _LineFits(observed)
    for end in range(least, len(observed) + 1):
        begin = np.arange(max(0, end - max(most, least)), end - least + 1)
        lengths = (end - begin) * cell
        prior = -0.5 * ((lengths - mean_length) / spread) ** 2 - np.log(spread)
        candidate = score[begin] + lines.evidence(begin, end) + prior
        best = int(np.argmax(candidate))
        score[end], before[end] = candidate[best], begin[best]
    cuts: list[int] = []
    end = len(observed)
    while (end := int(before[end])) > 0:
        cuts.append(int(starts[end]))
    return tile(cuts[::-1], total, min_length)


class _LineFits:
    """Answers the evidence of a straight line with noise for any span of observations, from prefix sums."""

    def __init__(self, observed: FloatArray) -> None:
        x = observed - observed.mean(axis=0)
        t = np.arange(len(x), dtype=np.float64)[:, None]
        first = np.zeros((1, x.shape[1]))
        self._x, self._xx, self._tx = (np.concatenate([first, np.cumsum(value, axis=0)]) for value in (x, x * x, t * x))
        # A few observations fit their line too well: no variance is less than what neighbours differ by. Half of the
        # squared difference is the variance, and its median that times the median of chi-squared.
        noise = np.median(np.diff(x, axis=0) ** 2, axis=0) / (2 * _MEDIAN_CHI_SQUARED)
        self._floor = noise + _VARIANCE_FLOOR * float(x.var()) + 1e-12
        self._dims = x.shape[1]

    def evidence(self, begin: IntArray, end: int) -> FloatArray:
        """Computes the log likelihood less the Bayesian charge of spans that end together, shape of `begin`."""
        n = (end - begin).astype(np.float64)[:, None]
        middle = (begin[:, None] + end - 1) / 2
        x, xx, tx = (sums[end] - sums[begin] for sums in (self._x, self._xx, self._tx))
        along = tx - middle * x
        steepness = np.maximum(n * (n * n - 1) / 12, 1e-12)
        residual = np.maximum(xx - x * x / n - along * along / steepness, 0.0) / n + self._floor
        likelihood = -0.5 * n[:, 0] * (np.log(2 * np.pi * residual) + 1).sum(axis=1)
        result: FloatArray = likelihood - 0.5 * 3 * self._dims * np.log(n[:, 0])
        return result


def visual_subgoals(latents: FloatArray, min_length: int, smoothing: float) -> IntArray:
    """Finds subgoals backwards from the last frame by UVD's criterion (Zhang et al., ICRA 2024).

    Before a subgoal is approached, the distance to it stops shrinking in time order: the last local maximum of the
    smoothed distance is the subgoal before it.

    Args:
        latents: ``(T, D)`` latents.
        min_length: Shortest segment; 18 frames in the release.
        smoothing: Standard deviation of the Gaussian that smooths distances (frames); 2.5 in the release.
    """
    goal, cuts = len(latents) - 1, list[int]()
    while goal >= 2 * min_length:
        distance = np.linalg.norm(latents[: goal + 1] - latents[goal], axis=1)
        maxima = argrelextrema(gaussian_filter1d(distance, smoothing, mode="nearest"), np.greater)[0]
        earlier = maxima[(maxima >= min_length) & (maxima <= goal - min_length)]
        if not len(earlier):
            break
        goal = int(earlier[-1])
        cuts.append(goal)
    return tile(cuts[::-1], len(latents), min_length)


def grip_and_rest(position: FloatArray, gripper: FloatArray, min_length: int, smoothing: float) -> IntArray:
    """Cuts where the gripper opens or closes and where the hand rests: the usual heuristic for keyframes.

    Args:
        position: ``(T, 3)`` positions of the hand.
        gripper: ``(T,)`` opening of the gripper; half way between its extremes parts open from closed.
        min_length: Shortest segment.
        smoothing: Standard deviation of the Gaussian that smooths speeds (frames).
    """
    total = len(position)
    if total < 2 * min_length:
        return tile([], total)
    is_open = gripper > (gripper.max() + gripper.min()) / 2
    grips = np.flatnonzero(np.diff(is_open)) + 1 if np.ptp(gripper) > 0 else np.empty(0, dtype=np.int64)
    speed = gaussian_filter1d(np.linalg.norm(np.diff(position, axis=0, prepend=position[:1]), axis=1), smoothing)
    rests = argrelextrema(speed, np.less_equal, order=min_length // 2)[0]
    rests = rests[speed[rests] < _RESTING * np.quantile(speed, 0.95)]
    # A change of grip is the surer sign: rests near one are dropped.
    lonely = [rest for rest in rests.tolist() if not len(grips) or np.abs(grips - rest).min() >= min_length]
    return tile(sorted([*grips.tolist(), *lonely]), total, min_length)


def _ruptures() -> Any:
    try:
        import ruptures
    except ImportError as error:
        raise ConfigError(
            "Change-point detection needs ruptures, which is not installed. Run: pip install 'lerobot_policy_buds[cp]'"
        ) from error
    return ruptures
