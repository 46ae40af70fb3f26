"""Records scripted demonstrations into a LeRobotDataset: in parallel, resumable, the same for any number of workers.

Attempts run in worker processes. Each is staged, by the worker that ran it, as a finished dataset of one episode in a
folder beside the dataset. The episodes are, one task after the other, the first successful attempts in the order of
their seeds; they are joined while later ones run, in the same folder, and the whole is renamed into place. A kill loses
the attempts in flight, or the joining, and nothing else.
"""

import logging
import os
import shutil
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from multiprocessing import get_context, parent_process
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
from filelock import FileLock, Timeout
from numpy.typing import NDArray
from tqdm import tqdm

from lerobot_buds.core import (
    ACTION,
    COLLECTION_FILE,
    CONTACT_SHEET_FILE,
    IMAGE_PREFIX,
    STATE,
    TRUE_STAGE,
    BudsError,
    ConfigError,
    DatasetError,
    read_json,
    storage_errors,
    write_json,
)
from lerobot_buds.data.collection import RECORD_VERSION
from lerobot_buds.data.joining import join_parts
from lerobot_buds.data.parts import write_part
from lerobot_buds.data.writing import camera_feature, require_encodable, vector_feature
from lerobot_buds.envs import ACTION_NAMES, CAMERAS, FPS, STATE_NAMES, EnvSettings, Task, tasks_named

from .attempts import Attempt, Style, attempt_in_worker
from .card import write_card
from .pictures import draw_contact_sheet

logger = logging.getLogger(__name__)

EVALUATION_SEEDS = 100_000
"""Seeds from here on are for evaluation, never for demonstrations."""

_HOPELESS_AFTER = 20

_TO_GO_ON = "Attempts that are whole are kept: make room, or see to its permissions, and run the same command again."


@dataclass(frozen=True)
class Recording:
    """What to record.

    Attributes:
        repo_id: The dataset's name.
        root: The dataset's folder, which must not exist.
        settings: The environments, one a task, that are drawn alike.
        episodes: Number of successful demonstrations wanted of each task.
        seed: Seed of the first attempt at each task; each further attempt takes the next one.
        workers: Processes.
        video: Stores the cameras as video (small, for the Hub), else as images (faster to load).
        style: How demonstrations are made, and what is kept of them as their action.
    """

    repo_id: str
    root: Path
    settings: tuple[EnvSettings, ...]
    episodes: int
    seed: int
    workers: int
    video: bool
    style: Style = field(default_factory=Style)

    @property
    def tasks(self) -> list[Task]:
        """The tasks recorded, in order."""
        return [tasks_named(settings.task)[0] for settings in self.settings]

    @property
    def stages(self) -> tuple[str, ...]:
        """Names of the true stages of all tasks, each once: what the column of true stages counts."""
        return tuple(dict.fromkeys(stage for task in self.tasks for stage in task.stages))


@dataclass(frozen=True)
class Summary:
    """What a recording came to.

    Attributes:
        episodes: Demonstrations in the dataset.
        attempts: Attempts behind them.
        failures: Failed attempts by task, stage and reason.
        frames: Frames in the dataset.
        seconds: Time that this call took (s).
    """

    episodes: int
    attempts: int
    failures: dict[str, int]
    frames: int
    seconds: float


def record(recording: Recording) -> Summary:
    """Records demonstrations, or goes on where an earlier call of the same settings was interrupted.

    Raises:
        ConfigError: A number is out of its range.
        DatasetError: The dataset exists, or another process is recording it.
        StorageError: The disk is full, or cannot be written.
        BudsError: The demonstrator fails most of its attempts, or a worker process died.
    """
    began = time.monotonic()
    _require_absent(recording.root)
    _check_numbers(recording)
    staging = recording.root.with_name(f".{recording.root.name}.attempts")
    with storage_errors(recording.root, _TO_GO_ON), _alone(staging, recording.root):
        _claim(staging, recording)
        with _workers(recording.workers) as pool:
            attempts, lengths = _written(pool, staging, recording)
        shutil.rmtree(staging)
    failures = Counter(
        f"{task.name}: {a.failure}"
        for task, of_task in zip(recording.tasks, attempts, strict=True)
        for a in of_task
        if not a.success
    )
    seconds = time.monotonic() - began
    return Summary(len(lengths), sum(map(len, attempts)), dict(failures), sum(lengths), seconds)


