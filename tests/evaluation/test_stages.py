"""The environment's own word on the stages agrees with the demonstrator who does them. Nothing is drawn here."""

import numpy as np
import pytest

from lerobot_buds.demos.attempts import STEPS_AFTER_SUCCESS, attempt
from lerobot_buds.envs import STAGE_FACTS, TASKS, EnvSettings, RobosuiteEnv, Task
from lerobot_buds.evaluation.trace import StageProgress

pytestmark = pytest.mark.slow


class WatchedEnv(RobosuiteEnv):
    """Keeps what it says of the stages, from the reset on."""

    def reset(self, **kwargs):
        observation, info = super().reset(**kwargs)
        self.stages_done = [info["stages_done"]]
        return observation, info

    def step(self, action):
        answer = super().step(action)
        self.stages_done.append(answer[-1]["stages_done"])
        return answer


def progress_of(task: Task, rows) -> list[int | None]:
    progress = StageProgress(task)
    for step, holds in enumerate(rows):
        progress.update(np.asarray(holds, dtype=bool), step)
    return progress.steps


@pytest.mark.parametrize("name", TASKS)
def test_a_demonstrator_does_every_stage_when_its_script_says_so(name: str) -> None:
    env, task = WatchedEnv(EnvSettings(name, draws=False)), TASKS[name]
    demonstration = attempt(env, 3)
    env.close()
    assert demonstration.success, demonstration.failure
    steps = progress_of(task, env.stages_done)
    true_stage = demonstration.arrays["true_stage"][:, 0]
    for number, step in enumerate(steps):
        frames = np.flatnonzero(true_stage == number)
        # What a stage aims at is reached within it, before the hand draws back.
        assert step is not None and frames[0] < step <= frames[-1] + 1, (task.stages[number], step, frames[[0, -1]])
    assert max(steps) == len(true_stage) - STEPS_AFTER_SUCCESS + 1  # the first step of success


def test_the_facts_are_those_of_the_stages_that_there_are() -> None:
    assert {stage for task in TASKS.values() for stage in task.stages} == set(STAGE_FACTS)


def task_of(needs: dict[str, tuple[str, ...]]) -> Task:
    return Task("test/task", "do", "kitchen", frozenset(), (), (), ("a", "b", "c"), needs=needs)


@pytest.mark.parametrize(
    ("needs", "rows", "expected"),
    [
        ({}, ["000", "100", "110", "111"], [1, 2, 3]),
        ({}, ["000", "100", "000", "010"], [1, 3, None]),  # done once is done
        ({}, ["000", "010", "000", "101"], [3, 1, 3]),  # out of order
        ({}, ["001", "001", "101", "110", "001"], [2, 3, 4]),  # c holds at first, and counts after a and b
        ({}, ["001", "000", "001"], [None, None, None]),
        ({}, ["011", "111"], [1, 1, 1]),  # a was all that b waited for, and b all that c waited for
        ({"b": ()}, ["010", "010"], [None, 0, None]),  # needs nothing and holds
        ({"c": ("a",)}, ["001", "101"], [1, None, 1]),
    ],
)
def test_progress_is_the_first_time_that_tells_something(needs, rows, expected) -> None:
    assert progress_of(task_of(needs), [[letter == "1" for letter in row] for row in rows]) == expected


def test_possible_stages_are_those_whose_needs_are_done() -> None:
    assert task_of({}).possible_stages([]) == [0]
    assert task_of({}).possible_stages([1]) == [0]
    assert task_of({}).possible_stages([0, 1]) == [2]
    assert task_of({"b": (), "c": ("b",)}).possible_stages([]) == [0, 1]
    assert task_of({"b": (), "c": ("b",)}).possible_stages([1]) == [0, 2]
    assert task_of({}).possible_stages([0, 1, 2]) == []
