"""Registers this package with LeRobot: the environment type ``robosuite`` and the policy type ``buds``.

Kept apart from the package itself, so that its numeric parts can be imported without LeRobot or torch.
"""

import logging
from importlib.metadata import version

from lerobot_buds.core import LEROBOT_REMEDY, untried_lerobot
from lerobot_buds.envs import configuration_robosuite as configuration_robosuite
from lerobot_buds.policy import configuration_buds as configuration_buds

if (warning := untried_lerobot(version("lerobot"))) is not None:
    logging.getLogger(__name__).warning("%s. If something is odd: %s", warning, LEROBOT_REMEDY)
