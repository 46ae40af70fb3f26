"""However a recording ends: the dataset holds whole episodes, and its record says which they are."""

import shutil
import signal

import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata

from lerobot_buds.cli.collect import CollectConfig, do_again
from lerobot_buds.core import ACTION, STATE, DatasetError, SimulatorError, write_json
from lerobot_buds.data import read_collection
from lerobot_buds.teleoperation.journal import journal_of, restore
from lerobot_buds.teleoperation.keys import press

pytestmark = pytest.mark.slow

TASK = "tool_use/cube_fetched"
LENGTH = 12
SEEDS = [3, 4, 5]


class Unplugged(Exception):
    """What the driver of a device raises whose cable was pulled."""


def unplug():
    raise Unplugged


@pytest.fixture
def interrupted(record, scripted):
    """Records short episodes; something happens in the second one."""

    def interrupted(happens, error=None, at=(1, 5)):
        scripted.before = staticmethod(lambda episode, step: happens() if (episode, step) == at else None)
        options = {"robot.episode_length": LENGTH}
        if error is None:
            return record(TASK, SEEDS, **options)
        with pytest.raises(error):
            record(TASK, SEEDS, **options)
        return None

    return interrupted


def lengths_of(root):
    dataset = LeRobotDataset("tests/recorded", root=root)
    episodes = np.array(dataset.hf_dataset["episode_index"])
    assert len(dataset[len(dataset) - 1]["action"]) == 4
    return np.bincount(episodes).tolist()


@pytest.mark.parametrize(
    ("happens", "error"),
    [
        (lambda: signal.raise_signal(signal.SIGINT), KeyboardInterrupt),
        (lambda: signal.raise_signal(signal.SIGTERM), SystemExit),
        (lambda: signal.raise_signal(signal.SIGHUP), SystemExit),
        (unplug, Unplugged),
    ],
    ids=["ctrl-c", "sigterm", "hangup", "unplugged"],
)
def test_what_interrupts_leaves_whole_episodes(interrupted, tmp_path, happens, error):
    interrupted(happens, error)
    root = tmp_path / "recorded"
    assert lengths_of(root) == [LENGTH]
    (task,) = read_collection(root)["tasks"]
    assert (task["episode_seeds"], task["succeeded"]) == ([3], [False])
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL


def test_escape_keeps_the_part_and_the_record_says_so(interrupted):
    root = interrupted(lambda: press("stop"))
    first, second = lengths_of(root)
    assert first == LENGTH and 5 < second < LENGTH
    (task,) = read_collection(root)["tasks"]
    assert (task["episode_seeds"], task["succeeded"]) == ([3, 4], [False, False])


def test_an_episode_recorded_again_takes_another_seed(interrupted):
    root = interrupted(lambda: press("re-record"))
    assert len(lengths_of(root)) == 3
    (task,) = read_collection(root)["tasks"]
    assert task["episode_seeds"] == [3, 5, 6]


def test_what_a_kill_destroys_is_done_again_from_the_journal(interrupted, tmp_path, run):
    """What lies on the disk amid the third episode is what a kill would leave there."""
    killed = tmp_path / "killed"

    def kill():
        for name in ("recorded", ".recorded.journal"):
            shutil.copytree(tmp_path / name, killed / name)

    root = interrupted(kill, at=(2, 5))
    assert not journal_of(root).exists()  # it has ended well
    with pytest.raises(OSError, match=r"."):
        LeRobotDataset("tests/recorded", root=killed / "recorded")
    journal = journal_of(killed / "recorded")
    config = CollectConfig("tests/again", root=killed / "again", journal=journal, video=False)
    assert do_again(config, journal) == 2
    again, whole = (
        LeRobotDataset("x", root=folder).hf_dataset.with_format("numpy") for folder in (killed / "again", root)
    )
    assert len(again) == 2 * LENGTH
    former = whole.filter(lambda row: row["episode_index"] < 2 and row["frame_index"] < LENGTH)
    for column in (ACTION, STATE, "observation.images.agentview", "episode_index", "timestamp"):
        np.testing.assert_array_equal(np.array(again[column]), np.array(former[column]))
    (task,) = read_collection(killed / "again")["tasks"]
    assert (task["episode_seeds"], task["succeeded"]) == ([3, 4], [False, False])
    with pytest.raises(DatasetError, match="exists already"):
        do_again(config, journal)


def test_a_save_that_is_interrupted_leaves_the_journal(record, tmp_path, monkeypatch, said):
    """Ctrl-C between LeRobot's table of frames and its table of episodes: the two tell of different episodes."""
    save = LeRobotDatasetMetadata.save_episode

    def interrupted(meta, number, *arguments):
        if number == 1:
            raise KeyboardInterrupt
        save(meta, number, *arguments)

    monkeypatch.setattr(LeRobotDatasetMetadata, "save_episode", interrupted)
    with pytest.raises(KeyboardInterrupt):
        record(TASK, SEEDS, **{"robot.episode_length": LENGTH})
    root = tmp_path / "recorded"
    assert any("--journal=" in line for line in said)
    assert len(restore(journal_of(root), "tests/again", tmp_path / "again", video=False).kept) == 1
    assert lengths_of(tmp_path / "again") == [LENGTH]


@pytest.mark.parametrize(
    ("changed", "error", "message"),
    [
        ({"actions": [[0.0, 0.0, 1.0]]}, DatasetError, r"actions of shape \(1, 3\)"),
        ({"actions": []}, DatasetError, r"actions of shape \(0,\)"),
        ({"actions": [[0.0], [0.0, 0.0]]}, DatasetError, "inhomogeneous"),
        ({"seed": None}, DatasetError, "seed None"),
        ({"succeeded": True}, SimulatorError, r"Episode 0 \(seed 3\) came out otherwise"),
    ],
)
def test_a_journal_that_does_not_fit_is_refused(tmp_path, changed, error, message):
    journal, episode = tmp_path / ".x.journal", {"seed": 3, "succeeded": False, "demonstrator": "teleoperated"}
    write_json(journal / "settings.json", {"task": TASK, "image_size": 32, "render_profile": "fastest"})
    write_json(journal / "000000.json", {**episode, "actions": [[0.0] * 4] * 2, **changed})
    with pytest.raises(error, match=message):
        restore(journal, "tests/again", tmp_path / "again", video=False)
    assert not (tmp_path / "again").exists()


def test_a_journal_that_was_left_is_not_mixed_with(interrupted, tmp_path):
    journal = journal_of(tmp_path / "recorded")
    journal.mkdir()
    interrupted(lambda: None, DatasetError)
    with pytest.raises(DatasetError, match="no journal"):
        restore(journal, "tests/again", tmp_path / "again", video=False)
