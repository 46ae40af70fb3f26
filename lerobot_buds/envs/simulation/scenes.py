"""The scenes by name."""

from collections.abc import Callable

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
    """Builds the scene of a task."""
    return SCENES[task.scene](task.start, task.goal)
