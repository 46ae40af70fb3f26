import numpy as np
import pytest
import torch
from lerobot.datasets import LeRobotDataset

from lerobot_buds.core import WORKSPACE_CAMERA, CheckpointError, DatasetError, SegmentationError
from lerobot_buds.demos import read_table
from lerobot_buds.policy.labels import LabelTable, history_rows
from lerobot_buds.policy.rollout import Rollout

SHAPE = (3, 32, 32)
HISTORY = 5
GRIPPER = [2, 3]


@pytest.fixture
def table(dataset_root):
    return LabelTable(dataset_root, WORKSPACE_CAMERA, SHAPE, GRIPPER, HISTORY)


def test_goals_are_the_frames_at_min_of_horizon_boundary_and_end(table, dataset_root, labels, horizon):
    dataset = LeRobotDataset("tests/segmented", root=dataset_root)
    start = 0
    for episode in labels:
        last = len(episode) - 1
        for t, label in enumerate(episode):
            later = np.flatnonzero(episode[t:] != label)
            boundary = t + later[0] if len(later) else len(episode)
            goal = start + min(t + horizon, boundary, last)
            found = table.lookup(torch.tensor([start + t]))
            assert found.skill.tolist() == [label]
            torch.testing.assert_close(found.goals[0], dataset[goal][WORKSPACE_CAMERA], rtol=0, atol=0)
        start += len(episode)


def test_offline_history_equals_the_fifo_of_a_rollout(table, dataset_root):
    frames = read_table(dataset_root, ["observation.state"])
    for start, end in zip(frames.starts, frames.ends, strict=True):
        readings = torch.from_numpy(frames.columns["observation.state"][start:end, GRIPPER])
        rollout = Rollout.start(readings[:1], HISTORY, subgoal_dim=1)
        for index, reading in zip(range(start, end), readings, strict=True):
            torch.testing.assert_close(table.lookup(torch.tensor([index])).history, rollout.history)
            rollout.advance(reading[None])


def test_history_is_oldest_first_excludes_now_and_stops_at_the_episode_start():
    rows = history_rows(np.array([10, 12, 30]), np.array([10, 10, 10]), frames=3)
    assert rows.tolist() == [[10, 10, 10], [10, 10, 11], [27, 28, 29]]


def test_no_history(dataset_root):
    table = LabelTable(dataset_root, WORKSPACE_CAMERA, SHAPE, [], HISTORY)
    assert table.lookup(torch.tensor([3, 4])).history.shape == (2, HISTORY, 0)


def test_images_of_another_shape_are_refused(dataset_root):
    with pytest.raises(CheckpointError, match=r"\(3, 32, 32\).*\(3, 64, 64\)"):
        LabelTable(dataset_root, WORKSPACE_CAMERA, (3, 64, 64), GRIPPER, HISTORY)


def test_frames_without_label_or_outside_are_refused(table):
    with pytest.raises(DatasetError, match="frame 30"):
        table.lookup(torch.tensor([0, 30]))
    table.skill = np.where(np.arange(30) == 4, -1, table.skill)
    with pytest.raises(SegmentationError, match="frame 4 "):
        table.lookup(torch.tensor([3, 4]))
    table.present = table.present.copy()
    table.present[29] = False
    with pytest.raises(SegmentationError, match="frame 28 "):
        table.lookup(torch.tensor([28]))
