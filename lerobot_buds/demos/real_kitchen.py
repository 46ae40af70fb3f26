"""How the demonstrator does each stage of the real kitchen's twin."""

from collections.abc import Iterator

import numpy as np

from .kitchen import move_pot
from .motions import Action, Demonstrator, Vec
from .vocabulary import Stage, carry, pick, release, sweep, up

_KNOB = np.array([0.0, 0.0, 0.020])  # in the lid's frame (m)
_LID_LYING = 0.915  # height of the lid's origin (m)
_POT_ON_TRAY = 0.014  # the pot's origin above the tray's (m)
_LYING, _CARRIED = 0.923, 1.0  # heights of the tool's origin (m)
_BESIDE_TRAY = 0.15  # from the tray's middle to the tool's bar (m)
_ASIDE = 0.155  # y of a tray that is far enough aside (m)


def take_lid_off(hand: Demonstrator) -> Iterator[Action]:
    """Lifts the lid by its knob and lays it down beside the pot."""
    state = hand.state
    place = state.position("pot_main") + hand.rng.uniform((-0.19, 0.0, 0.0), (-0.16, 0.06, 0.0))
    place[2] = _LID_LYING
    yield from pick(hand, lambda: state.point_on("lid_main", _KNOB), 0.06)
    yield from carry(hand, "lid_main", lambda: place + up(0.10), tolerance=0.02)
    yield from carry(hand, "lid_main", lambda: place, tolerance=0.008)
    yield from release(hand, rise=0.08)


def pot_on_tray(hand: Demonstrator) -> Iterator[Action]:
    """Takes the pot by a handle and puts it on the tray."""
    state = hand.state
    yield from move_pot(hand, lambda: state.position("tray_main") + up(_POT_ON_TRAY), aim=(0.006, 0.006, 0.0))


def take_tool(hand: Demonstrator) -> Iterator[Action]:
    """Grasps the tool's bar behind its middle and lifts it."""
    along_bar = np.array([hand.rng.uniform(-0.09, -0.08), 0.0, 0.0])
    yield from pick(hand, lambda: hand.state.point_on("tool_main", along_bar), 0.08)


def push_tray(hand: Demonstrator) -> Iterator[Action]:
    """Puts the tool's bar beside the tray, the hook around it, and pushes the tray aside."""
    state = hand.state
    offset = hand.rng.uniform((-0.003, -0.01), (0.003, 0.0))

    def beside_tray(height: float) -> Vec:
        tray = state.position("tray_main")
        return np.array([tray[0] - 0.016 + offset[0], tray[1] - _BESIDE_TRAY + offset[1], height])

    yield from carry(hand, "tool_main", lambda: beside_tray(_CARRIED), tolerance=0.012)
    yield from carry(hand, "tool_main", lambda: beside_tray(_LYING), tolerance=0.007)
    enough = _ASIDE + hand.rng.uniform(0.0, 0.02)
    yield from sweep(hand, (0.0, 1.0, 0.0), until=lambda: state.position("tray_main")[1] > enough)


def put_tool_down(hand: Demonstrator) -> Iterator[Action]:
    """Draws the tool back from the tray and lets go of it on the table."""
    state = hand.state
    place = state.position("tool_main") + hand.rng.uniform((-0.005, -0.07, 0.0), (0.005, -0.05, 0.0))
    place[2] = _LYING
    yield from carry(hand, "tool_main", lambda: place, tolerance=0.007)
    yield from release(hand, rise=0.08)


STAGES: dict[str, Stage] = {
    "take_lid_off": take_lid_off,
    "pot_on_tray": pot_on_tray,
    "take_tool": take_tool,
    "push_tray": push_tray,
    "put_tool_down": put_tool_down,
}
"""The stages that this module knows."""
