"""``lerobot-buds-segment``: the same bytes twice, the source untouched, one line for what goes wrong."""

import sys
from dataclasses import replace
from pathlib import Path

import draccus
import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset

from lerobot_buds.cli import segment, segmentation_pass
from lerobot_buds.core import (
    ACTION,
    EYE_IN_HAND_CAMERA,
    SEGMENTATION_FILE,
    SKILL_ID,
    STATE,
    SUBGOAL_INDEX,
    TRUE_STAGE,
    WORKSPACE_CAMERA,
    ConfigError,
    read_json,
    sha256_of_file,
    subgoals_of,
)
from lerobot_buds.data import read_table
from lerobot_buds.representation import RepresentationConfig
from lerobot_buds.segmentation import DiscoveryConfig

pytestmark = pytest.mark.slow

FPS = 20
STATE_NAMES = ["joint_1.pos", "gripper_left.pos", "eef_x.pos", "eef_y.pos"]
LENGTHS = ((40, 30), (35, 45))


@pytest.fixture(scope="module")
def source(tmp_path_factory) -> Path:
    """Two demonstrations of two stages that differ in colour and place."""
    root = tmp_path_factory.mktemp("source") / "demos"
    image = {"dtype": "image", "shape": (32, 32, 3), "names": ["height", "width", "channels"]}
    features = {
        WORKSPACE_CAMERA: image,
        EYE_IN_HAND_CAMERA: image,
        STATE: {"dtype": "float32", "shape": (4,), "names": STATE_NAMES},
        ACTION: {"dtype": "float32", "shape": (2,), "names": ["x", "y"]},
        TRUE_STAGE: {"dtype": "int64", "shape": (1,), "names": None},
    }
    dataset = LeRobotDataset.create("tests/plain", FPS, features, root=root, use_videos=False)
    rng = np.random.default_rng(0)
    for lengths in LENGTHS:
        for stage in np.repeat([0, 1], lengths):
            colour = np.array([[200, 40, 40], [40, 40, 200]])[stage]
            frame = {
                camera: np.clip(rng.normal(colour, 12, (32, 32, 3)), 0, 255).astype(np.uint8)
                for camera in (WORKSPACE_CAMERA, EYE_IN_HAND_CAMERA)
            }
            frame[STATE] = rng.normal(stage, 0.05, 4).astype(np.float32)
            frame[ACTION] = rng.normal(size=2).astype(np.float32)
            dataset.add_frame({**frame, TRUE_STAGE: np.array([stage]), "task": "sort the colours"})
        dataset.save_episode()
    dataset.finalize()
    return root


def settings(source: Path, folder: Path) -> segment.SegmentConfig:
    return segment.SegmentConfig(
        repo_id="tests/plain",
        root=str(source),
        output_root=str(folder / "skills"),
        work_dir=str(folder / "work"),
        subgoal_horizon_s=0.5,
        representation=RepresentationConfig(image_size=32, latent_dim=8, steps=6, batch_size=16, device="cpu"),
        discovery=DiscoveryConfig(window_s=0.25, max_skills=3, min_skill_s=0.5),
    )


def files(root: Path) -> dict[str, str]:
    return {str(p.relative_to(root)): sha256_of_file(p) for p in sorted(root.rglob("*")) if p.is_file()}


@pytest.fixture(scope="module")
def passes(source, tmp_path_factory):
    """Two complete passes with the same seeds, and the source's files before and after."""
    before = files(source)
    folders = [tmp_path_factory.mktemp(name) for name in ("first", "second")]
    records = [segment.segment(settings(source, folder)) for folder in folders]
    return folders, records, before, files(source)


def test_the_same_seeds_give_the_same_bytes(passes):
    folders, records, *_ = passes
    first, second = (files(folder / "skills") for folder in folders)
    assert first == second and SEGMENTATION_FILE in first
    assert records[0] == records[1]
    timelines = [sha256_of_file(folder / "work/timeline.png") for folder in folders]
    assert timelines[0] == timelines[1]


def test_the_source_is_untouched(passes):
    _, _, before, after = passes
    assert before == after


