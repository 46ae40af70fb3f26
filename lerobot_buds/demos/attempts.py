"""One attempt of the scripted demonstrator, and the same from a seed alone for worker processes."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_buds.envs import TASKS, EnvSettings, RobosuiteEnv

from .motions import Action, Demonstrator, MotionFailedError
from .orders import draw_order
from .stages import STAGES

STEPS_AFTER_SUCCESS = 10
"""Recording ends once the goal has held for this long, as in the original's collection (control steps)."""

_LONGEST = 2000


@dataclass
class Attempt:
    """What happened from one seed.

    Attributes:
        seed: Seed of the environment and, with it, of the demonstrator.
        success: The goal was reached and held to the end.
        failure: Empty, or the stage and reason of the failure.
        arrays: One row a frame: a uint8 image array per camera, ``agent_pos``, ``action`` (executed in the state of the
            same row), ``true_stage``. Empty for a failed attempt.
    """

    seed: int
    success: bool
    failure: str = ""
    arrays: dict[str, NDArray[Any]] = field(default_factory=dict)


def attempt(env: RobosuiteEnv, seed: int, tremor_seed: int | None = None) -> Attempt:
    """Lets the demonstrator do the environment's task once.

    Args:
        env: The environment; its episode limit does not bind the demonstrator.
        seed: Determines the start and all of the demonstrator's variety.
        tremor_seed: Gives the same start and the same intentions another noise on the hand's command, where given.
    """
    observation, _ = env.reset(seed=seed)
    rows: dict[str, list[Any]] = {}
    stage_names = TASKS[env.task].stages
    held = stage = 0
    try:
        for stage, wish in _script(env, seed, tremor_seed):
            action = env.executed(wish)
            for name, value in _row(observation, action, stage).items():
                rows.setdefault(name, []).append(value)
            observation, _, success, _, _ = env.step(action)
            held = held + 1 if success else 0
            if held == STEPS_AFTER_SUCCESS:
                break
            if len(rows["action"]) > _LONGEST:
                raise MotionFailedError(f"the episode is longer than {_LONGEST} steps")
    except MotionFailedError as error:
        return Attempt(seed, False, f"{stage_names[stage]}: {error}")
    if not held:
        return Attempt(seed, False, f"{stage_names[stage]}: the goal does not hold at the end")
    return Attempt(seed, True, arrays={name: np.stack(values) for name, values in rows.items()})


def _script(env: RobosuiteEnv, seed: int, tremor_seed: int | None) -> Iterator[tuple[int, Action]]:
    tremor = None if tremor_seed is None else np.random.default_rng(tremor_seed)
    hand = Demonstrator(env.state, np.random.default_rng([seed, 1]), tremor)
    task = TASKS[env.task]
    order = draw_order(task, hand.rng)
    for number in order:
        for action in STAGES[task.stages[number]](hand):
            yield number, action
    for action in hand.hold(STEPS_AFTER_SUCCESS):
        yield order[-1], action


def _row(observation: dict[str, Any], action: Action, stage: int) -> dict[str, Any]:
    return {
        **observation["pixels"],
        "agent_pos": observation["agent_pos"],
        "action": action,
        "true_stage": np.array([stage], dtype=np.int64),
    }


_env_of_this_process: RobosuiteEnv | None = None


def attempt_in_worker(settings: EnvSettings, seed: int) -> Attempt:
    """Runs an attempt in a worker process, which keeps its environment from one attempt to the next."""
    global _env_of_this_process
    if _env_of_this_process is None or _env_of_this_process.settings != settings:
        _env_of_this_process = RobosuiteEnv(settings)
    return attempt(_env_of_this_process, seed)
