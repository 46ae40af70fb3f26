"""An existing set of skills, for labelling further demonstrations: its temporal segments are the exemplars.

Old skills keep their numbers for ever; new ones are numbered behind them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from scipy.spatial.distance import pdist
from sklearn.cluster import AgglomerativeClustering
from sklearn.neighbors import KNeighborsClassifier, NearestNeighbors

from lerobot_buds.core import FloatArray, IntArray, SegmentationError

from .partition import dissolve_short_skills, frame_labels, pooled_features

NEIGHBORS = 5
"""Exemplars that vote on a segment."""

FAR = 2.0
"""A segment this many times as far from every exemplar as exemplars usually are from each other is like none of them
(ours, measured: docs/segmentation.md)."""

_USUAL = 0.95
_SAMPLE = 500


@dataclass(frozen=True)
class SkillLibrary:
    """The temporal segments of demonstrations that were segmented before, with the skill of each.

    Attributes:
        features: ``(N, k * D)`` keyframe features, see `pooled_features`.
        skills: ``(N,)`` int64 skills, in ``[0, n_skills)``.
        episodes: ``(N,)`` int64 number of the demonstration that each comes from.
        n_skills: Number of skills K; one may have no exemplar.
        num_keyframes: Keyframes per segment k.
    """

    features: FloatArray
    skills: IntArray
    episodes: IntArray
    n_skills: int
    num_keyframes: int

    @classmethod
    def of(
        cls,
        latents: Sequence[FloatArray],
        bounds: Sequence[IntArray],
        labels: Sequence[IntArray],
        n_skills: int,
        num_keyframes: int,
    ) -> Self:
        """Makes the library of a segmentation.

        Args:
            latents: ``(T, D)`` latents of every demonstration.
            bounds: ``(S, 2)`` temporal segments of every demonstration, each within one run of labels.
            labels: ``(T,)`` skill of every frame, per demonstration.
            n_skills: Number of skills K.
            num_keyframes: Keyframes per segment.
        """
        return cls(
            pooled_features(latents, bounds, num_keyframes),
            np.concatenate([episode[b[:, 0]] for episode, b in zip(labels, bounds, strict=True)]),
            np.repeat(np.arange(len(bounds), dtype=np.int64), [len(b) for b in bounds]),
            n_skills,
            num_keyframes,
        )

    @cached_property
    def reach(self) -> float:
        """How far an exemplar usually is from the nearest one of its skill in another demonstration (95th percentile).

        Infinite where no skill occurs in two demonstrations: nothing is far then.
        """
        nearest: list[FloatArray] = []
        for skill in np.unique(self.skills):
            of_skill = self.skills == skill
            for episode in np.unique(self.episodes[of_skill]):
                mine = of_skill & (self.episodes == episode)
                others = of_skill & (self.episodes != episode)
                if others.any():
                    search = NearestNeighbors(n_neighbors=1).fit(self.features[others])
                    nearest.append(search.kneighbors(self.features[mine])[0][:, 0])
        return float(np.quantile(np.concatenate(nearest), _USUAL)) if nearest else np.inf

    @cached_property
    def width(self) -> float:
        """How far two exemplars of one skill usually are from each other, in the widest skill (95th percentile)."""
        widths = []
        for skill in np.unique(self.skills):
            features = self.features[self.skills == skill]
            spread = features[np.linspace(0, len(features) - 1, min(_SAMPLE, len(features))).astype(np.int64)]
            widths.append(float(np.quantile(pdist(spread), _USUAL)) if len(spread) > 1 else 0.0)
        return max(widths)

    def label(
        self, latents: Sequence[FloatArray], bounds: Sequence[IntArray], *, grow: bool = False, min_length: int = 1
    ) -> list[IntArray]:
        """Labels demonstrations with the skills of their nearest exemplars.

        Args:
            latents: ``(T, D)`` latents of every demonstration, of the representation that made the exemplars.
            bounds: ``(S, 2)`` temporal segments of every demonstration, tiling it.
            grow: Opens new skills for segments that are far from all exemplars: as many as there are groups of them,
                none wider than the widest old skill.
            min_length: Shortest mean run that a new skill may have (frames).

        Returns:
            ``(T,)`` skill of every frame, per demonstration; new skills are numbered from `n_skills` on.

        Raises:
            SegmentationError: The latents are of another size than the library's.
        """
        features = pooled_features(latents, bounds, self.num_keyframes)
        if features.shape[1] != self.features.shape[1]:
            raise SegmentationError(
                f"The latents have {latents[0].shape[1]} dimensions, those of the library's exemplars "
                f"{self.features.shape[1] // self.num_keyframes}. Encode the demonstrations with the library's own "
                "representation."
            )
        neighbors = min(NEIGHBORS, len(self.features))
        vote = KNeighborsClassifier(n_neighbors=neighbors, weights="distance").fit(self.features, self.skills)
        found = vote.predict(features)
        if grow:
            far = vote.kneighbors(features, n_neighbors=1)[0][:, 0] > FAR * self.reach
            found[far] = self.n_skills + self._groups(features[far])
        labels = frame_labels(found, bounds)
        labels = dissolve_short_skills(latents, labels, min_length, self.num_keyframes, keep=range(self.n_skills))
        return self._compact(labels)

    def with_demonstrations(
        self, latents: Sequence[FloatArray], bounds: Sequence[IntArray], labels: Sequence[IntArray]
    ) -> Self:
        """Makes a library that has further demonstrations among its exemplars; for the arguments see `of`."""
        n_skills = max(self.n_skills, 1 + max(int(episode.max()) for episode in labels if len(episode)))
        new = type(self).of(latents, bounds, labels, n_skills, self.num_keyframes)
        return replace(
            new,
            features=np.concatenate([self.features, new.features]),
            skills=np.concatenate([self.skills, new.skills]),
            episodes=np.concatenate([self.episodes, new.episodes + 1 + self.episodes.max(initial=-1)]),
        )

    def _groups(self, features: FloatArray) -> IntArray:
        if len(features) < 2:
            return np.zeros(len(features), dtype=np.int64)
        search = AgglomerativeClustering(n_clusters=None, distance_threshold=self.width, linkage="average")
        groups: IntArray = search.fit_predict(features).astype(np.int64)
        return groups

    def _compact(self, labels: list[IntArray]) -> list[IntArray]:
        """Numbers the new skills by first appearance, behind the old ones."""
        values, first = np.unique(np.concatenate(labels), return_index=True)
        new = values[values >= self.n_skills]
        names = np.arange(values.max() + 1) if len(values) else np.empty(0, dtype=np.int64)
        names[new[np.argsort(first[values >= self.n_skills])]] = self.n_skills + np.arange(len(new))
        return [names[episode] for episode in labels]