def test_the_copy_is_labelled_and_otherwise_the_same(source, passes):
    folders, (record, _), *_ = passes
    copy = folders[0] / "skills"
    labelled = read_table(copy, [SKILL_ID, SUBGOAL_INDEX, STATE, TRUE_STAGE])
    plain = read_table(source, [STATE, TRUE_STAGE])
    for name in (STATE, TRUE_STAGE):
        np.testing.assert_array_equal(labelled.columns[name], plain.columns[name])
    skills, subgoals = labelled.columns[SKILL_ID], labelled.columns[SUBGOAL_INDEX]
    assert set(skills) == set(range(record.n_skills)) and 2 <= record.n_skills <= 3
    for start, end in zip(plain.starts, plain.ends, strict=True):
        # Ten frames are half a second; the rule itself is tested with the segments.
        np.testing.assert_array_equal(subgoals[start:end], start + subgoals_of(skills[start:end], 10))
    dataset = LeRobotDataset("tests/plain_skills", root=copy)
    assert dataset[3][SKILL_ID].item() == skills[3] and dataset.meta.total_episodes == 2
    assert read_json(copy / SEGMENTATION_FILE)["agreement"]["nmi"] >= 0


def test_a_finished_pass_is_not_repeated_over_its_output(source, passes):
    folders, *_ = passes
    before = files(folders[0])
    with pytest.raises(ConfigError, match="subgoal_horizon_s=0"):
        segment.segment(segment.SegmentConfig("tests/plain", root=str(source), subgoal_horizon_s=0))
    assert files(folders[0]) == before


def test_a_finished_representation_is_used_as_it_is(source, passes, tmp_path, monkeypatch):
    folders, (record, _), *_ = passes
    monkeypatch.setattr(segmentation_pass, "train_representation", None)
    config = replace(
        settings(source, tmp_path),
        representation=RepresentationConfig(),
        representation_path=str(folders[0] / "work/representation"),
    )
    assert segment.segment(config) == record
    assert files(tmp_path / "skills") == files(folders[0] / "skills")


def test_of_several_processes_the_first_alone_goes_on_after_training(source, passes, tmp_path, monkeypatch):
    folders, *_ = passes
    config = replace(settings(source, tmp_path), work_dir=str(folders[0] / "work"))
    monkeypatch.setattr(segmentation_pass, "is_main_process", lambda _: False)
    assert segment.segment(config) is None and not (tmp_path / "skills").exists()


def test_arguments_become_settings():
    config = draccus.parse(
        segment.SegmentConfig,
        args=["--repo_id=me/demos", "--discovery.max_skills=3", "--representation.steps=5", "--subgoal_horizon_s=1"],
    )
    assert config.discovery == DiscoveryConfig(max_skills=3)
    assert config.representation == RepresentationConfig(steps=5)
    assert (config.repo_id, config.subgoal_horizon_s) == ("me/demos", 1.0)


def test_the_command_tells_what_it_found(source, tmp_path, monkeypatch, capsys):
    arguments = [
        "--repo_id=tests/plain",
        f"--root={source}",
        f"--output_root={tmp_path / 'skills'}",
        f"--work_dir={tmp_path / 'work'}",
        *("--representation.image_size=32", "--representation.steps=2", "--representation.device=cpu"),
        *("--discovery.n_skills=1", "--discovery.window_s=0.25"),
    ]
    monkeypatch.setattr(sys, "argv", ["lerobot-buds-segment", *arguments])
    segment.main()
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "1 skills in 2 demonstrations"
    assert lines[1].startswith("  skill 0: 2 segments of")
    assert "boundary F1" in lines[-1]


def test_a_representation_that_cannot_be_had_ends_in_one_line(source, tmp_path, monkeypatch):
    arguments = ["--repo_id=tests/plain", f"--root={source}", "--representation_path=me/absent"]
    monkeypatch.setattr(sys, "argv", ["lerobot-buds-segment", *arguments, f"--output_root={tmp_path / 'skills'}"])
    with pytest.raises(SystemExit, match="error: 'me/absent' is not on this machine and the Hub cannot be reached"):
        segment.main()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--root=/no/such/folder"], "/no/such/folder"),
        (["--representation.image_size=8"], "image_size=8"),
        (["--discovery.max_skills=several"], "several"),
        (["--representation.cameras=[observation.images.agentveiw]"], "observation.images.agentview"),
        (["--discovery.n_skills=900"], "Lower n_skills"),
        (["--representation_path=me/absent"], "leave out either it or them"),
    ],
)
def test_what_cannot_work_ends_in_one_line(source, tmp_path, arguments, said, monkeypatch):
    usual = [
        "--repo_id=tests/plain",
        f"--root={source}",
        f"--output_root={tmp_path / 'skills'}",
        f"--work_dir={tmp_path / 'work'}",
        *("--representation.image_size=32", "--representation.steps=1"),
    ]
    monkeypatch.setattr(sys, "argv", ["lerobot-buds-segment", *usual, *arguments])
    with pytest.raises(SystemExit) as stop:
        segment.main()
    message = stop.value.code
    assert isinstance(message, str)  # Python prints it and exits with status 1
    assert message.startswith("error: ") and said in message and "Traceback" not in message
    assert not (tmp_path / "skills").exists()
