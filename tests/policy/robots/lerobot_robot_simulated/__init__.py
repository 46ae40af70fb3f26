"""A robot of random numbers. LeRobot finds it as it finds anybody's: by package, registered configuration, name."""

import signal
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from lerobot.robots import Robot, RobotConfig


@RobotConfig.register_subclass("simulated_arm")
@dataclass(kw_only=True)
class SimulatedArmConfig(RobotConfig):
    """What the robot is like, and how long its user watches it.

    Attributes:
        joints: Names of what it measures, ending in ``.pos``.
        actuators: Names of what it can be told, ending in ``.pos``.
        views: Names of its cameras. LeRobot expects configurations of devices in a field called `cameras`.
        pixels: Height of an image.
        steps: Actions after which the user presses Ctrl-C.
        width: Width of an image; as its height where None.
        still: Whether it always observes the same.
        spread: Standard deviation of what it measures, in its unit.
    """

    joints: list[str]
    actuators: list[str]
    views: list[str]
    pixels: int
    steps: int
    width: int | None = None
    still: bool = False
    spread: float = 1.0


class SimulatedArm(Robot):
    """Remembers everything it has shown and been told."""

    config_class = SimulatedArmConfig
    name = "simulated_arm"
    made: ClassVar[list["SimulatedArm"]] = []

    def __init__(self, config: SimulatedArmConfig) -> None:
        super().__init__(config)
        self.config = config
        self.connected = False
        self.shown: list[dict[str, Any]] = []
        self.told: list[dict[str, float]] = []
        self.made.append(self)

    @property
    def observation_features(self) -> dict[str, type | tuple[int, ...]]:
        shape = (self.config.pixels, self.config.width or self.config.pixels, 3)
        return {**dict.fromkeys(self.config.joints, float), **dict.fromkeys(self.config.views, shape)}

    @property
    def action_features(self) -> dict[str, type]:
        return dict.fromkeys(self.config.actuators, float)

    @property
    def is_connected(self) -> bool:
        return self.connected

    @property
    def is_calibrated(self) -> bool:
        return True

    def connect(self, calibrate: bool = True) -> None:
        self.connected = True

    def calibrate(self) -> None: ...

    def configure(self) -> None: ...

    def get_observation(self) -> dict[str, Any]:
        rng = np.random.default_rng(0 if self.config.still else len(self.shown))
        joints = {name: float(self.config.spread * rng.normal()) for name in self.config.joints}
        shape = (self.config.pixels, self.config.width or self.config.pixels, 3)
        images = {name: rng.integers(0, 256, shape).astype(np.uint8) for name in self.config.views}
        self.shown.append({**joints, **images})
        return dict(self.shown[-1])

    def send_action(self, action: dict[str, float]) -> dict[str, float]:
        self.told.append(dict(action))
        if len(self.told) == self.config.steps:
            signal.raise_signal(signal.SIGINT)
        return action

    def disconnect(self) -> None:
        self.connected = False
