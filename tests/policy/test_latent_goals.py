"""Subgoals that are latents of the goal frames, in the representation that the skills were found with."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from lerobot.datasets import LeRobotDatasetMetadata
from lerobot.policies import make_policy

from lerobot_buds.core import CheckpointError, SegmentationError
from lerobot_buds.policy import BudsConfig
from lerobot_buds.policy.labels import Labels, LabelTable
from lerobot_buds.policy.model import LatentGoals
from lerobot_buds.policy.modeling_buds import BudsPolicy
from lerobot_buds.representation import encode_dataset
from lerobot_buds.segmentation import SkillModel, load_labels


@pytest.fixture
def latents(dataset_root):
    """Those of all frames, ``(N, d)``."""
    return np.concatenate(encode_dataset(dataset_root, SkillModel.from_pretrained(dataset_root).representation))


@pytest.fixture
def copy(dataset_root, tmp_path):
    """The dataset, to be changed, and policies for it."""
    root = shutil.copytree(dataset_root, tmp_path / "copy")

    def build(small):
        meta = LeRobotDatasetMetadata("tests/segmented", root=root)
        return make_policy(BudsConfig(**{**small, "subgoal_space": "latent"}), ds_meta=meta)

    return root, build


def test_goals_are_the_latents_of_the_goal_frames(build, batch_of, dataset_root, latents):
    config = build(subgoal_space="latent").config
    assert config.subgoal_dim == latents.shape[1] == 3 + 5  # of the images, and the state beside them
    _, _, goals = load_labels(dataset_root)
    np.testing.assert_array_equal(Labels.of(batch_of(*range(30))).goal, latents[goals].astype(np.float32))
    assert config.representation == SkillModel.from_pretrained(dataset_root).representation.hash


def test_subgoals_are_standardised_latents_and_the_same_for_all_skills(build, latents):
    model = build(subgoal_space="latent").model
    everything = torch.from_numpy(latents.astype(np.float32))
    subgoal, target = model.encode_goals(torch.zeros(30, dtype=torch.int64), everything)
    assert torch.equal(subgoal, target)
    torch.testing.assert_close(subgoal.mean(dim=0), torch.zeros(8), rtol=0, atol=1e-4)
    torch.testing.assert_close(subgoal.std(dim=0, correction=0), torch.ones(8), rtol=0, atol=1e-3)
    assert torch.equal(model.encode_goals(torch.ones(30, dtype=torch.int64), everything)[0], subgoal)
    assert not any("subgoal_encoder" in name or "goal_trunk" in name for name, _ in model.named_parameters())


def test_constant_dimensions_are_centred_only_and_absent_frames_left_out():
    goals = LatentGoals(2)
    goals.fit(torch.tensor([[1.0, 7.0], [3.0, 7.0], [torch.nan, torch.nan]]))
    assert goals(torch.tensor([[3.0, 7.0], [1.0, 8.0]])).tolist() == [[1.0, 0.0], [-1.0, 1.0]]


def test_the_scaling_is_kept_with_the_weights(build, tmp_path):
    policy = build(subgoal_space="latent")
    policy.save_pretrained(tmp_path)
    again = BudsPolicy.from_pretrained(tmp_path)
    assert torch.equal(again.model.goals.mean, policy.model.goals.mean) and again.model.goals.mean.any()
    assert torch.equal(again.model.goals.std, policy.model.goals.std)


def test_another_representation_is_refused(build, copy, small, save_representation, tmp_path):
    root, build_for = copy
    with pytest.raises(CheckpointError, match=r"representation='other'"):
        build(subgoal_space="latent", representation="other")
    build(subgoal_space="latent").save_pretrained(tmp_path / "policy")
    known = LeRobotDatasetMetadata("tests/segmented", root=root)
    BudsPolicy.from_pretrained(tmp_path / "policy", dataset_meta=known)
    other = save_representation(root, seed=1)
    with pytest.raises(CheckpointError, match=f"representation=.*has '{other.hash}'"):
        BudsPolicy.from_pretrained(tmp_path / "policy", dataset_meta=known)
    assert build_for(small).config.representation == other.hash  # nothing against a new policy


def test_a_dataset_without_representation_is_refused(copy, small):
    root, build_for = copy
    shutil.rmtree(root / "meta/buds/representation")
    with pytest.raises(SegmentationError, match=r"holds no representation.*subgoal_space=image"):
        build_for(small)


def test_episodes_that_are_not_here_have_no_latents(build, dataset_root, monkeypatch, latents):
    """Frames of them are NaN, and all others what they are."""
    table = LabelTable(Path(dataset_root), build(subgoal_space="latent").config)
    table._present = np.arange(30) >= 12  # the first episode is missing
    assert np.isnan(table.latents[:12]).all()
    np.testing.assert_allclose(table.latents[12:], latents[12:], rtol=1e-4, atol=1e-5)
