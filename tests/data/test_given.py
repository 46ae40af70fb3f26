"""Labels that a dataset brings along: columns, and subtasks as lerobot-annotate writes them."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from lerobot_buds.core import COLLECTION_FILE, DatasetError, write_json
from lerobot_buds.data import LocalDataset, given_labels, read_annotations

PLAN = {"role": "assistant", "content": "first, then", "style": "plan", "timestamp": 0.0}
SUBTASKS = (
    [(0.0, "reach"), (0.3, "grasp"), (0.5, "reach")],
    [(0.0, "grasp")],
    [(0.0, "lift\nand <b>hold</b>"), (0.2, "reach")],
)


@pytest.fixture
def root(image_root: Path, tmp_path: Path) -> Path:
    """Episodes of 7, 5 and 6 frames at 10 Hz."""
    return Path(shutil.copytree(image_root, tmp_path / "dataset"))


def refusal(root: Path, source: str = "subtasks") -> str:
    with pytest.raises(DatasetError) as caught:
        given_labels(root, source)
    return str(caught.value)


def test_one_label_per_distinct_text(root: Path, annotate: Callable[..., Path]) -> None:
    given = given_labels(annotate(root, SUBTASKS, PLAN), "subtasks")
    assert given.names == ("reach", "grasp", "lift\nand <b>hold</b>")
    assert [episode.tolist() for episode in given.labels] == [[0, 0, 0, 1, 1, 0, 0], [1] * 5, [2, 2, 0, 0, 0, 0]]
    assert {len(rows) for rows in read_annotations(root)} == {2, 3, 4}


def test_chosen_episodes_alone_need_subtasks(root: Path, annotate: Callable[..., Path]) -> None:
    annotate(root, [SUBTASKS[0], [], SUBTASKS[2]])
    assert "1 of 3 episodes have no subtasks (the first is 1)" in refusal(root)
    given = given_labels(LocalDataset(root, (2,)), "subtasks")
    assert given.names == ("lift\nand <b>hold</b>", "reach") and given.labels[0].tolist() == [0, 0, 1, 1, 1, 1]


def test_a_dataset_without_annotations_has_no_subtasks(root: Path) -> None:
    assert read_annotations(root) == [[], [], []]
    assert "3 of 3 episodes have no subtasks" in refusal(root)


def test_a_late_first_subtask_and_ones_without_a_frame(
    root: Path, annotate: Callable[..., Path], caplog: pytest.LogCaptureFixture
) -> None:
    rows = [(0.2, "reach"), (0.41, "blink"), (0.42, "grasp"), (9.0, "never")]
    given = given_labels(annotate(root, [rows] * 3), "subtasks")
    assert given.names == ("reach", "grasp") and given.labels[0].tolist() == [0, 0, 0, 0, 0, 1, 1]
    assert "frames before the first subtask, up to 2" in caplog.text and "7 subtasks hold for no frame" in caplog.text


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([(0.0, "reach"), (0.3, "grasp"), (0.3, "lift")], "two subtasks begin at 0.3 s: 'grasp' and 'lift'"),
        ([(0.0, " ")], "has no text or no time"),
        ([(float("inf"), "reach")], "has no text or no time"),
    ],
)
def test_subtasks_that_do_not_label(
    root: Path, annotate: Callable[..., Path], rows: list[tuple[float, str]], said: str
) -> None:
    annotate(root, [SUBTASKS[0], rows, SUBTASKS[2]])
    assert "episode 1" in refusal(root) and said in refusal(root)


def test_frames_of_an_episode_that_disagree(root: Path, annotate: Callable[..., Path]) -> None:
    annotate(root, SUBTASKS)
    (path,) = root.glob("data/*/*.parquet")
    table = pq.read_table(path)
    cells = table["language_persistent"].to_pylist()
    cells[9] = cells[9] + [{**cells[9][0], "timestamp": 0.1}]
    place = table.column_names.index("language_persistent")
    pq.write_table(table.set_column(place, "language_persistent", pa.array(cells)), path)
    assert "the frames of episode 1 have different 'language_persistent'" in refusal(root)
    pq.write_table(table.set_column(place, "language_persistent", pa.array([["reach"]] * len(cells))), path)
    assert "'language_persistent' of episode 0 is not what LeRobot writes there" in refusal(root)


def test_one_label_per_value_of_a_column(root: Path) -> None:
    given = given_labels(LocalDataset(root, (0, 2)), "true_stage")
    assert given.names == ("true_stage 0", "true_stage 1", "true_stage 2")
    assert [episode.tolist() for episode in given.labels] == [[0, 0, 0, 1, 1, 1, 2], [0, 0, 0, 1, 1, 1]]
    assert given.labels[0].dtype == np.int64


@pytest.mark.parametrize(
    ("stages", "names"),
    [
        (["reach", "grasp", "lift", "rest"], ("reach", "grasp", "lift")),
        (["reach", "grasp"], ("true_stage 0", "true_stage 1", "true_stage 2")),
        (["reach"] * 3, ("true_stage 0", "true_stage 1", "true_stage 2")),
    ],
)
def test_stages_have_the_names_that_the_recorder_gave(root: Path, stages: list[str], names: tuple[str, ...]) -> None:
    write_json(root / COLLECTION_FILE, {"version": 2, "stages": stages})
    assert given_labels(root, "true_stage").names == names


def test_columns_that_do_not_label(root: Path) -> None:
    assert re.search("'true_stages'.*Did you mean 'true_stage'", refusal(root, "true_stages"))
    assert "'timestamp' does not label frames: 7 distinct values of type float32" in refusal(root, "timestamp")
    assert "'action' does not label frames" in refusal(root, "action")
