"""The scenes by name."""

from collections.abc import Callable

from lerobot_buds.core import ConfigError, near_names
from lerobot_buds.envs.tasks import Task

from .hammer_place import HammerPlace
from .kitchen import Kitchen
from .multitask_kitchen import MultitaskKitchen
from .real_kitchen import RealKitchen
from .tabletop import Scene
from .tool_use import ToolUse

SCENES: dict[str, Callable[[frozenset[str], tuple[str, ...]], Scene]] = {
    "hammer_place": HammerPlace,
    "kitchen": Kitchen,
    "multitask_kitchen": MultitaskKitchen,
    "real_kitchen": RealKitchen,
    "tool_use": ToolUse,
}
"""Scene name -> constructor, which takes the task's start and goal."""


def build_scene(task: Task) -> Scene:
    """Builds the scene of a task.

    Raises:
        ConfigError: There is none of its name.
    """
    if isinstance(task.scene, str) and task.scene not in SCENES:
        raise ConfigError(f"Task {task.name} has a scene that is not there. {near_names(task.scene, SCENES)}")
    constructor = SCENES[task.scene] if isinstance(task.scene, str) else task.scene
    return constructor(task.start, task.goal)
