"""However a recording ends: the dataset holds whole episodes, and its record says which they are."""

import signal

import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset

from lerobot_buds.data import read_collection
from lerobot_buds.teleoperation.keys import press

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
