"""Pauses: found by the state alone, and weighed in all losses alike."""

import numpy as np
import pytest
import torch

from lerobot_buds.core import ACTION, STATE, ConfigError
from lerobot_buds.data import FrameTable
from lerobot_buds.policy.inputs import read_actions, read_inputs
from lerobot_buds.policy.labels import Labels, LabelTable
from lerobot_buds.policy.pauses import is_pause


def moving(steps: list[float], scale: float = 1.0) -> np.ndarray:
    """A state whose first dimension takes these steps; the second hardly ever moves."""
    position = np.concatenate([[0.0], np.cumsum(steps)])
    return scale * np.stack([position, np.zeros_like(position)], axis=1)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 180.0])
def test_frames_from_which_nothing_moves_are_pauses_in_any_unit(scale):
    state = moving([1.0] * 20 + [0.01] * 15 + [1.0] * 20, scale)
    found = is_pause(state, np.array([0]), np.array([56]), 5)
    # The last frame from which no step of 1 lies within five frames is 30.
    assert found.nonzero()[0].tolist() == list(range(20, 31))


def test_a_gripper_that_closes_is_no_pause():
    arm = moving([1.0] * 200 + [0.0] * 20 + [1.0] * 200)
    arm[208:, 1] = 1.0  # in one frame of the pause, and never else
    found = is_pause(arm, np.array([0]), np.array([421]), 5)
    assert found.nonzero()[0].tolist() == [200, 201, 202, *range(208, 216)]


def test_episodes_end_where_they_end():
    state = np.concatenate([moving([1.0] * 9), moving([1.0] * 9)])
    state[10:] += 100  # a jump between episodes is no movement
    assert not is_pause(state, np.array([0, 10]), np.array([10, 20]), 5).any()
    still = np.zeros((10, 2))
    assert is_pause(still, np.array([0]), np.array([10]), 5).tolist() == [False] * 10
    assert not is_pause(still[:3], np.array([0]), np.array([3]), 5).any()  # shorter than a pause


def test_pauses_weigh_less_in_all_losses(dataset_root, build, batch_of, monkeypatch):
    pauses = np.zeros(30, dtype=bool)
    pauses[[2, 3, 14]] = True
    monkeypatch.setattr("lerobot_buds.policy.labels.is_pause", lambda *_: pauses)
    losses = {}
    for weight in (1.0, 0.25, 0.0):
        policy = build(pause_weight=weight).eval()
        losses[weight] = policy(batch_of(*range(30)), reduction="none")[0].detach()
    plain = losses[1.0]
    for weight, loss in losses.items():
        assert torch.allclose(loss, plain * torch.from_numpy(np.where(pauses, weight, 1.0)).float())
    policy = build(pause_weight=0.0).eval()
    data = batch_of(*range(30))
    labels = Labels.of(data)
    terms = policy.model(read_inputs(policy.config, data), labels, read_actions(policy.config, data), None)
    assert terms["skill_loss"].count_nonzero() == 30  # what is shown stays what it is
    assert policy.model.loss(terms, labels).mean() == losses[0.0].mean()


def test_what_is_a_pause_is_said(dataset_root, build, caplog):
    with caplog.at_level("INFO"):
        table = LabelTable(dataset_root, build(pause_weight=0.5).config)
    assert "of the frames are pauses and weigh 0.5" in caplog.text
    assert set(np.unique(table._frame_weight)) <= {0.5, 1.0}
    with pytest.raises(ConfigError, match="without proprioception nothing tells a pause"):
        build(pause_weight=0.5, current_state=[], history_state=[])
    with pytest.raises(ConfigError, match="pause_weight=-1"):
        build(pause_weight=-1)


@pytest.mark.parametrize("dtype", ["float32", "int64", "uint8"])
def test_episodes_that_are_not_here_say_nothing_of_pauses(build, monkeypatch, caplog, dtype):
    """Integers have no NaN: what is missing stands still in -1 or 0, for ever."""
    config = build(skills="flat", pause_weight=0.0).config
    moves = np.concatenate([moving([1.0] * 20 + [0.0] * 10 + [1.0] * 9 + [9.0]), np.zeros((600, 2))])
    state = np.repeat(moves[:, :1], config.state_size, axis=1).astype(dtype)
    state[41:] = {"f": np.nan, "i": -1, "u": 0}[state.dtype.kind]
    starts, ends, here = np.array([0, 41]), np.array([41, 641]), np.arange(641) < 41
    columns = {STATE: state, ACTION: np.zeros((641, 4), dtype=np.float32)}
    table = FrameTable("nowhere", 20.0, np.array([0, 1]), starts, ends, columns, here)
    monkeypatch.setattr("lerobot_buds.policy.labels.read_table", lambda *_: table)
    with caplog.at_level("INFO"):
        weights = LabelTable("nowhere", config)._frame_weight
    assert (weights == 0).nonzero()[0].tolist() == list(range(20, 26))
    assert "14.6 % of the frames are pauses" in caplog.text  # 6 of 41
