"""Registers this package with LeRobot: environment, policy, robot and teleoperator types.

Kept apart from the package itself, so that its numeric parts can be imported without LeRobot or torch.
"""

import logging
from importlib.metadata import version

from lerobot_buds.core import LEROBOT_REMEDY, untried_lerobot
from lerobot_buds.envs import configuration_robosuite as configuration_robosuite
from lerobot_buds.policy import configuration_buds as configuration_buds
from lerobot_buds.teleoperation import config_robosuite_hand as config_robosuite_hand
from lerobot_buds.teleoperation import config_robosuite_sim as config_robosuite_sim

if (warning := untried_lerobot(version("lerobot"))) is not None:
    logging.getLogger(__name__).warning("%s. If something is odd: %s", warning, LEROBOT_REMEDY)
