"""What held keys ask for."""

import pytest

from lerobot_buds.teleoperation.layout import CLOSE, KEYS, OPEN, SLOW, SLOW_KEY, STAY, action_of

STILL = {"delta_x": 0.0, "delta_y": 0.0, "delta_z": 0.0, "gripper": STAY}


@pytest.mark.parametrize(
    ("held", "asked"),
    [
        (set(), {}),
        ({"w"}, {"delta_x": 1.0}),
        ({"s", "d"}, {"delta_x": -1.0, "delta_y": -1.0}),
        ({"a", "i", SLOW_KEY}, {"delta_y": SLOW, "delta_z": SLOW}),
        ({"w", "s", "k"}, {"delta_z": -1.0}),
        ({"j"}, {"gripper": CLOSE}),
        ({"l", SLOW_KEY}, {"gripper": OPEN}),
        ({"j", "l"}, {}),
        ({"x", "ctrl", "page_up"}, {}),
    ],
)
def test_held_keys_by_hand(held, asked):
    assert action_of(held) == {**STILL, **asked}


def test_no_key_is_one_of_lerobots():
    """Those of its recording and of its corrections, which listen to the same keyboard."""
    assert KEYS.keys().isdisjoint({"n", "r", "q", "left", "right", "esc", "space", "tab", "enter"})
    assert SLOW_KEY not in KEYS
