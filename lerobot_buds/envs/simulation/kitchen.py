"""The Kitchen scene: a stove with its button, a pot, a cube to cook and a serving region."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from .furniture import button, cube, pot, serving_region, stove
from .kitchen_facts import STOVE_OFF, cube_in_pot, cube_touches_pot, pot_in_region, pot_stands_on, stove_on
from .primitives import Primitive
from .state import SimulationState

STOVE = (0.03, 0.095, 0.895)
BUTTON = (-0.14, 0.10, 0.895)
SERVING_REGION = (0.145, -0.15, 0.878)

_CUBE_HALF_SIZE = (0.015, 0.025, 0.020)
_CUBE_YAW = -np.pi / 2
_POT_HEIGHT = 0.9035


@dataclass(frozen=True)
class Kitchen:
    """Cooks and serves.

    Attributes:
        start: Nothing: this scene has one start.
        goal: Facts that must all hold.
    """

    start: frozenset[str]
    goal: tuple[str, ...]
    table_length: float = 1.0
    latches: Mapping[str, str] = field(default_factory=lambda: {"stove_has_been_on": "stove_on"})

    def objects(self) -> list[Primitive]:
        """Builds the fixtures, the pot and the cube."""
        return [
            stove(STOVE),
            button(BUTTON),
            serving_region(SERVING_REGION),
            pot(),
            cube(_CUBE_HALF_SIZE, "bread"),
        ]

    def place(self, state: SimulationState, rng: np.random.Generator) -> None:
        """Draws and writes the start positions, ranges after the task zoo; the stove is off."""
        state.set_pose("cube", np.array([rng.uniform(-0.15, -0.12), rng.uniform(-0.18, -0.12), 0.93]), _CUBE_YAW)
        pot_at = np.array([rng.uniform(-0.025, -0.02), rng.uniform(-0.15, -0.13), _POT_HEIGHT])
        state.set_pose("pot", pot_at, rng.uniform(-0.1, 0.1))
        state.set_joint("button_hinge", STOVE_OFF)

    def update(self, state: SimulationState) -> None:
        """Shows the flame while the stove is on."""
        state.show("stove_flame_visual", stove_on(state))

    def facts(self, state: SimulationState) -> dict[str, bool]:
        """Evaluates the predicates of the goal and of the stages."""
        return {
            "stove_on": stove_on(state),
            "stove_off": not stove_on(state),
            "cube_in_pot": cube_in_pot(state),
            "cube_touches_pot": cube_touches_pot(state),
            "pot_in_region": pot_in_region(state, SERVING_REGION),
            "pot_on_stove": pot_stands_on(state, STOVE),
            "pot_on_table": bool(state.position("pot_main")[2] < 0.91),
        }
