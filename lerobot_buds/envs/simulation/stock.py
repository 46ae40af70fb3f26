"""robosuite's own single-arm tasks, with the same control, and with randomness that a generator decides."""

from typing import Any

import numpy as np
import robosuite
from numpy.typing import NDArray

from .control import CONTROL_FREQUENCY, hold_hand_down, osc_position_config
from .lending import global_generator
from .state import SimulationState


class StockEnv:
    """One of robosuite's tasks by its name, with its own objects, cameras, start and success.

    Args:
        name: For example ``Lift``.
    """

    def __init__(self, name: str) -> None:
        with global_generator(_seed(np.random.default_rng(0))):  # some tasks draw sizes of objects here
            self._env: Any = robosuite.make(
                name,
                robots="Panda",
                controller_configs=osc_position_config(),
                use_camera_obs=False,
                use_object_obs=False,
                has_renderer=False,
                has_offscreen_renderer=False,
                control_freq=CONTROL_FREQUENCY,
                ignore_done=True,
                hard_reset=False,
            )
        self.state = SimulationState(self.sim)

    @property
    def sim(self) -> Any:
        """The simulation that robosuite steps."""
        return self._env.sim

    def reset_with(self, rng: np.random.Generator) -> None:
        """Starts an episode whose every random choice is drawn from `rng`."""
        with global_generator(_seed(rng)):
            self._env.reset()
        hold_hand_down(self._env.robots[0])

    def step(self, action: NDArray[np.float64]) -> None:
        """Advances one control step with a (4,) action: hand displacement and gripper, all in [-1, 1]."""
        self._env.step(action)

    def facts(self) -> dict[str, bool]:
        """Evaluates what robosuite tells of the state: success alone."""
        return {"success": bool(self._env._check_success())}

    def succeeded(self) -> bool:
        """Tells whether the task's own criterion holds now."""
        return self.facts()["success"]

    def close(self) -> None:
        """Frees the simulation."""
        self._env.close()


def _seed(rng: np.random.Generator) -> int:
    return int(rng.integers(2**32))
