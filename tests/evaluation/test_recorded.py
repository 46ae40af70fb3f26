"""Frames out of memory are what LeRobot's loader and the policy's preprocessor give."""

from pathlib import Path

import numpy as np
import pytest
import torch
from lerobot.datasets import LeRobotDataset, LeRobotDatasetMetadata
from lerobot.policies import make_policy, make_pre_post_processors

from lerobot_buds.core import ACTION
from lerobot_buds.evaluation.recorded import RecordedFrames
from lerobot_buds.policy import BudsConfig
from lerobot_buds.policy.inputs import read_actions, read_inputs
from lerobot_buds.policy.labels import Labels


@pytest.mark.parametrize(
    "settings",
    [{"chunk_size": 4}, {"image_size": 24, "subgoal_space": "latent"}, {"skills": "flat"}],
    ids=["chunks", "latents", "flat"],
)
def test_batches_are_those_of_lerobot(segmented: Path, small: dict, settings: dict) -> None:
    meta = LeRobotDatasetMetadata("tests/x", root=segmented)
    policy = make_policy(BudsConfig(**small | settings), ds_meta=meta)
    config = policy.config
    deltas = {ACTION: [i / meta.fps for i in range(config.chunk_size)]} if config.chunk_size > 1 else None
    dataset = LeRobotDataset("tests/x", root=segmented, delta_timestamps=deltas)
    frames = RecordedFrames(segmented, policy)
    assert frames.label_table is policy.labels  # latents of all frames are made once
    rows = np.array([0, 1, 50, frames.ends[0] - 2, frames.ends[0] - 1, frames.ends[0], len(dataset) - 1])
    prepare, _ = make_pre_post_processors(config, dataset_stats=meta.stats)
    batch = prepare(torch.utils.data.default_collate([dataset[int(row)] for row in rows]))

    observation = read_inputs(config, batch)
    for name, value in vars(frames.observation(rows)).items():
        assert torch.equal(value, getattr(observation, name)), name
    for name, value in vars(frames.labels(rows)).items():
        assert torch.equal(value, getattr(Labels.of(batch), name)), name
    actions, after_end = frames.actions(rows)
    assert torch.equal(actions, read_actions(config, batch))
    assert torch.equal(after_end, batch.get("action_is_pad", torch.zeros(len(rows), 1, dtype=torch.bool)))
