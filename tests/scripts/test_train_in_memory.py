"""A training on frames in memory leaves a checkpoint that runs, and the figures of what was held out."""

import runpy
from pathlib import Path

import pytest

from lerobot_buds.core import read_json
from lerobot_buds.envs import TASKS
from lerobot_buds.envs.configuration_robosuite import RobosuiteEnvConfig
from lerobot_buds.evaluation.checkpoint import load_checkpoint
from lerobot_buds.policy import BudsConfig

SCRIPT = runpy.run_path(str(Path(__file__).parents[2] / "scripts/train_in_memory.py"))
SMALL = {"encoder": "conv", "norm": "group", "conv_channels": [8, 8], "keypoints": 8, "head_widths": [32]}


@pytest.mark.parametrize("settings", [{"chunk_size": 2, "subgoal_space": "latent"}, {"skills": "flat"}])
def test_a_short_training_is_saved_and_diagnosed(segmented: Path, tmp_path: Path, settings: dict) -> None:
    policy = BudsConfig(device="cpu", **SMALL, **settings)
    SCRIPT["train"](SCRIPT["TrainingConfig"](segmented, tmp_path, policy, steps=3, batch_size=8, held_out=4))
    report = read_json(tmp_path / "training.json")
    assert report["steps"] == 3 and report["held_out"]["errors"]["chosen"] > 0 and report["losses"]["skill_loss"] > 0
    env = RobosuiteEnvConfig(image_size=32, render_profile="fastest")
    task = TASKS["multitask_kitchen/task3_variant1"]
    assert load_checkpoint(str(tmp_path / "pretrained_model"), env, task).policy.config.skills == policy.skills
