"""How the demonstrator does the stages of Hammer-Place; the drawer's are those of any cabinet."""

from collections.abc import Iterator

import numpy as np

from .motions import Action, Demonstrator, Vec
from .vocabulary import Stage, carry, pick, release

_FRONT_PANEL = np.array([0.0, -0.085, 0.0])  # its inner face, in the drawer's frame (m)
_TOP_EDGE = np.array([0.0, -0.092, 0.0])  # front edge of the cabinet's top, in the cabinet's frame (m)
_RELEASE_HEIGHT = 1.047  # the opening fingers clear the front panel (m)


def grasp_hammer(hand: Demonstrator) -> Iterator[Action]:
    """Grasps the hammer's handle from above and lifts it higher than the cabinet."""
    spread = hand.choose((0.005, 0.003, 0.002), (0.009, 0.003, 0.003))
    yield from pick(hand, lambda: hand.state.position("hammer_main"), 0.17, spread)


def put_hammer_in_drawer(hand: Demonstrator) -> Iterator[Action]:
    """Carries the hammer over the middle of what is open of the drawer and drops it in."""
    state = hand.state
    offset = hand.rng.uniform(
        (-0.018, -0.008, 0.0), (-0.002, 0.008, 0.012)
    )  # the head lies on the far side of the grasp

    def over_opening(height: float) -> Vec:
        middle = (state.point_on("cabinet_drawer", _FRONT_PANEL) + state.point_on("cabinet_main", _TOP_EDGE)) / 2
        return np.array([middle[0], middle[1], height]) + offset

    yield from carry(hand, "hammer_main", lambda: over_opening(_RELEASE_HEIGHT + 0.05), tolerance=0.015)
    yield from carry(hand, "hammer_main", lambda: over_opening(_RELEASE_HEIGHT), tolerance=0.008)
    yield from release(hand, rise=0.05)


STAGES: dict[str, Stage] = {"grasp_hammer": grasp_hammer, "put_hammer_in_drawer": put_hammer_in_drawer}
"""The stages that this module knows."""
