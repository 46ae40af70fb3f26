"""Surveys the scripted demonstrators: success, length, replay and variety over many seeds, for docs/environments.md.

Every seed is one attempt. Some successful ones are replayed from their seed with their stored actions in a fresh
environment, and some are done again with the same intentions and another tremor, which is what noise alone changes.
Results are kept in a JSON file; an interrupted survey goes on with what is missing.

    python scripts/survey_demonstrators.py --seeds=200 --task=multitask_kitchen,tool_use
"""

import os
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field
from functools import cache, partial
from itertools import combinations
from multiprocessing import get_context
from pathlib import Path

import draccus
import numpy as np
from tqdm import tqdm

from lerobot_buds.core import read_json, write_json
from lerobot_buds.demos.attempts import attempt
from lerobot_buds.envs import TASKS, EnvSettings, RobosuiteEnv, tasks_named
from lerobot_buds.evaluation import success_rate, warped_distances

REPLAY_EVERY, TREMBLE_EVERY = 8, 10
PATH_EVERY = 5
"""Control steps between the points of a path that is kept."""

CHUNK = 20


@dataclass
class SurveyConfig:
    """What to survey."""

    task: str = ",".join(TASKS)
    """Tasks, comma-separated; a suite's name selects all of its tasks."""

    seeds: int = 200
    """Attempts a task, from seed 0."""

    output: str = "outputs/survey.json"
    """Where the results are kept."""


@dataclass(frozen=True)
class Outcome:
    """One attempt.

    Attributes:
        steps: Its length (control steps); 0 if it failed.
        failure: Why it failed.
        order: The stages in the order in which they were done.
        path: Hand positions (m), every fifth step.
        other_tremor: The same of the repetition with another tremor, if it had one that succeeded.
        replayed: Success of the replay; None if there was none.
        replay_error: How far a body ends from where it ended before, at most, in the replay (m).
    """

    steps: int = 0
    failure: str = ""
    order: list[int] = field(default_factory=list)
    path: list[list[float]] = field(default_factory=list)
    other_tremor: list[list[float]] = field(default_factory=list)
    replayed: bool | None = None
    replay_error: float = 0.0


@cache
def env_of_this_process(task: str) -> RobosuiteEnv:
    """Makes the environment of a task, once a process; its cameras are not drawn."""
    return RobosuiteEnv(EnvSettings(task, None, image_size=16, draws=False))


def survey_seed(task: str, seed: int) -> Outcome:
    """Attempts a task, and repeats some attempts."""
    env = env_of_this_process(task)
    result = attempt(env, seed)
    if not result.success:
        return Outcome(failure=result.failure)
    end, actions = body_positions(env), result.arrays["action"]
    stage = result.arrays["true_stage"][:, 0]
    trembled = attempt(env, seed, tremor_seed=seed + 1) if seed % TREMBLE_EVERY == 0 else None
    replayed, error = replay(env.settings, seed, actions, end) if seed % REPLAY_EVERY == 0 else (None, 0.0)
    return Outcome(
        steps=len(actions),
        order=stage[np.flatnonzero(np.diff(stage, prepend=-1))].tolist(),
        path=path_of(result.arrays),
        other_tremor=path_of(trembled.arrays) if trembled is not None and trembled.success else [],
        replayed=replayed,
        replay_error=error,
    )


def path_of(arrays: dict[str, np.ndarray]) -> list[list[float]]:
    """Takes the hand's path (m) out of an attempt, rounded to 0.1 mm."""
    path: list[list[float]] = arrays["agent_pos"][::PATH_EVERY, -3:].astype(float).round(4).tolist()
    return path


def body_positions(env: RobosuiteEnv) -> np.ndarray:
    """Reads where every body is (m), shape (bodies, 3)."""
    return np.array(env.simulation.sim.data.body_xpos)


def replay(settings: EnvSettings, seed: int, actions: np.ndarray, end: np.ndarray) -> tuple[bool, float]:
    """Executes stored actions from a seed, in a fresh environment; see `Outcome` for what it returns."""
    env = RobosuiteEnv(settings)
    env.reset(seed=seed)
    success = False
    for action in actions:
        _, _, success, _, _ = env.step(action)
    error = float(np.linalg.norm(body_positions(env) - end, axis=1).max())
    env.close()
    return success, error


def row(task: str, outcomes: list[Outcome]) -> str:
    """Formats one line of the table."""
    done = [o for o in outcomes if not o.failure]
    rate = success_rate(len(done), len(outcomes))
    steps = np.array([o.steps for o in done])
    replays = [o for o in done if o.replayed is not None]
    error_mm = 1000 * max(o.replay_error for o in replays)
    return " | ".join(
        (
            f"| {task}",
            f"{len(done)} of {len(outcomes)} ({rate.low:.1%} to {rate.high:.1%})",
            f"{steps.mean():.0f} ({steps.min()} to {steps.max()})",
            f"{steps.std() / steps.mean():.3f}",
            spread(done),
            f"{len(set(map(tuple, (o.order for o in done))))}",
            f"{sum(bool(o.replayed) for o in replays)} of {len(replays)} ({error_mm:.3f} mm) |",
        )
    )


def spread(done: Sequence[Outcome]) -> str:
    """Formats how far paths lie apart, and how far noise alone sets them apart (cm, dynamic time warping)."""
    pairs = list(combinations([np.array(o.path) for o in done[:100]], 2))
    alone = [(np.array(o.path), np.array(o.other_tremor)) for o in done if o.other_tremor]
    return f"{100 * warped_distances(pairs).mean():.1f} / {100 * warped_distances(alone).mean():.1f} cm"


def main() -> None:
    """Surveys what the output lacks, then prints the table and the failures."""
    config = draccus.parse(SurveyConfig)
    path = Path(config.output)
    done: dict[str, list[dict[str, object]]] = read_json(path) if path.exists() else {}
    tasks = [task.name for task in tasks_named(config.task)]
    bar = tqdm(total=config.seeds * len(tasks), unit="attempt", smoothing=0, dynamic_ncols=True)
    with ProcessPoolExecutor(len(os.sched_getaffinity(0)), mp_context=get_context("spawn")) as pool:
        # In rounds, so that an interrupted survey knows something of every task.
        for end in range(CHUNK, config.seeds + CHUNK, CHUNK):
            for task in tasks:
                known = done.setdefault(task, [])
                missing = range(len(known), min(end, config.seeds))
                known += [asdict(o) for o in pool.map(partial(survey_seed, task), missing)]
                write_json(path, done)
                bar.update(min(len(known), config.seeds) - max(end - CHUNK, 0))
    print(
        "| task | successful attempts | steps: mean (range) | variation | paths apart / by noise alone | orders "
        "| successful replays (largest error) |\n|---|---|---|---|---|---|---|"
    )
    for task in tasks:
        print(row(task, [Outcome(**outcome) for outcome in done[task]]))  # type: ignore[arg-type]
    for task in tasks:
        for failure, count in Counter(str(o["failure"]) for o in done[task] if o["failure"]).items():
            print(f"{task}: {count} x {failure}")


if __name__ == "__main__":
    main()
