"""One episode of the simulation after another, by seed: how long it has lasted and whether it has succeeded."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lerobot_buds.core import OUR_FORMER_ACTION, SimulatorError
from lerobot_buds.envs import ACTION_NAMES, CAMERAS, FPS, STATE_NAMES, EnvSettings, RobosuiteEnv, tasks_named


class Scene:
    """The simulation, with what is shown of it now.

    Args:
        settings: The environment.
        hold_s: Time for which success must hold (s) until the episode has ended; None: that does not end it.

    Attributes:
        seed: Seed of this episode.
        steps: Control steps since it began.
        held: Control steps for which success has held without a break.
    """

    def __init__(self, settings: EnvSettings, hold_s: float | None) -> None:
        self._env = RobosuiteEnv(settings)
        self._hold = math.inf if hold_s is None else max(1, round(hold_s * FPS))
        self._length = tasks_named(settings.task)[0].max_steps if settings.max_steps is None else settings.max_steps
        self._stages_done = np.zeros(len(self._env.stages), np.bool_)
        self.seed = self.steps = self.held = 0

    def begin(self, seed: int) -> None:
        """Sets up the scene of a seed.

        Raises:
            SimulatorError: The simulator is missing or unsupported.
        """
        observation, info = self._env.reset(seed=seed)
        self.seed, self.steps, self.held = seed, 0, 0
        self._take(observation, info)

    def act(self, action: NDArray[np.float32]) -> NDArray[np.float32]:
        """Advances one control step.

        Args:
            action: (4,) float32 in [-1, 1].

        Returns:
            (4,) float32: what of it was executed.

        Raises:
            SimulatorError: The action or the simulation is not finite.
        """
        executed = self._env.executed(action)
        observation, _, success, _, info = self._env.step(action)
        self.steps, self.held = self.steps + 1, self.held + 1 if success else 0
        self._take(observation, info)
        return executed

    @property
    def shown(self) -> dict[str, Any]:
        """State (float) and camera images ((H, W, 3) uint8) by name."""
        return dict(self._shown)

    @property
    def stages(self) -> dict[str, bool]:
        """Stages of the task -> whether what they aim at holds now."""
        return dict(zip(self._env.stages, self._stages_done.tolist(), strict=True))

    @property
    def succeeded(self) -> bool:
        """Whether the goal holds now."""
        return self.held > 0

    @property
    def ended(self) -> bool:
        """Whether success has held for long enough, or the time is over."""
        return self.held >= self._hold or self.steps >= self._length

    def close(self) -> None:
        """Frees the simulator."""
        self._env.close()

    def _take(self, observation: dict[str, Any], info: dict[str, Any]) -> None:
        state = dict(zip(STATE_NAMES, observation["agent_pos"].tolist(), strict=True))
        self._shown = {**state, **{name: observation["pixels"][name] for name in CAMERAS}}
        self._stages_done = info["stages_done"]


def vector_of(action: dict[str, float]) -> NDArray[np.float32] | None:
    """Puts a named action in our order.

    Args:
        action: Values by `ACTION_NAMES`, or by the names that recordings had before there was a robot.

    Returns:
        (4,) float32; None for joint positions, by which LeRobot sends an arm back to where it began.

    Raises:
        SimulatorError: Names are missing.
    """
    for names in (ACTION_NAMES, OUR_FORMER_ACTION):
        if set(names) <= action.keys():
            return np.array([action[name] for name in names], dtype=np.float32)
    if action.keys() <= set(STATE_NAMES):
        return None
    missing = [name for name in ACTION_NAMES if name not in action]
    raise SimulatorError(f"The action lacks {missing}; the robot is told {ACTION_NAMES}.")
