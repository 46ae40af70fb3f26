"""Compares ways to cut demonstrations into temporal segments; the skill partition that follows is the same for all."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from sklearn.metrics import adjusted_rand_score

from lerobot_buds.core import (
    ConfigError,
    FloatArray,
    IntArray,
    frames_of_seconds,
    lengths_by_label,
    near_names,
    segments_of,
)
from lerobot_buds.segmentation import PRESETS, DiscoveryConfig, baselines, preset
from lerobot_buds.segmentation.cuts import CUTS, SHORTEST_S, SMOOTHING_S, Cut

from .agreement import Agreement, agreement, label_distance
from .matched import MatchedScores, matched_scores


@dataclass(frozen=True)
class Demonstrations:
    """What the methods look at, one array per demonstration, and what they are scored by.

    Attributes:
        latents: ``(T, D)`` latents.
        fused: ``(T, z)`` of them: what the auto-encoder fuses, without proprioception beside it.
        stages: ``(T,)`` true stages.
        position: ``(T, 3)`` positions of the hand.
        gripper: ``(T,)`` opening of the gripper.
        fps: Frames per second.
    """

    latents: Sequence[FloatArray]
    fused: Sequence[FloatArray]
    stages: Sequence[IntArray]
    position: Sequence[FloatArray]
    gripper: Sequence[FloatArray]
    fps: float


@dataclass(frozen=True)
class Result:
    """One method on one seed.

    Attributes:
        method: Its name.
        seed: The seed.
        labels: ``(T,)`` skill of every frame, per demonstration.
        scores: Agreement with the true stages.
        matched: The same as papers print it, of matched labels.
        label_distance: How differently demonstrations are labelled, see `label_distance`.
        seconds: From latents to labels (wall time).
        fps: Frames per second.
    """

    method: str
    seed: int
    labels: list[IntArray]
    scores: Agreement
    matched: MatchedScores
    label_distance: float
    seconds: float
    fps: float

    @property
    def n_skills(self) -> int:
        """Number of skills."""
        return len(np.unique(np.concatenate(self.labels)))

    @property
    def segments(self) -> float:
        """Mean number of segments of a demonstration."""
        return float(np.mean([len(segments_of(episode)) for episode in self.labels]))

    @property
    def skills(self) -> list[dict[str, float]]:
        """Per skill, the number of its segments and their mean length (seconds)."""
        lengths = lengths_by_label(map(segments_of, self.labels))
        return [
            {"segments": len(of_skill), "mean_seconds": float(np.mean(of_skill)) / self.fps}
            for of_skill in lengths.values()
        ]


def _grip_and_rest(data: Demonstrations) -> list[IntArray]:
    shortest, smoothing = frames_of_seconds(SHORTEST_S, data.fps), SMOOTHING_S * data.fps
    pairs = zip(data.position, data.gripper, strict=True)
    return [baselines.grip_and_rest(position, gripper, shortest, smoothing) for position, gripper in pairs]


def _true_stages(data: Demonstrations) -> list[IntArray]:
    return [baselines.stage_segments(stages) for stages in data.stages]


def _on_latents(cut: Cut) -> Callable[[Demonstrations], list[IntArray]]:
    return lambda data: cut(data.latents, data.fps)


BASELINES: dict[str, Callable[[Demonstrations], list[IntArray]]] = {
    **{name: _on_latents(cut) for name, cut in CUTS.items()},
    "grip and rest": _grip_and_rest,
    "true stages": _true_stages,
}
"""How each baseline cuts all demonstrations. The last one is an oracle."""

_FUSED_ALONE = ("paper", "released")  # proprioception beside the fused latent is ours

METHODS = (*PRESETS, *BASELINES)
"""All methods: the presets of ours, then the baselines."""


def compare(data: Demonstrations, config: DiscoveryConfig, seed: int, methods: Sequence[str] = METHODS) -> list[Result]:
    """Runs methods on the same demonstrations and scores them.

    Args:
        data: The demonstrations.
        config: Settings of skill discovery; all methods share those of the skill partition.
        seed: Seed of the clustering, for the results' names too.
        methods: Names out of `METHODS`.

    Raises:
        ConfigError: There is no such method, or ruptures is missing.
        SegmentationError: The latents are not finite.
    """
    for name in methods:
        if name not in METHODS:
            raise ConfigError(f"There is no method {name!r} to compare. {near_names(name, METHODS)}")
    return [_run(name, data, config, seed) for name in methods]


def _run(name: str, data: Demonstrations, config: DiscoveryConfig, seed: int) -> Result:
    began = time.perf_counter()
    segments = BASELINES[name](data) if name in BASELINES else None
    discovery = preset(name if segments is None else "default", config).build(data.fps)
    latents = data.fused if name in _FUSED_ALONE else data.latents
    labels = discovery.set_params(random_state=seed).fit(latents, segments=segments).labels_
    seconds = time.perf_counter() - began
    scores, matched = agreement(labels, data.stages, data.fps), matched_scores(labels, data.stages)
    return Result(name, seed, labels, scores, matched, label_distance(labels), seconds, data.fps)


def seed_stability(results: Sequence[Result]) -> float:
    """Averages the adjusted Rand index between the labels of every two seeds of one method; 1 for a single seed."""
    labels = [np.concatenate(result.labels) for result in results]
    return float(np.mean([adjusted_rand_score(a, b) for a, b in combinations(labels, 2)])) if labels[1:] else 1.0
