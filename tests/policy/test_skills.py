"""What a skill is made of: residual heads, tasks that a flat policy is told, frames beside its segments."""

import pytest
import torch

from lerobot_buds.core import ConfigError
from lerobot_buds.policy.labels import Labels
from lerobot_buds.policy.model import BESIDE_SHARE, spread_within


def encoded(library, rows=4):
    maps = library.encode_images(torch.rand(rows, 6, 32, 32))
    return maps, torch.randn(rows, library.subgoal_dim), torch.randn(rows, 12)


@pytest.mark.parametrize("shared", [False, True])
def test_residual_skills_begin_as_the_flat_head(build, shared):
    library = build(heads="residual", shared_trunk=shared).model.skills.eval()
    maps, subgoal, proprio = encoded(library)
    outputs = library(torch.tensor([0, 1, 0, 1]), maps, subgoal, proprio)
    base = library.base(maps, subgoal[:, :0], proprio)
    assert torch.equal(outputs, base) and base.any() and base.shape == (4, 1, 4)


def test_residual_skills_become_different_with_training(build, batch_of):
    policy = build(heads="residual", optimizer_lr=1e-2).train()
    optimizer = policy.config.get_optimizer_preset().build(policy.get_optim_params())
    for _ in range(3):
        loss, _ = policy(batch_of(*range(30)))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    library = policy.model.skills.eval()
    maps, subgoal, proprio = encoded(library)
    zeros, ones = (library(torch.full((4,), k), maps, subgoal, proprio) for k in (0, 1))
    assert not torch.allclose(zeros, ones)
    assert not torch.allclose(ones, library(torch.ones(4, dtype=torch.int64), maps, subgoal + 1, proprio))


def test_a_flat_policy_of_several_tasks_is_told_the_task(build, batch_of):
    tasks = ["Close the drawer", "Boil the pot"]
    policy, alone = build(skills="flat", tasks=tasks), build(skills="flat")
    widths = [p.model.skills.skills[0].head[0].in_features for p in (policy, alone)]
    assert widths[0] == widths[1] + 2 and alone.config.task_count == 0
    observation = {k: v for k, v in batch_of(0, 0).items() if k.startswith("observation")}
    actions = policy.select_action({**observation, "task": tasks})
    assert not torch.allclose(actions[0], actions[1])
    with pytest.raises(ConfigError, match="''"):
        policy.select_action({**observation, "task": ""})


def test_skills_are_not_told_the_task_where_a_meta_controller_is(build):
    widths = {build(tasks=t).model.skills.skills[0].head[0].in_features for t in ([], ["Close the drawer", "Boil"])}
    assert len(widths) == 1


def many(labels, rows):
    return Labels(**{name: value[:1].expand(rows, *value.shape[1:]) for name, value in vars(labels).items()})


@pytest.mark.parametrize("space", ["image", "latent"])
def test_frames_beside_an_edge_are_shared_out_in_training(build, batch_of, space):
    """Skill and goal go together."""
    model = build(boundary_overlap_s=0.1, subgoal_space=space).model
    labels = many(Labels.of(batch_of(5)), 2000)  # the first frame of skill 1: skill 0 is at its goal here
    assert labels.skill[0] == 1 and labels.neighbour[0] == 0
    torch.manual_seed(0)
    skill, goal, _ = model.train()._drawn_beside_edges(labels)
    beside = skill == 0
    assert beside.float().mean() == pytest.approx(BESIDE_SHARE, abs=0.04)
    assert torch.equal(goal[beside], labels.neighbour_goal[beside]) and torch.equal(goal[~beside], labels.goal[~beside])
    assert not torch.equal(labels.goal[0], labels.neighbour_goal[0])
    skill, goal, _ = model.eval()._drawn_beside_edges(labels)
    assert torch.equal(skill, labels.skill) and torch.equal(goal, labels.goal)


def test_the_spread_is_the_squared_distance_to_the_mean_of_the_skill():
    subgoal = torch.tensor([[0.0, 0.0], [2.0, 0.0], [5.0, 5.0], [2.0, 4.0]])
    assert spread_within(subgoal, torch.tensor([0, 0, 2, 0]), 3).tolist() == pytest.approx(
        [(4 / 3) ** 2 + (4 / 3) ** 2, (2 / 3) ** 2 + (4 / 3) ** 2, 0.0, (2 / 3) ** 2 + (8 / 3) ** 2]
    )
