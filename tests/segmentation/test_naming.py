"""Names of skills: what is said of them automatically, and the file that people edit."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lerobot.datasets import LeRobotDataset

from lerobot_buds.core import NAMES_FILE, SegmentationError, StorageError
from lerobot_buds.data import LocalDataset
from lerobot_buds.segmentation import SegmentationRecord, automatic_names, names_of, read_names, write_names

TEXTS = st.text(st.characters(exclude_categories=["Cs"]), min_size=1).filter(str.strip)


@given(names=st.lists(TEXTS, min_size=1, max_size=5, unique=True))
def test_any_names_come_back_exactly(names: list[str], tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.getbasetemp() / "any.yaml"
    write_names(path, names)
    assert read_names(path, len(names)) == tuple(names)


HOSTILE = ["reach\ngrasp", "<script>alert('x')</script>", "x" * 10_000, "no", "3", "\x1b[31mred", "{{ a }} ${subtask}"]


def test_names_that_look_like_something_else_come_back_exactly(tmp_path: Path) -> None:
    write_names(tmp_path / "names.yaml", HOSTILE)
    assert read_names(tmp_path / "names.yaml", len(HOSTILE)) == tuple(HOSTILE)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("skills: {0: a, 1: b, 3: c}", "there is no skill 3 (the dataset has 0 to 2); skill 2 has no name"),
        ("skills: {0: a, 1: b}", "skill 2 has no name"),
        ("skills: {0: a, 1: b, 2: a}", "skills 0 and 2 are both named 'a'"),
        ("skills: {0: a, 1: b, 1: c, 2: d}", "1 stands twice"),
        ("skills: {0: a, true: b, 2: c}", "there is no skill True"),
        ("skills: {0: a, 1: no, 2: c}", "the name of skill 1 is read as False, no text: put it in quotes"),
        ("skills: {0: a, 1: '  ', 2: c}", "the name of skill 1 is empty"),
        ('skills: {0: a, 1: "\\ud800", 2: c}', "half of a surrogate pair"),
        ("skills: [a, b, c]", "holds no names"),
        ("a, b, c", "holds no names"),
        ("", "holds no names"),
        ("skills: {0: a", "cannot be read as YAML"),
        ("skills: !!python/object/apply:os.getcwd []", "cannot be read as YAML"),
        ("[" * 5000, "cannot be read as YAML"),
        ("version: 2\nskills: {0: a, 1: b, 2: c}", "has format 2"),
    ],
)
def test_a_file_of_names_that_cannot_be_used(tmp_path: Path, content: str, said: str) -> None:
    path = tmp_path / "names.yaml"
    path.write_text(content)
    with pytest.raises(SegmentationError) as caught:
        read_names(path, 3)
    assert said in str(caught.value) and str(path) in str(caught.value)


def test_errors_about_anybodys_file_stay_short(tmp_path: Path) -> None:
    levels = [f"a{n}: &a{n} [" + ", ".join([f"*a{n - 1}" if n else "x"] * 9) + "]" for n in range(12)]
    for content in (
        "\n".join([*levels, "skills: {0: *a11}"]),
        "skills: {0: " + "x" * 10**6 + ", 1: " + "x" * 10**6 + "}",
    ):
        (tmp_path / "names.yaml").write_text(content)
        with pytest.raises(SegmentationError) as caught:
            read_names(tmp_path / "names.yaml", 2)
        assert len(str(caught.value)) < 10_000
    (tmp_path / "names.yaml").write_bytes(b"skills: {0: \xff}")
    for path in (tmp_path / "names.yaml", tmp_path, tmp_path / "absent.yaml"):
        with pytest.raises(SegmentationError, match=r"cannot be read|does not exist"):
            read_names(path, 1)
    with pytest.raises(StorageError):
        write_names(tmp_path / "names.yaml" / "inside.yaml", ["a"])


@pytest.fixture(scope="module")
def hand(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two demonstrations at 10 Hz of a gripper, of fingers with opposite signs, that closes for 1 s and opens again."""
    root = tmp_path_factory.mktemp("naming") / "hand"
    features = {
        "observation.state": {"dtype": "float32", "shape": (3,), "names": ["x.pos", "Gripper_left", "Gripper_right"]},
        "action": {"dtype": "float32", "shape": (1,), "names": ["x"]},
    }
    dataset = LeRobotDataset.create("test/hand", 10, features, root=root, use_videos=False)
    opening = np.concatenate([np.full(20, 0.04), np.linspace(0.04, 0, 10), np.zeros(20), np.linspace(0, 0.04, 10)])
    for _ in range(2):
        for t, width in enumerate(opening):
            state = np.array([t, width, -width], dtype=np.float32)
            dataset.add_frame({"observation.state": state, "action": np.zeros(1, np.float32), "task": "pick"})
        dataset.save_episode()
    dataset.finalize()
    return root


def named(root: Path, n_skills: int = 4, known: tuple[str, ...] = ()) -> tuple[str, ...]:
    labels = np.repeat([0, 1, 0, 2], [20, 10, 20, 10])
    record = SegmentationRecord.of_labels([labels] * 2, repo_id="test/hand", fps=10, horizon=4, n_skills=n_skills)
    return automatic_names(record, LocalDataset(root), known)


def test_names_tell_length_and_gripper(hand: Path) -> None:
    assert named(hand) == (
        "skill 0: 2.0 s",
        "skill 1: 1.0 s, gripper closes",
        "skill 2: 1.0 s, gripper opens",
        "skill 3: does not occur here",
    )


def test_names_that_people_gave_stay_with_the_skills_of_a_library(hand: Path) -> None:
    assert named(hand, 3, ("skill 0: 9.9 s", "pick")) == ("skill 0: 2.0 s", "pick", "skill 2: 1.0 s, gripper opens")


def test_a_segmented_dataset_has_names(segmented: Path, tmp_path: Path) -> None:
    names = names_of(segmented, 3)
    assert names is not None and [name[:9] for name in names] == ["skill 0: ", "skill 1: ", "skill 2: "]
    assert "lerobot-buds-name" in (segmented / NAMES_FILE).read_text()
    assert names_of(tmp_path, 3) is None
