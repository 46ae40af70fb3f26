"""Entry point by which LeRobot discovers the plugin: it imports the module named like the distribution."""

import lerobot_buds as lerobot_buds
