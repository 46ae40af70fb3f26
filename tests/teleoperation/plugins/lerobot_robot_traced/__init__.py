"""The simulated robot that tells what it does, found by LeRobot's commands by its package."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.robots import RobotConfig

from lerobot_buds.teleoperation.config_robosuite_sim import RobosuiteSimConfig
from lerobot_buds.teleoperation.robosuite_sim import RobosuiteSim


@RobotConfig.register_subclass("traced")
@dataclass(kw_only=True)
class TracedConfig(RobosuiteSimConfig):
    """Where to tell it: a file that gets one line of JSON an action, ``[observed numbers, action]``."""

    trace: Path


class Traced(RobosuiteSim):
    config_class, name = TracedConfig, "traced"
    seen: dict[str, float]

    def get_observation(self) -> dict[str, Any]:
        observation = super().get_observation()
        self.seen = {name: float(value) for name, value in observation.items() if np.ndim(value) == 0}
        return observation

    def send_action(self, action: dict[str, float]) -> dict[str, float]:
        with self.config.trace.open("a") as file:
            file.write(json.dumps([self.seen, action]) + "\n")
        return super().send_action(action)
