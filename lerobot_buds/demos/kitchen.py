"""How the demonstrator does each stage of the kitchen tasks."""

from collections.abc import Iterator

import numpy as np

from .motions import Action, Demonstrator, Vec
from .vocabulary import Stage, draw_back, push

_HANDLE_BAR = np.array([0.0, -0.16, 0.04])  # in the drawer's frame (m)
_REGION_X = 0.15
_PUSH_HEIGHT = 0.935


def close_drawer(hand: Demonstrator) -> Iterator[Action]:
    """Pushes the open drawer shut with the closed hand, then draws back from it."""
    state = hand.state
    # The bar is 18 mm thick: too high, and the hand passes over it.
    before = np.array([0.0, 0.07, 0.004]) + hand.jitter(0.01) * (1.0, 1.0, 0.3)

    def before_bar() -> Vec:
        bar: Vec = state.point_on("cabinet_drawer", _HANDLE_BAR) + before
        return bar

    yield from push(hand, before_bar, (0.0, -1.0, 0.0), until=lambda: state.joint("cabinet_slide") > -0.003)
    yield from draw_back(hand, (-0.02, 0.05, 0.02), (0.0, 0.07, 0.05))


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


STAGES: dict[str, Stage] = {"close_drawer": close_drawer, "push_pot": push_pot}
"""Every stage by the name that tasks list it under."""
