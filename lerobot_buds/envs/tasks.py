"""The tasks by name, as plain data: importable without a simulator."""

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from lerobot_buds.core import ConfigError, near_names

if TYPE_CHECKING:
    from .simulation.tabletop import Scene

_UNBOUNDED = ((-math.inf, math.inf),) * 3

STAGE_FACTS: dict[str, str] = {
    "close_drawer": "drawer_closed",
    "cube_in_pot": "cube_in_pot",
    "grasp_cube": "cube_lifted",
    "grasp_hammer": "hammer_lifted",
    "grasp_tool": "tool_lifted",
    "hook_cube": "cube_hooked",
    "open_drawer": "drawer_open",
    "pot_off_stove": "pot_on_table",
    "pot_on_stove": "pot_on_stove",
    "pot_on_tray": "pot_on_tray",
    "pull_cube": "cube_fetched",
    "push_pot": "pot_in_region",
    "push_tray": "tray_aside",
    "put_cube_in_pot": "cube_in_pot",
    "put_hammer_in_drawer": "hammer_laid_in",
    "put_tool_aside": "tool_put_aside",
    "put_tool_down": "tool_put_down",
    "take_lid_off": "lid_off",
    "take_tool": "tool_lifted",
    "turn_off": "stove_off",
    "turn_on": "stove_on",
}
"""Stage -> the fact that holds in the state that it aims at, and may hold before it: the stove is off at first, too."""


@dataclass(frozen=True)
class Task:
    """One task that `RobosuiteEnv` can run.

    Attributes:
        name: What users type, ``suite/task``.
        description: The instruction in natural language; equal to the dataset's task string.
        scene: What stands on the table: a key of `simulation.scenes.SCENES`, or what is there the value of a key.
        start: Facts that hold at the start and do not in the scene's plain arrangement.
        goal: Names of the facts that must all hold at once.
        released_goal: The same as the original's released code has it.
        stages: The demonstrator's stages, in their usual order.
        max_steps: Default episode length (control steps), from the original's README.
        workspace: Ranges of x, y and z that the hand is not sent beyond (m).
        needs: Which stages must come before a stage; where it names none for a stage, all those listed before it.
        stock: It is one of robosuite's own, which brings its objects, start and goal itself.
    """

    name: str
    description: str
    scene: "str | Callable[[frozenset[str], tuple[str, ...]], Scene]"
    start: frozenset[str]
    goal: tuple[str, ...]
    released_goal: tuple[str, ...]
    stages: tuple[str, ...]
    max_steps: int = 2500
    workspace: tuple[tuple[float, float], ...] = _UNBOUNDED
    needs: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    stock: bool = False

    @property
    def suite(self) -> str:
        """The part of the name before the slash; LeRobot groups results by it."""
        return self.name.split("/")[0]

    def possible_stages(self, done: Collection[int]) -> list[int]:
        """Lists the stages that may come next: not done yet, with all that they need done.

        Args:
            done: Numbers of the stages that are done, indices into `stages`.
        """
        names = {self.stages[number] for number in done}
        return [
            number
            for number, stage in enumerate(self.stages)
            if number not in done and names.issuperset(self.needs.get(stage, self.stages[:number]))
        ]

    def as_released(self) -> "Task":
        """Makes the task as the original's released code has it: its literal goal, and no bound on the workspace."""
        return replace(self, goal=self.released_goal, workspace=_UNBOUNDED)


# The paper's full goals. Released predicates leave out facts that hold at a variant's start and break by accident only.
_MULTITASK_GOALS: dict[int, tuple[str, tuple[str, ...]]] = {
    1: (
        "put the pot with the cube in it on the stove, with the stove on and the drawer closed",
        ("drawer_closed", "stove_on", "cube_in_pot", "pot_on_stove"),
    ),
    2: (
        "put the pot with the cube in it in the serving region, with the stove on and the drawer closed",
        ("drawer_closed", "stove_on", "cube_in_pot", "pot_in_region"),
    ),
    3: (
        "put the pot with the cube in it in the serving region, with the stove off and the drawer closed",
        ("drawer_closed", "stove_off", "cube_in_pot", "pot_in_region"),
    ),
}


def _multitask(number: int, variant: int, start: set[str], *stages: str) -> Task:
    """Makes one variant. A meta controller serves all variants of a task, so they share its goal and description."""
    description, goal = _MULTITASK_GOALS[number]
    # The release asks in Task-3 for all of it, in the others only for what does not hold at the start.
    held = (set() if "drawer_open" in start else {"drawer_closed"}) | start & {"stove_on"}
    released = tuple(fact for fact in goal if number == 3 or fact not in held)
    # Nothing but the goal asks for the stove, while the open drawer is in the way and the cube is to go with the pot.
    needs = {"turn_on": (), "cube_in_pot": (), "push_pot": ("cube_in_pot",), "pot_on_stove": ("cube_in_pot",)}
    return Task(
        name=f"multitask_kitchen/task{number}_variant{variant}",
        description=description,
        scene="multitask_kitchen",
        start=frozenset(start),
        goal=goal,
        released_goal=_any_contact(released),
        stages=stages,
        needs=needs if "turn_on" in stages else {},
    )


