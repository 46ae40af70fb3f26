"""Robots of tests, which LeRobot's commands find by their package: one that tells what another does, and a stand-in."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.robots import Robot, RobotConfig, make_robot_from_config

from lerobot_buds.envs import ACTION_NAMES, STATE_NAMES, EnvSettings, RobosuiteEnv
from lerobot_buds.teleoperation.page import open_page


@RobotConfig.register_subclass("traced")
@dataclass(kw_only=True)
class TracedConfig(RobotConfig):
    """Another robot, and where to tell what it does.

    Attributes:
        robot: The other one's type. (A configuration within one of the same kind is more than draccus can follow.)
        settings: The other one's settings.
        trace: A file that gets one line of JSON an action: ``[observed numbers, action]``.
    """

    robot: str
    trace: Path
    settings: dict[str, Any] = field(default_factory=dict)


@RobotConfig.register_subclass("bare_environment")
@dataclass(kw_only=True)
class BareEnvironmentConfig(RobotConfig):
    """The least that a robot of our environments must do.

    Attributes:
        task: Its name.
    """

    task: str = "tool_use/cube_fetched"


class _Device(Robot):
    """What both have in common."""

    def __init__(self, config: Any) -> None:
        super().__init__(config)
        self.config = config
        self.connected = False

    @property
    def is_connected(self) -> bool:
        return self.connected

    @property
    def is_calibrated(self) -> bool:
        return True

    def calibrate(self) -> None: ...

    def configure(self) -> None: ...


class Traced(_Device):
    config_class, name = TracedConfig, "traced"

    def __init__(self, config: TracedConfig) -> None:
        super().__init__(config)
        self.robot = make_robot_from_config(RobotConfig.get_choice_class(config.robot)(**config.settings))
        self.seen: dict[str, float] = {}

    @property
    def observation_features(self) -> dict[str, Any]:
        return self.robot.observation_features

    @property
    def action_features(self) -> dict[str, type]:
        return self.robot.action_features

    def connect(self, calibrate: bool = True) -> None:
        self.robot.connect()
        self.connected = True

    def get_observation(self) -> dict[str, Any]:
        observation = self.robot.get_observation()
        self.seen = {name: float(value) for name, value in observation.items() if np.ndim(value) == 0}
        return observation

    def send_action(self, action: dict[str, float]) -> dict[str, float]:
        with self.config.trace.open("a") as file:
            file.write(json.dumps([self.seen, action]) + "\n")
        return self.robot.send_action(action)

    def disconnect(self) -> None:
        self.robot.disconnect()
        self.connected = False


class BareEnvironment(_Device):
    config_class, name = BareEnvironmentConfig, "bare_environment"
    observation_features = dict.fromkeys(STATE_NAMES, float)
    action_features = dict.fromkeys(ACTION_NAMES, float)

    def connect(self, calibrate: bool = True) -> None:
        self.env = RobosuiteEnv(EnvSettings(self.config.task, image_size=32, draws=False))
        self.observation, _ = self.env.reset(seed=0)
        self.connected = True

    def get_observation(self) -> dict[str, Any]:
        if page := open_page():
            page.show(self.observation["pixels"], {"task": self.config.task})
        return dict(zip(STATE_NAMES, self.observation["agent_pos"].tolist(), strict=True))

    def send_action(self, action: dict[str, float]) -> dict[str, float]:
        self.observation, *_ = self.env.step(np.array([action[name] for name in ACTION_NAMES], np.float32))
        return action

    def disconnect(self) -> None:
        self.env.close()
        self.connected = False
