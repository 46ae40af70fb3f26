"""What the robot is told of the dataset must be true, and a recording goes on where it ended."""

import math
import shutil

import pytest
from lerobot.datasets import LeRobotDataset
from lerobot.robots import make_robot_from_config

from lerobot_buds.core import DatasetError
from lerobot_buds.data import read_collection
from lerobot_buds.envs import EnvSettings
from lerobot_buds.teleoperation.config_robosuite_sim import RobosuiteSimConfig
from lerobot_buds.teleoperation.keys import press
from lerobot_buds.teleoperation.pace import Pace
from lerobot_buds.teleoperation.session import Episode, Session

TASK = "tool_use/cube_fetched"
SETTINGS = EnvSettings(TASK, image_size=32, render_profile="fastest")
SHORT = {"robot.episode_length": 8}


@pytest.fixture
def resumed(record, monkeypatch):
    """Goes on with a recording; LeRobot compares the robot with it by a package that this environment does not have."""
    monkeypatch.setattr("lerobot.scripts.lerobot_record.sanity_check_dataset_robot_compatibility", lambda *_: None)
    return lambda *arguments, **options: record(*arguments, **options, resume="true")


def test_a_recording_goes_on_with_seeds_that_were_not_used(record, resumed):
    root = record(TASK, [3, 4], **SHORT)
    resumed(TASK, [3], **SHORT)
    assert LeRobotDataset("tests/recorded", root=root).num_episodes == 3
    (task,) = read_collection(root)["tasks"]
    assert task["episode_seeds"] == [3, 4, 5] and task["demonstrators"] == ["teleoperated"] * 3

    replays = {"task": TASK, "image_size": 32, "render_profile": "fastest", "dataset_root": str(root), "seed": 1}
    robot = make_robot_from_config(RobosuiteSimConfig(**replays))
    robot.connect()
    assert robot.facts()["seed"] == 1  # a replay has the seed that it was given
    robot.disconnect()

    with pytest.raises(DatasetError, match=r"was recorded with.*'fastest'.*not with.*'fast'"):
        resumed(TASK, [3], **SHORT, **{"robot.render_profile": "fast"})
    assert read_collection(root)["render_profile"] == "fastest"
    assert LeRobotDataset("tests/recorded", root=root).num_episodes == 3


def test_episodes_without_the_record_count_as_unknown(record, resumed, said):
    root = record(TASK, [3], **SHORT, **{"robot.dataset_root": "null"})
    assert read_collection(root) == {}
    resumed(TASK, [3], **SHORT)
    (task,) = read_collection(root)["tasks"]
    assert (task["episode_seeds"], task["succeeded"]) == ([None, 3], [None, False])
    assert any("seeds and success of some are not known" in line for line in said)


def test_words_of_ones_own_for_the_task_are_warned_of_once(record, said, tmp_path, monkeypatch):
    """The folder is told in another way than LeRobot is told it, too."""
    monkeypatch.chdir(tmp_path)
    record(TASK, [3, 4], "Fetch it", **SHORT, **{"robot.dataset_root": "./x/../recorded/"})
    (line,) = [line for line in said if "--dataset.single_task='put the cube into the pot'" in line]
    assert line.startswith("The task is called 'Fetch it' here")
    assert read_collection(tmp_path / "recorded")["tasks"][0]["episode_seeds"] == [3, 4]
    said.clear()
    shutil.rmtree(tmp_path / "recorded")
    record(TASK, [3], "put the cube into the pot", **SHORT)
    assert not any("single_task" in line for line in said)


def test_an_episode_that_its_user_ends_is_told_of(record, scripted, said):
    scripted.before = staticmethod(lambda episode, step: press("next") if (episode, step) == (0, 3) else None)
    record(TASK, [3, 4], **SHORT)
    assert [line.partition(" steps")[0] for line in said if line.startswith("Seed")] == [
        "Seed 3: no success after 4",
        "Seed 4: no success after 8",
    ]


def test_another_rate_is_refused_before_anything_is_recorded(record, tmp_path):
    with pytest.raises(
        DatasetError, match=r"has 30 frames per second, the simulation 20: record with --dataset.fps=20"
    ):
        record(TASK, [3], **SHORT, **{"dataset.fps": 30})


def test_another_dataset_is_refused(demonstrations, tmp_path):
    with pytest.raises(DatasetError, match="There is no dataset in"):
        Session(tmp_path, SETTINGS).start(0, 20)
    with pytest.raises(DatasetError, match=r"is not recorded into: give --robot.dataset_root as --dataset.root"):
        Session(demonstrations, SETTINGS).start(0, 20)
    with pytest.raises(DatasetError, match=r"Give the same settings, or record into another dataset"):
        Session.begin(demonstrations, SETTINGS)  # scripted, and another task


def test_nothing_is_written_where_the_robot_was_not_told_and_that_is_said(caplog):
    session = Session.begin(None, SETTINGS)
    session.start(0, 20)
    session.start(1, 20)
    assert [record.message for record in caplog.records if "--robot.dataset_root" in record.message] != []
    assert len(caplog.records) == 1
    session.ended(Episode(0, True, "teleoperated"))
    assert session.settle() is None and session.next_seed == 0


def test_the_pace_leaves_out_what_lies_between_episodes(monkeypatch):
    times = iter([0.0, 0.05, 0.1, 9.0, 9.05])
    monkeypatch.setattr("time.perf_counter", lambda: next(times))
    pace = Pace()
    for between in (False, False, False, True, False):
        if between:
            pace.pause()
        pace.tick()
    assert pace.periods == pytest.approx([0.05, 0.05, 0.05])
    assert pace.describe() == "period of the loop: median 50.0 ms, 99th percentile 50.0 ms"
    assert not pace.differs_from(30)  # three periods say nothing
    assert Pace([1 / 30] * 30).differs_from(20) and not Pace([1 / 20.5] * 30).differs_from(20)
    assert math.isnan(Pace().quantiles()[0])
