"""A robosuite task as a Gymnasium environment with LeRobot's observations.

The simulator is made at the first reset, in the process and thread that uses it: an OpenGL context does not survive a
fork, and spaces and attributes are then free to read.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from lerobot_buds.core import RENDER_PROFILES, ConfigError, SimulatorError

from .loading import open_renderer, open_simulation
from .rendering import profile_named
from .tasks import STAGE_FACTS, tasks_named

if TYPE_CHECKING:
    from .simulation.renderer import CameraRenderer
    from .simulation.state import SimulationState
    from .simulation.stock import StockEnv
    from .simulation.tabletop import TabletopEnv

FPS = 20
CAMERAS = {"agentview": "agentview", "eye_in_hand": "robot0_eye_in_hand"}
"""Observation name -> camera name in the model."""

STATE_NAMES = [
    *(f"joint_{i}.pos" for i in range(1, 8)),
    "gripper_left.pos",
    "gripper_right.pos",
    "eef_x.pos",
    "eef_y.pos",
    "eef_z.pos",
]
"""Dimensions of ``agent_pos``: seven arm joints (rad), two fingers (m), hand position in the world (m)."""

_STATE_BOUNDS = np.repeat([4.0, 0.1, 3.0], [7, 2, 3]).astype(np.float32)
"""What ``agent_pos`` stays within, either way: joints end at 3.76 rad and fingers at 0.04 m, by limits that give way by
0.03 rad and 3 mm, and the base is within 0.7 m of the world's middle, 0.9 m high, with a hand that reaches 1.3 m."""

ACTION_NAMES = ["delta_x.pos", "delta_y.pos", "delta_z.pos", "gripper.pos"]
REACH = 0.05
"""Displacement of the hand that an action of 1 aims at (m)."""

SETTLE_STEPS = 5
"""Steps with the gripper opening that every episode starts with; they belong to the reset (original's protocol)."""

Observation = dict[str, Any]


@dataclass(frozen=True)
class EnvSettings:
    """What a `RobosuiteEnv` is made from.

    Attributes:
        task: A task's full name.
        max_steps: Episode length (control steps); None for the task's own.
        image_size: Height and width of both cameras (pixels).
        render_profile: One of `RENDER_PROFILES`.
        draws: Draws the cameras; without, images are black and cost nothing, for surveys of states alone.
        released: Takes the goal and the workspace to the letter of the original's released code.
    """

    task: str
    max_steps: int | None = None
    image_size: int = 128
    render_profile: str = "fast"
    draws: bool = True
    released: bool = False


