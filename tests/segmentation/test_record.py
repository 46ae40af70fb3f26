import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import lerobot_buds.segmentation
from lerobot_buds.core import SEGMENTATION_FILE, SegmentationError, read_json, subgoals_of, write_json
from lerobot_buds.segmentation import SegmentationRecord, check_labels

pytestmark = pytest.mark.slow


def columns(record: SegmentationRecord) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    lengths = np.array(record.source.episode_lengths)
    ends = np.cumsum(lengths)
    starts = ends - lengths
    subgoals = [s + subgoals_of(e, record.horizon) for s, e in zip(starts, record.labels, strict=True)]
    return np.concatenate(record.labels), np.concatenate(subgoals), starts, ends, np.ones(ends[-1], dtype=bool)


episode_labels = st.lists(st.integers(0, 3), max_size=20).map(lambda x: np.array(x, dtype=np.int64))
numbers = st.integers() | st.floats(allow_nan=False, allow_infinity=False)
plain = st.dictionaries(st.text(), st.none() | st.booleans() | numbers | st.text() | st.lists(numbers | st.text()))


@settings(max_examples=60)
@given(
    labels=st.lists(episode_labels, min_size=1, max_size=4).filter(lambda episodes: any(map(len, episodes))),
    horizon=st.integers(1, 9),
    fps=st.integers(1, 1000),
    repo_id=st.text(),
    parameters=plain,
    representation=plain,
    seeds=st.dictionaries(st.text(), st.integers()),
    agreement=st.none() | st.dictionaries(st.text(), st.floats(allow_nan=False, allow_infinity=False)),
)
def test_write_read_write_is_the_identity(
    tmp_path_factory: pytest.TempPathFactory, labels: list[np.ndarray], **description: Any
) -> None:
    root = tmp_path_factory.mktemp("record")
    record = SegmentationRecord.of_labels(labels, **description)
    record.write(root)
    first = (root / SEGMENTATION_FILE).read_bytes()
    again = SegmentationRecord.read(root)
    assert again == record
    again.write(root)
    assert (root / SEGMENTATION_FILE).read_bytes() == first
    for mine, theirs in zip(again.labels, labels, strict=True):
        assert mine.tolist() == theirs.tolist()
    check_labels(record, *columns(record))


def test_the_file_says_what_a_reader_wants(record: SegmentationRecord, tmp_path: Path) -> None:
    record.write(tmp_path)
    content = read_json(tmp_path / SEGMENTATION_FILE)
    assert content["source"] == {
        "repo_id": "test/source",
        "fps": 10,
        "episode_lengths": [25, 6, 30],
        "total_frames": 61,
        "commit": None,
        "chosen": None,
        "content": [],
    }
    assert content["episodes"][2]["segments"] == [[0, 9, 2], [9, 18, 0], [18, 30, 1]]
    assert (content["horizon"], content["horizon_seconds"]) == (4, 0.4)
    assert content["skills"][0] == {"segments": 2, "mean_frames": 9.5, "mean_seconds": 0.95}
    assert content["schema_version"] == 1


def test_a_newer_record_is_refused_with_the_version_to_install(record: SegmentationRecord, tmp_path: Path) -> None:
    replace(record, schema_version=2, package_version="0.9.1").write(tmp_path)
    with pytest.raises(SegmentationError, match=r"Install lerobot_policy_buds>=0\.9\.1"):
        SegmentationRecord.read(tmp_path)


def test_an_older_record_is_read(record: SegmentationRecord, tmp_path: Path) -> None:
    record.write(tmp_path)
    content = read_json(tmp_path / SEGMENTATION_FILE)
    content["schema_version"] = 0
    for name in ("agreement", "seeds", "representation", "skills", "horizon_seconds"):
        del content[name]
    write_json(tmp_path / SEGMENTATION_FILE, content)
    old = SegmentationRecord.read(tmp_path)
    assert (old.agreement, old.seeds, old.schema_version) == (None, {}, 0)
    assert old.episodes == record.episodes


def test_a_missing_record_names_the_cause_and_the_command(tmp_path: Path) -> None:
    with pytest.raises(SegmentationError, match=r"(?s)lerobot-edit-dataset.*lerobot-buds-segment"):
        SegmentationRecord.read(tmp_path)


@pytest.mark.parametrize("content", ["[1]", "{", '{"schema_version": 1}', "null"])
def test_a_damaged_record_is_refused(tmp_path: Path, content: str) -> None:
    path = tmp_path / SEGMENTATION_FILE
    path.parent.mkdir(parents=True)
    path.write_text(content)
    with pytest.raises(SegmentationError, match=r"(?s)damaged.*To segment it as it is now"):
        SegmentationRecord.read(tmp_path)


def test_segments_that_do_not_tile_are_refused(record: SegmentationRecord, tmp_path: Path) -> None:
    record.write(tmp_path)
    content = read_json(tmp_path / SEGMENTATION_FILE)
    content["episodes"][0]["segments"].pop()
    write_json(tmp_path / SEGMENTATION_FILE, content)
    with pytest.raises(SegmentationError, match="do not tile"):
        SegmentationRecord.read(tmp_path)


def test_a_deleted_episode_is_noticed(record: SegmentationRecord) -> None:
    skill, subgoal, starts, ends, present = columns(record)
    n = ends[0]
    with pytest.raises(SegmentationError, match=r"2 episodes of 36 frames.*3 of 61.*To segment it as it is now"):
        check_labels(record, skill[n:], subgoal[n:], starts[1:] - n, ends[1:] - n, present[n:])


def test_renumbered_frames_are_noticed(record: SegmentationRecord) -> None:
    skill, subgoal, starts, ends, present = columns(record)
    with pytest.raises(SegmentationError, match=r"labels of episode 0 .*To segment it as it is now"):
        check_labels(record, skill, subgoal + 1, starts, ends, present)


def test_one_changed_label_is_noticed(record: SegmentationRecord) -> None:
    skill, subgoal, starts, ends, present = columns(record)
    skill[28] += 1
    with pytest.raises(SegmentationError, match=r"episode 1 \(frames 25 to 30\)"):
        check_labels(record, skill, subgoal, starts, ends, present)


def test_reordered_episodes_of_equal_length_are_noticed() -> None:
    labels = [np.repeat([0, 1], [4, 4]), np.repeat([1, 0], [5, 3])]
    record = SegmentationRecord.of_labels(labels, repo_id="a/b", fps=10, horizon=2)
    other = SegmentationRecord.of_labels(labels[::-1], repo_id="a/b", fps=10, horizon=2)
    with pytest.raises(SegmentationError, match="episode 0"):
        check_labels(record, *columns(other))


def test_absent_episodes_are_passed_over(record: SegmentationRecord) -> None:
    skill, subgoal, starts, ends, present = columns(record)
    skill[:25], subgoal[:25], present[:25] = -1, -1, False
    check_labels(record, skill, subgoal, starts, ends, present)


def test_importing_the_folder_loads_neither_torch_nor_lerobot() -> None:
    # The plugin's own __init__ registers configurations with LeRobot; an empty package stands in for it here.
    root = Path(lerobot_buds.__file__).parent
    code = f"""
import sys, types
package = types.ModuleType("lerobot_buds")
package.__path__ = [{str(root)!r}]
sys.modules["lerobot_buds"] = package
import lerobot_buds.segmentation, lerobot_buds.evaluation.agreement
heavy = {{"torch", "lerobot", "matplotlib"}} & set(sys.modules)
assert not heavy, heavy
"""
    subprocess.run([sys.executable, "-c", code], check=True)
