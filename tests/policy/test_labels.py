import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.datasets import LeRobotDataset

from lerobot_buds.core import WORKSPACE_CAMERA, CheckpointError, DatasetError, SegmentationError
from lerobot_buds.data import read_table
from lerobot_buds.policy.labels import LabelTable, history_rows
from lerobot_buds.policy.rollout import Rollout

HISTORY = 5
GRIPPER = [2, 3]
PERIOD = 5


@pytest.fixture
def table(dataset_root, build):
    return LabelTable(dataset_root, build().config)


def test_goals_are_the_frames_at_min_of_horizon_boundary_and_end(table, dataset_root, labels, horizon):
    dataset = LeRobotDataset("tests/segmented", root=dataset_root)
    table.goals.recognise(torch.tensor([0]), dataset[0][WORKSPACE_CAMERA][None])
    start = 0
    for episode in labels:
        last = len(episode) - 1
        for t, label in enumerate(episode):
            later = np.flatnonzero(episode[t:] != label)
            boundary = t + later[0] if len(later) else len(episode)
            goal = start + min(t + horizon, boundary, last)
            found = table.lookup(torch.tensor([start + t]))
            assert found.skill.tolist() == [label]
            assert found.subgoal.tolist() == [goal]
            image = table.goals.images(found.subgoal.numpy(), torch.device("cpu"))[0]
            torch.testing.assert_close(image, dataset[goal][WORKSPACE_CAMERA], rtol=0, atol=0)
            assert found.ending.tolist() == [boundary - t <= PERIOD]
        start += len(episode)


def test_offline_history_equals_the_fifo_of_a_rollout(table, dataset_root):
    frames = read_table(dataset_root, ["observation.state"])
    for start, end in zip(frames.starts, frames.ends, strict=True):
        readings = torch.from_numpy(frames.columns["observation.state"][start:end, GRIPPER])
        rollout = Rollout.start(readings[:1], HISTORY, subgoal_dim=1, chunk=(1, 4))
        for index, reading in zip(range(start, end), readings, strict=True):
            torch.testing.assert_close(table.lookup(torch.tensor([index])).history, rollout.history)
            rollout.advance(reading[None], torch.zeros(1, 1, 4), rollout.ended, decay=0.0)


def test_history_is_oldest_first_excludes_now_and_stops_at_the_episode_start():
    rows = history_rows(np.array([10, 12, 30]), np.array([10, 10, 10]), frames=3)
    assert rows.tolist() == [[10, 10, 10], [10, 10, 11], [27, 28, 29]]


def test_no_history(dataset_root, build):
    table = LabelTable(dataset_root, build(history_dims=[], current_dims=[0]).config)
    assert table.lookup(torch.tensor([3, 4])).history.shape == (2, HISTORY, 0)


def test_images_of_another_shape_are_refused(dataset_root, build):
    config = build().config
    config.input_features = {**config.input_features, WORKSPACE_CAMERA: PolicyFeature(FeatureType.VISUAL, (3, 64, 64))}
    goals = LabelTable(dataset_root, config).goals
    with pytest.raises(CheckpointError, match="no RGB camera of 64 x 64 pixels"):
        goals.recognise(torch.tensor([0]), torch.zeros(1, 3, 64, 64))


def test_whole_demonstrations_are_one_skill_with_a_subgoal_ahead(dataset_root, build):
    table = LabelTable(dataset_root, build(skills="single", subgoal_horizon_s=0.15).config)
    found = table.lookup(torch.arange(30))
    assert not found.skill.any() and table.weights.tolist() == [1.0]
    expected = [min(t + 3, end - 1) for start, end in ((0, 12), (12, 20), (20, 30)) for t in range(start, end)]
    assert found.subgoal.tolist() == expected


def test_weights_make_skills_count_alike(table):
    frames = np.bincount(table.skill)
    torch.testing.assert_close(table.weights.numpy() * frames, np.full(2, 15.0))


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
