"""Imports HDF5 demonstrations into a LeRobotDataset: resumable, and checked before it appears.

Every demonstration is staged as a finished dataset of one episode beside the target. When all are there, they are
joined without encoding anew, the result is read back and checked, and renamed into place. A kill loses the
demonstration in flight, or the joining, and nothing else.
"""

import logging
import shutil
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from tqdm import tqdm

from lerobot_buds.core import (
    ACTION,
    COLLECTION_FILE,
    STATE,
    TRUE_STAGE,
    ConfigError,
    DatasetError,
    read_json,
    sha256_of_file,
    sha256_of_json,
    storage_errors,
    write_json,
)
from lerobot_buds.data.checks import check_demonstrations
from lerobot_buds.data.collection import RECORD_VERSION
from lerobot_buds.data.dataset import FPS_RANGE, LocalDataset
from lerobot_buds.data.joining import join_parts
from lerobot_buds.data.parts import write_part
from lerobot_buds.data.writing import (
    camera_feature,
    only_writer,
    require_encodable,
    vector_feature,
)

from .hdf5 import Demonstrations, Source, files_of, open_demonstrations

CHECKED_SIDE = 128
"""Side (pixels) at which frames that were read back are kept: of the default representation, their next reader."""

logger = logging.getLogger(__name__)

_TO_GO_ON = "What was staged is kept: make room, or see to its permissions, and run the same command again."

_SAME_RATE = 1e-4
"""Rates that differ by a smaller share are one, written with more or fewer digits (29.97)."""


@dataclass(frozen=True)
class Import:
    """What to import.

    Attributes:
        source: The demonstrations.
        repo_id: The dataset's name.
        root: The dataset's folder, which must not exist.
        task: What all of the demonstrations do, in words; None for what the source says.
        fps: The rate at which they were recorded (frames per second); None for what the source says.
        video: Stores the cameras as video (small, for the Hub), else as images (lossless, faster to load).
        overrule: Takes `task` and `fps` although the source says otherwise.
    """

    source: Source
    repo_id: str
    root: Path
    task: str | None = None
    fps: float | None = None
    video: bool = True
    overrule: bool = False


@dataclass(frozen=True)
class Imported:
    """What an import came to: numbers of episodes and frames, and what looks wrong in them but is no error."""

    episodes: int
    frames: int
    warnings: list[str]


def import_demonstrations(plan: Import, cache_dir: Path | None = None) -> Imported:
    """Imports demonstrations, or goes on where an earlier call with the same settings was interrupted.

    Args:
        plan: What to import.
        cache_dir: Folder of the decoded frames, which the check of the videos leaves there; LeRobot's home where None.

    Raises:
        ConfigError: A setting cannot work, contradicts the source, or is missing because the source does not say it.
        DatasetError: The source is damaged or lacks something, the dataset exists, or another process is writing it.
        StorageError: The disk is full, or cannot be written.
        SimulatorError: States are to be played back, but the simulator is missing or unsupported.
    """
    if plan.task is not None and not plan.task.strip():
        raise ConfigError(f"task={plan.task!r} must not be empty; leave it out where the file says it.")
    if plan.root.exists():
        raise DatasetError(f"{plan.root} exists already. Remove it or choose another --root.")
    staging = plan.root.with_name(f".{plan.root.name}.import")
    with open_demonstrations(plan.source) as demonstrations:
        features, fps, tasks = _features(plan, demonstrations), _fps(plan, demonstrations), _tasks(plan, demonstrations)
        record = _record(plan, demonstrations, fps, tasks)
        with storage_errors(plan.root, _TO_GO_ON):
            staging.mkdir(parents=True, exist_ok=True)
        with only_writer(plan.root):
            _claim(staging, record)
            for name in tqdm(demonstrations.lengths, desc="demonstrations", unit="episode", dynamic_ncols=True):
                if not (staging / name).exists():
                    columns = demonstrations.read(name)
                    with storage_errors(plan.root, _TO_GO_ON):
                        write_part(staging / name, plan.repo_id, fps, features, columns, tasks[name])
            with storage_errors(plan.root, _TO_GO_ON):
                warnings = _merge(staging, plan, demonstrations, record, cache_dir)
                shutil.rmtree(staging)
        return Imported(len(demonstrations.lengths), sum(demonstrations.lengths.values()), warnings)


def _features(plan: Import, demonstrations: Demonstrations) -> dict[str, dict[str, Any]]:
    features = {key: camera_feature(shape, plan.video) for key, shape in demonstrations.image_shapes.items()}
    if demonstrations.state_names:
        features[STATE] = vector_feature(demonstrations.state_names)
    features[ACTION] = vector_feature(demonstrations.action_names)
    if demonstrations.stages:
        features[TRUE_STAGE] = {"dtype": "int64", "shape": (1,), "names": None}
    require_encodable(features)  # now, before anything is staged
    return features


