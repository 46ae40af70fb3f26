"""Labels without recordings: a companion of somebody's dataset, joined with it again wherever it is.

A companion holds all of ``meta/buds`` that is of the segmentation, and the labels once more as a table that needs no
program of ours. Columns of the joined copy are made of the record, as they were the first time.
"""

import logging
import shutil
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lerobot_buds.core import (
    CARD_FILE,
    EXEMPLARS_FILE,
    NAMES_FILE,
    SEGMENTATION_FILE,
    TIMELINE_FILE,
    SegmentationError,
    remove_leftovers,
    staged_directory,
    storage_errors,
    subgoals_of,
)

from .card import SPARE_CARD_FILE, write_card
from .model import REPRESENTATION_DIR, SkillModel
from .naming import names_of
from .record import SegmentationRecord, load_labels
from .write import write_segmented_dataset

if TYPE_CHECKING:
    from lerobot_buds.data import AnyDataset, LocalDataset

logger = logging.getLogger(__name__)

LABELS_FILE = "labels/labels.parquet"
"""The labels of a companion: ``episode_index``, ``frame_index``, ``skill_id`` and ``subgoal_frame``, all int64."""


def write_companion(root: Path, target: Path, repo_id: str, representation: bool = True) -> None:
    """Writes the labels of a segmented dataset, without its recordings, into a folder of their own.

    Args:
        root: Folder of the segmented dataset, with all its rows.
        target: Folder to create.
        repo_id: Name of the companion.
        representation: Whether it holds the representation and the exemplars as well: without them it is smaller, and
            can neither label other demonstrations nor serve latent subgoals.

    Raises:
        SegmentationError: The dataset is not segmented, its labels are out of step with it, or the target exists.
        DatasetError: The dataset is damaged or incomplete.
        StorageError: The target cannot be written.
    """
    from lerobot_buds.data import only_writer

    record = _with_content(load_labels(root)[0], root)
    if target.exists():
        raise SegmentationError(f"{target} exists already; remove it, or choose another folder.")
    kept = [NAMES_FILE, *([EXEMPLARS_FILE, REPRESENTATION_DIR] if representation else [])]
    with storage_errors(target, "Nothing was left behind."), only_writer(target):
        remove_leftovers(target.parent, target.name)
        with staged_directory(target) as staging:
            record.write(staging)
            for place in kept:
                _copy(root / place, staging / place)
            _write_table(staging / LABELS_FILE, record)
            write_card(staging, repo_id, labels_only=True)
    size = sum(path.stat().st_size for path in target.rglob("*") if path.is_file())
    logger.info("Wrote %s, %.1f kB without recordings.", target, size / 1000)


def join_companion(
    companion: Path, source: "AnyDataset", target_root: Path, target_repo_id: str, edited: bool = False
) -> SegmentationRecord:
    """Makes a segmented dataset of labels and the dataset that they are of.

    Args:
        companion: Folder of the companion, or of the segmented dataset itself.
        source: What stands for its source; other episodes than those that were labelled are left out.
        target_root: Folder to create.
        target_repo_id: Name of the new dataset.
        edited: Episodes of the source were deleted, reordered or repeated: they are found by what is in them, not by
            their numbers, and each must have been labelled.

    Returns:
        The record.

    Raises:
        SegmentationError: The companion is damaged, the source is not what was labelled (the first episode that differs
            is named), is labelled already, or the target exists.
        CheckpointError: The companion's representation is damaged.
        DatasetError: The source is damaged or incomplete, or the target cannot be written.
    """
    from lerobot_buds.data import LocalDataset

    record = _with_content(SegmentationRecord.read(companion), companion)
    local = LocalDataset.of(source)
    if edited:
        record = _found_again(record, local, companion)
    labelled = record.source.chosen or tuple(range(len(record.episodes)))
    everything = labelled == tuple(range(len(local.all_episodes)))
    _check_source(record, replace(local, chosen=labelled), companion)
    model = SkillModel.from_pretrained(companion) if (companion / REPRESENTATION_DIR).is_dir() else None
    part = replace(local, chosen=None if everything else labelled)
    write_segmented_dataset(part, target_root, target_repo_id, record, model, names_of(companion, record.n_skills))
    return record


