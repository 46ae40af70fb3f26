"""What each key does, on the keyboard and in the page: the one list of them. See docs/teleoperation.md.

Arrows, ``n``, ``r``, ``q`` and Escape are LeRobot's while it records, and space, Tab and Enter while a person corrects
a policy (its dagger strategy): a key of ours among them would end an episode, or hand the robot back.
"""

from collections.abc import Set
from dataclasses import dataclass

PAPER_SPEED = 0.625
"""Displacement that a SpaceMouse pushed to its end gave in the paper's collection, of the 1 that the environments take:
robosuite 1.3 scaled its reading in [-1, 1] by 0.005 and that by 125. 3 cm ahead of the hand, some 0.17 m/s."""

CLOSE, STAY, OPEN = 0.0, 1.0, 2.0
"""A gripper's commands as LeRobot's teleoperators give them."""

SLOW_KEY = "shift"
SLOW = 0.3
"""Share of the speed while `SLOW_KEY` is held (ours: a key is all or nothing; 2.5 mm a step place a thing)."""


@dataclass(frozen=True)
class Key:
    """What a key does while it is held.

    Attributes:
        label: What the person sees.
        axis: The value of an operator's action that it sets, see `action_of`.
        value: What it is set to.
    """

    label: str
    axis: str
    value: float


KEYS = {
    "w": Key("away", "delta_x", 1.0),
    "s": Key("near", "delta_x", -1.0),
    "a": Key("left", "delta_y", 1.0),
    "d": Key("right", "delta_y", -1.0),
    "i": Key("up", "delta_z", 1.0),
    "k": Key("down", "delta_z", -1.0),
    "j": Key("close", "gripper", CLOSE),
    "l": Key("open", "gripper", OPEN),
}

BUTTONS = {
    "next": "Next",
    "re-record": "Re-record",
    "stop": "Stop",
    "pause": "Pause or resume",
    "correct": "Take over or hand back",
}
"""What may be pressed, and how it is labelled. The first three are for recording, the others for corrections."""

RECORDING = ("next", "re-record", "stop")


def action_of(held: Set[str]) -> dict[str, float]:
    """Tells what held keys ask for, in the terms of LeRobot's gamepad.

    Args:
        held: Names of keys; those that mean nothing are passed over.

    Returns:
        ``delta_x`` (away from the operator), ``delta_y`` (to the left) and ``delta_z`` (up), in [-1, 1], and
        ``gripper`` (0 closes, 1 stays, 2 opens). Keys that contradict each other cancel out.
    """
    axes = {"delta_x": 0.0, "delta_y": 0.0, "delta_z": 0.0}
    asked = {key.value for name, key in KEYS.items() if name in held and key.axis == "gripper"}
    for name in held & KEYS.keys():
        if (axis := KEYS[name].axis) in axes:
            axes[axis] += KEYS[name].value
    speed = SLOW if SLOW_KEY in held else 1.0
    return {
        **{axis: speed * value for axis, value in axes.items()},
        "gripper": asked.pop() if len(asked) == 1 else STAY,
    }
