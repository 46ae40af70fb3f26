"""One attempt of the scripted demonstrator, and the same from a seed alone for worker processes."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_buds.core import ConfigError, near_names
from lerobot_buds.envs import TASKS, EnvSettings, RobosuiteEnv, Task

from .motions import Action, Demonstrator, MotionFailedError
from .orders import draw_order
from .people import Person
from .stages import STAGES
from .vocabulary import Stage

STEPS_AFTER_SUCCESS = 10
"""Recording ends once the goal has held for this long, as in the original's collection (control steps)."""

MANNERS = {"scripted": Demonstrator, "people": Person}
"""Who demonstrates, by the manner that recordings name."""

_LONGEST = {"scripted": 2000, "people": 4000}
"""Length of an attempt (control steps) beyond which it has failed."""


@dataclass(frozen=True)
class Style:
    """How demonstrations are made, and what is kept of them as their action.

    Attributes:
        manner: One of `MANNERS`.
        clean_actions: The action of a row is what was meant, without the tremor that was executed with it.
    """

    manner: str = "scripted"
    clean_actions: bool = False

    def __post_init__(self) -> None:
        if self.manner not in MANNERS:
            raise ConfigError(f"There is no manner {self.manner!r}. {near_names(self.manner, MANNERS)}")


@dataclass
class Attempt:
    """What happened from one seed.

    Attributes:
        seed: Seed of the environment and, with it, of the demonstrator.
        success: The goal was reached and held to the end.
        failure: Empty, or the stage and reason of the failure.
        arrays: One row a frame: a uint8 image array per camera, ``agent_pos``, ``action`` (executed in the state of the
            same row, or what was meant by it, see `Style`), ``true_stage``. Empty for a failed attempt.
        retries: Names of the stages in which something was missed and done again, once each time.
    """

    seed: int
    success: bool
    failure: str = ""
    arrays: dict[str, NDArray[Any]] = field(default_factory=dict)
    retries: list[str] = field(default_factory=list)


_AS_EVER = Style()


def attempt(env: RobosuiteEnv, seed: int, tremor_seed: int | None = None, style: Style = _AS_EVER) -> Attempt:
    """Lets the demonstrator do the environment's task once.

    Args:
        env: The environment; its episode limit does not bind the demonstrator.
        seed: Determines the start and all of the demonstrator's variety.
        tremor_seed: Gives the same start and the same intentions another noise on the hand's command, where given.
        style: How it is done, and what is kept of it.

    Raises:
        ConfigError: Nothing is known of how to do a stage.
    """
    observation, _ = env.reset(seed=seed)
    tremor = None if tremor_seed is None else np.random.default_rng(tremor_seed)
    hand = MANNERS[style.manner](env.state, np.random.default_rng([seed, 1]), tremor)
    rows: dict[str, list[Any]] = {}
    stage_names, retries = TASKS[env.task].stages, list[str]()
    held = stage = 0
    try:
        for stage, wish in _script(TASKS[env.task], hand):
            retries += [stage_names[stage]] * (hand.retries - len(retries))
            action = env.executed(wish)
            kept = env.executed(hand.intention) if style.clean_actions else action
            for name, value in _row(observation, kept, stage).items():
                rows.setdefault(name, []).append(value)
            observation, _, success, _, _ = env.step(action)
            held = held + 1 if success else 0
            if held == STEPS_AFTER_SUCCESS:
                break
            if len(rows["action"]) > _LONGEST[style.manner]:
                raise MotionFailedError(f"the episode is longer than {_LONGEST[style.manner]} steps")
    except MotionFailedError as error:
        return Attempt(seed, False, f"{stage_names[stage]}: {error}", retries=retries)
    if not held:
        return Attempt(seed, False, f"{stage_names[stage]}: the goal does not hold at the end", retries=retries)
    return Attempt(seed, True, arrays={name: np.stack(values) for name, values in rows.items()}, retries=retries)


def _script(task: Task, hand: Demonstrator) -> Iterator[tuple[int, Action]]:
    order = draw_order(task, hand.rng)
    motions = [(number, _motion(task, number)) for number in order]  # all of them, before anything is done
    for number, motion in motions:
        for action in chain(hand.think(), motion(hand)):
            yield number, action
    for action in hand.hold(STEPS_AFTER_SUCCESS):
        yield order[-1], action


def _motion(task: Task, number: int) -> Stage:
    if (stage := task.stages[number]) not in STAGES:
        raise ConfigError(f"No demonstrator can do stage {stage!r} of {task.name}. {near_names(stage, STAGES)}")
    return STAGES[stage]


def _row(observation: dict[str, Any], action: Action, stage: int) -> dict[str, Any]:
    return {
        **observation["pixels"],
        "agent_pos": observation["agent_pos"],
        "action": action,
        "true_stage": np.array([stage], dtype=np.int64),
    }


_env_of_this_process: RobosuiteEnv | None = None


def attempt_in_worker(settings: EnvSettings, seed: int, style: Style = _AS_EVER) -> Attempt:
    """Runs an attempt in a worker process, which keeps its environment from one attempt to the next."""
    global _env_of_this_process
    if _env_of_this_process is None or _env_of_this_process.settings != settings:
        _env_of_this_process = RobosuiteEnv(settings)
    return attempt(_env_of_this_process, seed, style=style)
