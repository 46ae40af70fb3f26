"""The robot type ``robosuite_sim`` on LeRobot's command line; what it does is in `robosuite_sim`, loaded when made."""

from dataclasses import dataclass

from lerobot.robots import RobotConfig

from lerobot_buds.core import ConfigError
from lerobot_buds.envs import profile_named, tasks_named

SMALLEST_IMAGE = 32
"""The least that LeRobot's video encoder takes (pixels): of smaller images it ends its process, or never ends."""


@RobotConfig.register_subclass("robosuite_sim")
@dataclass(kw_only=True)
class RobosuiteSimConfig(RobotConfig):  # type: ignore[misc]  # LeRobot ships no types
    """One of our tasks as a robot, for LeRobot's commands.

    Attributes:
        task: Name of one task, ``suite/task``.
        image_size: Height and width of both cameras (pixels), at least `SMALLEST_IMAGE`.
        render_profile: What is drawn: ``fast``, ``fastest`` or ``full``.
        seed: Seed of the first episode; each further one takes the next. Seeds from 100000 on are for evaluation.
        end_after_success_s: An episode ends by itself once success has held for so long (s); None: it never does.
        episode_length: Length (control steps) at which an episode ends by itself; None for the task's own.
        new_scene_s: How long a new scene is shown before its episode begins by itself (s); None: for as long as LeRobot
            leaves its user to set up the scene (``--dataset.reset_time_s``), which is the most in any case.
        dataset_root: The folder that is recorded into, as in ``--dataset.root``: the robot, which is not told,
            writes there how the demonstrations came about. None: nothing is written.
    """

    task: str = "tool_use/cube_fetched"
    image_size: int = 128
    render_profile: str = "fast"
    seed: int = 0
    end_after_success_s: float | None = 0.5
    episode_length: int | None = None
    new_scene_s: float | None = 1.0
    dataset_root: str | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        tasks = tasks_named(self.task)
        if len(tasks) != 1:
            raise ConfigError(f"robot.task={self.task!r} names {len(tasks)} tasks; one robot runs exactly one.")
        profile_named(self.render_profile)
        for name, least in (("image_size", SMALLEST_IMAGE), ("seed", 0), ("episode_length", 1)):
            value = getattr(self, name)
            if value is not None and value < least:
                raise ConfigError(f"robot.{name}={value} cannot work; it must be at least {least}.")
        for name in ("end_after_success_s", "new_scene_s"):
            value = getattr(self, name)
            if value is not None and not value >= 0:
                raise ConfigError(f"robot.{name}={value} cannot work; it is a time in seconds, or null for never.")