def _require_absent(root: Path) -> None:
    if root.exists():
        raise DatasetError(f"{root} exists already. Remove it or choose another --root.")


@contextmanager
def _alone(staging: Path, root: Path) -> Iterator[None]:
    """Keeps other processes away while the dataset is made."""
    staging.mkdir(parents=True, exist_ok=True)
    lock = FileLock(staging / "lock")
    try:
        lock.acquire(blocking=False)
    except Timeout:  # an OSError, too
        raise DatasetError(f"Another process is recording {root}; wait for it to end.") from None
    try:
        _require_absent(root)  # it may have come while this process started
        yield
    finally:
        lock.release()


def _check_numbers(recording: Recording) -> None:
    for name, value, least in (
        ("episodes", recording.episodes, 1),
        ("workers", recording.workers, 1),
        ("seed", recording.seed, 0),
        ("image_size", recording.settings[0].image_size, 1),
    ):
        if value < least:
            raise ConfigError(f"{name}={value} cannot work; it must be at least {least}.")
    require_encodable(_features(recording))
    # The most seeds that are tried before the demonstrator is given up.
    if recording.seed + 2 * recording.episodes + _HOPELESS_AFTER >= EVALUATION_SEEDS:
        raise ConfigError(f"Seeds from {EVALUATION_SEEDS} on are for evaluation; choose a smaller seed.")


def _claim(staging: Path, recording: Recording) -> None:
    """Refuses to mix attempts of different settings in one staging folder."""
    wanted = {
        "settings": [asdict(settings) for settings in recording.settings],
        "seed": recording.seed,
        "video": recording.video,
        **asdict(recording.style),
    }
    claim = staging / "settings.json"
    if claim.exists() and read_json(claim) != wanted:
        raise DatasetError(
            f"{staging} holds attempts of an interrupted recording with other settings. Remove it to start over."
        )
    write_json(claim, wanted)


def _written(pool: ProcessPoolExecutor, staging: Path, recording: Recording) -> tuple[list[list[Attempt]], list[int]]:
    """Makes the dataset; returns the attempts by task and seed, without arrays, and the lengths of the episodes."""
    folder = staging / "dataset"
    shutil.rmtree(folder, ignore_errors=True)  # what a killed call left
    attempts: list[list[Attempt]] = []
    lengths = join_parts(_parts(pool, staging, recording, attempts), recording.repo_id, folder)
    record = _collection_record(recording, attempts)
    write_json(folder / COLLECTION_FILE, record)
    draw_contact_sheet(folder, folder / CONTACT_SHEET_FILE, recording.stages)
    write_card(folder, record, lengths)
    folder.replace(recording.root)
    return attempts, lengths


def _parts(
    pool: ProcessPoolExecutor, staging: Path, recording: Recording, attempts: list[list[Attempt]]
) -> Iterator[Path]:
    """Runs the attempts at every task, tells them in `attempts`, and yields the part of each that succeeded."""
    total = recording.episodes * len(recording.tasks)
    with tqdm(total=total, desc="demonstrations", unit="episode", dynamic_ncols=True) as bar:
        for settings in recording.settings:
            attempts.append([])
            for made in _attempts(pool, staging, recording, settings):
                attempts[-1].append(made)
                bar.update(int(made.success))
                bar.set_postfix(task=settings.task, failed=sum(not a.success for a in attempts[-1]))
                if made.success:
                    yield _staged(staging, settings.task, made.seed, "part")


def _attempts(
    pool: ProcessPoolExecutor, staging: Path, recording: Recording, settings: EnvSettings
) -> Iterator[Attempt]:
    """Yields attempts at one task in the order of their seeds until enough of them succeeded."""
    done = failed = 0
    pending: list[Future[Attempt]] = []
    next_seed = recording.seed
    while done < recording.episodes:
        while len(pending) < min(2 * recording.workers, recording.episodes - done):
            pending.append(pool.submit(_staged_attempt, staging, recording, settings, next_seed))
            next_seed += 1
        result = pending.pop(0).result()
        done, failed = done + result.success, failed + (not result.success)
        if failed > _HOPELESS_AFTER and failed > done:
            raise BudsError(f"The demonstrator failed {failed} of {done + failed} attempts: {result.failure}.")
        yield result


