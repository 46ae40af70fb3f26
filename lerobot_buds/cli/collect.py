"""``lerobot-buds-collect``: records scripted demonstrations of a robosuite task into a LeRobotDataset."""

import os
from dataclasses import dataclass

import draccus

from lerobot_buds.demos.recording import Recording, Summary, record
from lerobot_buds.envs import EnvSettings, profile_named, tasks_named

from .running import dataset_root, run


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
    """Records the demonstrations that the settings ask for."""
    (task,) = tasks_named(config.task)
    profile_named(config.render_profile)
    return record(
        Recording(
            repo_id=config.repo_id,
            root=dataset_root(config.repo_id, config.root),
            settings=EnvSettings(task.name, None, config.image_size, config.render_profile),
            episodes=config.episodes,
            seed=config.seed,
            workers=config.workers or len(os.sched_getaffinity(0)),
            video=config.video,
        )
    )


def main() -> None:
    """Entry point of the console script."""
    config = draccus.parse(CollectConfig)
    summary = run(lambda: collect(config))
    print(
        f"{summary.episodes} demonstrations, {summary.frames} frames, from {summary.attempts} attempts "
        f"in {summary.seconds:.0f} s"
    )
    for failure, count in summary.failures.items():
        print(f"  {count} failed in {failure}")
