"""The tasks in Gymnasium's registry, for everybody who makes environments by `gymnasium.make`.

Gymnasium has had no entry points since its version 1.0, so somebody must import what registers: `lerobot_buds.envs`
does, and the plugin with it.
"""

import re
import sys
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from lerobot_buds.core import ConfigError, near_names

from .robosuite_env import EnvSettings, RobosuiteEnv
from .tasks import STOCK_TASKS, TASKS

NAMESPACE = "lerobot_buds"

_OPTIONS = ("image_size", "max_episode_steps", "released", "render_mode", "render_profile")
_WHOLE = "full"  # the task that is its suite's first, and has its name


class RegisteredEnv(RobosuiteEnv):
    """A `RobosuiteEnv` as `gymnasium.make` makes it: settings are keyword arguments, and Gymnasium limits the time.

    Args:
        task: A task's full name, which the registry gives.
        image_size: Height and width of both cameras (pixels).
        render_profile: What is drawn: ``fast``, ``fastest`` or ``full``.
        released: Takes the goal and the workspace to the letter of the original's released code.
        render_mode: ``rgb_array``, or None to have `render` draw nothing. Observations have their images anyway.
        unknown: Refused.

    Raises:
        ConfigError: A name or a value is unknown.
    """

    def __init__(
        self,
        task: str,
        *,
        image_size: int = 128,
        render_profile: str = "fast",
        released: bool = False,
        render_mode: str | None = "rgb_array",
        **unknown: Any,
    ) -> None:
        for name in unknown:
            raise ConfigError(f"The environment of {task} has no setting {name!r}. {near_names(name, _OPTIONS)}")
        if render_mode not in (None, *self.metadata["render_modes"]):
            modes = near_names(str(render_mode), self.metadata["render_modes"])
            raise ConfigError(f"There is no render_mode {render_mode!r}. {modes}")
        # `make` keeps max_episode_steps to itself, for its TimeLimit; -1 there means no limit at all.
        super().__init__(EnvSettings(task, sys.maxsize, image_size, render_profile, released=released))
        self.render_mode = render_mode

    def render(self) -> NDArray[np.uint8] | None:  # type: ignore[override]  # Gymnasium's contract
        """Draws the workspace camera: ``(H, W, 3)`` uint8; None without a render mode."""
        return super().render() if self.render_mode else None


def env_id(task: str) -> str:
    """Makes the name of a task in Gymnasium's registry.

    Args:
        task: For example ``tool_use/full``, ``multitask_kitchen/task1_variant1`` or ``Lift``.

    Returns:
        For example ``lerobot_buds/ToolUse-v0``, ``lerobot_buds/MultitaskKitchen-Task1-Variant1-v0``,
        ``lerobot_buds/Lift-v0``.
    """
    parts = re.split(r"/|(?<=\d)_", task.removesuffix(f"/{_WHOLE}"))
    names = ["".join(word[:1].upper() + word[1:] for word in part.split("_")) for part in parts]
    return f"{NAMESPACE}/{'-'.join(names)}-v0"


def register_tasks() -> None:
    """Registers every task that there is and that Gymnasium does not know yet; may be called again after adding one."""
    for task in (*TASKS.values(), *STOCK_TASKS.values()):
        if env_id(task.name) not in gym.registry:
            gym.register(
                env_id(task.name),
                entry_point=f"{__name__}:{RegisteredEnv.__name__}",
                max_episode_steps=task.max_steps,
                kwargs={"task": task.name},
            )
