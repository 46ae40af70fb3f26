"""Skill discovery from latents: tree, temporal segments and skill partition behind one estimator."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from sklearn.base import BaseEstimator

from lerobot_buds.core import (
    ConfigError,
    FloatArray,
    IntArray,
    SegmentationError,
    frames_of_seconds,
    near_names,
    segments_of,
)

from .partition import dissolve_short_skills, partition_segments, renumber
from .temporal import temporal_segments
from .tree import FEATURES, Feature, adjacent_distances, build_tree, window_bounds

logger = logging.getLogger(__name__)


class SkillDiscovery(BaseEstimator):  # type: ignore[misc]
    """Segments demonstrations into skills, without any label (paper, bottom-up skill discovery).

    Follows scikit-learn: parameters are stored as given, `fit` sets the attributes with a trailing underscore. The
    result is the same for the same seed, whatever the order of the demonstrations (but for the skills' numbers) and
    however the latent space is rotated.

    Args:
        window: Frames per bottom element of the tree.
        max_skills: Most skills; ones that are too short on average are dissolved, so fewer may come out.
        n_skills: If given, exactly this many skills, none dissolved; `max_skills` and `min_skill_length` are not used.
        segments_per_episode: Temporal segments wanted per demonstration; None for twice the number of skills (notes).
        min_segment_length: Nodes of the tree of this many frames or fewer are not split.
        min_skill_length: Shortest mean segment of a skill (frames).
        num_keyframes: Latents that describe a segment, at least 2.
        feature: What describes a segment in the tree: ``mean`` over all frames (paper) or ``three_frames`` (release).
        length_penalty: Penalty per frame of merged length; 0 is the paper's rule, 1/5 the released code's.
        relative_penalty: Takes the penalty in units of the median distance between neighbouring bottom elements of the
            whole set, so that the scale of the latents does not matter; the release takes it in units of the latents.
        passes: Times the segments are clustered.
        gamma: Width of the clustering's kernel; None for a width taken from the segments.
        random_state: Seed of the clustering.

    Attributes:
        labels_: List of ``(T,)`` int64 arrays, the skill of every frame, in ``[0, n_skills_)``, numbered by first
            appearance.
        segments_: List of lists of `Segment`, the runs of equal skills.
        temporal_segments_: List of ``(S, 2)`` int64 half-open spans, before clustering.
        n_skills_: Number of skills K.
    """

    labels_: list[IntArray]
    temporal_segments_: list[IntArray]
    n_skills_: int

    def __init__(
        self,
        *,
        window: int = 10,
        max_skills: int = 8,
        n_skills: int | None = None,
        segments_per_episode: int | None = None,
        min_segment_length: int = 20,
        min_skill_length: int = 30,
        num_keyframes: int = 5,
        feature: Feature = "mean",
        length_penalty: float = 0.2,
        relative_penalty: bool = True,
        passes: int = 2,
        gamma: float | None = None,
        random_state: int = 0,
    ) -> None:
        self.window = window
        self.max_skills = max_skills
        self.n_skills = n_skills
        self.segments_per_episode = segments_per_episode
        self.min_segment_length = min_segment_length
        self.min_skill_length = min_skill_length
        self.num_keyframes = num_keyframes
        self.feature = feature
        self.length_penalty = length_penalty
        self.relative_penalty = relative_penalty
        self.passes = passes
        self.gamma = gamma
        self.random_state = random_state

    def check(self, lengths: Sequence[int]) -> None:
        """Refuses what cannot work whatever the latents are, so that it can be asked before there are any.

        Args:
            lengths: Frames of every demonstration.

        Raises:
            ConfigError: A parameter has a value that cannot work.
            SegmentationError: `n_skills` is more than the trees of these demonstrations have bottom elements.
        """
        self._check_parameters()
        self._check_enough([len(window_bounds(length, self.window)) for length in lengths])

    def fit(self, latents: Sequence[FloatArray], y: None = None, *, segments: Sequence[IntArray] | None = None) -> Self:
        """Discovers the skills of a set of demonstrations.

        Args:
            latents: One ``(T, D)`` float array of finite latents per demonstration, D the same for all. A demonstration
                shorter than two windows is one segment; one without frames has none.
            y: Not used.
            segments: Temporal segments from elsewhere, for example from `baselines`, in the place of the tree's:
                ``(S, 2)`` int64 half-open spans that tile each demonstration.

        Returns:
            This estimator, with its result in ``labels_``, ``segments_``, ``temporal_segments_`` and ``n_skills_``.

        Raises:
            ConfigError: A parameter has a value that cannot work.
            SegmentationError: A latent is not finite, or `n_skills` is more than there are segments.
        """
        self._check_parameters()
        episodes = _checked(latents)
        skills = self.n_skills or self.max_skills
        self.temporal_segments_ = self._segments(episodes, skills) if segments is None else _tiling(episodes, segments)
        self._check_enough([len(bounds) for bounds in self.temporal_segments_])
        labels = partition_segments(
            episodes,
            self.temporal_segments_,
            skills,
            num_keyframes=self.num_keyframes,
            passes=self.passes,
            random_state=self.random_state,
            gamma=self.gamma,
        )
        if self.n_skills is None:
            labels = dissolve_short_skills(episodes, labels, self.min_skill_length, self.num_keyframes)
        self.labels_ = renumber(labels)
        self.segments_ = [segments_of(episode) for episode in self.labels_]
        self.n_skills_ = 1 + max(int(episode.max()) for episode in self.labels_ if len(episode))
        if self.n_skills is not None and self.n_skills_ != self.n_skills:
            raise SegmentationError(
                f"n_skills = {self.n_skills} skills were asked for, but the segments fall into {self.n_skills_} "
                f"distinct groups only. Lower n_skills, or check that the latents differ within episodes."
            )
        return self

    def _segments(self, episodes: list[FloatArray], skills: int) -> list[IntArray]:
        """Cuts every demonstration by its tree."""
        wanted = self.segments_per_episode or 2 * skills
        unit = _median_distance(episodes, self.window, self.feature) if self.relative_penalty else 1.0

        def cut(episode: FloatArray) -> IntArray:
            if len(episode) == 0:
                return np.empty((0, 2), dtype=np.int64)
            tree = build_tree(episode, self.window, self.length_penalty * unit, self.feature)
            return temporal_segments(tree, wanted, self.min_segment_length)

        found = [cut(episode) for episode in episodes]
        counts = [len(bounds) for bounds in found]
        fewer = sum(count < wanted for count in counts)
        if fewer:
            logger.warning(
                "%d of %d demonstrations are too short for %d temporal segments and have fewer (least: %d).",
                fewer,
                len(counts),
                wanted,
                min(counts),
            )
        return found

    def _check_parameters(self) -> None:
        least = {
            "window": 1,
            "max_skills": 1,
            "n_skills": 1,
            "segments_per_episode": 1,
            "min_segment_length": 0,
            "min_skill_length": 0,
            "num_keyframes": 2,
            "length_penalty": 0,
            "passes": 1,
            "random_state": 0,
        }
        for name, low in least.items():
            value = getattr(self, name)
            if value is not None and not value >= low:
                raise ConfigError(f"Skill discovery: {name} = {value!r} cannot work; it must be at least {low}.")
        if self.feature not in FEATURES:
            raise ConfigError(
                f"Skill discovery: there is no feature {self.feature!r}. {near_names(self.feature, FEATURES)}"
            )
        if self.gamma is not None and not self.gamma > 0:
            raise ConfigError(f"Skill discovery: gamma = {self.gamma!r} cannot work; it must be positive.")

    def _check_enough(self, counts: list[int]) -> None:
        if self.n_skills is not None and self.n_skills > sum(counts):
            raise SegmentationError(
                f"n_skills = {self.n_skills} skills were asked for, but the {len(counts)} demonstrations have only "
                f"{sum(counts)} temporal segments. Lower n_skills to at most {sum(counts)}, shorten the window "
                f"({self.window} frames) or the minimum segment length ({self.min_segment_length} frames), or add "
                "demonstrations."
            )


@dataclass(frozen=True)
class DiscoveryConfig:
    """Settings of skill discovery, with durations in seconds so that they hold at any frame rate.

    The defaults are those published for the Kitchen task (20 frames per second).
    """

    window_s: float = 0.5
    """Length of the tree's bottom elements (seconds). Paper: 10 frames."""

    max_skills: int = 8
    """Most skills K_max. Implementation notes: 8 for Kitchen, 6 for Tool-Use and Hammer-Place, 10 for Multitask-
    Kitchen."""

    n_skills: int | None = None
    """If given, exactly this many skills, none dissolved. Ours; for the paper's table over K."""

    segments_per_episode: int | None = None
    """Temporal segments per demonstration; None for twice the skills. Implementation notes: 2."""

    min_segment_s: float = 1.0
    """Nodes of the tree up to this long are not split (seconds). Ours: two windows; the paper leaves it open."""

    min_skill_s: float = 1.5
    """Shortest mean segment of a skill (seconds). Released commands: 30 frames for Kitchen; 35 frames for Hammer-
    Place, 20 for Multitask-Kitchen."""

    num_keyframes: int = 5
    """Latents that describe a segment. Released code: 5 for the kitchens, 3 for the others."""

    feature: Feature = "mean"
    """What describes a segment in the tree: ``mean`` over all frames (paper), or ``three_frames`` (released code)."""

    length_penalty: float = 4.0
    """Penalty per second of merged length in the tree. Released code: 1/5 per frame; 0 is the paper."""

    relative_penalty: bool = True
    """Takes the penalty in units of the median distance between neighbouring bottom elements. Ours; the released code
    takes it in units of the latents, whose scale is arbitrary."""

    passes: int = 2
    """Times the segments are clustered. Released code: 2; paper: 1."""

    gamma: float | None = None
    """Width of the clustering's kernel; None for a width taken from the segments (ours). Released code: 0.0025 for all
    tasks but Hammer-Place, 0.0001, on latents of arbitrary scale."""

    seed: int = 0
    """Seed of the clustering. Ours; the release is not seeded."""

    def build(self, fps: float) -> SkillDiscovery:
        """Makes the estimator for a frame rate (frames per second)."""
        return SkillDiscovery(
            window=frames_of_seconds(self.window_s, fps),
            max_skills=self.max_skills,
            n_skills=self.n_skills,
            segments_per_episode=self.segments_per_episode,
            min_segment_length=frames_of_seconds(self.min_segment_s, fps),
            min_skill_length=frames_of_seconds(self.min_skill_s, fps),
            num_keyframes=self.num_keyframes,
            feature=self.feature,
            length_penalty=self.length_penalty / fps,
            relative_penalty=self.relative_penalty,
            passes=self.passes,
            gamma=self.gamma,
            random_state=self.seed,
        )


def preset(name: str, config: DiscoveryConfig) -> DiscoveryConfig:
    """Makes settings follow the paper or the released code wherever they depart from it.

    Task-dependent settings (numbers of skills and keyframes, durations) stay as they are.

    Args:
        name: ``default`` (ours; changes nothing), ``paper`` or ``released``.
        config: The settings to start from.

    Raises:
        ConfigError: There is no such preset.
    """
    if name not in PRESETS:
        raise ConfigError(f"There is no preset {name!r}. {near_names(name, PRESETS)}")
    return replace(config, **PRESETS[name])


PRESETS: dict[str, dict[str, Any]] = {
    "default": {},
    "paper": {"feature": "mean", "length_penalty": 0.0, "passes": 1},
    # Its search has no minimum, and its kernel width is that of all tasks but Hammer-Place.
    "released": {
        "feature": "three_frames",
        "length_penalty": 4.0,
        "relative_penalty": False,
        "passes": 2,
        "gamma": 0.05**2,
        "min_segment_s": 0.0,
    },
}
"""What the presets set; docs/segmentation.md says why."""


def _checked(latents: Sequence[FloatArray]) -> list[FloatArray]:
    episodes = [np.asarray(episode, dtype=np.float64) for episode in latents]
    if not any(len(episode) for episode in episodes):
        raise SegmentationError("There are no demonstrations to segment: no episode has any frame.")
    dims = episodes[0].shape[1:]
    for number, episode in enumerate(episodes):
        if episode.ndim != 2 or episode.shape[1:] != dims or dims[0] == 0:
            raise SegmentationError(
                f"The latents of episode {number} have shape {episode.shape}; (frames, dimensions) was expected, with "
                f"the dimensions of episode 0, {episodes[0].shape}."
            )
        bad = np.argwhere(~np.isfinite(episode))
        if len(bad):
            frame, dim = bad[0]
            raise SegmentationError(
                f"The latent of episode {number}, frame {frame}, dimension {dim} is {episode[frame, dim]} "
                f"({len(bad)} such values in this episode). Check the episode's frames, or train the representation "
                "again."
            )
    return episodes


def _tiling(episodes: list[FloatArray], segments: Sequence[IntArray]) -> list[IntArray]:
    """Refuses segments that do not tile the demonstrations."""
    if len(segments) != len(episodes):
        raise SegmentationError(
            f"There are segments of {len(segments)} demonstrations, but latents of {len(episodes)}."
        )
    for number, (episode, bounds) in enumerate(zip(episodes, segments, strict=True)):
        edges = [0, *bounds[:, 1].tolist()]
        if bounds[:, 0].tolist() != edges[:-1] or edges[-1] != len(episode) or (np.diff(edges) < 1).any():
            raise SegmentationError(
                f"The segments of demonstration {number} do not tile its {len(episode)} frames: {bounds.tolist()}."
            )
    return list(segments)


def _median_distance(episodes: list[FloatArray], window: int, feature: Feature) -> float:
    """Takes the unit of the length penalty from the data (ours): it must not depend on the scale of the latents."""
    distances = np.concatenate([adjacent_distances(episode, window, feature) for episode in episodes if len(episode)])
    # Episodes that stand still leave rounding errors, which are no unit.
    rounding = 1e-9 * max(float(np.abs(episode).max()) for episode in episodes if len(episode))
    moving = distances[distances > rounding]
    return float(np.median(moving)) if len(moving) else 1.0