class RobosuiteEnv(gym.Env[Observation, NDArray[np.float32]]):
    """One environment.

    Observations hold ``pixels`` (one ``(H, W, 3)`` uint8 image a camera, top row first), ``agent_pos`` ((12,) float32,
    see `STATE_NAMES`), and ``render_profile`` and ``control_rate`` ((1,) float32 each: the number of the profile, and
    steps per second), so that a policy can refuse what differs from where it was trained. Actions are (4,) float32 in
    [-1, 1]: hand displacement in the world's axes (1 aims 5 cm ahead) and gripper (-1 opens, +1 closes). The reward is
    1 on success, which ends the episode. ``info`` holds ``is_success`` (bool) and ``stages_done`` ((S,) bool: which of
    the task's stages have what they aim at now, see `STAGE_FACTS`).

    Args:
        settings: The task and how it is drawn.

    Raises:
        ConfigError: The settings name an unknown or ambiguous task or profile, or a value that cannot work.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": FPS}  # noqa: RUF012 (Gymnasium's form)
    render_mode: str | None = "rgb_array"

    def __init__(self, settings: EnvSettings) -> None:
        tasks = tasks_named(settings.task)
        if len(tasks) != 1:
            raise ConfigError(f"{settings.task!r} names {len(tasks)} tasks; one environment runs exactly one.")
        profile_named(settings.render_profile)
        self.settings = settings
        self._task = tasks[0].as_released() if settings.released else tasks[0]
        self.task = self._task.name
        self.task_description = self._task.description
        self.stages = self._task.stages
        for stage in self.stages:
            if stage not in STAGE_FACTS:
                raise ConfigError(f"STAGE_FACTS does not say what stage {stage!r} of {self.task} aims at.")
        self._max_episode_steps = self._task.max_steps if settings.max_steps is None else settings.max_steps
        if self._max_episode_steps < 1:
            raise ConfigError(f"episode_length={self._max_episode_steps} cannot work; it must be at least 1 step.")
        size = settings.image_size
        if size < 1:
            raise ConfigError(f"image_size={size} cannot work; it must be at least 1 pixel.")
        image = gym.spaces.Box(0, 255, (size, size, 3), np.uint8)
        self.observation_space = gym.spaces.Dict(
            {
                "pixels": gym.spaces.Dict(dict.fromkeys(CAMERAS, image)),
                "agent_pos": gym.spaces.Box(-_STATE_BOUNDS, _STATE_BOUNDS, dtype=np.float32),
                "render_profile": gym.spaces.Box(0, len(RENDER_PROFILES), (1,), np.float32),
                "control_rate": gym.spaces.Box(0, FPS, (1,), np.float32),
            }
        )
        self.action_space = gym.spaces.Box(-1.0, 1.0, (len(ACTION_NAMES),), np.float32)
        self._simulation: TabletopEnv | StockEnv | None = None
        self._renderer: CameraRenderer | None = None
        self._steps = 0
        self._black = {name: np.zeros((size, size, 3), np.uint8) for name in CAMERAS}

    @property
    def simulation(self) -> "TabletopEnv | StockEnv":
        """The robosuite environment, made on first use.

        Raises:
            SimulatorError: The simulator is missing or unsupported.
        """
        if self._simulation is None:
            self._simulation = open_simulation(self._task)
        return self._simulation

    @property
    def state(self) -> "SimulationState":
        """The true state, for demonstrators and scores; a policy must not see it."""
        return self.simulation.state

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode, including its settle steps.

        Args:
            seed: Determines every random choice of this episode, whatever ran before.
            options: Ignored; LeRobot marks the start of a rollout with it.
        """
        super().reset(seed=seed)
        self._steps = 0
        self.simulation.reset_with(self.np_random)
        for _ in range(SETTLE_STEPS):
            self.simulation.step(np.array([0.0, 0.0, 0.0, -1.0]))
        return self._observe(), self._info()

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Advances one control step (50 ms).

        Args:
            action: (4,) float; what is executed of it, `executed` tells.

        Raises:
            SimulatorError: The action is of another shape, or it or the simulation is not finite.
        """
        if np.shape(action) != self.action_space.shape:
            raise SimulatorError(f"{self.task} takes actions of {self.action_space.shape}, not {np.shape(action)}.")
        if not np.isfinite(action).all():
            raise SimulatorError(f"Step {self._steps} of {self.task}: the action is not finite: {action}.")
        self.simulation.step(self.executed(action).astype(np.float64))
        self._steps += 1
        if self.state.diverged():
            raise SimulatorError(f"Step {self._steps} of {self.task}: the simulation diverged to NaN or infinity.")
        info = self._info()
        success = info["is_success"]
        truncated = self._steps >= self._max_episode_steps and not success
        return self._observe(), float(success), success, truncated, info

    def executed(self, action: NDArray[np.float32]) -> NDArray[np.float32]:
        """Tells what of an action would be executed now: clipped to [-1, 1], and to the task's workspace.

        Args:
            action: (4,) float.

        Returns:
            (4,) float32; executing it again changes nothing more.
        """
        reach = (np.array(self._task.workspace).T - self.state.hand) / REACH
        low, high = (np.append(np.clip(side, -1.0, 1.0), end) for side, end in zip(reach, (-1.0, 1.0), strict=True))
        clipped: NDArray[np.float32] = np.clip(action, low, high).astype(np.float32)
        return clipped

    def render(self) -> NDArray[np.uint8]:
        """Draws the workspace camera: ``(H, W, 3)`` uint8."""
        return self._draw(CAMERAS["agentview"])

    def close(self) -> None:
        """Frees the renderer and the simulation; may be called twice."""
        if self._renderer is not None:
            self._renderer.close()
        if self._simulation is not None:
            self._simulation.close()
        self._renderer = self._simulation = None

    def _info(self) -> dict[str, Any]:
        facts = self.simulation.facts()
        done = np.array([facts[STAGE_FACTS[stage]] for stage in self._task.stages], dtype=np.bool_)
        return {"is_success": self.simulation.succeeded(), "stages_done": done}

    def _draw(self, camera: str) -> NDArray[np.uint8]:
        if self._renderer is None:
            self._renderer = open_renderer(self.simulation, self.settings.render_profile, self.settings.image_size)
        return self._renderer.render(camera)

    def _draw_all(self) -> dict[str, NDArray[np.uint8]]:
        return {name: self._draw(camera) for name, camera in CAMERAS.items()}

    def _observe(self) -> Observation:
        state = self.state
        return {
            "pixels": self._draw_all() if self.settings.draws else self._black,
            "agent_pos": np.concatenate([state.arm, state.fingers, state.hand]).astype(np.float32),
            "render_profile": np.array([RENDER_PROFILES.index(self.settings.render_profile)], dtype=np.float32),
            "control_rate": np.array([FPS], dtype=np.float32),
        }
