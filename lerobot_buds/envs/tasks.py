"""The tasks by name, as plain data: importable without a simulator."""

from dataclasses import dataclass

from lerobot_buds.core import ConfigError, near_names


@dataclass(frozen=True)
class KitchenStart:
    """How an episode of the Multitask-Kitchen starts.

    Attributes:
        drawer_open: The drawer stands open by 10 cm.
        stove_on: The stove's lever is switched on.
        cube_in_pot: The cube lies in the pot, instead of on the table.
    """

    drawer_open: bool
    stove_on: bool
    cube_in_pot: bool = False


@dataclass(frozen=True)
class Task:
    """One task that `RobosuiteEnv` can run.

    Attributes:
        name: What users type, ``suite/task``.
        description: The instruction in natural language; equal to the dataset's task string.
        start: How its episodes start.
        goal: Names of the facts that must all hold at once.
        stages: The demonstrator's stages, in order.
        max_steps: Default episode length (control steps), from the original's README.
    """

    name: str
    description: str
    start: KitchenStart
    goal: tuple[str, ...]
    stages: tuple[str, ...]
    max_steps: int = 2500

    @property
    def suite(self) -> str:
        """The part of the name before the slash; LeRobot groups results by it."""
        return self.name.split("/")[0]


_ON_STOVE = ("drawer_closed", "stove_on", "cube_in_pot", "pot_on_stove")
_SERVED_HOT = ("drawer_closed", "stove_on", "cube_in_pot", "pot_in_region")
_SERVED = ("drawer_closed", "stove_off", "cube_in_pot", "pot_in_region")

TASKS: dict[str, Task] = {
    task.name: task
    for task in (
        Task(
            "multitask_kitchen/task3_variant1",
            "close the drawer and push the pot into the serving region",
            KitchenStart(drawer_open=True, stove_on=False, cube_in_pot=True),
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
