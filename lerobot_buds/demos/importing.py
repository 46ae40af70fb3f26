"""Imports HDF5 demonstrations into a LeRobotDataset: resumable, and checked before it appears.

Every demonstration is staged as a finished dataset of one episode beside the target, through LeRobot's own writer. When
all are there, LeRobot merges them without encoding anew, the result is read back and checked, and renamed into place. A
kill loses the demonstration in flight, or the merge, and nothing else.
"""

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
    ConfigError,
    DatasetError,
    read_json,
    sha256_of_file,
    sha256_of_json,
    staged_directory,
    write_json,
)
from lerobot_buds.data.checks import check_demonstrations
from lerobot_buds.data.collection import RECORD_VERSION
from lerobot_buds.data.dataset import FPS_RANGE, LocalDataset
from lerobot_buds.data.writing import (
    camera_feature,
    create_dataset,
    only_writer,
    sort_stats,
    vector_feature,
    write_episode,
)

from .hdf5 import Demonstrations, open_demonstrations
from .hdf5_layouts import Source


@dataclass(frozen=True)
class Import:
    """What to import.

    Attributes:
        source: The demonstrations.
        repo_id: The dataset's name.
        root: The dataset's folder, which must not exist.
        task: What all of the demonstrations do, in words.
        fps: The rate at which they were recorded (frames per second); the files do not tell.
        video: Stores the cameras as video (small, for the Hub), else as images (lossless, faster to load).
    """

    source: Source
    repo_id: str
    root: Path
    task: str
    fps: int
    video: bool = True


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
        ConfigError: A setting cannot work.
        DatasetError: The source is damaged or lacks something, the dataset exists, or another process is writing it.
    """
    if not plan.task.strip() or not FPS_RANGE[0] <= plan.fps <= FPS_RANGE[1]:
        raise ConfigError(f"task={plan.task!r} must not be empty, and fps={plan.fps} must be in {FPS_RANGE}.")
    if plan.root.exists():
        raise DatasetError(f"{plan.root} exists already. Remove it or choose another --root.")
    staging = plan.root.with_name(f".{plan.root.name}.import")
    with open_demonstrations(plan.source) as demonstrations:
        record = _record(plan, demonstrations)
        staging.mkdir(parents=True, exist_ok=True)
        with only_writer(plan.root):
            _claim(staging, record)
            _stage(staging, plan, demonstrations)
            warnings = _merge(staging, plan, list(demonstrations.lengths.values()), record, cache_dir)
            shutil.rmtree(staging)
        return Imported(len(demonstrations.lengths), sum(demonstrations.lengths.values()), warnings)


def _record(plan: Import, demonstrations: Demonstrations) -> dict[str, Any]:
    source = plan.source
    return {
        "version": RECORD_VERSION,
        "demonstrator": "imported",
        "task": plan.task,
        "fps": plan.fps,
        "video": plan.video,
        "source": {**asdict(source), "path": source.path.name, "sha256": sha256_of_file(source.path)},
        "layout": demonstrations.layout.name,
        "alignment": source.alignment,
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


def _stage(staging: Path, plan: Import, demonstrations: Demonstrations) -> None:
    features = {key: camera_feature(shape, plan.video) for key, shape in demonstrations.image_shapes.items()}
    features |= {STATE: vector_feature(demonstrations.state_names), ACTION: vector_feature(demonstrations.action_names)}
    for name in tqdm(demonstrations.lengths, desc="demonstrations", unit="episode", dynamic_ncols=True):
        if not (staging / name).exists():
            with staged_directory(staging / name) as folder:
                dataset = create_dataset(plan.repo_id, folder, plan.fps, features)
                write_episode(dataset, demonstrations.read(name), plan.task)
                dataset.finalize()


def _merge(
    staging: Path, plan: Import, lengths: list[int], record: dict[str, Any], cache_dir: Path | None
) -> list[str]:
    """Merges the staged episodes into the dataset, once their frames were read back and counted."""
    from lerobot.datasets import aggregate_datasets

    # Below the staging folder, so that a kill leaves nothing that the next call does not find and remove.
    merged = staging / "merged"
    shutil.rmtree(merged, ignore_errors=True)
    names = record["episode_names"]
    parts = [staging / name for name in names]
    # Appended image rows would be encoded anew, all that are there for each episode: as many files as episodes instead.
    aggregate_datasets([plan.repo_id] * len(parts), plan.repo_id, parts, merged, concatenate_data=plan.video)
    sort_stats(merged)
    written = [int(episode["length"]) for episode in LocalDataset(merged).episodes]
    if written != lengths:
        raise DatasetError(f"{merged}: the episodes have {written} frames, the source {lengths}. This is a bug.")
    warnings = check_demonstrations(merged, cache_dir=cache_dir)
    write_json(merged / COLLECTION_FILE, record)
    merged.rename(plan.root)
    return warnings
