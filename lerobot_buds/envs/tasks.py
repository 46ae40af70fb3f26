"""The tasks by name, as plain data: importable without a simulator."""

import math
from dataclasses import dataclass

from lerobot_buds.core import ConfigError, near_names


@dataclass(frozen=True)
class Task:
    """One task that `RobosuiteEnv` can run.

    Attributes:
        name: What users type, ``suite/task``.
        description: The instruction in natural language; equal to the dataset's task string.
        scene: What stands on the table: a key of `simulation.scenes.SCENES`.
        start: Facts that hold at the start and do not in the scene's plain arrangement.
        goal: Names of the facts that must all hold at once.
        stages: The demonstrator's stages, in order.
        max_steps: Default episode length (control steps), from the original's README.
        workspace: Ranges of x, y and z that the hand is not sent beyond (m).
    """

    name: str
    description: str
    scene: str
    start: frozenset[str]
    goal: tuple[str, ...]
    stages: tuple[str, ...]
    max_steps: int = 2500
    workspace: tuple[tuple[float, float], ...] = ((-math.inf, math.inf),) * 3

    @property
    def suite(self) -> str:
        """The part of the name before the slash; LeRobot groups results by it."""
        return self.name.split("/")[0]


_SERVED = ("drawer_closed", "stove_off", "cube_in_pot", "pot_in_region")

# Without it the hand could simply take the cube, and the tool would be needless (ours; the original has no bound).
_NEAR_SIDE = ((-math.inf, 0.03), (-math.inf, math.inf), (-math.inf, math.inf))

TASKS: dict[str, Task] = {
    task.name: task
    for task in (
        Task(
            "tool_use/full",
            "fetch the cube with the tool and put it into the pot",
            "tool_use",
            frozenset(),
            ("cube_in_pot",),
            ("grasp_tool", "hook_cube", "pull_cube", "put_tool_aside", "grasp_cube", "put_cube_in_pot"),
            1500,
            _NEAR_SIDE,
        ),
        Task(
            "tool_use/cube_fetched",
            "put the cube into the pot",
            "tool_use",
            frozenset({"cube_fetched"}),
            ("cube_in_pot",),
            ("grasp_cube", "put_cube_in_pot"),
            1500,
            _NEAR_SIDE,
        ),
        Task(
            "hammer_place/full",
            "put the hammer into the drawer and close it",
            "hammer_place",
            frozenset(),
            ("hammer_in_drawer", "drawer_closed"),
            ("open_drawer", "grasp_hammer", "put_hammer_in_drawer", "close_drawer"),
            1500,
        ),
        Task(
            "multitask_kitchen/task3_variant1",
            "close the drawer and push the pot into the serving region",
            "multitask_kitchen",
            frozenset({"drawer_open", "cube_in_pot"}),
            _SERVED,
            ("close_drawer", "push_pot"),
        ),
    )
}


def tasks_named(names: str) -> list[Task]:
    """Looks up a comma-separated selection of tasks; a suite's name selects all of its tasks.

    Args:
        names: For example ``multitask_kitchen/task3_variant1`` or ``multitask_kitchen``.

    Returns:
        The tasks in the order named, each once.

    Raises:
        ConfigError: A name is neither a task nor a suite.
    """
    chosen: dict[str, Task] = {}
    for name in (part.strip() for part in names.split(",")):
        matches = [t for t in TASKS.values() if name in (t.name, t.suite)]
        if not matches:
            known = {t.name for t in TASKS.values()} | {t.suite for t in TASKS.values()}
            raise ConfigError(f"There is no robosuite task {name!r}. {near_names(name, known)}")
        chosen |= {t.name: t for t in matches}
    return list(chosen.values())
