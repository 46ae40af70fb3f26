"""Labels after LeRobot's own edit tools: used where they are still right, refused where they are out of step."""

import re
import shlex
import shutil
import sys
from collections.abc import Callable
from functools import partial
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
from lerobot.scripts import lerobot_edit_dataset

from lerobot_buds.cli import join as join_command
from lerobot_buds.cli.running import parse
from lerobot_buds.cli.segment import SegmentConfig
from lerobot_buds.core import RECORD_DIR, BudsError, SegmentationError
from lerobot_buds.segmentation import SegmentationRecord, check_target, load_labels, write_segmented_dataset

pytestmark = pytest.mark.slow


@pytest.fixture
def dataset(segmented: Path) -> LeRobotDataset:
    return LeRobotDataset("test/segmented", root=segmented)


def with_record(root: Path, segmented: Path) -> Path:
    """Puts the record back that LeRobot drops."""
    shutil.copytree(segmented / RECORD_DIR, root / RECORD_DIR)
    return root


def refusal(function: Callable[..., object], *arguments: object) -> str:
    with pytest.raises(SegmentationError) as caught:
        function(*arguments)
    return str(caught.value)


def test_every_edit_drops_the_record(dataset: LeRobotDataset, tmp_path: Path) -> None:
    edited = delete_episodes(dataset, [2], tmp_path / "edited", repo_id="test/edited")
    with pytest.raises(SegmentationError, match=r"no segmentation record.*run lerobot-buds-segment"):
        load_labels(Path(edited.root))


@pytest.mark.parametrize("episode", [0, 1, 2])
def test_deleted_episodes(dataset: LeRobotDataset, segmented: Path, tmp_path: Path, episode: int) -> None:
    edited = delete_episodes(dataset, [episode], tmp_path / "edited", repo_id="test/edited")
    with pytest.raises(
        SegmentationError,
        match=r"has 2 episodes of \d+ frames, its segmentation record 3 of 61.*To segment it as it is now",
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


EDITS = {
    "delete_episodes": ("edited", [0, 2], "--operation.episode_indices=[1]"),
    "split": ("edited_last", [1, 2], '--operation.splits={"first": [0], "last": [1, 2]}'),
    "merge": ("edited", [0, 1, 2, 0, 1, 2], '--operation.repo_ids=["test/segmented", "test/segmented"]'),
}
"""Of lerobot-edit-dataset: folder of the result, source episodes that it holds, option."""


def edit(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> None:
    monkeypatch.setattr(sys, "argv", ["lerobot-edit-dataset", *arguments])
    lerobot_edit_dataset.main()


@pytest.mark.parametrize("operation", EDITS)
def test_the_advice_for_labels_out_of_step_can_be_followed(
    operation: str, segmented: Path, record: SegmentationRecord, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The commands of the message, word by word: the labels go, and what is left can be segmented."""
    folder, kept, option = EDITS[operation]
    place = [f"--root={segmented}", "--repo_id=test/segmented", f"--new_root={tmp_path / 'edited'}"]
    if operation == "split":
        place[2] = f"--new_root={tmp_path}"
        option = option.replace('"first"', '"edited_first"').replace('"last"', '"edited_last"')
    if operation == "merge":
        place = [f"--new_root={tmp_path / 'edited'}", f'--operation.roots=["{segmented}", "{segmented}"]']
    edit(monkeypatch, *place, "--new_repo_id=test/edited", f"--operation.type={operation}", option)
    edited = tmp_path / folder
    said = [refusal(load_labels, edited), refusal(check_target, edited, tmp_path / "target")]
    said.append(refusal(load_labels, with_record(edited, segmented)))
    pattern = r"\(lerobot-edit-dataset (.*?)\), then run lerobot-buds-segment (.*)\.$"
    (advice,) = {match.groups() for match in map(partial(re.search, pattern), said) if match}
    monkeypatch.setattr(lerobot_edit_dataset, "HF_LEROBOT_HOME", tmp_path / "home")
    monkeypatch.setattr("lerobot.utils.constants.HF_LEROBOT_HOME", tmp_path / "home")
    edit(monkeypatch, *shlex.split(advice[0]))
    monkeypatch.setattr(sys, "argv", ["lerobot-buds-segment", *shlex.split(advice[1])])
    unlabelled = parse(SegmentConfig).open()
    check_target(unlabelled, tmp_path / "target")
    labels = [record.labels[number] for number in kept]
    anew = SegmentationRecord.of_labels(labels, repo_id="local/unlabelled", fps=10, horizon=4, n_skills=3)
    write_segmented_dataset(unlabelled, tmp_path / "target", "test/again", anew)
    np.testing.assert_array_equal(load_labels(tmp_path / "target")[1], np.concatenate(labels))
    options = ["--source_repo_id=local/unlabelled", "--edited=true", f"--output_root={tmp_path / 'kept'}"]
    monkeypatch.setattr(sys, "argv", ["lerobot-buds-join", f"--root={segmented}", *options])
    join_command.main()  # the other way: the skills are kept
    found, skills, _ = load_labels(tmp_path / "kept")
    np.testing.assert_array_equal(skills, np.concatenate(labels))
    assert record.labels_hash in found.lineage