def _fps(plan: Import, demonstrations: Demonstrations) -> float:
    """Settles the rate between what was asked for and what the source says; a whole number is an int, as LeRobot's."""
    told, given = demonstrations.fps, plan.fps
    fps = told if given is None else given
    if fps is None:
        raise ConfigError(
            f"{plan.source.path} does not say at which rate it was recorded; say it with --fps (robosuite's default "
            "and the BUDS release's is 20)."
        )
    if not FPS_RANGE[0] <= fps <= FPS_RANGE[1]:
        raise ConfigError(f"fps={fps:g} must be in {FPS_RANGE}.")
    if told is not None and abs(fps - told) > _SAME_RATE * told:
        _contradict(plan, f"fps={fps:g}", f"{told:g} frames per second")
    if given is None:
        logger.info("%s: recorded at %g frames per second, as it says itself.", plan.source.path, fps)
    return int(fps) if fps == int(fps) else fps


def _tasks(plan: Import, demonstrations: Demonstrations) -> dict[str, str]:
    """Settles the task of every demonstration between what was asked for and what the source says in words."""
    tasks, unnamed = {}, []
    for name in demonstrations.lengths:
        told = demonstrations.instructions.get(name)
        if plan.task is not None and told is not None and _plain(plan.task) != _plain(told):
            _contradict(plan, f"task={plan.task!r}", f"{told!r} of {name}")
        task = plan.task or told or demonstrations.environment
        if task is None:
            unnamed.append(name)
        else:
            tasks[name] = task
    if unnamed:
        raise ConfigError(
            f"{plan.source.path} does not say what {unnamed[0]} does, nor {len(unnamed) - 1} more; say it in words "
            "with --task."
        )
    if plan.task is None:
        logger.info("%s: tasks are %s, as it says itself.", plan.source.path, sorted(set(tasks.values())))
    return tasks


def _contradict(plan: Import, given: str, told: str) -> None:
    """Refuses a setting that the source contradicts, unless that was asked for; then says so."""
    if not plan.overrule:
        raise ConfigError(
            f"{given}, but {plan.source.path} says {told}. Leave the setting out, or let it count with --overrule=true."
        )
    logger.warning("%s says %s; overruled: %s.", plan.source.path, told, given)


def _plain(words: str) -> str:
    return " ".join(words.lower().split())


def _record(plan: Import, demonstrations: Demonstrations, fps: float, tasks: dict[str, str]) -> dict[str, Any]:
    source = plan.source
    files = {path.name: sha256_of_file(path) for path in files_of(source.path)}
    distinct = set(tasks.values())
    return {
        "version": RECORD_VERSION,
        "demonstrator": "imported",
        "task": distinct.pop() if len(distinct) == 1 else None,
        "episode_tasks": list(tasks.values()),
        "fps": fps,
        "video": plan.video,
        "overruled": plan.overrule,
        "source": {
            **asdict(source),
            "path": source.path.name,
            "assets": source.assets and source.assets.name,
            "sha256": sha256_of_json(files) if source.path.is_dir() else files[source.path.name],
            "files": files,
        },
        "told": {"fps": demonstrations.fps, "environment": demonstrations.environment},
        "facts": demonstrations.facts,
        "layout": demonstrations.layout,
        "alignment": source.alignment,
        "stages": list(demonstrations.stages),
        "episode_names": list(demonstrations.lengths),
        "versions": {name: version(name) for name in ("lerobot_policy_buds", "lerobot", "h5py")},
    }


def _claim(staging: Path, record: dict[str, Any]) -> None:
    """Refuses to mix demonstrations of different files or settings in one staging folder."""
    claim = staging / "import.json"
    if claim.exists() and sha256_of_json(read_json(claim)) != sha256_of_json(record):
        raise DatasetError(
            f"{staging} holds an interrupted import with another source or other settings. Remove it to start over."
        )
    write_json(claim, record)


def _merge(
    staging: Path, plan: Import, demonstrations: Demonstrations, record: dict[str, Any], cache_dir: Path | None
) -> list[str]:
    """Merges the staged episodes into the dataset, once their frames were read back and counted."""
    # Below the staging folder, so that a kill leaves nothing that the next call does not find and remove.
    merged = staging / "merged"
    shutil.rmtree(merged, ignore_errors=True)
    join_parts([staging / name for name in demonstrations.lengths], plan.repo_id, merged)
    written = [int(episode["length"]) for episode in LocalDataset(merged).episodes]
    lengths = list(demonstrations.lengths.values())
    if written != lengths:
        raise DatasetError(f"{merged}: the episodes have {written} frames, the source {lengths}. This is a bug.")
    columns = [STATE, ACTION] if demonstrations.state_names else [ACTION]
    warnings = check_demonstrations(merged, list(demonstrations.image_shapes), columns, cache_dir, CHECKED_SIDE)
    write_json(merged / COLLECTION_FILE, record)
    merged.rename(plan.root)
    return warnings
