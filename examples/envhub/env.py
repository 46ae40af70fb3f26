"""A task of lerobot_buds as an environment on the Hub: LeRobot's `make_env` downloads this file and calls its function.

The README beside it says how to use and share it.
"""

from typing import Any

import gymnasium as gym
from lerobot.envs import EnvConfig

from lerobot_buds.envs.configuration_robosuite import RobosuiteEnvConfig

SETTINGS = {"task": "tool_use/cube_fetched", "episode_length": None, "image_size": 128, "render_profile": "fast"}
"""What is run where nothing else is asked for: size and profile are those of the demonstrations."""


def make_env(
    n_envs: int = 1, use_async_envs: bool = False, cfg: EnvConfig | None = None
) -> dict[str, dict[int, gym.vector.VectorEnv[Any, Any, Any]]]:
    """Makes the environments.

    Args:
        n_envs: How many of each task.
        use_async_envs: Runs each in its own process.
        cfg: The settings that LeRobot was given, of which those of the names in `SETTINGS` count.

    Returns:
        ``{suite: {number of the task within it: vector environment}}``.
    """
    asked = {name: getattr(cfg, name, None) for name in SETTINGS}
    settings = SETTINGS | {name: value for name, value in asked.items() if value is not None}
    return RobosuiteEnvConfig(**settings).create_envs(n_envs, use_async_envs)
