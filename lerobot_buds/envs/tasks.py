"""The tasks by name, as plain data: importable without a simulator."""

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
    """

    name: str
    description: str
    scene: str
    start: frozenset[str]
    goal: tuple[str, ...]
    stages: tuple[str, ...]
    max_steps: int = 2500

    @property
    def suite(self) -> str:
        """The part of the name before the slash; LeRobot groups results by it."""
        return self.name.split("/")[0]


_SERVED = ("drawer_closed", "stove_off", "cube_in_pot", "pot_in_region")

TASKS: dict[str, Task] = {
    task.name: task
    for task in (
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
