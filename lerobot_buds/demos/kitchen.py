"""How the demonstrator does each stage of the kitchen tasks.

Positions in comments and constants are metres; bodies are those of `envs.simulation.furniture`.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from .motions import Action, Demonstrator, Target, Vec
from .tool_use import grasp_cube, put_cube_in_pot
from .vocabulary import Stage, carry, draw_back, lift, pick, push, release, up

_PAD = np.array([0.0, 0.0, 0.08])  # in the switch's frame
# In the pot's frame: the handle away from the cabinet, whose own handle would stop the hand, 6 mm below the bar's
# centre, where the pot tilts least.
_POT_HANDLE = np.array([0.0, 0.06, 0.071])
_OTHER_HANDLE = _POT_HANDLE * (1.0, -1.0, 1.0)
_NO_CABINET = -0.1  # a pot further right than this (m, y) stands in the kitchen that has no cabinet
_LEVER_TURNED = 0.12  # rad
_OVER_LEVER = 0.058  # a closed hand that is this much too high passes over the pad (m)
_PUSH_HEIGHT = 0.935
_POT_ON_STOVE = 0.026  # the pot's origin above the stove's
_POT_ON_TABLE = 0.9045


def turn_on(hand: Demonstrator) -> Iterator[Action]:
    """Pushes the lever away from the robot's right, which lights the stove."""
    yield from _turn_lever(hand, 1.0)


def turn_off(hand: Demonstrator) -> Iterator[Action]:
    """Pushes the lever back."""
    yield from _turn_lever(hand, -1.0)


def cube_in_pot(hand: Demonstrator) -> Iterator[Action]:
    """Picks the cube up and drops it into the pot from just above the handles."""
    yield from grasp_cube(hand)
    yield from put_cube_in_pot(hand)


def pot_on_stove(hand: Demonstrator) -> Iterator[Action]:
    """Takes the pot by a handle and puts it on the stove."""
    state = hand.state
    yield from move_pot(hand, lambda: state.position("stove_main") + up(_POT_ON_STOVE))


def pot_off_stove(hand: Demonstrator) -> Iterator[Action]:
    """Puts the pot back on the table, short of the serving region."""
    state = hand.state
    short = hand.rng.uniform(0.15, 0.17)

    def beside_region() -> Vec:
        region = state.position("serving_region_main")
        return np.array([region[0] - short, region[1], _POT_ON_TABLE])

    yield from move_pot(hand, beside_region)


def push_pot(hand: Demonstrator) -> Iterator[Action]:
    """Goes behind the pot and pushes it away from the robot into the serving region with the closed hand."""
    state = hand.state
    # Left of the pot's middle: further right, the palm would come down on the handle of a cabinet's drawer.
    right = -0.015 if state.position("pot_main")[1] < _NO_CABINET else 0.004
    corners = hand.choose(
        ((-0.008, 0.004, -0.004), (0.008, 0.020, 0.004)), ((-0.030, right, -0.008), (0.008, 0.025, 0.012))
    )
    offset = hand.rng.uniform(*corners)
    stop = state.position("serving_region_main")[0] - hand.rng.uniform(0.0, 0.03)

    def behind_pot() -> Vec:
        pot = state.position("pot_main")
        return np.array([pot[0] - 0.12, pot[1], _PUSH_HEIGHT]) + offset

    yield from push(
        hand, behind_pot, (1.0, 0.0, 0.0), until=lambda: state.position("pot_main")[0] > stop, hover=(0.12, 0.16)
    )
    yield from draw_back(hand, (-0.06, -0.01, 0.0), (-0.04, 0.01, 0.02))
    yield from lift(hand, 0.10)


def move_pot(hand: Demonstrator, goal: Target, aim: Sequence[float] = (0.008, 0.008, 0.0)) -> Iterator[Action]:
    """Carries the pot by its left handle, or by either where no cabinet stands in the way, and sets it down.

    Args:
        hand: The hand.
        goal: Where the pot's origin is to be (m), just above its support.
        aim: It is set down off this point by up to so much along each axis (m).
    """
    state = hand.state
    off = hand.rng.uniform(-1.0, 1.0, 3) * aim
    handle = _POT_HANDLE
    if hand.choose(False, state.position("pot_main")[1] < _NO_CABINET) and hand.rng.random() < 0.5:
        handle = _OTHER_HANDLE
    spread = hand.choose((0.006, 0.001, 0.0015), (0.010, 0.001, 0.0025))
    yield from pick(hand, lambda: state.point_on("pot_main", handle), 0.06, spread)
    height = hand.rng.uniform(0.05, 0.07)
    yield from carry(hand, "pot_main", lambda: goal() + off + up(height), tolerance=0.015)
    yield from carry(hand, "pot_main", lambda: goal() + off, tolerance=0.008)
    yield from release(hand, 0.09)


def _turn_lever(hand: Demonstrator, side: float) -> Iterator[Action]:
    state = hand.state
    before = np.array([0.0, -0.11 * side, 0.005]) + hand.jitter(0.008) * hand.choose((1.0, 1.0, 0.5), (2.0, 2.5, 1.2))

    def before_pad() -> Vec:
        pad: Vec = state.point_on("button_switch", _PAD) + before
        return pad

    yield from push(
        hand,
        before_pad,
        (0.0, side, 0.0),
        until=lambda: side * state.joint("button_hinge") > _LEVER_TURNED,
        hover=(0.06, 0.10),
        over=_OVER_LEVER,
    )
    yield from draw_back(hand, (-0.01, -0.045 * side - 0.01, 0.02), (0.01, -0.045 * side + 0.01, 0.04))
    yield from lift(hand, 0.08)


STAGES: dict[str, Stage] = {
    "turn_on": turn_on,
    "turn_off": turn_off,
    "cube_in_pot": cube_in_pot,
    "pot_on_stove": pot_on_stove,
    "pot_off_stove": pot_off_stove,
    "push_pot": push_pot,
}
"""The stages that this module knows."""
