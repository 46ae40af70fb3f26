"""The predicates that scenes with a pot or a stove share, with the task zoo's thresholds."""

import numpy as np

from .primitives import Vector
from .state import SimulationState

STOVE_OFF = -0.25
"""Lever of a stove that starts off (rad). The zoo's -0.4 lies beyond the hinge's range and springs back here."""


def stove_on(state: SimulationState) -> bool:
    """Tells whether the lever switches the stove on: hinge at or beyond its middle."""
    return state.joint("button_hinge") >= 0.0


def cube_in_pot(state: SimulationState) -> bool:
    """Tells whether the cube is in the pot; one that only touches its outside is not.

    That is the zoo's predicate in Tool-Use; in its kitchens any contact counts.
    """
    away = np.abs(state.position("pot_main") - state.position("cube_main"))
    return bool(state.touching("cube", "pot") and np.hypot(*away[:2]) < 0.06 and away[2] < 0.05)


def cube_touches_pot(state: SimulationState) -> bool:
    """Tells whether the cube touches the pot anywhere, which is "in the pot" to the zoo's kitchens."""
    return state.touching("cube", "pot")


def pot_stands_on(state: SimulationState, stove: Vector) -> bool:
    """Tells whether the pot stands on a stove (ours): its middle over the plate, its floor down to it.

    Args:
        state: The simulation.
        stove: The stove's position in the world (m).
    """
    away = np.abs(state.position("pot_main") - np.array(stove) - (0.0, 0.0, 0.025))
    return bool((away < (0.08, 0.08, 0.01)).all())


def pot_in_region(state: SimulationState, region: Vector) -> bool:
    """Tells whether the pot stands in the serving region.

    Args:
        state: The simulation.
        region: The region's position in the world (m).
    """
    return bool((np.abs(state.position("pot_main") - np.array(region)) < (0.05, 0.10, 0.05)).all())
