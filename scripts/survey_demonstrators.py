"""Surveys the scripted demonstrators: success, length and replay over many seeds, for docs/environments.md.

Every seed is one attempt; every fourth successful one is replayed from its seed with its stored actions. Results are
kept in a JSON file after every task, so that an interrupted survey goes on with the tasks that are missing.

    python scripts/survey_demonstrators.py --seeds=200 --task=multitask_kitchen,tool_use
"""

import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import draccus
import numpy as np
from tqdm import tqdm

from lerobot_buds.core import read_json, write_json
from lerobot_buds.demos.attempts import attempt_in_worker
from lerobot_buds.envs import TASKS, EnvSettings, RobosuiteEnv, tasks_named

REPLAY_EVERY = 4


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
    """One attempt: its length (steps; 0 if it failed), why it failed, and the success of its replay, if it had one."""

    steps: int
    failure: str
    replayed: bool | None


def survey_seed(task: str, seed: int) -> Outcome:
    """Attempts a task, with pictures too small to cost much, and replays some attempts."""
    settings = EnvSettings(task, None, image_size=16, render_profile="fastest")
    result = attempt_in_worker(settings, seed)
    if not result.success:
        return Outcome(0, result.failure, None)
    actions = result.arrays["action"]
    return Outcome(len(actions), "", replay(settings, seed, actions) if seed % REPLAY_EVERY == 0 else None)


def replay(settings: EnvSettings, seed: int, actions: np.ndarray) -> bool:
    """Executes stored actions from a seed, in a fresh environment; tells whether they end in success."""
    env = RobosuiteEnv(settings)
    env.reset(seed=seed)
    success = False
    for action in actions:
        _, _, success, _, _ = env.step(action)
    env.close()
    return success


def row(task: str, outcomes: list[Outcome]) -> str:
    """Formats one line of the table."""
    steps = np.array([o.steps for o in outcomes if not o.failure])
    replays = [o.replayed for o in outcomes if o.replayed is not None]
    spread = f"{steps.mean():.0f} ({steps.min()} to {steps.max()}) | {steps.std() / steps.mean():.2f}"
    return f"| {task} | {len(steps)} of {len(outcomes)} | {spread} | {sum(replays)} of {len(replays)} |"


def main() -> None:
    """Surveys every task that the output lacks, then prints the table."""
    config = draccus.parse(SurveyConfig)
    path = Path(config.output)
    done = read_json(path) if path.exists() else {}
    tasks = [task.name for task in tasks_named(config.task)]
    with ProcessPoolExecutor(len(os.sched_getaffinity(0)), mp_context=get_context("spawn")) as pool:
        for task in tasks:
            if len(done.get(task, [])) < config.seeds:
                outcomes = pool.map(partial(survey_seed, task), range(config.seeds))
                done[task] = [asdict(o) for o in tqdm(outcomes, total=config.seeds, desc=task)]
                write_json(path, done)
    print(
        "| task | successful attempts | steps: mean (range) | variation | successful replays |\n|---|---|---|---|---|"
    )
    for task in tasks:
        print(row(task, [Outcome(**outcome) for outcome in done[task]]))


if __name__ == "__main__":
    main()
