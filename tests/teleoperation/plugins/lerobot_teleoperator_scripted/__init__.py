"""A teleoperator that does what the scripted demonstrator did from the same seeds; tests interrupt it."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import numpy as np
from lerobot.teleoperators import Teleoperator, TeleoperatorConfig

from lerobot_buds.demos.attempts import attempt
from lerobot_buds.envs import ACTION_NAMES, EnvSettings, RobosuiteEnv
from lerobot_buds.teleoperation.announcements import Announcement, Announcements

STILL = dict.fromkeys(ACTION_NAMES, 0.0)


@cache
def actions_of(task: str, seed: int) -> np.ndarray:
    """The demonstrator's actions, ``(T, 4)``; they lead to success that is held for ten steps."""
    env = RobosuiteEnv(EnvSettings(task, draws=False))
    done = attempt(env, seed)
    env.close()
    assert done.success, done.failure
    return done.arrays["action"]


@TeleoperatorConfig.register_subclass("scripted")
@dataclass(kw_only=True)
class ScriptedConfig(TeleoperatorConfig):
    """What is done.

    Attributes:
        task: The task.
        seeds: Seeds of the robot's episodes, in the order in which they are announced.
    """

    task: str
    seeds: list[int]


class Scripted(Teleoperator):
    """Acts while an episode is recorded, or a correction."""

    config_class = ScriptedConfig
    name = "scripted"
    before: ClassVar[Callable[[int, int], None] | None] = None
    """Called with the number of the episode and of the step in it, before every action."""

    def __init__(self, config: ScriptedConfig) -> None:
        super().__init__(config)
        self.config = config
        self.announcements = Announcements()
        self.connected = False
        self.episode, self.step, self.acts = -1, 0, False

    @property
    def action_features(self) -> dict[str, type]:
        return dict.fromkeys(ACTION_NAMES, float)

    @property
    def feedback_features(self) -> dict[str, type]:
        return {}

    @property
    def is_connected(self) -> bool:
        return self.connected

    @property
    def is_calibrated(self) -> bool:
        return True

    def connect(self, calibrate: bool = True) -> None:
        for seed in self.config.seeds:
            actions_of(self.config.task, seed)
        self.announcements.listen()
        self.connected = True

    def calibrate(self) -> None: ...

    def configure(self) -> None: ...

    def send_feedback(self, feedback: dict[str, Any]) -> None: ...

    def get_action(self) -> dict[str, float]:
        for what, _ in self.announcements.heard():
            if what in (Announcement.EPISODE, Announcement.CORRECTION):
                self.episode, self.step, self.acts = self.episode + 1, 0, True
            elif what is Announcement.RESET:
                self.acts = False
        if not self.acts:
            return dict(STILL)
        if Scripted.before is not None:
            Scripted.before(self.episode, self.step)
        actions = actions_of(self.config.task, self.config.seeds[self.episode % len(self.config.seeds)])
        self.step += 1
        if self.step > len(actions):
            return dict(STILL)
        return dict(zip(ACTION_NAMES, actions[self.step - 1].tolist(), strict=True))

    def disconnect(self) -> None:
        self.announcements.stop()
        self.connected = False