@contextmanager
def _workers(number: int) -> Iterator[ProcessPoolExecutor]:
    pool = ProcessPoolExecutor(number, mp_context=get_context("spawn"), initializer=_end_with_parent)
    try:
        yield pool
    except BrokenProcessPool as error:
        raise BudsError("A worker process died (out of memory?). Run the same command again to go on.") from error
    finally:
        pool.shutdown(cancel_futures=True)


def _end_with_parent() -> None:
    """Makes a worker end when its parent is killed; it would wait for work for ever."""
    parent = parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    Thread(target=watch, daemon=True).start()


def _staged_attempt(staging: Path, recording: Recording, settings: EnvSettings, seed: int) -> Attempt:
    """Runs one attempt in a worker and stages it, unless an earlier run did."""
    outcome = _staged(staging, settings.task, seed, "json")
    if outcome.exists():
        return Attempt(**read_json(outcome))
    result = attempt_in_worker(settings, seed, recording.style)
    if result.success:
        (task,) = tasks_named(settings.task)
        part = _staged(staging, settings.task, seed, "part")
        shutil.rmtree(part, ignore_errors=True)  # of a call that was killed between the two
        write_part(
            part,
            recording.repo_id,
            FPS,
            _features(recording),
            _columns(result.arrays, task, recording),
            task.description,
            robot_type="panda",
            encoder_threads=1,  # the other cores have workers of their own
        )
    told = replace(result, arrays={})
    write_json(outcome, asdict(told))
    return told


def _staged(staging: Path, task: str, seed: int, suffix: str) -> Path:
    return staging / f"{task.replace('/', '.')}.{seed:06d}.{suffix}"


def _columns(arrays: dict[str, NDArray[Any]], task: Task, recording: Recording) -> dict[str, NDArray[Any]]:
    """Names an attempt's arrays as the columns of its episode, and counts its stages as all tasks together do."""
    number_of = np.array([recording.stages.index(stage) for stage in task.stages])
    return {
        **{IMAGE_PREFIX + camera: arrays[camera] for camera in CAMERAS},
        STATE: arrays["agent_pos"],
        ACTION: arrays["action"],
        TRUE_STAGE: number_of[arrays["true_stage"]],
    }


def features_of(size: int, video: bool) -> dict[str, dict[str, Any]]:
    """Describes for LeRobot what every recording in our environments has: both cameras, state and action.

    Args:
        size: Height and width of the images (pixels).
        video: Stores them as video, else as images.
    """
    return {
        **{IMAGE_PREFIX + camera: camera_feature((size, size, 3), video) for camera in CAMERAS},
        STATE: vector_feature(STATE_NAMES),
        ACTION: vector_feature(ACTION_NAMES),
    }


def _features(recording: Recording) -> dict[str, dict[str, Any]]:
    stage = {"dtype": "int64", "shape": (1,), "names": None}
    return features_of(recording.settings[0].image_size, recording.video) | {TRUE_STAGE: stage}


def _collection_record(recording: Recording, attempts: list[list[Attempt]]) -> dict[str, Any]:
    return {
        "version": RECORD_VERSION,
        "demonstrator": "scripted",
        **asdict(recording.style),
        "tasks": [
            {
                "name": task.name,
                "description": task.description,
                "episode_seeds": [a.seed for a in of_task if a.success],
                "retries": [a.retries for a in of_task if a.success],
                "failed_attempts": [{"seed": a.seed, "failure": a.failure} for a in of_task if not a.success],
            }
            for task, of_task in zip(recording.tasks, attempts, strict=True)
        ],
        "stages": list(recording.stages),
        "render_profile": recording.settings[0].render_profile,
        "image_size": recording.settings[0].image_size,
        "versions": {name: version(name) for name in ("lerobot_policy_buds", "lerobot", "robosuite", "mujoco")},
    }
