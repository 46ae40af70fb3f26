"""Why rollouts failed, and what a run of them comes to."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from lerobot_buds.core import frames_of_seconds

from .rollouts import SuccessRate, success_rate
from .trace import Episode, RolloutRecord

WRONG_SKILL, MANIPULATION = "wrong_skill", "manipulation"
"""How a rollout fails (paper): the skill is wrong, as the state is unlike the demonstrations, or it is done badly."""

FOREIGN_SHARE = 0.5
"""Share of foreign decisions from which a failure counts as one of the skill (ours)."""

FAILURE_WINDOW_S = 10.0
"""How long after the last progress decisions are judged (ours): some two stages of a demonstrator. What a lost hand
does from then to the time limit does not tell why it is lost."""


def failure_of(episode: Episode, period: int, window: int) -> str | None:
    """Classifies a failed episode.

    Args:
        episode: The episode.
        period: Control steps for which a decision holds; the one in force at the last progress is judged as well.
        window: Control steps after the last progress in which decisions are judged.

    Returns:
        `WRONG_SKILL`, `MANIPULATION`, or None: it did not fail, was lost to an error, or nobody asked demonstrations.
    """
    if episode.success or episode.error:
        return None
    since = min(episode.last_progress, episode.length - 1)
    judged = [d.foreign for d in episode.decisions if since - period < d.step < since + window]
    if not judged or any(foreign is None for foreign in judged):
        return None
    return WRONG_SKILL if np.mean([bool(foreign) for foreign in judged]) >= FOREIGN_SHARE else MANIPULATION


def failures_of(record: RolloutRecord) -> list[str | None]:
    """Classifies all episodes of a record, see `failure_of`."""
    window = frames_of_seconds(record.settings["failure_window_s"], record.fps)
    return [failure_of(episode, record.period, window) for episode in record.episodes]


def summarise(record: RolloutRecord) -> dict[str, Any]:
    """Computes what a run comes to, as plain data; an episode that was lost to an error counts as that alone.

    Returns:
        ``episodes`` and ``errors`` (counts); ``success`` (see `SuccessRate`); ``stages`` (how many episodes did each,
        and when); ``failures`` (counts by class, None where they are not classified); ``foreign_decisions`` and
        ``replaced_decisions`` (shares in [0, 1]); ``switches`` of the skill and ``seconds``, means over the episodes;
        ``seconds_to_success``, over the successful ones. What there is nothing to compute from is None.
    """
    judged = [pair for pair in zip(record.episodes, failures_of(record), strict=True) if not pair[0].error]
    whole = [episode for episode, _ in judged]
    failures = [failure for episode, failure in judged if not episode.success]
    decisions = [decision for episode in whole for decision in episode.decisions]
    seconds = [episode.length / record.fps for episode in whole]
    return {
        "episodes": len(whole),
        "errors": len(record.episodes) - len(whole),
        "success": asdict(success_rate(len(whole) - len(failures), len(whole))) if whole else None,
        "stages": [_stage(name, [e.stage_steps[i] for e in whole], record.fps) for i, name in enumerate(record.stages)],
        "failures": None if None in failures else {name: failures.count(name) for name in (WRONG_SKILL, MANIPULATION)},
        "foreign_decisions": _mean([d.foreign for d in decisions if d.foreign is not None]),
        "replaced_decisions": _mean([d.skill != d.proposed for d in decisions]),
        "switches": _mean([episode.switches for episode in whole]),
        "seconds_to_success": _mean([s for s, episode in zip(seconds, whole, strict=True) if episode.success]),
        "seconds": _mean(seconds),
    }


def figures_of(record: RolloutRecord) -> list[tuple[str, str]]:
    """Says what a run comes to, as pairs of what is counted and how much of it there was."""
    summary = summarise(record)
    rows = [("episodes", _rate_in_words(summary["success"]))]
    rows += [(stage["name"], _stage_in_words(stage)) for stage in summary["stages"]]
    rows.append(("failures", _failures_in_words(summary["failures"])))
    if summary["foreign_decisions"] is not None:
        rows.append(("foreign decisions", f"{summary['foreign_decisions']:.0%}"))
    if summary["replaced_decisions"]:
        rows.append(("replaced decisions", f"{summary['replaced_decisions']:.0%}"))
    if summary["switches"] is not None:
        rows.append(("skill switches", f"{summary['switches']:.1f} an episode"))
        rows.append(("time", f"{summary['seconds']:.1f} s an episode"))
    if summary["seconds_to_success"] is not None:
        rows.append(("time to success", f"{summary['seconds_to_success']:.1f} s"))
    if summary["errors"]:
        rows.append(("lost to errors", f"{summary['errors']} more; run again to repeat them"))
    return rows


def summary_table(record: RolloutRecord) -> str:
    """Formats what a run comes to, one figure a line."""
    rows = figures_of(record)
    width = max(len(name) for name, _ in rows) + 2
    return "".join(f"{name:<{width}}{value}\n" for name, value in rows)


def _stage(name: str, steps: Sequence[int | None], fps: float) -> dict[str, Any]:
    seconds = [step / fps for step in steps if step is not None]
    return {"name": name, "done": len(seconds), "episodes": len(steps), "mean_seconds": _mean(seconds)}


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None


def _rate_in_words(success: dict[str, Any] | None) -> str:
    return "every episode was lost to an error" if success is None else str(SuccessRate(**success))


def _stage_in_words(stage: dict[str, Any]) -> str:
    if not stage["done"]:
        return f"0 of {stage['episodes']}"
    return f"{stage['done']} of {stage['episodes']}, after {stage['mean_seconds']:.1f} s on average"


def _failures_in_words(failures: dict[str, int] | None) -> str:
    if failures is None:
        return "not classified: that takes the segmented dataset (dataset_root)"
    return f"{failures[WRONG_SKILL]} wrong skill, {failures[MANIPULATION]} manipulation"
