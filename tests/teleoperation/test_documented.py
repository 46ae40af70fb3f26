"""docs/teleoperation.md tells of the keys and defaults that there are."""

import re
from pathlib import Path

import pytest

from lerobot_buds.teleoperation.config_robosuite_hand import DEVICES, RobosuiteHandConfig
from lerobot_buds.teleoperation.displacement import DisplacementStep
from lerobot_buds.teleoperation.layout import KEYS, SLOW, SLOW_KEY, action_of

PAGE = (Path(__file__).parents[2] / "docs/teleoperation.md").read_text()
ROWS = dict(re.findall(r"^\| `(\w+)` \| .*? \| (?:`([\w.]+` -?[\d.]+))? *\|$", PAGE, flags=re.M))


def test_every_key_has_a_row_and_no_other():
    assert list(ROWS) == [*KEYS, SLOW_KEY]
    assert f"`{SLOW_KEY}` | moves at {SLOW} of the speed" in PAGE


@pytest.mark.parametrize("key", KEYS)
def test_a_key_does_what_its_row_says(key):
    step = DisplacementStep()
    before = step.action(action_of({"j" if key == "l" else "l"}))  # so that the gripper has something to change
    axis, value = ROWS[key].split("` ")
    assert step.action(action_of({key})) == before | {axis: float(value)}


def test_devices_and_defaults():
    config = RobosuiteHandConfig()
    assert re.findall(r"^\| `(\w+)` \| (?:nothing|`pip)", PAGE, flags=re.M) == [
        "page",
        "keyboard",
        "gamepad",
        "spacemouse",
    ]
    assert set(DEVICES) == {"page", "keyboard", "gamepad", "spacemouse"}
    assert f"`--teleop.speed` ({config.speed})" in PAGE and f"127.0.0.1:{config.port}/" in PAGE