def _any_contact(goal: tuple[str, ...]) -> tuple[str, ...]:
    """Replaces "in the pot" by what the release's kitchens take for it."""
    return tuple("cube_touches_pot" if fact == "cube_in_pot" else fact for fact in goal)


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
            ("hammer_in_drawer", "drawer_closed"),
            ("open_drawer", "grasp_hammer", "put_hammer_in_drawer", "close_drawer"),
            1500,
        ),
        Task(
            name="kitchen/full",
            description="turn on the stove, cook the cube in the pot, serve the pot and turn off the stove",
            scene="kitchen",
            start=frozenset(),
            goal=("stove_has_been_on", "stove_off", "cube_in_pot", "pot_in_region"),
            released_goal=("stove_has_been_on", "stove_off", "cube_touches_pot", "pot_in_region"),
            stages=("turn_on", "pot_on_stove", "cube_in_pot", "pot_off_stove", "push_pot", "turn_off"),
            needs={"pot_on_stove": (), "cube_in_pot": ("pot_on_stove",), "turn_off": ("turn_on", "cube_in_pot")},
            max_steps=5000,
        ),
        _multitask(1, 1, {"drawer_open", "stove_on"}, "close_drawer", "cube_in_pot", "pot_on_stove"),
        _multitask(1, 2, {"stove_on"}, "cube_in_pot", "pot_on_stove"),
        _multitask(1, 3, set(), "turn_on", "cube_in_pot", "pot_on_stove"),
        _multitask(2, 1, set(), "turn_on", "cube_in_pot", "push_pot"),
        _multitask(2, 2, {"stove_on"}, "cube_in_pot", "push_pot"),
        _multitask(2, 3, {"drawer_open", "stove_on"}, "close_drawer", "cube_in_pot", "push_pot"),
        _multitask(3, 1, {"drawer_open", "cube_in_pot"}, "close_drawer", "push_pot"),
        _multitask(3, 2, set(), "cube_in_pot", "push_pot"),
        _multitask(3, 3, {"drawer_open"}, "close_drawer", "cube_in_pot", "push_pot"),
        Task(
            name="real_kitchen/full",
            description="take the lid off the pot, put the pot on the tray and push them aside with the tool",
            scene="real_kitchen",
            start=frozenset(),
            goal=("lid_off", "pot_on_tray", "tray_aside", "tool_has_been_lifted", "tool_put_down"),
            released_goal=("lid_off", "pot_on_tray", "tray_aside", "tool_has_been_lifted", "tool_put_down"),
            stages=("take_lid_off", "pot_on_tray", "take_tool", "push_tray", "put_tool_down"),
        ),
    )
}


STOCK_TASKS: dict[str, Task] = {
    name: Task(name, description, "", frozenset(), (), (), (), max_steps=500, stock=True)
    for name, description in {
        "Lift": "lift the cube",
        "Stack": "stack the red cube on the green one",
        "NutAssembly": "put both nuts on their pegs",
        "NutAssemblySquare": "put the square nut on its peg",
        "NutAssemblyRound": "put the round nut on its peg",
        "PickPlace": "put every object into its bin",
        "PickPlaceCan": "put the can into its bin",
        "PickPlaceMilk": "put the milk into its bin",
        "PickPlaceBread": "put the bread into its bin",
        "PickPlaceCereal": "put the cereal into its bin",
        "Door": "open the door",
    }.items()
}
"""robosuite's own single-arm tasks under its own names, with its usual horizon; they have no demonstrator."""


def tasks_named(names: str) -> list[Task]:
    """Looks up a comma-separated selection of tasks; a suite's name selects all of its tasks.

    Args:
        names: For example ``multitask_kitchen/task3_variant1``, ``multitask_kitchen`` or ``Lift``.

    Returns:
        The tasks in the order named, each once.

    Raises:
        ConfigError: A name is neither a task nor a suite.
    """
    chosen: dict[str, Task] = {}
    all_tasks = [*TASKS.values(), *STOCK_TASKS.values()]
    for name in (part.strip() for part in names.split(",")):
        matches = [t for t in all_tasks if name in (t.name, t.suite)]
        if not matches:
            known = {t.name for t in all_tasks} | {t.suite for t in all_tasks}
            raise ConfigError(f"There is no robosuite task {name!r}. {near_names(name, known)}")
        chosen |= {t.name: t for t in matches}
    return list(chosen.values())
