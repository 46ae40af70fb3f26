"""BUDS for LeRobot: skills out of unsegmented demonstrations.

LeRobot finds the plugin by itself, through the module `lerobot_policy_buds`, which imports `lerobot_buds.plugin`.
Importing this package alone loads neither LeRobot nor torch nor the simulator.
"""
