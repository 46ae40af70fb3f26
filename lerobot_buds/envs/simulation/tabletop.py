"""A Panda at a table in robosuite, around a `Scene` that says what stands on it and what counts as success.

Differences from robosuite 1.5.1's own environments, all measured to matter: the hand's orientation is held straight
down (1.5.1 re-targets the achieved orientation at every step, and the tilt adds up to some 19 degrees an episode), all
randomness comes from one generator given at reset (robosuite draws from numpy's global one), resets are soft, and
robosuite's observables, which cost time at every physics step, are not built.
"""

from collections import OrderedDict
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from robosuite.environments.manipulation.manipulation_env import ManipulationEnv
from robosuite.models.arenas import TableArena
from robosuite.models.tasks import ManipulationTask

from .control import CONTROL_FREQUENCY, hold_hand_down, osc_position_config
from .lending import global_generator
from .primitives import Primitive
from .state import SimulationState

TABLE_OFFSET = (-0.2, 0.0, 0.90)
TABLE_FRICTION = (0.6, 0.005, 0.0001)
JOINT_NOISE = 0.02
"""Standard deviation of the arm's start position (rad per joint); robosuite's default noise."""

_AGENTVIEW_POS = (0.5386131746834771, 0.0, 1.4903500240372423)
_AGENTVIEW_QUAT = (0.6380177736282349, 0.3048497438430786, 0.30484986305236816, 0.6380177736282349)
# 5 cm closer to the fingertips than robosuite's default, as in the original's data and evaluation.
_EYE_IN_HAND_POS = "0.05 0 0.049999"


class Scene(Protocol):
    """What stands on the table, how it starts, and what counts as success."""

    @property
    def table_length(self) -> float:
        """Extent of the table along x (m)."""
        ...

    @property
    def goal(self) -> tuple[str, ...]:
        """Names of the facts that must all hold for success."""
        ...

    @property
    def latches(self) -> Mapping[str, str]:
        """Facts that hold from the moment another fact has held: name -> the fact that sets it."""
        ...

    def objects(self) -> list[Primitive]:
        """Builds every object and fixture, once per environment."""
        ...

    def place(self, state: SimulationState, rng: np.random.Generator) -> None:
        """Writes the start positions of a new episode."""
        ...

    def update(self, state: SimulationState) -> None:
        """Refreshes looks after every control step."""
        ...

    def facts(self, state: SimulationState) -> dict[str, bool]:
        """Evaluates every predicate of the scene, less its latches."""
        ...


class TabletopEnv(ManipulationEnv):  # type: ignore[misc]  # robosuite ships no types
    """robosuite environment of one scene, with 4-D actions: hand displacement (x, y, z) and gripper, all in [-1, 1].

    Args:
        scene: The scene on the table.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._rng = np.random.default_rng(0)
        self._latched: set[str] = set()
        with global_generator(0):  # robosuite draws the start noise that it then multiplies by 0
            super().__init__(
                robots="Panda",
                base_types="default",
                gripper_types="default",
                controller_configs=osc_position_config(),
                initialization_noise=None,
                use_camera_obs=False,
                has_renderer=False,
                has_offscreen_renderer=False,
                control_freq=CONTROL_FREQUENCY,
                ignore_done=True,
                hard_reset=False,
            )
        self.state = SimulationState(self.sim)

    def reset_with(self, rng: np.random.Generator) -> None:
        """Starts an episode whose every random choice is drawn from `rng`."""
        self._rng = rng
        with global_generator(0):  # as above
            self.reset()

    def facts(self) -> dict[str, bool]:
        """Evaluates the scene's predicates in the present state, and what its latches remember of this episode."""
        return self.scene.facts(self.state) | {name: name in self._latched for name in self.scene.latches}

    def succeeded(self) -> bool:
        """Tells whether every fact of the goal holds now."""
        facts = self.facts()
        return all(facts[name] for name in self.scene.goal)

    def reward(self, action: NDArray[np.float64] | None = None) -> float:
        """Computes the sparse reward: 1 on success, else 0."""
        return float(self.succeeded())

    def _post_action(self, action: NDArray[np.float64]) -> Any:
        if self.scene.latches:
            facts = self.scene.facts(self.state)
            self._latched |= {name for name, fact in self.scene.latches.items() if facts[fact]}
        self.scene.update(self.state)
        return super()._post_action(action)

    def _check_success(self) -> bool:
        return self.succeeded()

    def _load_model(self) -> None:
        super()._load_model()
        length = self.scene.table_length
        robot_model = self.robots[0].robot_model
        robot_model.set_base_xpos(robot_model.base_xpos_offset["table"](length))
        for camera in robot_model.worldbody.iter("camera"):
            if camera.get("name", "").endswith("eye_in_hand"):
                camera.set("pos", _EYE_IN_HAND_POS)
        arena = TableArena(
            table_full_size=(length, 0.8, 0.05), table_friction=TABLE_FRICTION, table_offset=TABLE_OFFSET
        )
        arena.set_origin([0, 0, 0])
        arena.set_camera(camera_name="agentview", pos=_AGENTVIEW_POS, quat=_AGENTVIEW_QUAT)
        self.model = ManipulationTask(
            mujoco_arena=arena, mujoco_robots=[robot_model], mujoco_objects=self.scene.objects()
        )

    def _setup_observables(self) -> "OrderedDict[str, Any]":
        # The wrapper reads what it needs from the simulation; robosuite would refresh these 25 times a control step.
        return OrderedDict()

    def _reset_internal(self) -> None:
        robot = self.robots[0]
        # Written before the reset, so that the controller's null-space posture follows the noisy start.
        robot.init_qpos = robot.robot_model.init_qpos + self._rng.normal(0.0, JOINT_NOISE, 7)
        super()._reset_internal()
        # Controllers are rebuilt at every reset, so the hold is applied anew each time.
        hold_hand_down(robot)
        self._latched.clear()
        state = SimulationState(self.sim)
        self.scene.place(state, self._rng)
        self.scene.update(state)
