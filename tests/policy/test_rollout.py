import copy
import pickle
import threading

import pytest
import torch

from lerobot_buds.core import STATE, WORKSPACE_CAMERA, CheckpointError, ConfigError
from lerobot_buds.policy.modeling_buds import BudsPolicy

pytestmark = pytest.mark.slow

PERIOD = 5


@pytest.fixture
def observe(batch_of):
    """Observations of rows of the dataset, without anything that only training knows."""

    def observe(*rows):
        return {k: v for k, v in batch_of(*rows).items() if k.startswith("observation") or k == "task"}

    return observe


@pytest.mark.parametrize("drawn", [False, True])
def test_what_an_environment_does_depends_on_no_other(build, observe, drawn):
    policy = build(drawn_subgoals=drawn)
    noise = torch.randn(3, policy.config.meta_latent)
    steps = [(t, 12 + t, 20 + t) for t in range(7)]
    policy.reset()
    together = torch.stack([policy.select_action(observe(*rows), noise=noise) for rows in steps])
    assert together.shape == (7, 3, 4) and together.abs().max() <= 1
    for env in range(3):
        policy.reset()
        alone = [policy.select_action(observe(rows[env]), noise=noise[env : env + 1]) for rows in steps]
        assert torch.equal(torch.cat(alone), together[:, env])  # to the last bit


def test_a_decision_is_held_for_exactly_its_period(build, observe, monkeypatch):
    policy = build()
    decisions = []
    propose = policy.model.meta_controllers.propose

    def count(*arguments):
        decisions.append(step)
        return propose(*arguments)

    monkeypatch.setattr(policy.model.meta_controllers, "propose", count)
    for episode in range(2):
        policy.reset()
        assert policy.current_skills is None
        for step in range(12):
            policy.select_action(observe(step % 8, 12))
            assert policy.current_skills.shape == (2,)
        assert decisions == [0, 0, PERIOD, PERIOD, 2 * PERIOD, 2 * PERIOD] * (episode + 1)  # two environments


def test_environments_may_decide_at_different_steps(build, observe):
    policy = build(drawn_subgoals=True)
    policy.reset()
    policy.select_action(observe(0, 12))
    rollout = policy._rollouts[threading.get_ident()]
    rollout.steps_left = torch.tensor([0, 2])
    before = rollout.subgoal.clone()
    policy.select_action(observe(1, 13), noise=torch.full((2, 4), 9.0))
    assert not torch.equal(rollout.subgoal[0], before[0]) and torch.equal(rollout.subgoal[1], before[1])
    assert rollout.steps_left.tolist() == [PERIOD - 1, 1]


def test_an_override_replaces_decisions_when_they_fall_due(build, observe):
    policy = build()
    policy.reset()
    seen = []

    def swap(rows, skill, subgoal):
        seen.append(rows.tolist())
        assert skill.shape == (len(rows),) and subgoal.shape == (len(rows), policy.config.subgoal_dim)
        return 1 - skill, torch.zeros_like(subgoal)

    policy.select_action(observe(0, 12))
    asked = policy.current_skills
    policy.reset()
    for step in range(PERIOD + 1):
        policy.select_action(observe(step, 12), override=swap)
    assert seen == [[0], [1], [0], [1]]
    policy.reset()
    policy.select_action(observe(0, 12), override=swap)
    assert torch.equal(policy.current_skills, 1 - asked)
    assert not policy._rollouts[threading.get_ident()].subgoal.any()


def test_only_a_drawn_latent_is_the_generators_and_matters(build, observe):
    policy = build(drawn_subgoals=True)

    def act(seed):
        policy.reset()
        torch.manual_seed(seed)
        return policy.select_action(observe(0))

    assert torch.equal(act(1), act(1)) and not torch.equal(act(1), act(2))
    policy.config.drawn_subgoals = False
    assert torch.equal(act(1), act(2))


def test_evaluation_neither_shifts_nor_adds_noise(build, batch_of):
    policy = build(kl_weight=0.0)
    batch = batch_of(*range(8))
    policy.eval()
    assert policy(batch)[0] == policy(batch)[0]
    policy.train()
    assert policy(batch)[0] != policy(batch)[0]


def test_threads_have_rollouts_of_their_own(build, observe):
    policy = build()
    policy.reset()
    policy.select_action(observe(0, 12))
    seen = []

    def other():
        policy.reset()
        policy.select_action(observe(1, 2, 3))
        seen.append(len(policy.current_skills))

    thread = threading.Thread(target=other)
    thread.start()
    thread.join()
    assert seen == [3] and len(policy.current_skills) == 2


def test_a_rollout_may_leave_inference_mode(build, observe):
    policy = build()
    with torch.inference_mode():
        policy.select_action(observe(0))
    for step in range(1, 7):
        policy.select_action(observe(step))


def test_copies_start_without_rollouts(build, batch_of, observe):
    policy = build()
    policy(batch_of(0, 1))
    policy.select_action(observe(0))
    for twin in (copy.deepcopy(policy), pickle.loads(pickle.dumps(policy))):
        assert twin.current_skills is None
        twin(batch_of(0, 1))


def test_inputs_that_do_not_fit_are_refused(build, observe):
    policy = build()
    observation = observe(0)
    with pytest.raises(CheckpointError, match=r"needs.*agentview.*It has"):
        policy.select_action({k: v for k, v in observation.items() if k != WORKSPACE_CAMERA})
    with pytest.raises(CheckpointError, match=r"\(3, 32, 32\).*\(3, 48, 48\)"):
        policy.select_action({**observation, WORKSPACE_CAMERA: torch.zeros(1, 3, 48, 48)})
    with pytest.raises(CheckpointError, match=r"\(3, 32, 32\).*\(32, 32, 3\)"):
        policy.select_action({**observation, WORKSPACE_CAMERA: torch.zeros(1, 32, 32, 3)})
    with pytest.raises(CheckpointError, match=r"\(5,\).*\(4,\)"):
        policy.select_action({**observation, STATE: torch.zeros(1, 4)})
    with pytest.raises(ConfigError, match=r"'Close the drawr'.*Did you mean 'Close the drawer'"):
        policy.select_action({**observation, "task": ["Close the drawr"]})
    policy.select_action({**observation, "task": [""]})


def test_an_untrained_policy_is_built_from_an_environments_features_alone(build, small, observe):
    features = build().config
    config = type(features)(
        **{**small, "current_state": None, "history_state": None},
        input_features=dict(features.input_features),
        output_features=dict(features.output_features),
    )
    policy = BudsPolicy(config)
    assert policy.config.n_skills == 1 and policy.config.current_dims == [0, 1, 2, 3, 4]
    assert policy.select_action(observe(0)).shape == (1, 4)


def test_constant_state_dimensions_do_not_blow_up(build, meta):
    policy = build()
    stats = {**meta.stats, STATE: {**meta.stats[STATE], "std": meta.stats[STATE]["std"] * 0}}
    frozen = BudsPolicy(policy.config, dataset_stats=stats)
    assert torch.equal(frozen.model.proprioception.std, torch.ones(5))
    torch.testing.assert_close(
        policy.model.proprioception.mean, torch.as_tensor(meta.stats[STATE]["mean"], dtype=torch.float32)
    )
