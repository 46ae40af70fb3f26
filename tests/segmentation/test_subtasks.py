"""Segments as LeRobot's subtasks: read by LeRobot's own renderer and tools, and read back as the same segments."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from filelock import FileLock
from lerobot.configs.recipe import MessageTurn, TrainingRecipe
from lerobot.datasets import (
    LeRobotDataset,
    StreamingLeRobotDataset,
    delete_episodes,
    merge_datasets,
    remove_feature,
    split_dataset,
)
from lerobot.datasets.language_render import render_sample
from lerobot.utils.collate import lerobot_collate_fn

from lerobot_buds.core import RECORD_DIR, DatasetError, SegmentationError, StorageError, sha256_of_file
from lerobot_buds.data import given_labels, read_annotations
from lerobot_buds.segmentation import SegmentationRecord, load_labels, names_of, write_subtasks

NAMES = ("reach for <b>it</b>", "pull\nthe drawer", "let go: «wide»")
RECIPE = TrainingRecipe(
    messages=[
        MessageTurn(role="user", content="${task}", stream="high_level"),
        MessageTurn(role="assistant", content="${subtask}", stream="high_level", target=True, if_present="subtask"),
    ]
)
PLAN = {"role": "assistant", "content": "first, then", "style": "plan", "timestamp": 0.0}


def contents(root: Path) -> dict[str, str]:
    return {str(p.relative_to(root)): sha256_of_file(p) for p in sorted(root.rglob("*")) if p.is_file()}


@pytest.fixture
def dataset(segmented: Path, tmp_path: Path) -> Path:
    """Segmented, without subtasks."""
    return Path(shutil.copytree(segmented, tmp_path / "dataset"))


@pytest.fixture
def named(dataset: Path) -> Path:
    write_subtasks(dataset, NAMES)
    return dataset


def rendered(root: Path) -> list[str]:
    """What LeRobot's renderer of recipes makes a policy say in every frame."""
    said = []
    for item in LeRobotDataset("test/named", root=root):
        sample = render_sample(
            recipe=RECIPE,
            persistent=item["language_persistent"],
            events=item["language_events"],
            t=float(item["timestamp"]),
            sample_idx=int(item["index"]),
            task=item["task"],
        )
        said.append(sample["messages"][sample["target_message_indices"][0]]["content"])
    return said


def test_lerobots_recipes_say_the_skill_of_every_frame(named: Path, record: SegmentationRecord) -> None:
    assert rendered(named) == [NAMES[skill] for skill in np.concatenate(record.labels)]
    assert names_of(named, 3) == NAMES


def test_everything_else_stays(named: Path, segmented: Path) -> None:
    before, after = contents(segmented), contents(named)
    changed = {name for name in after if after[name] != before.get(name)}
    assert changed == {"data/chunk-000/file-000.parquet", "meta/info.json", f"{RECORD_DIR}/names.yaml"}
    old, new = (pq.read_table(root / "data/chunk-000/file-000.parquet") for root in (segmented, named))
    assert new.select(old.column_names).equals(old)
    for ours, theirs in zip(load_labels(named), load_labels(segmented), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    features = [list(LeRobotDataset("test/any", root=root).meta.features) for root in (segmented, named)]
    assert features[1] == [*features[0], "language_persistent", "language_events"]


def test_export_then_import_is_the_identity(named: Path, record: SegmentationRecord) -> None:
    given = given_labels(named, "subtasks")
    assert given.names == NAMES
    for ours, theirs in zip(given.labels, record.labels, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_names_are_changed_as_often_as_one_likes(named: Path) -> None:
    write_subtasks(named, NAMES[::-1])
    assert rendered(named)[0] == NAMES[2]
    write_subtasks(named, NAMES)
    before = contents(named)
    write_subtasks(named, NAMES)
    assert contents(named) == before


def test_lerobots_loaders_read_them(named: Path) -> None:
    loader = torch.utils.data.DataLoader(
        LeRobotDataset("test/named", root=named), batch_size=8, collate_fn=lerobot_collate_fn
    )
    assert next(iter(loader))["skill_id"].shape == (8,)
    streamed = next(iter(StreamingLeRobotDataset("test/named", root=named, shuffle=False)))
    assert streamed["language_persistent"][0]["content"] in NAMES


def test_lerobots_edits_keep_them_right(named: Path, record: SegmentationRecord, tmp_path: Path) -> None:
    """Subtasks are told by time within their episode, so that labels can be read from them after an edit."""
    said = [[NAMES[skill] for skill in labels] for labels in record.labels]
    dataset = LeRobotDataset("test/named", root=named)
    deleted = delete_episodes(dataset, [0], tmp_path / "deleted", repo_id="test/deleted")
    assert rendered(deleted.root) == said[1] + said[2]
    parts = split_dataset(dataset, {"last": [2], "first": [0, 1]}, tmp_path / "parts")
    assert rendered(parts["last"].root) == said[2]
    merged = merge_datasets([parts["last"], parts["first"], dataset], "test/merged", tmp_path / "merged")
    assert rendered(merged.root) == [*said[2], *said[0], *said[1], *said[0], *said[1], *said[2]]
    plain = remove_feature(dataset, ["skill_id", "subgoal_index"], tmp_path / "plain", repo_id="test/plain")
    for ours, theirs in zip(given_labels(plain.root, "subtasks").labels, record.labels, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_subtasks_of_people_are_replaced_on_demand_only(dataset: Path, annotate: Callable[..., Path]) -> None:
    annotate(dataset, [[(0.0, "theirs"), (0.5, "theirs too")]] * 3, PLAN)
    before = contents(dataset)
    with pytest.raises(SegmentationError, match=r"episode 0 has 2 subtasks that are not those of its 2 segments"):
        write_subtasks(dataset, NAMES)
    assert contents(dataset) == before
    write_subtasks(dataset, NAMES, replace=True)
    assert rendered(dataset)[0] == NAMES[0]
    assert [[row["style"] for row in rows].count("plan") for rows in read_annotations(dataset)] == [1, 1, 1]


def test_a_name_that_is_too_long_changes_nothing(dataset: Path) -> None:
    before = contents(dataset)
    with pytest.raises(SegmentationError, match="name of skill 1 has 10000 characters, more than 200"):
        write_subtasks(dataset, ("a", "x" * 10_000, "c"))
    assert contents(dataset) == before


def test_labels_out_of_step_are_refused(dataset: Path, tmp_path: Path) -> None:
    edited = delete_episodes(LeRobotDataset("t/d", root=dataset), [0], tmp_path / "edited", repo_id="t/edited")
    with pytest.raises(SegmentationError, match="no segmentation record"):
        write_subtasks(Path(edited.root), NAMES)


def test_a_full_disk_or_a_second_writer_changes_nothing(dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = contents(dataset)
    with FileLock(dataset.with_name(f".{dataset.name}.lock")), pytest.raises(DatasetError, match="Another process"):
        write_subtasks(dataset, NAMES)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("lerobot_buds.segmentation.subtasks.write_names", full)
    with pytest.raises(StorageError, match="No space left on device"):
        write_subtasks(dataset, NAMES)
    assert contents(dataset) == before


def test_a_kill_within_the_renames_is_mended(dataset: Path, named: Path, segmented: Path) -> None:
    whole = contents(named)
    for name in ("meta/info.json", f"{RECORD_DIR}/names.yaml"):
        shutil.copy(segmented / name, dataset / name)
    (dataset / "data/chunk-000/.file-000.parquet.01234567.part").write_text("half")
    write_subtasks(dataset, NAMES)
    assert contents(dataset) == whole
