"""How the demonstrator opens and closes a cabinet's drawer, whichever way the cabinet faces."""

from collections.abc import Iterator

import numpy as np

from .motions import Action, Demonstrator, Target, Vec
from .vocabulary import Stage, draw_back, grasp, persist, push, release, sweep, up

_HANDLE_BAR = np.array([0.0, -0.16, 0.04])  # in the drawer's frame (m)
_HELD = 0.03  # further than this from the bar, a hand has lost it (m)


def open_drawer(hand: Demonstrator) -> Iterator[Action]:
    """Grasps the handle bar from above, pulls the drawer open and lets go."""
    wide = -hand.rng.uniform(0.108, 0.120)  # it cannot go beyond 0.135 m
    # Off the bar towards the hand, because the open fingers hardly fit between bar and front panel; and below it, so
    # that the pads, which reach higher than the fingertips, close on its middle and do not slip up.
    at_bar = _near_bar(hand, np.array([0.0, -0.008, -0.005]))
    spread = hand.choose((0.02, 0.003, 0.002), (0.035, 0.003, 0.002))

    def is_open() -> bool:
        return hand.state.joint("cabinet_slide") < wide

    def has_slipped() -> bool:
        return bool(np.linalg.norm(hand.state.hand - at_bar()) > _HELD + spread[0])

    def go() -> Iterator[Action]:
        yield from grasp(hand, at_bar, spread)
        until = hand.choose(is_open, lambda: is_open() or has_slipped())
        yield from sweep(hand, -_closing(hand), until, through=at_bar)
        yield from release(hand, rise=0.08)

    yield from persist(hand, go, is_open)


def close_drawer(hand: Demonstrator) -> Iterator[Action]:
    """Pushes the open drawer shut with the closed hand, then draws back from it."""
    # The bar is 18 mm thick, the fingers end 9 mm below the hand's point: too high, and they pass over it.
    spread = hand.choose((1.0, 1.0, 0.3), (3.0, 1.5, 0.3))
    before = np.array([0.0, -0.07, -0.004]) + hand.jitter(0.01) * spread
    along = _closing(hand)
    yield from push(
        hand,
        _near_bar(hand, before),
        along,
        until=lambda: hand.state.joint("cabinet_slide") > -0.003,
        hover=(0.04, 0.08),
    )
    back = -0.06 * along + up(0.035)
    yield from draw_back(hand, back - 0.01, back + 0.01)


def _near_bar(hand: Demonstrator, offset: Vec) -> Target:
    return lambda: hand.state.point_on("cabinet_drawer", _HANDLE_BAR + offset)


def _closing(hand: Demonstrator) -> Vec:
    direction: Vec = hand.state.point_on("cabinet_main", np.array([0.0, 1.0, 0.0])) - hand.state.position(
        "cabinet_main"
    )
    return direction


STAGES: dict[str, Stage] = {"open_drawer": open_drawer, "close_drawer": close_drawer}
"""The stages that this module knows."""
