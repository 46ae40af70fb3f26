"""Skill discovery from latents: tree, temporal segments and skill partition behind one estimator."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Literal, Self

import numpy as np
from sklearn.base import BaseEstimator

from lerobot_buds.core import ConfigError, FloatArray, IntArray, SegmentationError, near_names, segments_of

from .checks import checked_latents, tiling
from .consolidate import consolidate
from .durations import MOVEMENT, SLIGHT, Durations, count_segments, median_count, min_skill_of, window_of
from .lines import LineFits, line_tree, settle_boundaries
from .partition import dissolve_short_skills, distinct_segments, partition_segments, renumber, spans_of
from .selection import choose_n_skills
from .stability import stability
from .temporal import SEARCHES, Search, temporal_segments
from .tree import FEATURES, Feature, TaskStructure, build_tree, median_distance, window_bounds

logger = logging.getLogger(__name__)


class SkillDiscovery(BaseEstimator):  # type: ignore[misc]
    """Segments demonstrations into skills, without any label (paper, bottom-up skill discovery).

    Follows scikit-learn: parameters are stored as given, `fit` sets the attributes with a trailing underscore. The
    result is the same for the same seed, whatever the order of the demonstrations (but for the skills' numbers) and
    however the latent space is rotated.

    Args:
        window: Frames per bottom element of the tree; None for a part of the median demonstration, see `durations`.
        max_skills: Most skills; ones that are too short on average are dissolved, so fewer may come out.
        n_skills: If given, exactly this many skills, none dissolved; `max_skills` and `min_skill_length` are not used
            for the last clustering. ``"auto"`` clusters into the number from 2 to `max_skills` that parts the segments
            best, see `choose_n_skills`, and then dissolves short skills. None for ``"auto"`` where pieces are
            consolidated, else for `max_skills` (paper).
        segments_per_episode: Temporal segments wanted per demonstration. None: by ``line``, as many as the
            demonstrations are worth, see `count_segments`; by other features, twice the number of skills (notes).
        segment_worth: Share of what moves in a demonstration that each of its segments must explain, by ``line``; None
            for one that is taken from the demonstrations, see `count_segments`.
        cutter: Cuts the demonstrations in the place of the tree, for example one of `CUTS`: from their latents to
            ``(S, 2)`` int64 half-open spans that tile each. None for the tree.
        search: How the tree is cut: by ``levels`` (paper), or ``best_first`` for an exact number of segments (ours).
        min_segment_length: Nodes of the tree of this many frames or fewer are not split; None for one window by
            ``line``, else two.
        min_skill_length: Shortest mean segment of a skill (frames); None for a part of the median demonstration.
        num_keyframes: Latents that describe a segment, at least 2.
        feature: What segments are merged by in the tree: a straight ``line`` (ours), the ``mean`` over all frames
            (paper) or ``three_frames`` (release).
        length_penalty: Penalty per frame of merged length; 0 is the paper's rule, 1/5 the released code's. A ``line``
            needs none.
        relative_penalty: Takes the penalty in units of the median distance between neighbouring bottom elements of the
            whole set, so that the scale of the latents does not matter; the release takes it in units of the latents.
        passes: Times the segments are clustered.
        consolidate: Joins skills that are pieces of one after every pass but an exact last one, see `consolidate`
            (ours).
        gamma: Width of the clustering's kernel; None for a width taken from the segments.
        random_state: Seed of the clustering.

    Attributes:
        labels_: List of ``(T,)`` int64 arrays, the skill of every frame, in ``[0, n_skills_)``, numbered by first
            appearance.
        segments_: List of lists of `Segment`, the runs of equal skills.
        temporal_segments_: List of ``(S, 2)`` int64 half-open spans, before clustering.
        n_skills_: Number of skills K.
        scores_: Where the number of skills was chosen, how well each number of clusters parts the segments; else empty.
        durations_: The lengths it worked with, see `Durations`.
        stability_: Set by `check_stability`.
    """

    labels_: list[IntArray]
    temporal_segments_: list[IntArray]
    n_skills_: int
    scores_: dict[int, float]
    durations_: Durations
    stability_: float

    def __init__(
        self,
        *,
        window: int | None = None,
        max_skills: int = 12,
        n_skills: int | Literal["auto"] | None = None,
        segments_per_episode: int | None = None,
        segment_worth: float | None = None,
        cutter: Callable[[Sequence[FloatArray]], list[IntArray]] | None = None,
        search: Search = "best_first",
        min_segment_length: int | None = None,
        min_skill_length: int | None = None,
        num_keyframes: int = 5,
        feature: Feature = "line",
        length_penalty: float = 0.2,
        relative_penalty: bool = True,
        passes: int = 2,
        consolidate: bool = True,
        gamma: float | None = None,
        random_state: int = 0,
    ) -> None:
        self.window = window
        self.max_skills = max_skills
        self.n_skills = n_skills
        self.segments_per_episode = segments_per_episode
        self.segment_worth = segment_worth
        self.cutter = cutter
        self.search = search
        self.min_segment_length = min_segment_length
        self.min_skill_length = min_skill_length
        self.num_keyframes = num_keyframes
        self.feature = feature
        self.length_penalty = length_penalty
        self.relative_penalty = relative_penalty
        self.passes = passes
        self.consolidate = consolidate
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
        if any(lengths):
            window = self.window or window_of(lengths)
            self._check_enough([len(window_bounds(length, window)) for length in lengths], window)

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
        lines = [LineFits(episode) for episode in episodes]
        own = segments is None and self.cutter is None and self.feature == "line"
        self.temporal_segments_ = self._cut(episodes, lines) if segments is None else tiling(episodes, segments)
        if segments is not None:
            self.durations_ = self._durations(episodes, [len(bounds) for bounds in segments])
        self._check_enough([len(bounds) for bounds in self.temporal_segments_], self.durations_.window)
        labels = self._partition(episodes, lines, settle=own)
        self.labels_ = renumber(labels)
        self.segments_ = [segments_of(episode) for episode in self.labels_]
        self.n_skills_ = 1 + max(int(episode.max()) for episode in self.labels_ if len(episode))
        if self._exact is not None and self.n_skills_ != self._exact:
            raise SegmentationError(
                f"n_skills = {self._exact} skills were asked for, but the segments fall into {self.n_skills_} distinct "
                "groups only. Lower n_skills, or check that the latents differ within episodes."
            )
        self._warn()
        return self

    def cut(self, latents: Sequence[FloatArray]) -> list[IntArray]:
        """Cuts demonstrations into temporal segments without looking for skills; sets ``durations_``.

        Args:
            latents: ``(T, D)`` latents of every demonstration.

        Returns:
            ``(S, 2)`` int64 half-open spans of every demonstration, tiling it.

        Raises:
            ConfigError: A parameter has a value that cannot work.
            SegmentationError: A latent is not finite.
        """
        self._check_parameters()
        episodes = checked_latents(latents)
        return self._cut(episodes, [LineFits(episode) for episode in episodes])

    def trees(self, latents: Sequence[FloatArray]) -> dict[int, TaskStructure]:
        """Builds the hierarchical task structures that `cut` cuts, to be looked at.

        Args:
            latents: ``(T, D)`` latents of every demonstration.

        Returns:
            Place of each demonstration that has frames -> its tree.

        Raises:
            ConfigError: A parameter has a value that cannot work.
            SegmentationError: A latent is not finite.
        """
        self._check_parameters()
        episodes = checked_latents(latents)
        return self._trees(episodes, [LineFits(episode) for episode in episodes])[0]

    def check_stability(self, latents: Sequence[FloatArray], runs: int = 2) -> float:
        """Measures how much of the result holds when the demonstrations differ slightly; sets ``stability_``.

        Args:
            latents: What it was fitted to.
            runs: Times to try.

        Returns:
            See `stability`.
        """
        self.stability_ = stability(self, latents, runs)
        return self.stability_

    def _durations(self, episodes: list[FloatArray], counts: Sequence[int]) -> Durations:
        """Makes the lengths of one fit; `counts` are the segments that each demonstration is worth, or has."""
        lengths = [len(episode) for episode in episodes]
        window = self.window or window_of(lengths)
        shortest = window if self.feature == "line" else 2 * window
        of_data = median_count(counts) if counts else 2 * (self._exact or self.max_skills)
        return Durations(
            window=window,
            min_segment_length=shortest if self.min_segment_length is None else self.min_segment_length,
            min_skill_length=min_skill_of(lengths) if self.min_skill_length is None else self.min_skill_length,
            segments_per_episode=self.segments_per_episode or of_data,
        )

    def _cut(self, episodes: list[FloatArray], lines: list[LineFits]) -> list[IntArray]:
        if self.cutter is not None:
            found = tiling(episodes, self.cutter(episodes))
            self.durations_ = self._durations(episodes, [len(bounds) for bounds in found])
            return found
        trees, added = self._trees(episodes, lines)
        full, counts, worth = list(trees), list[int](), 0.0
        if self.feature == "line":
            counts, worth = count_segments([lines[i] for i in full], added, self.segment_worth)
        self.durations_ = replace(self._durations(episodes, counts), segment_worth=worth)
        wanted, shortest = self.durations_.segments_per_episode, self.durations_.min_segment_length
        free = bool(counts) and self.segments_per_episode is None
        found = [np.empty((0, 2), dtype=np.int64)] * len(episodes)
        for number, (i, tree) in enumerate(trees.items()):
            count = counts[number] if free else wanted
            found[i] = temporal_segments(tree, count, shortest, self.search)
            if self.feature == "line":
                found[i] = settle_boundaries(lines[i], found[i], self.durations_.window)
        self._warn_of_few([len(found[i]) for i in full], wanted)
        return found

    def _trees(
        self, episodes: list[FloatArray], lines: list[LineFits]
    ) -> tuple[dict[int, TaskStructure], list[FloatArray]]:
        """Builds the tree of every demonstration that has frames; by ``line``, tells what each merge added to it."""
        window = self.window or window_of([len(episode) for episode in episodes])
        full = [number for number, episode in enumerate(episodes) if len(episode)]
        if self.feature == "line":
            made = {i: line_tree(lines[i], len(episodes[i]), window) for i in full}
            return {i: tree for i, (tree, _) in made.items()}, [costs for _, costs in made.values()]
        unit = median_distance(episodes, window, self.feature) if self.relative_penalty else 1.0
        return {i: build_tree(episodes[i], window, self.length_penalty * unit, self.feature) for i in full}, []

    def _partition(self, episodes: list[FloatArray], lines: list[LineFits], settle: bool) -> list[IntArray]:
        """Clusters the temporal segments in passes; each starts from the runs of equal skills of the last."""
        exact, self.scores_ = self._exact, {}
        chosen = self.n_skills == "auto" or (self.n_skills is None and self.consolidate)
        shortest, bounds = self.durations_.min_skill_length, self.temporal_segments_
        clustering: dict[str, Any] = {
            "num_keyframes": self.num_keyframes,
            "random_state": self.random_state,
            "gamma": self.gamma,
        }
        skills = exact or self.max_skills
        passes = self.passes
        while self.consolidate and passes > 1:
            labels = partition_segments(episodes, bounds, max(skills, self.max_skills), passes=1, **clustering)
            labels = dissolve_short_skills(episodes, labels, shortest, self.num_keyframes, least=2)
            labels = self._consolidated(labels, lines, settle)
            bounds = [spans_of(episode) for episode in labels]
            passes -= 1
        if exact is not None and exact > distinct_segments(episodes, bounds, self.num_keyframes):
            bounds = self.temporal_segments_
        if chosen:
            skills, self.scores_ = choose_n_skills(episodes, bounds, self.max_skills, **clustering)
        labels = partition_segments(episodes, bounds, skills, passes=passes, **clustering)
        if exact is not None:
            return labels
        labels = dissolve_short_skills(episodes, labels, shortest, self.num_keyframes)
        return self._consolidated(labels, lines, settle) if self.consolidate else labels

    def _consolidated(self, labels: list[IntArray], lines: list[LineFits], settle: bool) -> list[IntArray]:
        # Clear movements are no pieces of one another.
        clear = self.durations_.segment_worth >= MOVEMENT
        joined = consolidate(labels, lines, MOVEMENT if clear else SLIGHT)
        for i, (before, after) in enumerate(zip(labels, joined, strict=True)):
            runs = spans_of(after)
            if settle and 1 < len(runs) < len(spans_of(before)):
                settled = settle_boundaries(lines[i], runs, self.durations_.window)
                joined[i] = np.repeat(after[runs[:, 0]], settled[:, 1] - settled[:, 0])
        return joined

    def _warn_of_few(self, counts: list[int], wanted: int) -> None:
        fewer = sum(count < wanted for count in counts)
        if fewer and (self.feature != "line" or self.segments_per_episode is not None):
            logger.warning(
                "%d of %d demonstrations are too short for %d temporal segments and have fewer (least: %d). Set "
                "segments_per_episode to at most %d, or shorten the window (%d frames).",
                fewer,
                len(counts),
                wanted,
                min(counts),
                min(counts),
                self.durations_.window,
            )

    def _warn(self) -> None:
        if all(len(bounds) < 2 for bounds in self.temporal_segments_):
            logger.warning(
                "No demonstration was cut: nothing in the latents turns by more than their noise, or the "
                "demonstrations are shorter than two windows (%d frames each). Check what the representation keeps; to "
                "have them cut nevertheless, set segments_per_episode (and a shorter window).",
                self.durations_.window,
            )
        elif self.n_skills_ == 1 and self._exact is None:
            logger.warning(
                "All segments came out as one skill: they are short beside the demonstrations, or never occur apart. "
                "Where more are known to be there, set n_skills to their number."
            )

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
            "segment_worth": 0,
            "passes": 1,
            "random_state": 0,
        }
        for name, low in least.items():
            value = getattr(self, name)
            if value == "auto" and name == "n_skills":
                continue
            if value is not None and not (isinstance(value, int | float) and value >= low):
                raise ConfigError(f"Skill discovery: {name} = {value!r} cannot work; it must be at least {low}.")
        for name, known in (("feature", ("line", *FEATURES)), ("search", tuple(SEARCHES))):
            value = getattr(self, name)
            if value not in known:
                raise ConfigError(f"Skill discovery: there is no {name} {value!r}. {near_names(value, known)}")
        if self.gamma is not None and not self.gamma > 0:
            raise ConfigError(f"Skill discovery: gamma = {self.gamma!r} cannot work; it must be positive.")

    @property
    def _exact(self) -> int | None:
        return self.n_skills if isinstance(self.n_skills, int) else None

    def _check_enough(self, counts: list[int], window: int) -> None:
        if self._exact is not None and self._exact > sum(counts):
            raise SegmentationError(
                f"n_skills = {self.n_skills} skills were asked for, but the {len(counts)} demonstrations have only "
                f"{sum(counts)} temporal segments. Lower n_skills to at most {sum(counts)}, shorten the window "
                f"({window} frames), set segments_per_episode higher, or add demonstrations."
            )
