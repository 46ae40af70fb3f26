"""5. Write a task: a table, what counts as success on it, and who demonstrates it. The page to it is docs/own_task.md.

    python examples/5_write_a_task.py --preview=outputs/serve_cube
    python examples/5_write_a_task.py --repo_id=me/serve_cube --root=outputs/serve_cube --episodes=8

The first draws an attempt, the second records; their options are those of `lerobot-buds-collect`.
"""

import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lerobot_buds.cli import collect
from lerobot_buds.demos.motions import Action, Demonstrator
from lerobot_buds.demos.stages import STAGES
from lerobot_buds.demos.vocabulary import carry, release, up
from lerobot_buds.envs import STAGE_FACTS, TASKS, Task, register_tasks

REGION = np.array([0.05, 0.15, 0.878])  # in the world (m); the table's top is at 0.9


@dataclass(frozen=True)
class ServeCube:
    """The table: a cube, and a red region to put it in."""

    start: frozenset[str]  # the task's
    goal: tuple[str, ...]
    table_length: float = 0.8  # along x (m)
    latches: Mapping[str, str] = field(default_factory=dict)

    def objects(self) -> list[Any]:
        """Builds what stands there."""
        from lerobot_buds.envs.simulation.furniture import cube, serving_region  # here: it loads the simulator

        return [serving_region(tuple(REGION)), cube((0.02, 0.025, 0.02), "blue_wood")]

    def place(self, state: Any, rng: np.random.Generator) -> None:
        """Starts an episode."""
        state.set_pose("cube", np.array([rng.uniform(-0.15, -0.05), rng.uniform(-0.2, -0.1), 0.93]), yaw=-np.pi / 2)

    def update(self, state: Any) -> None:
        """Nothing changes its looks."""

    def facts(self, state: Any) -> dict[str, bool]:
        """Tells what holds now."""
        cube = state.position("cube_main")
        inside = (np.abs(cube - REGION)[:2] < (0.05, 0.08)).all() and not state.touching("cube", "gripper0")
        return {"cube_lifted": bool(cube[2] > 0.94), "cube_served": bool(inside and cube[2] < 0.93)}


def serve_cube(hand: Demonstrator) -> Iterator[Action]:
    """Carries the cube over the region, lowers it and lets go."""
    place = REGION + up(0.045) + hand.jitter(0.01) * (1, 1, 0)
    yield from carry(hand, "cube_main", lambda: place + up(0.06), tolerance=0.02)
    yield from carry(hand, "cube_main", lambda: place)
    yield from release(hand, rise=0.08)


TASK = Task(
    name="serve_cube/full",
    description="put the cube in the red region",
    scene=ServeCube,
    start=frozenset(),
    goal=("cube_served",),
    released_goal=("cube_served",),
    stages=("grasp_cube", "serve_cube"),  # the first is Tool-Use's
    max_steps=500,
)
TASKS[TASK.name] = TASK
STAGE_FACTS["serve_cube"], STAGES["serve_cube"] = "cube_served", serve_cube
register_tasks()


def main(arguments: list[str] | None = None) -> None:
    """Records the task, or draws an attempt, in a process that knows it."""
    collect.main([f"--task={TASK.name}", *(sys.argv[1:] if arguments is None else arguments)])


if __name__ == "__main__":
    main()
