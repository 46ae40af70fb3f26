"""``lerobot-buds-name``, and skills made of labels that are there: ``lerobot-buds-segment --labels_from``."""

import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset, add_features, delete_episodes, remove_feature

from lerobot_buds.cli import compare, name
from lerobot_buds.cli.segment import SegmentConfig, segment
from lerobot_buds.core import NAMES_FILE, ConfigError, DatasetError, SegmentationError, read_json
from lerobot_buds.segmentation import SegmentationRecord, SkillModel, load_labels, names_of, write_segmented_dataset

pytestmark = pytest.mark.slow

LENGTHS = (30, 24)
SUBTASKS = [[(0.0, "reach"), (0.75, "pull"), (1.2, "reach")], [(0.0, "reach"), (0.6, "<i>let go</i>")]]
LABELS = [np.repeat([0, 1, 0], [15, 9, 6]), np.repeat([0, 2], [12, 12])]


@pytest.fixture
def annotated(make_dataset: Callable[..., Path], annotate: Callable[..., Path], tmp_path: Path) -> Path:
    """Two demonstrations at 20 Hz with people's subtasks and a column of stages."""
    root = make_dataset(tmp_path / "plain", lengths=LENGTHS)
    stages = np.concatenate([np.arange(length) // 10 for length in LENGTHS])
    column = {"true_stage": (stages, {"dtype": "int64", "shape": (1,), "names": None})}
    dataset = add_features(LeRobotDataset("tests/foreign", root=root), column, tmp_path / "source", "tests/foreign")
    return annotate(Path(dataset.root), SUBTASKS)


@pytest.fixture
def labelled(annotated: Path, settings: Callable, tmp_path: Path) -> Path:
    segment(from_labels(annotated, tmp_path, settings, "subtasks"))
    return tmp_path / "skills"


def from_labels(source: Path, folder: Path, settings: Callable, where: str) -> SegmentConfig:
    """Settings without any of discovery, which would have no effect."""
    plain = settings(source, folder)
    plain.discovery = SegmentConfig(plain.repo_id).discovery
    plain.labels_from = where
    return plain


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> None:
    monkeypatch.setattr(sys, "argv", ["lerobot-buds-name", *map(str, arguments)])
    name.main()


def test_subtasks_become_skills(labelled: Path, tmp_path: Path) -> None:
    record, skills, _ = load_labels(labelled)
    assert skills.tolist() == np.concatenate(LABELS).tolist()
    assert names_of(labelled, record.n_skills) == ("reach", "pull", "<i>let go</i>")
    assert record.labels_from == "subtasks" and record.stability is None
    assert 0 < record.agreement["nmi"] < 1  # against the true stages
    model = SkillModel.from_pretrained(labelled)
    assert model.names == ("reach", "pull", "<i>let go</i>") and len(model.library.skills) == 5
    again = model.label(tmp_path / "source")  # the library labels other demonstrations
    assert [len(episode) for episode in again.labels] == list(LENGTHS)


def test_a_column_becomes_skills(annotated: Path, settings: Callable, tmp_path: Path) -> None:
    """The oracle: the true stages as skills."""
    record = segment(from_labels(annotated, tmp_path, settings, "true_stage"))
    assert np.concatenate(record.labels).tolist() == [t // 10 for length in LENGTHS for t in range(length)]
    assert record.labels_from == "true_stage" and record.agreement["boundary_f1"] == 1
    assert names_of(tmp_path / "skills", 3) == ("true_stage 0", "true_stage 1", "true_stage 2")


def test_export_import_export(labelled: Path, settings: Callable, tmp_path: Path) -> None:
    """Skills that leave as subtasks come back as they were, with their names."""
    name.name_skills(name.NameConfig(root=labelled))
    plain = remove_feature(
        LeRobotDataset("t/s", root=labelled), ["skill_id", "subgoal_index"], tmp_path / "edited", repo_id="t/edited"
    )
    segment(from_labels(Path(plain.root), tmp_path / "second", settings, "subtasks"))
    before, after = (SegmentationRecord.read(root) for root in (labelled, tmp_path / "second/skills"))
    assert after.episodes == before.episodes and after.labels_hash == before.labels_hash
    assert (tmp_path / "second/skills" / NAMES_FILE).read_text() == (labelled / NAMES_FILE).read_text()


def test_what_cannot_work_is_refused_before_anything_is_trained(annotated: Path, refused: Callable[..., str]) -> None:
    plain = {"window_s": None, "max_skills": None, "min_skill_s": None}
    assert "'grasped'" in refused(annotated, DatasetError, labels_from="grasped", discovery=plain)
    assert "settings ['discovery'] have no effect" in refused(annotated, ConfigError, labels_from="true_stage")
    for other in ({"library": "somebody/skills"}, {"representation_only": True}):
        assert "labels_from" in refused(annotated, ConfigError, labels_from="subtasks", **other)


def test_names_are_written_edited_and_applied(
    labelled: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "names.yaml"
    run(monkeypatch, f"--root={labelled}", f"--names={path}")
    assert "edit the names" in capsys.readouterr().out and '1: "pull"' in path.read_text()
    path.write_text(path.read_text().replace('1: "pull"', "1: pull the drawer"))
    run(monkeypatch, f"--root={labelled}", f"--names={path}")
    assert "subtasks of the dataset now" in capsys.readouterr().out
    assert names_of(labelled, 3) == ("reach", "pull the drawer", "<i>let go</i>")
    cells = [LeRobotDataset("t/s", root=labelled)[place]["language_persistent"] for place in (0, 53)]
    assert [[row["content"] for row in cell] for cell in cells] == [
        ["reach", "pull the drawer", "reach"],
        ["reach", "<i>let go</i>"],
    ]


def test_a_dataset_of_an_earlier_version_gets_automatic_names(
    labelled: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (labelled / NAMES_FILE).unlink()
    run(monkeypatch, f"--root={labelled}")
    assert "skill 2: 0.6 s" in (labelled / NAMES_FILE).read_text() and "edit the names" in capsys.readouterr().out
    run(monkeypatch, f"--root={labelled}")
    assert names_of(labelled, 3)[2].startswith("skill 2: 0.6 s")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("1: ", "7: "), "there is no skill 7"),
        (('"pull"', "reach"), "skills 0 and 1 are both named 'reach'"),
    ],
)
def test_a_wrong_edit_ends_in_one_line_and_changes_nothing(
    labelled: Path,
    hashes: Callable[[Path], dict[str, str]],
    monkeypatch: pytest.MonkeyPatch,
    change: tuple[str, str],
    said: str,
) -> None:
    path = labelled / NAMES_FILE
    path.write_text(path.read_text().replace(*change))
    before = hashes(labelled)
    with pytest.raises(SystemExit) as stop:
        run(monkeypatch, f"--root={labelled}")
    assert said in str(stop.value.code) and "\n" not in str(stop.value.code)
    assert hashes(labelled) == before


def test_no_dataset_or_one_that_is_not_segmented(annotated: Path) -> None:
    with pytest.raises(ConfigError, match="Which dataset"):
        name.name_skills(name.NameConfig())
    with pytest.raises(SegmentationError, match="no segmentation record"):
        name.name_skills(name.NameConfig(root=annotated))


def test_subtasks_are_a_truth_to_compare_with(
    annotated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--repo_id=tests/foreign", f"--root={annotated}", f"--work_dir={tmp_path / 'work'}", "--seeds=1"]
    arguments += ["--representation.image_size=16", "--representation.steps=2", "--representation.batch_size=16"]
    arguments += ["--representation.device=cpu", "--methods=[true stages]"]
    monkeypatch.setattr(sys, "argv", ["lerobot-buds-compare", *arguments, "--truth=subtasks"])
    compare.main()
    (oracle,) = read_json(tmp_path / "work/comparison.json")
    assert oracle["precision"]["low"] == 1 and capsys.readouterr().out  # it cuts where people did
    shutil.rmtree(tmp_path / "work")
    monkeypatch.setattr(sys, "argv", ["lerobot-buds-compare", *arguments, "--truth=subtask"])
    with pytest.raises(SystemExit) as stop:
        compare.main()
    assert "no column 'subtask'" in str(stop.value.code) and "Did you mean 'subtasks'" in str(stop.value.code)


def test_videos_are_left_alone(
    make_dataset: Callable[..., Path], hashes: Callable[[Path], dict[str, str]], tmp_path: Path
) -> None:
    source = make_dataset(tmp_path / "video", lengths=(20, 16), video=True)
    record = SegmentationRecord.of_labels(
        [np.repeat([0, 1], [12, 8]), np.repeat([1], 16)], repo_id="tests/foreign", fps=20, horizon=4
    )
    write_segmented_dataset(source, tmp_path / "skills", "tests/skills", record)
    before = {path: digest for path, digest in hashes(tmp_path / "skills").items() if path.startswith("videos")}
    name.name_skills(name.NameConfig(root=tmp_path / "skills"))
    after = {path: digest for path, digest in hashes(tmp_path / "skills").items() if path.startswith("videos")}
    assert before and before == after
    edited = delete_episodes(
        LeRobotDataset("t/s", root=tmp_path / "skills"), [0], tmp_path / "edited", repo_id="t/edited"
    )
    item = LeRobotDataset("t/edited", root=edited.root)[3]
    assert item["observation.images.front"].shape == (3, 32, 32)
    assert [row["content"] for row in item["language_persistent"]] == [names_of(tmp_path / "skills", 2)[1]]
