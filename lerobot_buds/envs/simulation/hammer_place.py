"""The Hammer-Place scene: a hammer on the table and a cabinet with a closed drawer to put it in."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from .furniture import cabinet
from .primitives import Primitive
from .state import SimulationState
from .tools import hammer

CABINET = (0.0, 0.30, 0.905)

_NO_TURN = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class HammerPlace:
    """The task with its one start.

    Attributes:
        start: Empty.
        goal: Facts that must all hold.
    """

    start: frozenset[str]
    goal: tuple[str, ...]
    table_length: float = 0.8
    latches: Mapping[str, str] = field(default_factory=dict)

    def objects(self) -> list[Primitive]:
        """Builds the cabinet, whose drawer opens by 13.5 cm towards -y, and the hammer."""
        return [cabinet(CABINET, _NO_TURN, "red_wood", extra_posts=False), hammer()]

    def place(self, state: SimulationState, rng: np.random.Generator) -> None:
        """Draws and writes the hammer's place, ranges after the task zoo; its claw faces either side."""
        hammer_at = np.array([rng.uniform(-0.10, -0.02), rng.uniform(-0.20, -0.13), 0.933])
        state.set_pose("hammer", hammer_at, 0.0, roll=np.pi * rng.integers(2))
        state.set_joint("cabinet_slide", 0.0)

    def update(self, state: SimulationState) -> None:
        """Nothing changes its looks here."""

    def facts(self, state: SimulationState) -> dict[str, bool]:
        """Evaluates the predicates of the zoo, to which a hammer on top of the cabinet lies too high, and of stages."""
        at, slide = state.position("hammer_main"), state.joint("cabinet_slide")
        in_drawer = at - state.position("cabinet_drawer")
        return {
            "hammer_in_drawer": bool(0.94 < at[2] < 1.0 and at[1] > 0.22),
            "drawer_closed": slide > -0.01,
            "drawer_open": slide < -0.10,  # wide enough for the hammer
            "hammer_lifted": bool(at[2] > 1.0),  # over the drawer's front
            # Between its walls, wherever it has been pulled to.
            "hammer_laid_in": bool(abs(in_drawer[0]) < 0.07 and -0.09 < in_drawer[1] < 0.06 and 0.94 < at[2] < 1.0),
        }
