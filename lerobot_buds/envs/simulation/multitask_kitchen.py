"""The Multitask-Kitchen scene: three tasks in three variants around a cabinet, a stove with its button, and a pot."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from .furniture import button, cabinet, cube, pot, serving_region, stove
from .kitchen_facts import STOVE_OFF, cube_in_pot, cube_touches_pot, pot_in_region, stove_on
from .primitives import Primitive
from .state import SimulationState

STOVE = (0.03, 0.18, 0.895)
BUTTON = (-0.14, 0.20, 0.895)
SERVING_REGION = (0.15, -0.02, 0.878)
CABINET = (-0.05, -0.30, 0.905)

_HALF_TURN = (0.0, 0.0, 0.0, 1.0)
_CUBE_HALF_SIZE = (0.015, 0.023, 0.020)
_CUBE_YAW = -np.pi / 2
_POT_HEIGHT = 0.9035
_DRAWER_OPEN = -0.10


@dataclass(frozen=True)
class MultitaskKitchen:
    """One variant of one task of the Multitask-Kitchen.

    Attributes:
        start: Any of ``drawer_open`` (by 10 cm), ``stove_on`` and ``cube_in_pot`` (instead of on the table).
        goal: Facts that must all hold.
    """

    start: frozenset[str]
    goal: tuple[str, ...]
    table_length: float = 1.0
    latches: Mapping[str, str] = field(default_factory=dict)

    def objects(self) -> list[Primitive]:
        """Builds the fixtures, the pot and the cube."""
        return [
            cabinet(CABINET, _HALF_TURN, "ceramic", extra_posts=True),
            stove(STOVE),
            button(BUTTON),
            serving_region(SERVING_REGION),
            pot(),
            cube(_CUBE_HALF_SIZE, "bread"),
        ]

    def place(self, state: SimulationState, rng: np.random.Generator) -> None:
        """Draws and writes the start positions, ranges after the task zoo.

        Every variant draws the same numbers in the same order, so that a seed means the same pot in each of them.
        """
        pot_at = np.array([rng.uniform(0.01, 0.05), rng.uniform(-0.02, 0.02), _POT_HEIGHT])
        pot_yaw = rng.uniform(-0.1, 0.1)
        lever_on = rng.uniform(0.1, 0.3)
        cube_on_table = np.array([rng.uniform(-0.25, -0.21), rng.uniform(0.04, 0.08), 0.93])
        cube_in_pot = pot_at + np.array([*rng.uniform(-0.01, 0.01, 2), 0.030])
        state.set_pose("pot", pot_at, pot_yaw)
        state.set_pose("cube", cube_in_pot if "cube_in_pot" in self.start else cube_on_table, _CUBE_YAW)
        state.set_joint("button_hinge", lever_on if "stove_on" in self.start else STOVE_OFF)
        state.set_joint("cabinet_slide", _DRAWER_OPEN if "drawer_open" in self.start else 0.0)

    def update(self, state: SimulationState) -> None:
        """Shows the flame while the stove is on."""
        state.show("stove_flame_visual", stove_on(state))

    def facts(self, state: SimulationState) -> dict[str, bool]:
        """Evaluates the predicates of the paper's goals."""
        pot_at = state.position("pot_main")
        return {
            "drawer_closed": state.joint("cabinet_slide") > -0.01,
            "stove_on": stove_on(state),
            "stove_off": not stove_on(state),
            "cube_in_pot": cube_in_pot(state),
            "cube_touches_pot": cube_touches_pot(state),
            # The zoo's box: its middle lies 2 cm off the stove's.
            "pot_on_stove": bool(
                abs(pot_at[0] - 0.05) < 0.08 and abs(pot_at[1] - 0.20) < 0.08 and 0.90 < pot_at[2] < 0.925
            ),
            "pot_in_region": pot_in_region(state, SERVING_REGION),
        }
