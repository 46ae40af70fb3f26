"""How the demonstrator does each stage of the kitchen tasks."""

from collections.abc import Callable, Iterator

import numpy as np

from .motions import Action, Demonstrator, Vec

Stage = Callable[[Demonstrator], Iterator[Action]]

_HANDLE_BAR = np.array([0.0, -0.16, 0.04])  # in the drawer's frame (m)
_REGION_X = 0.15
_PUSH_HEIGHT = 0.935
_TRAVEL_HEIGHT = 1.08


def close_drawer(hand: Demonstrator) -> Iterator[Action]:
    """Pushes the open drawer shut with the closed hand, then draws back from it."""
    state = hand.state
    offset = hand.jitter(0.01) * (1.0, 1.0, 0.3)  # the bar is 18 mm thick: too high, and the hand passes over it

    before = np.array([0.0, 0.07, 0.004])

    def before_bar() -> Vec:
        bar: Vec = state.point_on("cabinet_drawer", _HANDLE_BAR) + before + offset
        return bar

    yield from hand.hold(4, closed=True)
    yield from hand.move(before_bar, closed=True, tolerance=0.02)
    yield from hand.move(
        lambda: before_bar() - (0.0, 0.10, 0.0), closed=True, until=lambda: state.joint("cabinet_slide") > -0.003
    )
    back = state.hand + hand.rng.uniform((-0.02, 0.05, 0.02), (0.0, 0.07, 0.05))
    yield from hand.move(lambda: back, closed=True, tolerance=0.025)


def push_pot(hand: Demonstrator) -> Iterator[Action]:
    """Goes behind the pot and pushes it away from the robot into the serving region with the closed hand."""
    state = hand.state
    offset = hand.jitter(0.008) * (1.0, 1.0, 0.5)
    stop = _REGION_X - hand.rng.uniform(0.0, 0.03)

    def behind(gap: float, height: float) -> Vec:
        pot = state.position("pot_main")
        return np.array([pot[0] - gap, pot[1], height]) + offset

    yield from hand.move(lambda: behind(0.13, _TRAVEL_HEIGHT), closed=True, tolerance=0.025)
    yield from hand.move(lambda: behind(0.12, _PUSH_HEIGHT), closed=True)
    yield from hand.move(
        lambda: behind(0.0, _PUSH_HEIGHT), closed=True, until=lambda: state.position("pot_main")[0] > stop
    )


STAGES: dict[str, Stage] = {"close_drawer": close_drawer, "push_pot": push_pot}
"""Every stage by the name that tasks list it under."""
