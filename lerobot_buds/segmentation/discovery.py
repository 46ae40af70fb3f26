"""Skill discovery from latents: tree, temporal segments and skill partition behind one estimator."""

import logging
from collections.abc import Callable, Sequence
from typing import Any, Literal, Self

import numpy as np
from sklearn.base import BaseEstimator

from lerobot_buds.core import ConfigError, FloatArray, IntArray, SegmentationError, near_names, segments_of

from .checks import checked_latents, tiling
from .partition import dissolve_short_skills, partition_segments, renumber
from .selection import choose_n_skills
from .temporal import SEARCHES, Search, temporal_segments
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
            ``"auto"`` clusters into the number from 2 to `max_skills` that parts the segments best, see
            `choose_n_skills`, and then dissolves short skills as without it.
        segments_per_episode: Temporal segments wanted per demonstration; None for twice the number of skills (notes).
        cutter: Cuts the demonstrations in the place of the tree, for example one of `CUTS`: from their latents to
            ``(S, 2)`` int64 half-open spans that tile each. None for the tree.
        search: How the tree is cut: by ``levels`` (paper), or ``best_first`` for an exact number of segments (ours).
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
        scores_: With ``n_skills="auto"``, how well each number of clusters parts the segments; else empty.
    """

    labels_: list[IntArray]
    temporal_segments_: list[IntArray]
    n_skills_: int
    scores_: dict[int, float]

    def __init__(
        self,
        *,
        window: int = 10,
        max_skills: int = 10,
        n_skills: int | Literal["auto"] | None = None,
        segments_per_episode: int | None = None,
        cutter: Callable[[Sequence[FloatArray]], list[IntArray]] | None = None,
        search: Search = "levels",
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
        self.cutter = cutter
        self.search = search
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
        episodes = checked_latents(latents)
        exact = self._exact
        skills, self.scores_ = exact or self.max_skills, {}
        self.temporal_segments_ = self._cut(episodes, skills) if segments is None else tiling(episodes, segments)
        self._check_enough([len(bounds) for bounds in self.temporal_segments_])
        clustering: dict[str, Any] = {
            "num_keyframes": self.num_keyframes,
            "random_state": self.random_state,
            "gamma": self.gamma,
        }
        if self.n_skills == "auto":
            skills, self.scores_ = choose_n_skills(episodes, self.temporal_segments_, self.max_skills, **clustering)
        labels = partition_segments(episodes, self.temporal_segments_, skills, passes=self.passes, **clustering)
        if exact is None:
            labels = dissolve_short_skills(episodes, labels, self.min_skill_length, self.num_keyframes)
        self.labels_ = renumber(labels)
        self.segments_ = [segments_of(episode) for episode in self.labels_]
        self.n_skills_ = 1 + max(int(episode.max()) for episode in self.labels_ if len(episode))
        if exact is not None and self.n_skills_ != exact:
            raise SegmentationError(
                f"n_skills = {exact} skills were asked for, but the segments fall into {self.n_skills_} distinct "
                "groups only. Lower n_skills, or check that the latents differ within episodes."
            )
        return self

    def cut(self, latents: Sequence[FloatArray]) -> list[IntArray]:
        """Cuts demonstrations into temporal segments without looking for skills.

        Args:
            latents: ``(T, D)`` latents of every demonstration.

        Returns:
            ``(S, 2)`` int64 half-open spans of every demonstration, tiling it.

        Raises:
            ConfigError: A parameter has a value that cannot work.
            SegmentationError: A latent is not finite.
        """
        self._check_parameters()
        return self._cut(checked_latents(latents), self._exact or self.max_skills)

    def _cut(self, episodes: list[FloatArray], skills: int) -> list[IntArray]:
        if self.cutter is not None:
            return tiling(episodes, self.cutter(episodes))
        wanted = self.segments_per_episode or 2 * skills
        unit = _median_distance(episodes, self.window, self.feature) if self.relative_penalty else 1.0

        def cut(episode: FloatArray) -> IntArray:
            if len(episode) == 0:
                return np.empty((0, 2), dtype=np.int64)
            tree = build_tree(episode, self.window, self.length_penalty * unit, self.feature)
            return temporal_segments(tree, wanted, self.min_segment_length, self.search)

        found = [cut(episode) for episode in episodes]
        counts = [len(bounds) for bounds in found]
        fewer = sum(count < wanted for count in counts)
        if fewer:
            logger.warning(
                "%d of %d demonstrations are too short for %d temporal segments and have fewer (least: %d). "
                "If most are, set segments_per_episode to about twice the skills of one demonstration.",
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
            if value == "auto" and name == "n_skills":
                continue
            if value is not None and not (isinstance(value, int | float) and value >= low):
                raise ConfigError(f"Skill discovery: {name} = {value!r} cannot work; it must be at least {low}.")
        for name, known in (("feature", FEATURES), ("search", SEARCHES)):
            value = getattr(self, name)
            if value not in known:
                raise ConfigError(f"Skill discovery: there is no {name} {value!r}. {near_names(value, known)}")
        if self.gamma is not None and not self.gamma > 0:
            raise ConfigError(f"Skill discovery: gamma = {self.gamma!r} cannot work; it must be positive.")

    @property
    def _exact(self) -> int | None:
        return self.n_skills if isinstance(self.n_skills, int) else None

    def _check_enough(self, counts: list[int]) -> None:
        if self._exact is not None and self._exact > sum(counts):
            raise SegmentationError(
                f"n_skills = {self.n_skills} skills were asked for, but the {len(counts)} demonstrations have only "
                f"{sum(counts)} temporal segments. Lower n_skills to at most {sum(counts)}, shorten the window "
                f"({self.window} frames) or the minimum segment length ({self.min_segment_length} frames), or add "
                "demonstrations."
            )


def _median_distance(episodes: list[FloatArray], window: int, feature: Feature) -> float:
    """Takes the unit of the length penalty from the data (ours): it must not depend on the scale of the latents."""
    distances = np.concatenate([adjacent_distances(episode, window, feature) for episode in episodes if len(episode)])
    # Episodes that stand still leave rounding errors, which are no unit.
    rounding = 1e-9 * max(float(np.abs(episode).max()) for episode in episodes if len(episode))
    moving = distances[distances > rounding]
    return float(np.median(moving)) if len(moving) else 1.0
