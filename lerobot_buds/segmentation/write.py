"""Writes a segmented copy of a LeRobotDataset: two label columns, their statistics and the segmentation record.

Invariants: the source is only read; the target appears whole or not at all; the same inputs give the same bytes.
LeRobot is imported on use, so that importing this module stays cheap.
"""

import logging
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lerobot_buds.core import (
    COLLECTION_FILE,
    NAMES_FILE,
    RECORD_DIR,
    SEGMENTATION_FILE,
    SKILL_ID,
    SUBGOAL_INDEX,
    TIMELINE_FILE,
    DatasetError,
    IntArray,
    SegmentationError,
    read_json,
    remove_leftovers,
    staged_directory,
    subgoals_of,
    write_json,
)

from .card import SPARE_CARD_FILE, write_card
from .model import SkillModel
from .naming import automatic_names, write_names
from .record import SegmentationRecord, load_labels, relabelling

if TYPE_CHECKING:
    from lerobot.datasets import LeRobotDataset

    from lerobot_buds.data import AnyDataset, LocalDataset

FeatureStats = dict[str, NDArray[np.float64]]

logger = logging.getLogger(__name__)

_COLUMN = {"dtype": "int64", "shape": (1,), "names": None}
_SPARE_BYTES = 16 * 1024**2
"""Room for what is not copied: label columns, statistics, record, the file system's own needs."""


def check_target(source: "AnyDataset", target_root: Path) -> None:
    """Refuses a labelled copy that could not be written; cheap, so that it can be asked before anything is learned.

    Args:
        source: What stands for the dataset to segment.
        target_root: Folder to create.

    Raises:
        SegmentationError: The source is labelled already, the target exists or lies in the source, or the chosen
            episodes cannot be cut out of its videos.
        DatasetError: Another process is writing the target, its disk is too full, or it cannot be written.
    """
    with _reserved(source, target_root):
        pass


def write_segmented_dataset(
    source: "AnyDataset",
    target_root: Path,
    target_repo_id: str,
    record: SegmentationRecord,
    model: SkillModel | None = None,
    names: Sequence[str] | None = None,
) -> None:
    """Writes the labels of a record, with a copy of everything else of the chosen episodes, as a new dataset.

    Besides LeRobot's own files the source's other records under ``meta/buds`` are carried over. What an earlier,
    killed write left beside the target is removed.

    Args:
        source: What stands for the segmented dataset's source; without labels, and its chosen episodes whole.
        target_root: Folder to create; its parent is created where missing.
        target_repo_id: Name of the new dataset.
        record: The segmentation, made from this source; its labels become the columns.
        model: What labelled it, to label others with; left out where None.
        names: One name per skill; automatic ones where None.

    Raises:
        SegmentationError: The record does not fit the source, the source is labelled already, the target exists or lies
            in the source, or the chosen episodes cannot be cut out of its videos.
        DatasetError: The source is damaged or incomplete, another process is writing the target, or its disk is too
            full or cannot be written.
    """
    from lerobot_buds.data import LocalDataset

    local = LocalDataset.of(source)
    with _reserved(local, target_root):
        _check_source(local, record)
        with staged_directory(target_root) as staging, _chosen_only(local, staging, record.source.repo_id) as root:
            _write_columns(root, staging, target_repo_id, record)
            _copy_records(local, staging)
            record.write(staging)
            known = () if model is None else model.names
            write_names(staging / NAMES_FILE, automatic_names(record, local, known) if names is None else names)
            if model is not None:
                model.save(staging)
            write_card(staging, target_repo_id)
            load_labels(staging)
    logger.info("Wrote %s with %d skills.", target_root, record.n_skills)


@contextmanager
def _reserved(source: "AnyDataset", target_root: Path) -> Iterator[None]:
    """Keeps a target that can be written for this process alone; says what a failure to write means."""
    from lerobot_buds.data import LocalDataset, only_writer

    local = LocalDataset.of(source)
    source_root = local.root
    labelled = [name for name in (SKILL_ID, SUBGOAL_INDEX) if name in LocalDataset(source_root).features]
    if labelled:
        raise SegmentationError(
            f"{source_root} already has the columns {labelled}. {relabelling(source_root, labelled)}"
        )
    if target_root.resolve().is_relative_to(source_root.resolve()):
        raise SegmentationError(f"{target_root} lies in {source_root}, which is only read; choose a target outside.")
    _require_whole_rate(local)
    needed = sum(path.stat().st_size for path in source_root.rglob("*") if path.is_file()) + _SPARE_BYTES
    try:
        with only_writer(target_root):
            if target_root.exists():
                raise SegmentationError(f"{target_root} exists already; remove it, or choose another output_root.")
            remove_leftovers(target_root.parent, target_root.name)
            _check_space(target_root, needed)
            yield
    except OSError as error:
        raise DatasetError(
            f"{target_root} could not be written ({error}). It needs about {needed} bytes on a disk that can be "
            f"written; nothing was left behind, and {source_root} is untouched."
        ) from error


