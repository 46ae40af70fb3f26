"""Several actions at once: carried out without looking, and predicted without acting."""

import threading

import pytest
import torch

PLAIN = {"skill_memory": False, "history_state": []}
"""Nothing but what is seen and felt now decides."""


@pytest.fixture
def observe(batch_of):
    """Observations of rows of the dataset."""

    def observe(*rows):
        return {k: v for k, v in batch_of(*rows).items() if k.startswith("observation")}

    return observe


@pytest.fixture
def looks(monkeypatch):
    """Notes how many rows a model plans for at which call."""

    def looks(policy):
        noted, act = [], policy.model.act
        monkeypatch.setattr(policy.model, "act", lambda seen, *rest: noted.append(len(seen.task)) or act(seen, *rest))
        return noted

    return looks


def rollout_of(policy):
    return policy._rollouts[threading.get_ident()]


def test_actions_are_carried_out_without_looking(build, observe):
    """What is seen in between changes nothing, until the plan is done."""
    policy = build(chunk_size=4, n_action_steps=3, **PLAIN)
    acted = torch.stack([policy.select_action(observe(row, row + 10)) for row in (0, 1, 2, 3)], dim=1)
    policy.reset()
    planned = policy.predict_action_chunk(observe(0, 10))
    assert planned.shape == (2, 4, 4)
    torch.testing.assert_close(acted[:, :3], planned[:, :3])
    assert not torch.allclose(acted[:, 3], planned[:, 3])


@pytest.mark.parametrize(("steps", "at"), [(1, range(12)), (3, [0, 3, 5, 8, 10]), (8, [0, 5, 10])])
def test_a_due_decision_plans_anew(build, observe, looks, steps, at):
    """Decisions fall due every five steps, whatever is left of a plan."""
    policy = build(chunk_size=8, n_action_steps=steps)
    noted = looks(policy)
    counts = []
    for row in range(12):
        policy.select_action(observe(row, row))
        counts.append(len(noted))
    assert [t for t in range(12) if counts[t] > (counts[t - 1] if t else 0)] == list(at)


def test_every_environment_plans_for_itself(build, observe, looks):
    policy = build(chunk_size=3, n_action_steps=3, **PLAIN)
    noted = looks(policy)
    policy.select_action(observe(0, 12))
    rollout_of(policy).steps_left = torch.tensor([4, 0])
    old = rollout_of(policy).plan[:, 0]
    together = policy.select_action(observe(1, 13))
    assert noted == [1, 1, 1]  # both look, one after the other, then the second alone
    assert torch.equal(together[0], old[0]) and not torch.equal(together[1], old[1])
    policy.reset()
    torch.testing.assert_close(policy.select_action(observe(13))[0], together[1])


def test_flat_policies_plan_too(build, observe, looks):
    policy = build(skills="flat", chunk_size=4, n_action_steps=4)
    noted = looks(policy)
    for row in range(9):
        policy.select_action(observe(row))
    assert len(noted) == 3


@pytest.mark.parametrize("settings", [{}, {"skills": "flat"}, {"subgoal_space": "latent"}])
def test_a_predicted_chunk_begins_with_the_next_action(build, observe, settings):
    """Without memory, a rollout begins as one predicts outside of any."""
    policy = build(chunk_size=3, skill_memory=False, **settings)
    predicted = policy.predict_action_chunk(observe(0, 12))
    assert predicted.shape == (2, 3, 4) and policy.current_skills is None
    torch.testing.assert_close(policy.select_action(observe(0, 12)), predicted[:, 0])


def test_predicting_leaves_the_rollout_as_it_is(build, observe):
    policy = build(chunk_size=3, n_action_steps=2)
    plain = torch.stack([policy.select_action(observe(row, 12)) for row in range(7)])
    policy.reset()
    for row in range(7):
        assert torch.equal(policy.select_action(observe(row, 12)), plain[row])
        before = {name: value.clone() for name, value in vars(rollout_of(policy)).items()}
        first, second = (policy.predict_action_chunk(observe(20, 29)) for _ in range(2))
        assert torch.equal(first, second)
        assert all(torch.equal(value, before[name]) for name, value in vars(rollout_of(policy)).items())
        assert len(policy.predict_action_chunk(observe(3))) == 1  # other rows than those of the rollout
