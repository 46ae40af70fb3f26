"""Labels after LeRobot's own edit tools: used where they are still right, refused where they are out of step."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from lerobot.datasets import (
    LeRobotDataset,
    add_features,
    delete_episodes,
    merge_datasets,
    modify_tasks,
    remove_feature,
    split_dataset,
)

from lerobot_buds.core import RECORD_DIR, BudsError, SegmentationError
from lerobot_buds.segmentation import load_labels


@pytest.fixture
def dataset(segmented: Path) -> LeRobotDataset:
    return LeRobotDataset("test/segmented", root=segmented)


def with_record(root: Path, segmented: Path) -> Path:
    """Puts the record back that LeRobot drops."""
    shutil.copytree(segmented / RECORD_DIR, root / RECORD_DIR)
    return root


def test_every_edit_drops_the_record(dataset: LeRobotDataset, tmp_path: Path) -> None:
    edited = delete_episodes(dataset, [2], tmp_path / "edited", repo_id="test/edited")
    with pytest.raises(SegmentationError, match=r"no segmentation record.*Run lerobot-buds-segment"):
        load_labels(Path(edited.root))


@pytest.mark.parametrize("episode", [0, 1, 2])
def test_deleted_episodes(dataset: LeRobotDataset, segmented: Path, tmp_path: Path, episode: int) -> None:
    edited = delete_episodes(dataset, [episode], tmp_path / "edited", repo_id="test/edited")
    with pytest.raises(
        SegmentationError, match=r"has 2 episodes of \d+ frames, its segmentation record 3 of 61.*Re-run"
    ):
        load_labels(with_record(Path(edited.root), segmented))


def test_merged_datasets(dataset: LeRobotDataset, segmented: Path, tmp_path: Path) -> None:
    merged = merge_datasets([dataset, dataset], "test/merged", tmp_path / "merged")
    with pytest.raises(SegmentationError, match="has 6 episodes of 122 frames, its segmentation record 3 of 61"):
        load_labels(with_record(Path(merged.root), segmented))


def test_split_and_merged_in_another_order(dataset: LeRobotDataset, segmented: Path, tmp_path: Path) -> None:
    parts = split_dataset(dataset, {"last": [2], "first": [0, 1]}, tmp_path / "parts")
    merged = merge_datasets([parts["last"], parts["first"]], "test/merged", tmp_path / "merged")
    with pytest.raises(SegmentationError, match="the first of another length is episode 0"):
        load_labels(with_record(Path(merged.root), segmented))


def test_a_removed_column(dataset: LeRobotDataset, segmented: Path, tmp_path: Path) -> None:
    edited = remove_feature(dataset, "skill_id", tmp_path / "edited", repo_id="test/edited")
    with pytest.raises(BudsError, match=r"(?s)lacks 1 required feature.*'skill_id'"):
        load_labels(with_record(Path(edited.root), segmented))


def test_edits_that_leave_the_frames_in_place(dataset: LeRobotDataset, segmented: Path, tmp_path: Path) -> None:
    spec = {"dtype": "float32", "shape": (1,), "names": None}
    more = add_features(
        dataset, {"reward": (np.zeros(61, dtype=np.float32), spec)}, tmp_path / "more", repo_id="test/more"
    )
    root = with_record(Path(more.root), segmented)
    modify_tasks(LeRobotDataset("test/more", root=root), new_task="open the drawer")
    for ours, theirs in zip(load_labels(root)[1:], load_labels(segmented)[1:], strict=True):
        np.testing.assert_array_equal(ours, theirs)
