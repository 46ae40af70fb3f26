"""The environment type ``robosuite`` on LeRobot's command line."""

from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs import EnvConfig

from lerobot_buds.core import ACTION, IMAGE_PREFIX, STATE, ConfigError

from .loading import check_versions, installed_version
from .rendering import profile_named
from .robosuite_env import ACTION_NAMES, CAMERAS, FPS, STATE_NAMES, EnvSettings
from .tasks import tasks_named
from .vector_env import EpisodeVectorEnv


@EnvConfig.register_subclass("robosuite")
@dataclass
class RobosuiteEnvConfig(EnvConfig):  # type: ignore[misc]  # LeRobot ships no types
    """robosuite tasks for ``lerobot-eval`` and ``lerobot-train``.

    Attributes:
        task: Task names, comma-separated; a suite's name selects all of its tasks.
        fps: Control steps per second; robosuite tasks run at 20.
        episode_length: Episode length (control steps); None for each task's own.
        image_size: Height and width of both cameras (pixels).
        render_profile: What is drawn: ``fast``, ``fastest`` or ``full``. Must be that of the demonstrations.
        released: Goals and workspace to the letter of the original's released code; see docs/environments.md.
    """

    task: str = "multitask_kitchen/task3_variant1"
    fps: float = FPS
    episode_length: int | None = None
    image_size: int = 128
    render_profile: str = "fast"
    released: bool = False
    features: dict[str, PolicyFeature] = field(default_factory=dict)
    features_map: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        tasks_named(self.task)
        profile_named(self.render_profile)
        image = PolicyFeature(type=FeatureType.VISUAL, shape=(self.image_size, self.image_size, 3))
        self.features = {
            ACTION: PolicyFeature(type=FeatureType.ACTION, shape=(len(ACTION_NAMES),)),
            "agent_pos": PolicyFeature(type=FeatureType.STATE, shape=(len(STATE_NAMES),)),
            **{f"pixels/{camera}": image for camera in CAMERAS},
        }
        self.features_map = {
            ACTION: ACTION,
            "agent_pos": STATE,
            **{f"pixels/{camera}": IMAGE_PREFIX + camera for camera in CAMERAS},
        }

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Nothing: environments are made by `create_envs`, not through Gymnasium's registry."""
        return {}

    def create_envs(
        self, n_envs: int, use_async_envs: bool = False
    ) -> dict[str, dict[int, gym.vector.VectorEnv[Any, Any, Any]]]:
        """Makes one vector environment a task, grouped by suite.

        Args:
            n_envs: Environments in each.
            use_async_envs: Runs each environment in its own process.

        Returns:
            ``{suite: {number of the task within it: vector environment}}``.

        Raises:
            ConfigError: A task or the profile is unknown, or fps is not 20.
            SimulatorError: The simulator is missing or of an unsupported version.
        """
        if self.fps != FPS:
            raise ConfigError(f"robosuite tasks run at {FPS} control steps per second, not at {self.fps:g}.")
        check_versions(installed_version("robosuite"), installed_version("mujoco"))
        suites: dict[str, dict[int, gym.vector.VectorEnv[Any, Any, Any]]] = {}
        for task in tasks_named(self.task):
            settings = EnvSettings(
                task.name, self.episode_length, self.image_size, self.render_profile, released=self.released
            )
            group = suites.setdefault(task.suite, {})
            group[len(group)] = EpisodeVectorEnv(settings, n_envs, in_workers=use_async_envs and n_envs > 1)
        return suites
