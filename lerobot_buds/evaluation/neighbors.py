"""Where a rollout is among the demonstrations: the frames nearest to a latent, and what was done there.

A search tree would not pay: latents have some forty dimensions, and which frames count changes with the stage.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d
from scipy.spatial.distance import cdist

from lerobot_buds.core import FloatArray, IntArray

NEIGHBORS = 5
"""Demonstrations that are asked at a decision; as many exemplars vote on a segment in skill discovery."""

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class DemonstrationFrames:
    """The frames of segmented demonstrations in the latent space of their representation.

    Attributes:
        latents: ``(N, D)`` float64 latents of all frames of the dataset.
        starts: ``(E,)`` absolute index of the first frame of every demonstration that may be asked.
        ends: ``(E,)`` one past their last frames.
        skills: ``(N,)`` int64 skill of every frame.
        subgoals: ``(N,)`` int64 absolute index of every frame's subgoal.
        n_skills: Number of skills K.
        reach: How far around a frame the labels count as being there (frames): labels change at one frame, while a
            decision is held for several.
    """

    latents: FloatArray
    starts: IntArray
    ends: IntArray
    skills: IntArray
    subgoals: IntArray
    n_skills: int
    reach: int

    @cached_property
    def skills_around(self) -> Mask:
        """Which skills occur within the reach of a frame and in the same demonstration, ``(N, K)`` bool."""
        around = np.zeros((len(self.skills), self.n_skills), dtype=np.bool_)
        for start, end in zip(self.starts, self.ends, strict=True):
            own = self.skills[start:end, None] == np.arange(self.n_skills)
            around[start:end] = maximum_filter1d(own, 2 * self.reach + 1, axis=0, mode="constant")
        return around

    def distances(self, latent: FloatArray) -> FloatArray:
        """Computes the Euclidean distance of every frame, ``(N,)``, from a latent ``(D,)``."""
        distances: FloatArray = cdist(latent[None], self.latents)[0]
        return distances

    def nearest(self, distances: FloatArray, count: int, allowed: Mask | None = None) -> IntArray:
        """Finds the nearest frames, one a demonstration.

        Args:
            distances: ``(N,)`` of all frames, see `distances`.
            count: How many are wanted.
            allowed: ``(N,)`` frames that may be found; all where None.

        Returns:
            Absolute indices, nearest first; fewer than `count` where fewer demonstrations have an allowed frame.
        """
        if allowed is not None:
            distances = np.where(allowed, distances, np.inf)
        best = np.array(
            [s + distances[s:e].argmin() for s, e in zip(self.starts, self.ends, strict=True)], dtype=np.int64
        )
        best = best[np.isfinite(distances[best])]
        nearest: IntArray = best[np.argsort(distances[best], kind="stable")[:count]]
        return nearest

    def is_foreign(self, skill: int, frames: IntArray) -> bool:
        """Tells whether a skill is in use around none of some frames."""
        return not self.skills_around[frames, skill].any()

    def majority_skill(self, frames: IntArray) -> int:
        """Tells the most frequent skill of some frames, nearest first; of equally frequent ones that of the nearest."""
        skills = self.skills[frames]
        votes = np.bincount(skills, minlength=self.n_skills)
        return int(skills[votes[skills].argmax()])

    def subgoal_frame(self, skill: int, distances: FloatArray, allowed: Mask | None = None) -> int | None:
        """Finds the frame that the nearest allowed frame of a skill has for its subgoal; None where there is none."""
        of_skill = self.skills == skill
        found = self.nearest(distances, 1, of_skill if allowed is None else of_skill & allowed)
        return int(self.subgoals[found[0]]) if len(found) else None
