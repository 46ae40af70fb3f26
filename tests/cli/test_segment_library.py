"""Skills of one dataset, used again: by ``--library``, with ``--grow``, and from Python."""

import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset

from lerobot_buds.cli import segment as command
from lerobot_buds.cli.segment import segment
from lerobot_buds.core import EXEMPLARS_FILE, SEGMENTATION_FILE, CheckpointError, ConfigError, SegmentationError
from lerobot_buds.segmentation import SegmentationRecord, SkillModel, discover_skills, load_labels, read_library

pytestmark = pytest.mark.slow

SMALL = {"representation": {"steps": 60}, "discovery": {"max_skills": 2}}


@pytest.fixture(scope="module")
def source(make_dataset: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_dataset(tmp_path_factory.mktemp("library") / "source", lengths=(40, 36, 44))


@pytest.fixture(scope="module")
def library(source: Path, settings: Callable, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The source with its skills."""
    folder = tmp_path_factory.mktemp("first")
    segment(settings(source, folder, **SMALL))
    return folder / "skills"


def pass_with(source: Path, folder: Path, settings: Callable, **changes: object) -> command.SegmentConfig:
    plain = command.SegmentConfig("tests/foreign")
    own = settings(source, folder)
    return replace(own, representation=plain.representation, discovery=plain.discovery, **changes)


def test_a_dataset_carries_what_it_takes_to_label_others(
    source: Path, library: Path, settings: Callable, tmp_path: Path
) -> None:
    # Nothing but these files is needed, and the demonstrations they were made from least of all.
    shutil.copytree(library / "meta/buds", tmp_path / "alone/meta/buds")
    record = segment(pass_with(source, tmp_path, settings, library=str(tmp_path / "alone")))
    assert record is not None and record.library is not None
    before = SegmentationRecord.read(library)
    assert record.library == {"name": str(tmp_path / "alone"), "grown": False, "lineage": [before.labels_hash]}
    assert record.lineage == (record.labels_hash, before.labels_hash)
    assert [e.tolist() for e in record.labels] == [e.tolist() for e in before.labels]
    assert (record.n_skills, record.parameters) == (before.n_skills, before.parameters)
    extended = read_library(tmp_path / "skills")
    assert len(extended.skills) == 2 * len(read_library(library).skills)
    assert len(np.unique(extended.episodes)) == 6


def test_growing_keeps_old_numbers_and_adds_new_ones(
    library: Path, settings: Callable, make_dataset: Callable[..., Path], tmp_path: Path
) -> None:
    plain = make_dataset(tmp_path / "plain", lengths=(40, 40))
    strange = make_dataset(tmp_path / "strange", lengths=(40, 40), offset=4.0)
    known = SegmentationRecord.read(library).n_skills
    records = [
        segment(pass_with(root, tmp_path / f"of_{root.name}", settings, library=str(library), grow=True))
        for root in (plain, strange)
    ]
    assert records[0] is not None and records[0].n_skills == known
    assert records[1] is not None and records[1].n_skills > known
    assert min(min(e) for e in records[1].labels) >= known
    stored, skill_id, _ = load_labels(tmp_path / "of_strange/skills")
    assert stored.n_skills == records[1].n_skills == skill_id.max() + 1


def test_three_lines_of_python_find_the_same(source: Path, library: Path, settings: Callable, tmp_path: Path) -> None:
    config = settings(source, tmp_path, **SMALL)
    dataset = LeRobotDataset("tests/foreign", root=source)
    skills = discover_skills(dataset, config.representation, config.discovery, tmp_path)
    assert [e.tolist() for e in skills.labels] == [e.tolist() for e in SegmentationRecord.read(library).labels]
    assert skills.n_skills == SegmentationRecord.read(library).n_skills
    assert [len(h) for h in skills.latents] == [40, 36, 44]
    again = SkillModel.from_pretrained(library).label(dataset)
    assert [e.tolist() for e in again.labels] == [e.tolist() for e in skills.labels]


def test_the_number_of_skills_is_chosen_and_said(source: Path, settings: Callable, tmp_path: Path) -> None:
    record = segment(settings(source, tmp_path, discovery={"n_skills": "auto", "max_skills": 4}))
    assert record is not None and record.silhouettes is not None
    assert set(record.silhouettes) <= {"2", "3", "4"} and SegmentationRecord.read(tmp_path / "skills") == record
    assert (tmp_path / "work/n_skills.png").stat().st_size > 1000


@pytest.mark.parametrize("missing", [EXEMPLARS_FILE, SEGMENTATION_FILE, "meta/buds/representation/representation.json"])
def test_a_library_without_a_part_is_refused(library: Path, tmp_path: Path, missing: str) -> None:
    shutil.copytree(library / "meta/buds", tmp_path / "meta/buds")
    (tmp_path / missing).unlink()
    with pytest.raises((SegmentationError, CheckpointError), match=Path(missing).name.partition(".")[0]):
        SkillModel.from_pretrained(tmp_path)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--grow=true"], "there is no library"),
        (["--library=LIBRARY", "--discovery.max_skills=3"], "['discovery']"),
        (["--library=LIBRARY", "--representation.steps=3"], "['representation']"),
        (["--preset=papers"], "Did you mean 'paper'"),
    ],
)
def test_what_cannot_work_ends_in_one_line(
    source: Path, library: Path, tmp_path: Path, arguments: list[str], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    places = [f"--root={source}", f"--output_root={tmp_path / 'skills'}", f"--work_dir={tmp_path / 'work'}"]
    given = [argument.replace("LIBRARY", str(library)) for argument in arguments]
    monkeypatch.setattr(sys, "argv", ["lerobot-buds-segment", "--repo_id=tests/foreign", *places, *given])
    with pytest.raises(SystemExit) as stop:
        command.main()
    assert said in str(stop.value.code) and not (tmp_path / "work").exists()


def test_a_dataset_of_other_cameras_is_refused(
    library: Path, settings: Callable, make_dataset: Callable[..., Path], tmp_path: Path
) -> None:
    other = make_dataset(tmp_path / "other", cameras={"observation.images.front": (24, 24, 3)})
    with pytest.raises(CheckpointError, match="32 x 32 pixels, but"):
        segment(pass_with(other, tmp_path / "out", settings, library=str(library)))
    with pytest.raises(ConfigError, match="must be at least 1"):
        segment(settings(other, tmp_path / "out", discovery={"max_skills": 0}))


def test_skills_of_another_rate_are_refused(
    make_dataset: Callable, library: Path, settings: Callable, tmp_path: Path
) -> None:
    other = make_dataset(tmp_path / "other", lengths=(40, 36), fps=12.5)
    with pytest.raises(SegmentationError, match=r"found at \d+ frames a second, .*other has 12\.5"):
        segment(pass_with(other, tmp_path, settings, library=str(library)))
    assert not (tmp_path / "skills").exists()