def _found_again(record: SegmentationRecord, source: "LocalDataset", companion: Path) -> SegmentationRecord:
    """Puts the labels in the order in which their episodes are now; skills keep their numbers, and their lineage."""
    from lerobot_buds.data import commit_of, content_hashes

    places = {digest: number for number, digest in enumerate(record.source.content)}
    hashes = [digest or "" for digest in content_hashes(source)]
    if unknown := [number for number, digest in enumerate(hashes) if digest not in places]:
        raise SegmentationError(
            f"Episode {unknown[0]} of {source.root} is none of those of {record.source.repo_id} that were labelled in "
            f"{companion} ({len(unknown)} of {len(hashes)} are not): take them out with lerobot-edit-dataset, or "
            f"segment what is there anew: lerobot-buds-segment --repo_id={record.source.repo_id} --root={source.root}."
        )
    found = [record.labels[places[digest]] for digest in hashes]
    kept = ("parameters", "seeds", "representation", "labels_from")
    return SegmentationRecord.of_labels(
        found,
        repo_id=source.repo_id or record.source.repo_id,
        fps=record.source.fps,
        horizon=record.horizon,
        n_skills=record.n_skills,
        commit=commit_of(source.root),
        content=hashes,
        library={"name": companion.name, "grown": False, "lineage": list(record.lineage)},
        **{name: getattr(record, name) for name in kept},
    )


def _check_source(record: SegmentationRecord, source: "LocalDataset", companion: Path) -> None:
    """Refuses a source in which an episode is not what was labelled."""
    from lerobot_buds.data import content_hashes

    count, labelled = len(source.all_episodes), source.chosen or ()
    absent = [number for number in labelled if number >= count]
    found = content_hashes(replace(source, chosen=tuple(n for n in labelled if n < count)))
    different = [n for n, ours, theirs in zip(labelled, record.source.content, found, strict=False) if ours != theirs]
    first = min([*different, *absent], default=None)
    if first is None:
        return
    missing = first in absent or found[labelled.index(first)] is None
    what = "is not there" if missing else "holds other actions, states or times"
    advice = f"label what is there anew: lerobot-buds-segment --repo_id={record.source.repo_id} --root={source.root}"
    if (companion / REPRESENTATION_DIR).is_dir():
        advice = advice.replace("anew", "now, with the same skills") + f" --library={companion}"
    if record.source.commit is not None:
        fetched = f"leave out all --source options, to fetch what was labelled (commit {record.source.commit})"
        advice = f"{fetched}, or {advice}"
    raise SegmentationError(
        f"Episode {first} of {source.root} is not the one of {record.source.repo_id} that was labelled: it {what} "
        f"({len(different) + len(absent)} of {len(labelled)} differ). The labels of {companion} do not hold for it: "
        f"{advice}."
    )


def _with_content(record: SegmentationRecord, root: Path) -> SegmentationRecord:
    """Adds the hashes of the source's rows, which are those of the labelled copy, where a record lacks them."""
    from lerobot_buds.data import content_hashes

    if record.source.content:
        return record
    hashes = content_hashes(root)
    absent = [number for number, digest in enumerate(hashes) if digest is None]
    if absent:
        raise SegmentationError(f"Episode {absent[0]} of {root} is not whole on this machine: fetch all of it first.")
    content = tuple(digest for digest in hashes if digest is not None)
    return replace(record, source=replace(record.source, content=content))


def _copy(source: Path, target: Path) -> None:
    if source.is_dir():
        shutil.copytree(source, target)
    elif source.exists():
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, target)


def _write_table(path: Path, record: SegmentationRecord) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    labels = record.labels
    columns = {
        "episode_index": np.repeat(np.arange(len(labels)), record.source.episode_lengths),
        "frame_index": np.concatenate([np.arange(len(episode)) for episode in labels]),
        "skill_id": np.concatenate(labels),
        "subgoal_frame": np.concatenate([subgoals_of(episode, record.horizon) for episode in labels]),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.table(columns), path, compression="zstd")


COMPANION_FILES = (
    *(CARD_FILE, SPARE_CARD_FILE, TIMELINE_FILE, LABELS_FILE, SEGMENTATION_FILE, NAMES_FILE, EXEMPLARS_FILE),
    f"{REPRESENTATION_DIR}/representation.json",
    f"{REPRESENTATION_DIR}/representation.safetensors",
)
"""All that a companion may hold, and all that is fetched of one."""
