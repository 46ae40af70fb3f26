"""How the arm is controlled in every task: the hand's position by the action, its orientation straight down."""

from typing import Any

import numpy as np
from robosuite.controllers import load_composite_controller_config, load_part_controller_config

CONTROL_FREQUENCY = 20
"""Control steps per second."""

# Columns are the grip site's axes in the world: straight down, fingers opening along y (robosuite 1.3's orientation).
HAND_DOWN = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def osc_position_config() -> dict[str, Any]:
    """Makes robosuite's configuration of a Panda whose actions are hand displacement (x, y, z) and gripper."""
    config: dict[str, Any] = load_composite_controller_config(robot="Panda")
    arm = load_part_controller_config(default_controller="OSC_POSITION")
    config["body_parts"] = {"right": arm | {"gripper": {"type": "GRIP"}}}
    return config


def hold_hand_down(robot: Any) -> None:
    """Makes a robot hold its hand straight down from now on, until its controllers are rebuilt by a reset.

    robosuite 1.5.1 re-targets the achieved orientation at every step, and the tilt adds up.
    """
    arm = robot.composite_controller.part_controllers["right"]
    arm.compute_goal_ori = lambda *_args, **_kwargs: HAND_DOWN
