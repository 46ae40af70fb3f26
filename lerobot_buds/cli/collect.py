"""``lerobot-buds-collect``: records scripted demonstrations of a robosuite task into a LeRobotDataset."""

import os
from dataclasses import dataclass

from lerobot_buds.core import ConfigError
from lerobot_buds.demos.recording import Recording, Summary, record
from lerobot_buds.envs import EnvSettings, profile_named, tasks_named

from .running import dataset_root, parse, run


@dataclass
class CollectConfig:
    """Settings of a recording."""

    repo_id: str
    """The dataset's name, for example ``me/close_and_serve``."""

    task: str = "multitask_kitchen/task3_variant1"
    """The task's name."""

    episodes: int = 40
    """Number of successful demonstrations wanted."""

    root: str | None = None
    """The dataset's folder; None for LeRobot's own place for `repo_id`."""

    seed: int = 0
    """Seed of the first attempt; below 100,000, where evaluation seeds begin."""

    workers: int = 0
    """Parallel processes; 0 for one a core."""

    image_size: int = 128
    """Height and width of both cameras (pixels)."""

    render_profile: str = "fast"
    """What is drawn: ``fast``, ``fastest`` or ``full``."""

    video: bool = True
    """Stores the cameras as video, else as images."""


def collect(config: CollectConfig) -> Summary:
    """Records the demonstrations that the settings ask for.

    Raises:
        ConfigError: A setting cannot work.
        DatasetError: The dataset exists, or another process is recording it.
        BudsError: The demonstrator fails most of its attempts, or a worker process died.
    """
    tasks = tasks_named(config.task)
    if len(tasks) != 1:
        raise ConfigError(f"{config.task!r} names {len(tasks)} tasks; record one dataset each.")
    profile_named(config.render_profile)
    return record(
        Recording(
            repo_id=config.repo_id,
            root=dataset_root(config.repo_id, config.root),
            settings=EnvSettings(tasks[0].name, None, config.image_size, config.render_profile),
            episodes=config.episodes,
            seed=config.seed,
            workers=config.workers or len(os.sched_getaffinity(0)),
            video=config.video,
        )
    )


def main() -> None:
    """Entry point of the console script."""
    config = parse(CollectConfig)
    summary = run(lambda: collect(config))
    print(
        f"{summary.episodes} demonstrations, {summary.frames} frames, from {summary.attempts} attempts "
        f"in {summary.seconds:.0f} s"
    )
    for failure, count in summary.failures.items():
        print(f"  {count} failed in {failure}")
