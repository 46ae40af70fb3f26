"""``lerobot-buds-collect``: records scripted demonstrations of a robosuite task into a LeRobotDataset."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from lerobot_buds.core import ConfigError
from lerobot_buds.envs import EnvSettings, profile_named, tasks_named

from .running import dataset_root, parse, run

if TYPE_CHECKING:
    from lerobot_buds.demos.recording import Summary


@dataclass
class CollectConfig:
    """Settings of a recording."""

    repo_id: str = ""
    """The dataset's name, for example ``me/close_and_serve``; only a preview needs none."""

    task: str = "multitask_kitchen/task3_variant1"
    """Task names, comma-separated; a suite's name selects all of its tasks. All go into one dataset."""

    episodes: int = 40
    """Number of successful demonstrations wanted of each task."""

    root: Path | None = None
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

    manner: str = "scripted"
    """How it is demonstrated: ``scripted``, or as ``people`` do it, who wait, miss, correct and try again."""

    clean_actions: bool = False
    """Records as actions what was meant, without the tremor that was executed with it."""

    journal: Path | None = None
    """Folder of the journal that a killed recording on the simulated robot has left beside its dataset: its episodes
    are done again, and nothing is demonstrated. Task, size, profile and seeds are the journal's."""

    preview: Path | None = None
    """Folder for one contact sheet a task, of one attempt each, to look at; nothing is recorded then."""


def collect(config: CollectConfig) -> "Summary":
    """Records the demonstrations that the settings ask for.

    Raises:
        ConfigError: A setting cannot work.
        DatasetError: The dataset exists, or another process is recording it.
        BudsError: The demonstrator fails most of its attempts, or a worker process died.
    """
    from lerobot_buds.demos.attempts import Style
    from lerobot_buds.demos.recording import Recording, record

    if not config.repo_id:
        raise ConfigError("The dataset has no name; give it one, for example --repo_id=me/close_and_serve.")
    return record(
        Recording(
            repo_id=config.repo_id,
            root=dataset_root(config.repo_id, config.root),
            settings=env_settings(config),
            episodes=config.episodes,
            seed=config.seed,
            workers=config.workers or len(os.sched_getaffinity(0)),
            video=config.video,
            style=Style(config.manner, config.clean_actions),
        )
    )


def do_again(config: CollectConfig, journal: Path) -> int:
    """Makes the dataset of a recording that was killed, from its journal.

    Returns:
        Episodes in the dataset.

    Raises:
        ConfigError: The dataset has no name.
        DatasetError: The journal is empty or damaged, or the dataset exists.
    """
    from lerobot_buds.teleoperation.journal import restore

    if not config.repo_id:
        raise ConfigError("The dataset has no name; give it one, for example --repo_id=me/close_and_serve.")
    return len(restore(journal, config.repo_id, dataset_root(config.repo_id, config.root), config.video).kept)


def env_settings(config: CollectConfig) -> tuple[EnvSettings, ...]:
    """Makes the settings of one environment a task.

    Raises:
        ConfigError: A task or the profile is unknown, or a task has no demonstrator.
    """
    tasks = tasks_named(config.task)
    stock = [task.name for task in tasks if task.stock]
    if stock:
        raise ConfigError(f"There is no demonstrator for robosuite's own tasks: {', '.join(stock)}.")
    profile_named(config.render_profile)
    return tuple(EnvSettings(task.name, None, config.image_size, config.render_profile) for task in tasks)


def preview(config: CollectConfig, folder: Path) -> list[Path]:
    """Draws a contact sheet of one attempt at every task.

    Returns:
        The pictures.

    Raises:
        ConfigError: A setting cannot work.
        BudsError: An attempt failed.
    """
    from lerobot_buds.demos.attempts import Style, attempt_in_worker
    from lerobot_buds.demos.pictures import draw_attempt

    pictures, style = [], Style(config.manner, config.clean_actions)
    for settings in env_settings(config):
        pictures.append(folder / f"{settings.task.replace('/', '.')}.png")
        draw_attempt(
            attempt_in_worker(settings, config.seed, style), tasks_named(settings.task)[0].stages, pictures[-1]
        )
    return pictures


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point of the console script, and of programs that have tasks of their own.

    Args:
        arguments: In the place of the program's.
    """
    config = parse(CollectConfig, arguments)
    if config.preview is not None:
        folder = config.preview
        print(*run(lambda: preview(config, folder)), sep="\n")
        return
    if config.journal is not None:
        journal = config.journal
        print(f"{run(lambda: do_again(config, journal))} episodes were done again")
        return
    summary = run(lambda: collect(config))
    print(
        f"{summary.episodes} demonstrations, {summary.frames} frames, from {summary.attempts} attempts "
        f"in {summary.seconds:.0f} s"
    )
    for failure, count in summary.failures.items():
        print(f"  {count} failed in {failure}")
