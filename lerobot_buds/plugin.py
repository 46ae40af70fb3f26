"""Registers this package with LeRobot: the environment type ``robosuite`` and the policy type ``buds``.

Kept apart from the package itself, so that its numeric parts can be imported without LeRobot or torch.
"""

from lerobot_buds.envs import configuration_robosuite as configuration_robosuite
from lerobot_buds.policy import configuration_buds as configuration_buds
