"""What LeRobots after 0.6.1 ask of a policy, and datasets with LeRobot's language annotations."""

import shutil
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from lerobot.datasets import LeRobotDatasetMetadata
from lerobot.scripts import lerobot_train

from lerobot_buds.policy import BudsConfig
from lerobot_buds.policy.modeling_buds import BudsPolicy
from lerobot_buds.segmentation import write_subtasks


def test_a_policy_whose_weights_come_later(
    build: Callable[..., BudsPolicy], meta: LeRobotDatasetMetadata, tmp_path: Path
) -> None:
    """`make_policy(defer_weight_load=True)` constructs what `from_pretrained` would, without the library of skills."""
    build().save_pretrained(tmp_path / "library")
    build(skills_path=str(tmp_path / "library")).save_pretrained(tmp_path / "policy")
    shutil.rmtree(tmp_path / "library")
    config = BudsConfig.from_pretrained(tmp_path / "policy")
    config.pretrained_path = tmp_path / "policy"
    deferred = BudsPolicy(config=config, dataset_stats=meta.stats, dataset_meta=meta).eval()
    loaded = BudsPolicy.from_pretrained(tmp_path / "policy", dataset_stats=meta.stats, dataset_meta=meta)
    assert {name: p.requires_grad for name, p in deferred.named_parameters()} == {
        name: p.requires_grad for name, p in loaded.named_parameters()
    }
    deferred.load_state_dict(loaded.state_dict())
    assert deferred.config == config and not deferred.training


@pytest.mark.parametrize("chunks", [1, 4])
def test_dropped_plans_are_made_anew_and_nothing_is_forgotten(
    build: Callable[..., BudsPolicy], batch_of: Callable[..., dict], monkeypatch: pytest.MonkeyPatch, chunks: int
) -> None:
    """After a change of the task LeRobot calls `drop_queued_actions`; it must hold at the next step."""
    policy = build(chunk_size=chunks, n_action_steps=chunks)
    observation = {k: v for k, v in batch_of(0, 12).items() if k.startswith("observation") or k == "task"}
    policy.drop_queued_actions()  # before the first step there is nothing to drop
    decisions: list[int] = []
    propose = policy.model.meta_controllers.propose
    monkeypatch.setattr(policy.model.meta_controllers, "propose", lambda *a: decisions.append(step) or propose(*a))
    for step in range(4):
        if step == 2:
            rollout = policy._rollouts[threading.get_ident()]
            before = {name: value.clone() for name, value in vars(rollout).items()}
            policy.drop_queued_actions()
            changed = {name for name, value in vars(rollout).items() if not torch.equal(value, before[name])}
            assert changed <= {"steps_left", "planned"}
        policy.select_action(observation)
    assert decisions == [0, 0, 2, 2]  # two environments


def test_a_dataset_with_subtasks_trains(
    meta: LeRobotDatasetMetadata, tmp_path: Path, run_script: Callable, command: Callable
) -> None:
    root = Path(shutil.copytree(meta.root, tmp_path / "named"))
    write_subtasks(root, ("reach", "pull"))
    losses = []
    for folder, where in ((root, "named"), (Path(meta.root), "plain")):
        arguments = command(folder, output_dir=tmp_path / f"out_{where}", steps=2, batch_size=4, save_freq=2)
        run_script(lerobot_train.main, *arguments)
        weights = tmp_path / f"out_{where}/checkpoints/last/pretrained_model/model.safetensors"
        losses.append(weights.read_bytes())
    assert losses[0] == losses[1]  # they change nothing of what is learnt