def _require_whole_rate(source: "LocalDataset") -> None:
    """Refuses to cut videos of 29.97 frames a second: LeRobot gives the frames that it keeps the times of 29."""
    chosen = [int(record["episode_index"]) for record in source.episodes]
    others = [record for record in source.all_episodes if int(record["episode_index"]) not in chosen]
    if source.fps.is_integer() or not others:
        return
    for camera in (name for name, feature in source.features.items() if feature["dtype"] == "video"):
        kept = {source.video_path(record, camera) for record in source.episodes}
        if cut := [path for path in (source.video_path(record, camera) for record in others) if path in kept]:
            raise SegmentationError(
                f"{cut[0]} holds chosen and other episodes at {source.fps:g} frames per second: LeRobot cuts videos at "
                "whole rates only, and would give these frames wrong times. Segment all episodes, and train on those "
                f"chosen with --dataset.episodes='{chosen}'."
            )


def _check_source(source: "LocalDataset", record: SegmentationRecord) -> None:
    from lerobot_buds.data import read_table, require_videos, require_whole

    table = read_table(source, [])
    lengths = tuple((table.ends - table.starts).tolist())
    if (lengths, table.fps) != (record.source.episode_lengths, record.source.fps):
        raise SegmentationError(
            f"The segmentation is of {len(record.source.episode_lengths)} episodes with {record.source.total_frames} "
            f"frames at {record.source.fps:g} frames per second, but {source.root} holds {len(lengths)} with "
            f"{sum(lengths)} at {table.fps:g}, or their lengths differ. Segment this one anew."
        )
    require_whole(table)
    require_videos(source)


@contextmanager
def _chosen_only(source: "LocalDataset", staging: Path, repo_id: str) -> Iterator[Path]:
    """Yields the folder of a dataset that holds the chosen episodes alone, which LeRobot cuts out where it must."""
    from lerobot.datasets import LeRobotDataset, delete_episodes

    chosen = {int(record["episode_index"]) for record in source.episodes}
    others = [number for number in range(len(source.all_episodes)) if number not in chosen]
    if not others:
        yield source.root
        return
    part = staging.with_name(f"{staging.name}.chosen")
    try:
        whole = LeRobotDataset(repo_id, root=source.root, video_backend=source.video_backend)
        delete_episodes(whole, others, output_dir=part, repo_id=repo_id)
        yield part
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _check_space(target: Path, needed: int) -> None:
    free = shutil.disk_usage(target.parent).free
    if free < needed:
        raise DatasetError(
            f"{target} needs about {needed} bytes, but its disk has only {free} free. Free {needed - free} bytes or "
            "choose a target on another disk. Nothing was written."
        )


def _write_columns(source: Path, staging: Path, repo_id: str, record: SegmentationRecord) -> None:
    from lerobot.datasets import LeRobotDataset, add_features, write_stats

    labels = record.labels
    starts = np.cumsum([0, *record.source.episode_lengths[:-1]])
    subgoals = [start + subgoals_of(episode, record.horizon) for start, episode in zip(starts, labels, strict=True)]
    columns = {SKILL_ID: labels, SUBGOAL_INDEX: subgoals}
    made = add_features(
        LeRobotDataset(record.source.repo_id, root=source),
        {name: (np.concatenate(values), dict(_COLUMN)) for name, values in columns.items()},
        output_dir=staging,
        repo_id=repo_id,
    )
    # add_features leaves new columns without statistics.
    write_stats({**(made.meta.stats or {}), **_stats(columns)}, staging)
    _drop_cache(made)


def _stats(columns: dict[str, list[IntArray]]) -> dict[str, FeatureStats]:
    from lerobot.datasets import aggregate_stats, get_feature_stats

    per_episode = [
        {name: get_feature_stats(values, axis=0, keepdims=True) for name, values in zip(columns, episode, strict=True)}
        for episode in zip(*columns.values(), strict=True)
    ]
    stats: dict[str, FeatureStats] = aggregate_stats(per_episode)
    return {name: stats[name] for name in columns}  # aggregate_stats returns them in the order of a set


def _drop_cache(dataset: "LeRobotDataset") -> None:
    # `datasets` made an arrow copy of every row, images included, for a staging path that will never be opened again.
    for folder in {Path(file["filename"]).parent for file in dataset.hf_dataset.cache_files}:
        shutil.rmtree(folder, ignore_errors=True)


def _copy_records(source: "LocalDataset", staging: Path) -> None:
    if (source.root / RECORD_DIR).is_dir():
        stale = (SEGMENTATION_FILE, NAMES_FILE, SPARE_CARD_FILE, TIMELINE_FILE)
        ignored = shutil.ignore_patterns(*(Path(name).name for name in stale))
        shutil.copytree(source.root / RECORD_DIR, staging / RECORD_DIR, ignore=ignored)
    if source.chosen is not None and (staging / COLLECTION_FILE).exists():
        # What it says episode by episode is of the whole; which of them these are must be said beside it.
        write_json(
            staging / COLLECTION_FILE, {**read_json(staging / COLLECTION_FILE), "chosen_episodes": list(source.chosen)}
        )
