"""The baselines that need nothing but latents, with durations in seconds, by name."""

from collections.abc import Callable, Sequence

from lerobot_buds.core import FloatArray, IntArray, frames_of_seconds

from . import baselines, prediction, transport

SHORTEST_S = 1.0
SMOOTHING_S = 0.125
_UNIFORM_S = 2.0
_CELL_S = 0.25
_PRIOR_S = (4.0, 2.0)
_AHEAD_S, _SURPRISE_SMOOTHING_S = 0.5, 0.25
_PROTOTYPES = 12  # as many as `MAX_SKILLS`
_CONSISTENT_SHARE = 0.04  # of a demonstration, on either side of a frame; the release of ASOT

Cut = Callable[[Sequence[FloatArray], float], list[IntArray]]
"""From ``(T, D)`` latents of every demonstration and their frame rate (frames per second) to their ``(S, 2)`` spans."""


def _uniform(latents: Sequence[FloatArray], fps: float) -> list[IntArray]:
    length = frames_of_seconds(_UNIFORM_S, fps)
    return [baselines.uniform_segments(len(episode), length) for episode in latents]


def _kernel_change_points(latents: Sequence[FloatArray], fps: float) -> list[IntArray]:
    gamma, shortest = baselines.kernel_width(latents), frames_of_seconds(SHORTEST_S, fps)
    return [baselines.kernel_change_points(episode, shortest, gamma) for episode in latents]


def _mean_change_points(latents: Sequence[FloatArray], fps: float) -> list[IntArray]:
    shortest = frames_of_seconds(SHORTEST_S, fps)
    return [baselines.mean_change_points(episode, shortest) for episode in latents]


def _map_change_points(latents: Sequence[FloatArray], fps: float) -> list[IntArray]:
    cell, mean, spread, shortest = (frames_of_seconds(s, fps) for s in (_CELL_S, *_PRIOR_S, SHORTEST_S))
    return [baselines.map_change_points(episode, cell, mean, spread, shortest) for episode in latents]


def _visual_subgoals(latents: Sequence[FloatArray], fps: float) -> list[IntArray]:
    shortest = frames_of_seconds(SHORTEST_S, fps)
    return [baselines.visual_subgoals(episode, shortest, SMOOTHING_S * fps) for episode in latents]


def _prediction_error(latents: Sequence[FloatArray], fps: float) -> list[IntArray]:
    errors = prediction.prediction_errors(latents, frames_of_seconds(_AHEAD_S, fps))
    return prediction.surprising_moments(errors, frames_of_seconds(SHORTEST_S, fps), _SURPRISE_SMOOTHING_S * fps)


def _optimal_transport(latents: Sequence[FloatArray], fps: float) -> list[IntArray]:
    prototypes, shortest = transport.prototypes_of(latents, _PROTOTYPES), frames_of_seconds(SHORTEST_S, fps)
    radii = [max(1, round(_CONSISTENT_SHARE * len(episode))) for episode in latents]
    pairs = zip(latents, radii, strict=True)
    return [transport.transport_segments(episode, prototypes, radius, shortest) for episode, radius in pairs]


CUTS: dict[str, Cut] = {
    "kernel change points": _kernel_change_points,
    "mean change points": _mean_change_points,
    "MAP change points": _map_change_points,
    "UVD": _visual_subgoals,
    "prediction error": _prediction_error,
    "optimal transport": _optimal_transport,
    "uniform": _uniform,
}
"""How each baseline cuts all demonstrations; the same latents give the same cuts."""
