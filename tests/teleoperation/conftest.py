"""A hand whose files lie in a folder of the test's."""

import pytest

from lerobot_buds.teleoperation.config_robosuite_hand import RobosuiteHandConfig
from lerobot_buds.teleoperation.robosuite_hand import RobosuiteHand


@pytest.fixture
def hand(tmp_path):
    """Makes a `RobosuiteHand` from settings, and closes it in the end."""
    made = []

    def make(**settings):
        made.append(RobosuiteHand(RobosuiteHandConfig(calibration_dir=tmp_path, **settings)))
        return made[-1]

    yield make
    for each in made:
        each.disconnect()
