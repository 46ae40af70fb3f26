"""How the demonstrator does each stage of the kitchen tasks."""

from collections.abc import Iterator

import numpy as np

from .motions import Action, Demonstrator, Vec
from .vocabulary import Stage, push

_REGION_X = 0.15
_PUSH_HEIGHT = 0.935


def push_pot(hand: Demonstrator) -> Iterator[Action]:
    """Goes behind the pot and pushes it away from the robot into the serving region with the closed hand."""
    state = hand.state
    offset = hand.jitter(0.008) * (1.0, 1.0, 0.5)
    stop = _REGION_X - hand.rng.uniform(0.0, 0.03)

    def behind_pot() -> Vec:
        pot = state.position("pot_main")
        return np.array([pot[0] - 0.12, pot[1], _PUSH_HEIGHT]) + offset

    yield from push(
        hand, behind_pot, (1.0, 0.0, 0.0), until=lambda: state.position("pot_main")[0] > stop, hover=(0.12, 0.16)
    )


STAGES: dict[str, Stage] = {"push_pot": push_pot}
"""The stages that this module knows."""
