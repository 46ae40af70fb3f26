import shutil
import signal
import subprocess
import sys
from collections import namedtuple
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from filelock import FileLock
from lerobot.datasets import LeRobotDataset, delete_episodes

import lerobot_buds
from lerobot_buds.core import (
    COLLECTION_FILE,
    SEGMENTATION_FILE,
    DatasetError,
    SegmentationError,
    read_json,
    sha256_of_file,
)
from lerobot_buds.segmentation import SegmentationRecord, load_labels, write_segmented_dataset

pytestmark = pytest.mark.slow


def contents(root: Path) -> dict[str, str]:
    return {str(p.relative_to(root)): sha256_of_file(p) for p in sorted(root.rglob("*")) if p.is_file()}


def beside(target: Path) -> list[str]:
    return sorted(p.name for p in target.parent.iterdir() if p.name != f".{target.name}.lock")


def test_lerobot_reads_the_labels(segmented: Path, record: SegmentationRecord) -> None:
    dataset = LeRobotDataset("test/segmented", root=segmented)
    assert dataset.meta.total_episodes == 3 and dataset.meta.features["skill_id"]["dtype"] == "int64"
    items = [dataset[i] for i in range(len(dataset))]
    assert [int(item["skill_id"]) for item in items] == np.concatenate(record.labels).tolist()
    for item in items:
        t, episode = int(item["frame_index"]), int(item["episode_index"])
        start = sum(record.source.episode_lengths[:episode])
        end = next(s.end for s in record.episodes[episode].segments if s.start <= t < s.end)
        expected = min(t + record.horizon, end, record.source.episode_lengths[episode] - 1)
        assert int(item["subgoal_index"]) == start + expected


def test_statistics_cover_the_new_columns(segmented: Path, source: Path, record: SegmentationRecord) -> None:
    stats = read_json(segmented / "meta/stats.json")
    labels = np.concatenate(record.labels)
    assert stats["skill_id"]["mean"] == [pytest.approx(labels.mean())]
    assert (stats["skill_id"]["min"], stats["skill_id"]["max"], stats["skill_id"]["count"]) == ([0], [2], [61])
    assert stats["subgoal_index"]["max"] == [60]
    old = read_json(source / "meta/stats.json")
    assert {name: stats[name] for name in old} == old


def test_records_travel_and_labels_load(segmented: Path, record: SegmentationRecord) -> None:
    assert read_json(segmented / COLLECTION_FILE) == {"seed": 7}
    loaded, skill_id, subgoal_index = load_labels(segmented)
    assert loaded == record
    assert skill_id.dtype == subgoal_index.dtype == np.int64
    assert skill_id.tolist() == np.concatenate(record.labels).tolist()


def test_same_inputs_same_bytes_and_an_untouched_source(
    segmented: Path, source: Path, record: SegmentationRecord, tmp_path: Path
) -> None:
    before = contents(source)
    write_segmented_dataset(source, tmp_path / "again", "test/segmented", record)
    assert contents(tmp_path / "again") == contents(segmented)
    assert contents(source) == before


def test_an_existing_target_is_refused(segmented: Path, source: Path, record: SegmentationRecord) -> None:
    before = contents(segmented)
    with pytest.raises(SegmentationError, match="exists already"):
        write_segmented_dataset(source, segmented, "test/segmented", record)
    assert contents(segmented) == before


def test_a_labelled_source_is_refused(segmented: Path, record: SegmentationRecord, tmp_path: Path) -> None:
    with pytest.raises(SegmentationError, match="already has the columns"):
        write_segmented_dataset(segmented, tmp_path / "x", "test/x", record)


def test_a_record_of_another_dataset_is_refused(source: Path, record: SegmentationRecord, tmp_path: Path) -> None:
    for other in (
        replace(record, source=replace(record.source, fps=20)),
        SegmentationRecord.of_labels(record.labels[:2], repo_id="a/b", fps=10, horizon=4),
    ):
        with pytest.raises(SegmentationError, match="Segment this one anew"):
            write_segmented_dataset(source, tmp_path / "x", "test/x", other)
    assert beside(tmp_path / "x") == []


def test_a_full_disk_is_noticed_first(
    source: Path, record: SegmentationRecord, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage(10, 9, 1))
    with pytest.raises(DatasetError, match=r"needs about \d+ bytes, but its disk has only 1 free"):
        write_segmented_dataset(source, tmp_path / "x", "test/x", record)
    assert beside(tmp_path / "x") == []


def test_a_disk_that_fills_up_leaves_nothing(
    source: Path, record: SegmentationRecord, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: SegmentationRecord, root: Path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(SegmentationRecord, "write", full)
    with pytest.raises(DatasetError, match=r"No space left on device.*needs about \d+ bytes"):
        write_segmented_dataset(source, tmp_path / "x", "test/x", record)
    assert beside(tmp_path / "x") == []


def test_a_second_writer_is_refused(source: Path, record: SegmentationRecord, tmp_path: Path) -> None:
    with FileLock(tmp_path / ".x.lock"), pytest.raises(DatasetError, match="Another process is writing"):
        write_segmented_dataset(source, tmp_path / "x", "test/x", record)
    assert beside(tmp_path / "x") == []


def test_a_target_that_cannot_be_written(source: Path, record: SegmentationRecord, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(DatasetError, match=r"could not be written \(.*\). It needs about \d+ bytes"):
        write_segmented_dataset(source, tmp_path / "file" / "x", "test/x", record)


KILLED_WRITE = """
import os, signal, sys
from pathlib import Path
from lerobot_buds.segmentation import SegmentationRecord, write_segmented_dataset
record = SegmentationRecord.read(Path(sys.argv[3]))
SegmentationRecord.write = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
write_segmented_dataset(Path(sys.argv[1]), Path(sys.argv[2]), "test/segmented", record)
"""


def test_a_killed_write_leaves_no_target_and_a_rerun_finishes(
    segmented: Path, source: Path, record: SegmentationRecord, tmp_path: Path
) -> None:
    target = tmp_path / "out" / "x"
    other = target.parent / ".x.y.01234567.part"  # the staging folder of another target, "x.y"
    other.mkdir(parents=True)
    record.write(tmp_path / "given")
    command = [sys.executable, "-c", KILLED_WRITE, *map(str, (source, target, tmp_path / "given"))]
    killed = subprocess.run(command, cwd=Path(lerobot_buds.__file__).parents[1], check=False)
    assert killed.returncode == -signal.SIGKILL
    left = [name for name in beside(target) if name != other.name]
    assert len(left) == 1 and (target.parent / left[0] / "meta/info.json").exists()

    write_segmented_dataset(source, target, "test/segmented", record)
    assert contents(target) == contents(segmented)
    assert beside(target) == [other.name, "x"]


def test_labels_are_refused_after_lerobot_edits(segmented: Path, tmp_path: Path) -> None:
    dataset = LeRobotDataset("test/segmented", root=segmented)
    edited = delete_episodes(dataset, episode_indices=[0], output_dir=tmp_path / "edited", repo_id="test/edited")
    with pytest.raises(SegmentationError, match="no segmentation record"):
        load_labels(edited.root)
    (edited.root / SEGMENTATION_FILE).parent.mkdir()
    shutil.copy(segmented / SEGMENTATION_FILE, edited.root / SEGMENTATION_FILE)
    with pytest.raises(SegmentationError, match="To segment it as it is now"):
        load_labels(edited.root)
