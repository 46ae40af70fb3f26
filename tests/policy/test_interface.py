"""What LeRobot's generic tests ask of every policy, written anew for ``buds``."""

import copy

import draccus
import pytest
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.policies import get_policy_class, make_policy, make_policy_config, make_pre_post_processors

from lerobot_buds.core import ACTION
from lerobot_buds.envs.configuration_robosuite import RobosuiteEnvConfig
from lerobot_buds.policy import BudsConfig
from lerobot_buds.policy.modeling_buds import BudsPolicy


def test_the_factory_knows_the_type():
    assert get_policy_class("buds") is BudsPolicy
    assert isinstance(make_policy_config("buds", device="cpu"), BudsConfig)
    assert BudsPolicy.name == "buds" and BudsPolicy.config_class is BudsConfig


def test_defaults_build_from_an_environment_and_act():
    policy = make_policy(make_policy_config("buds", device="cpu"), env_cfg=RobosuiteEnvConfig())
    observation = {key: torch.rand(2, *f.shape) for key, f in policy.config.input_features.items()}
    assert policy.select_action({**observation, "task": ["", ""]}).shape == (2, 4)


def test_a_step_changes_every_parameter_and_no_input(build, batch_of):
    policy = build().train()
    batch = batch_of(*range(30))
    before_batch = copy.deepcopy(batch)
    before = copy.deepcopy(dict(policy.named_parameters()))
    optimizer = policy.config.get_optimizer_preset().build(policy.get_optim_params())
    loss, metrics = policy.forward(batch)
    assert loss.ndim == 0 and loss.requires_grad
    assert all(isinstance(value, float) for value in metrics.values())
    loss.backward()
    optimizer.step()
    assert all(not torch.equal(before[name], p) for name, p in policy.named_parameters())
    assert batch.keys() == before_batch.keys()
    for key, value in batch.items():
        assert torch.equal(value, before_batch[key]) if isinstance(value, torch.Tensor) else value == before_batch[key]


def test_weights_lie_otherwise_for_acting_only(build, batch_of):
    # LeRobot saves the optimiser's state, which takes after the weights, and can save only what is contiguous.
    policy = build()
    before = [p.stride() for p in policy.parameters()]
    with torch.inference_mode():  # as lerobot-eval does, in the midst of training too
        policy.select_action({k: v for k, v in batch_of(0).items() if k.startswith("observation")})
    weights = [p for p in policy.parameters() if p.ndim == 4 and p.shape[1] > 1 and p.shape[2] > 1]
    assert weights and not any(p.is_contiguous() for p in weights)
    policy.train()
    # Strides to the last: the order of sums, hence an exact resume, depends on them.
    assert [p.stride() for p in policy.parameters()] == before
    loss, _ = policy(batch_of(*range(30)))
    loss.backward()
    assert all(p.grad is not None for p in policy.parameters())


def test_processors_pass_everything_on(build, batch_of):
    policy = build()
    prepare, finish = make_pre_post_processors(policy.config, dataset_stats=None)
    batch = batch_of(0, 12)
    prepared = prepare(batch)
    for key in policy.config.input_features:
        assert torch.equal(prepared[key], batch[key])
    assert prepared["task"] == batch["task"] and torch.equal(prepared["index"], batch["index"])
    action = policy.select_action(prepared)
    assert torch.equal(finish(action), action)


def test_acting_changes_no_observation_and_is_repeatable(build, batch_of):
    policy = build()
    observation = {k: v for k, v in batch_of(0, 12).items() if k.startswith("observation") or k == "task"}
    before = copy.deepcopy(observation)

    def act():
        policy.reset()
        torch.manual_seed(2)
        return torch.stack([policy.select_action(observation) for _ in range(6)])

    assert torch.equal(act(), act())
    assert all(torch.equal(before[k], v) for k, v in observation.items() if k != "task")


def test_saving_and_loading_keep_weights_and_configuration(build, tmp_path):
    policy = build(chunk_size=2)
    policy.save_pretrained(tmp_path)
    again = get_policy_class("buds").from_pretrained(tmp_path)
    assert not again.training
    state = again.state_dict()
    assert policy.state_dict().keys() == state.keys()
    assert all(torch.equal(value, state[key]) for key, value in policy.state_dict().items())
    assert draccus.encode(PreTrainedConfig.from_pretrained(tmp_path)) == draccus.encode(policy.config)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["README.md", "config.json", "model.safetensors"]


@pytest.mark.parametrize("key", [ACTION, "observation.state"])
def test_features_come_from_the_dataset(build, key):
    config = build().config
    feature = {**config.input_features, **config.output_features}[key]
    assert feature.shape == ((4,) if key == ACTION else (5,))
