"""Labels without recordings: what a companion holds, and that it is joined with what was labelled and nothing else."""

import re
import shlex
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from lerobot_buds.cli import join as join_command
from lerobot_buds.cli.running import parse
from lerobot_buds.cli.segment import SegmentConfig
from lerobot_buds.core import SEGMENTATION_FILE, SegmentationError, read_json, write_json
from lerobot_buds.data import LocalDataset, content_hashes
from lerobot_buds.segmentation import (
    SegmentationRecord,
    check_target,
    join_companion,
    load_labels,
    names_of,
    write_companion,
    write_segmented_dataset,
)

ROWS = "data/chunk-000/file-000.parquet"


@pytest.fixture
def companion(segmented: Path, tmp_path: Path) -> Path:
    write_companion(segmented, tmp_path / "labels", "me/labels")
    return tmp_path / "labels"


def changed(source: Path, target: Path, column: str, row: int) -> Path:
    """A copy of a dataset with another value in one row of a column of vectors."""
    shutil.copytree(source, target)
    table = pq.read_table(target / ROWS)
    values = table[column].to_pylist()
    values[row] = [value + 1 for value in values[row]]
    place = table.column_names.index(column)
    table = table.set_column(place, table.field(place), pa.array(values, table[column].type))
    pq.write_table(table, target / ROWS)
    return target


def test_what_was_labelled_is_joined_to_what_the_labels_were_taken_from(source, segmented, companion, tmp_path):
    join_companion(companion, source, tmp_path / "joined", "me/joined")
    for ours, theirs in zip(load_labels(tmp_path / "joined"), load_labels(segmented), strict=True):
        if not isinstance(ours, SegmentationRecord):
            np.testing.assert_array_equal(ours, theirs)
    assert (tmp_path / "joined" / ROWS).read_bytes() == (segmented / ROWS).read_bytes()
    assert names_of(tmp_path / "joined", 3) == names_of(segmented, 3)


def test_a_companion_holds_labels_and_no_recordings(segmented, companion, record):
    table = pq.read_table(companion / "labels/labels.parquet").to_pydict()
    np.testing.assert_array_equal(table["skill_id"], np.concatenate(record.labels))
    subgoals = load_labels(segmented)[2] - np.repeat([0, 25, 31], [25, 6, 30])
    np.testing.assert_array_equal(table["subgoal_frame"], subgoals)
    assert not (companion / "data").exists() and not (companion / "meta/info.json").exists()
    assert "lerobot-buds-join --repo_id=me/labels" in (companion / "README.md").read_text()


def test_episodes_are_told_by_what_was_felt_and_done(source, segmented, tmp_path):
    assert content_hashes(source) == content_hashes(segmented)
    assert content_hashes(LocalDataset(source, chosen=(1,))) == content_hashes(source)[1:2]
    other = content_hashes(changed(source, tmp_path / "other", "action", 26))
    assert [a == b for a, b in zip(content_hashes(source), other, strict=True)] == [True, False, True]


@pytest.mark.parametrize("column", ["action", "observation.state"])
def test_a_source_that_changed_is_refused_by_episode(source, companion, tmp_path, column):
    other = changed(source, tmp_path / "other", column, 40)
    with pytest.raises(
        SegmentationError, match=r"Episode 2 of .*other is not the one of test/source.*\(1 of 3 differ\)"
    ):
        join_companion(companion, other, tmp_path / "joined", "me/joined")
    assert not (tmp_path / "joined").exists()


def test_a_source_that_lost_an_episode_is_refused(source, companion, tmp_path):
    from lerobot.datasets import LeRobotDataset, delete_episodes

    delete_episodes(LeRobotDataset("test/source", root=source), [2], tmp_path / "fewer", repo_id="test/fewer")
    with pytest.raises(SegmentationError, match=r"Episode 2 of .* it is not there"):
        join_companion(companion, tmp_path / "fewer", tmp_path / "joined", "me/joined")


def test_an_edited_source_with_an_episode_that_was_never_labelled_is_refused(source, companion, tmp_path):
    other = changed(source, tmp_path / "other", "action", 26)
    with pytest.raises(SegmentationError, match=r"Episode 1 of .* is none of those .*\(1 of 3 are not\)"):
        join_companion(companion, other, tmp_path / "joined", "me/joined", edited=True)


def test_a_source_that_grew_is_joined_in_part(source, record, tmp_path):
    """The labels of two of its episodes, one of them not the first."""
    labels = [record.labels[0], record.labels[2]]
    hashes = [content_hashes(source)[n] for n in (0, 2)]
    part = SegmentationRecord.of_labels(
        labels, repo_id="test/source", fps=10, horizon=4, n_skills=3, chosen=[0, 2], content=hashes
    )
    chosen = LocalDataset(source, chosen=(0, 2))
    write_segmented_dataset(chosen, tmp_path / "part", "me/part", part)
    write_companion(tmp_path / "part", tmp_path / "labels", "me/labels")
    join_companion(tmp_path / "labels", source, tmp_path / "joined", "me/joined")
    np.testing.assert_array_equal(load_labels(tmp_path / "joined")[1], np.concatenate(labels))


def test_the_advice_of_a_refusal_can_be_followed(source, companion, tmp_path, monkeypatch):
    record = SegmentationRecord.read(companion)
    replace(record, source=replace(record.source, commit="ab" * 20)).write(companion)
    other = changed(source, tmp_path / "other", "action", 0)
    arguments = [f"--root={companion}", f"--source_root={other}", f"--output_root={tmp_path / 'joined'}"]
    monkeypatch.setattr(sys, "argv", ["lerobot-buds-join", *arguments])
    with pytest.raises(SystemExit, match=r"leave out all --source options.*abab\)") as caught:
        join_command.main()
    advice = re.search(r", or label .* anew: lerobot-buds-segment (.*)\.$", str(caught.value))
    assert advice is not None
    monkeypatch.setattr(sys, "argv", ["lerobot-buds-segment", *shlex.split(advice[1])])
    config = parse(SegmentConfig)
    assert config.root == other
    check_target(config.open(), tmp_path / "target")


def test_an_older_record_is_completed_from_its_copy(segmented, source, tmp_path):
    copy = shutil.copytree(segmented, tmp_path / "copy")
    content = read_json(copy / SEGMENTATION_FILE)
    for name in ("content", "commit", "chosen"):
        content["source"].pop(name, None)
    write_json(copy / SEGMENTATION_FILE, content)
    write_companion(copy, tmp_path / "labels", "me/labels")
    assert SegmentationRecord.read(tmp_path / "labels").source.content == content_hashes(source)


def test_a_target_that_exists_is_kept(segmented, companion):
    before = sorted(companion.rglob("*"))
    with pytest.raises(SegmentationError, match="exists already"):
        write_companion(segmented, companion, "me/labels")
    assert sorted(companion.rglob("*")) == before
