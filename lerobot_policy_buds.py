"""Entry point by which LeRobot discovers the plugin: it imports the module named like the distribution."""

from lerobot_buds import plugin as plugin
