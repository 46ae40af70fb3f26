"""Graphed steps on a CPU: what is recorded there runs again in Python, and writes to the same memory as a graph."""

import pickle
from copy import deepcopy

import numpy as np
import pytest
import torch
from lerobot.scripts import lerobot_train
from torch._subclasses.fake_tensor import FakeTensorMode

from lerobot_buds.core import ConfigError
from lerobot_buds.policy import BudsConfig, graphs
from lerobot_buds.policy.graphs import GraphedSteps
from lerobot_buds.policy.grouping import Grouping
from lerobot_buds.policy.inputs import read_actions, read_inputs
from lerobot_buds.policy.labels import Labels
from lerobot_buds.policy.modeling_buds import BudsPolicy

pytestmark = pytest.mark.slow

WATCHED = 3


class Rerun:
    """Stands in for CUDA graphs."""

    def __init__(self):
        self.recordings = 0

    def rehearse(self, work):
        work()

    def record(self, work):
        self.recordings += 1
        written = work()

        def again():
            with torch.enable_grad():
                for old, new in zip(written, work(), strict=True):
                    if old is not None:
                        old.data.copy_(new)

        return written, again


@pytest.fixture(autouse=True)
def graphs_on_cpus(monkeypatch):
    monkeypatch.setattr(graphs, "WATCHED", WATCHED)
    monkeypatch.setattr(BudsPolicy, "_replays", property(lambda self: self.config.cuda_graphs and self.training))


@pytest.fixture
def pair(build, batch_of):
    """Two equal policies, one of them with graphs that have been recorded."""

    def pair(**settings):
        graphed = build(cuda_graphs=True, **settings).train()
        graphed._graphed_steps = GraphedSteps(graphed.model, Rerun())
        plain = build(**settings).train()
        plain.load_state_dict(graphed.state_dict())
        for _ in range(WATCHED + 1):
            trained(graphed, batch_of(*range(30)))
        assert graphed._graphed_steps._replay.calls == 1
        return plain, graphed

    return pair


def trained(policy, batch):
    """Loss, terms and gradients of a batch; the policies draw the same numbers."""
    policy.zero_grad()
    torch.manual_seed(3)
    loss, terms = policy(batch)
    loss.backward()
    return loss.item(), terms, {n: None if p.grad is None else p.grad.clone() for n, p in policy.named_parameters()}


def check_equal(plain, graphed, batch):
    """Compares one step of both, and returns whether it was replayed."""
    calls = graphed._graphed_steps._replay.calls
    (loss, terms, gradients), (loss_again, terms_again, gradients_again) = (trained(p, batch) for p in (plain, graphed))
    assert loss_again == pytest.approx(loss) and terms_again == pytest.approx(terms, rel=1e-4, abs=1e-5)
    for name, gradient in gradients.items():
        if gradient is None:
            assert gradients_again[name] is None, name
        else:
            torch.testing.assert_close(gradients_again[name], gradient, rtol=1e-4, atol=1e-6)
    return graphed._graphed_steps._replay.calls > calls


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"shared_trunk": True, "meta_trunk": "skills", "imagined_subgoals": 0.5},
        {"subgoal_space": "latent", "drawn_subgoals": True},
        {"heads": "residual", "balance_skills": True},
        {"skills": "flat"},
        {"meta_controllers": "conditioned"},
    ],
    ids=str,
)
def test_a_replayed_step_is_the_step(pair, batch_of, settings):
    plain, graphed = pair(**settings)
    optimizers = [p.config.get_optimizer_preset().build(p.get_optim_params()) for p in (plain, graphed)]
    batches = [batch_of(*range(30)), batch_of(*range(29, -1, -1)), batch_of(*range(2, 30), 0, 1)]
    for batch in batches:
        assert check_equal(plain, graphed, batch)
        for optimizer in optimizers:
            optimizer.step()
        plain.load_state_dict(graphed.state_dict())
    assert graphed._graphed_steps._recorder.recordings == 2  # forward and backward, once


def test_tasks_have_meta_controllers_of_their_own(pair, batch_of, task, monkeypatch):
    monkeypatch.setattr(torch, "randn_like", torch.zeros_like)  # rows that fill up draw, too: others draw differently
    plain, graphed = pair(tasks=[task, "Boil the pot"])
    batch = batch_of(*range(30))
    assert check_equal(plain, graphed, batch)  # the other task is absent: its controller gets no gradient
    batch["task"] = ["Boil the pot"] * 3 + batch["task"][3:]
    assert not check_equal(plain, graphed, batch)  # never seen so often before


def test_what_does_not_fit_is_computed_as_without_graphs(pair, batch_of, labels):
    plain, graphed = pair(boundary_overlap_s=0.0)
    of_one = np.flatnonzero(np.concatenate(labels) == 1).tolist()
    assert not check_equal(plain, graphed, batch_of(*(of_one * 3)[:30]))  # more than there is room for
    assert not check_equal(plain, graphed, batch_of(*range(7)))  # another size
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert not check_equal(plain, graphed, batch_of(*range(30)))  # another precision
    assert check_equal(plain, graphed, batch_of(*range(30)))


def test_a_skill_without_rows_gets_no_gradient(pair, batch_of, labels):
    plain, graphed = pair(boundary_overlap_s=0.0)
    graphed._graphed_steps._capacities[0] = [30, 30]
    graphed._graphed_steps._replay = None
    of_one = np.flatnonzero(np.concatenate(labels) == 1).tolist()
    trained(graphed, batch_of(*range(30)))
    assert check_equal(plain, graphed, batch_of(*(of_one * 3)[:30]))
    assert all(p.grad is None for p in graphed.model.skills.skills[0].parameters())


def test_gradients_that_are_there_are_added_to(pair, batch_of):
    plain, graphed = pair()
    batch = batch_of(*range(30))
    once = trained(plain, batch)[2]
    trained(graphed, batch)
    torch.manual_seed(3)
    graphed(batch)[0].backward()
    for name, parameter in graphed.named_parameters():
        torch.testing.assert_close(parameter.grad, 2 * once[name], rtol=1e-4, atol=1e-6)


def test_the_gradients_of_a_step_before_the_last_are_gone(pair, batch_of):
    _, graphed = pair()
    graphed.zero_grad()
    first, _ = graphed(batch_of(*range(30)))
    graphed(batch_of(*range(30)))
    with pytest.raises(RuntimeError, match="the last step alone"):
        first.backward()


def test_a_step_of_samples_that_weigh_differently(pair, batch_of):
    plain, graphed = pair()
    weight = torch.arange(30.0)
    for policy in (plain, graphed):
        policy.zero_grad()
        torch.manual_seed(3)
        (policy(batch_of(*range(30)), reduction="none")[0] * weight).sum().backward()
    for one, other in zip(plain.parameters(), graphed.parameters(), strict=True):
        torch.testing.assert_close(one.grad, other.grad, rtol=1e-4, atol=1e-4)


def test_weights_that_moved_are_recorded_anew(pair, batch_of):
    plain, graphed = pair()
    steps = graphed._graphed_steps
    graphed.eval().select_action({k: v for k, v in batch_of(0).items() if k.startswith("observation") or k == "task"})
    assert check_equal(plain, graphed.train(), batch_of(*range(30)))
    assert steps._recorder.recordings == 2  # acting leaves them where they are
    for parameter in graphed.parameters():
        parameter.data = parameter.data.clone()
    trained(graphed, batch_of(*range(30)))
    assert steps._recorder.recordings == 4
    assert check_equal(plain, graphed, batch_of(*range(30)))


def test_copies_have_no_graphs_and_validation_does_without(pair, batch_of):
    plain, graphed = pair()
    for copy in (deepcopy(graphed), pickle.loads(pickle.dumps(graphed))):
        assert copy._graphed_steps is None
    calls = graphed._graphed_steps._replay.calls
    with torch.no_grad():
        validation = [policy.eval()(batch_of(*range(30)))[1] for policy in (plain, graphed)]
        graphed.train()(batch_of(*range(30)))
    assert validation[0] == validation[1] and graphed._graphed_steps._replay.calls == calls


def test_what_graphs_exclude_is_refused(small):
    with pytest.raises(ConfigError, match="norm='group'"):
        BudsConfig(**{**small, "norm": "batch", "cuda_graphs": True})
    with pytest.raises(ConfigError, match="exclude each other"):
        BudsConfig(**{**small, "compile_model": True, "cuda_graphs": True})


def test_frozen_skills_are_part_of_a_graph(pair, build, batch_of, tmp_path):
    build().save_pretrained(tmp_path / "library")
    plain, graphed = pair(skills_path=str(tmp_path / "library"))
    assert check_equal(plain, graphed, batch_of(*range(30)))
    assert all(p.grad is None for p in graphed.model.skills.parameters())


def test_a_run_with_the_setting_goes_on_after_a_checkpoint(run_script, command, dataset_root, tmp_path, monkeypatch):
    """On a CPU the setting changes nothing."""
    monkeypatch.setattr(BudsPolicy, "_replays", False)
    settings = {"policy.cuda_graphs": True, "batch_size": 8, "steps": 2, "save_freq": 1}
    run_script(lerobot_train.main, *command(dataset_root, output_dir=tmp_path / "run", **settings))
    half = tmp_path / "run/checkpoints/000001/pretrained_model/train_config.json"
    run_script(lerobot_train.main, f"--config_path={half}", "--resume=true")


@pytest.mark.parametrize("settings", [{}, {"shared_trunk": True, "meta_trunk": "skills", "imagined_subgoals": 0.5}])
def test_nothing_in_a_step_waits_for_a_gpu(build, batch_of, settings):
    """With fake tensors of a GPU whatever needs a number on the host is an error, as it is in a capture."""
    config = build(skill_memory=True, **settings).config
    batch = batch_of(*range(30))
    with FakeTensorMode() as mode:
        with torch.device("cuda"):
            model = BudsPolicy(config, from_checkpoint=True).train().model
        batch = {k: _on_gpu(mode, value) for k, value in batch.items()}
        labels = Labels.of(batch)
        sample = model.sample(read_inputs(config, batch), labels, read_actions(config, batch), None)
        rows = [torch.zeros(size, dtype=torch.int64, device="cuda") for size in (20, 15, 30)]
        by_skill = Grouping((0, 1), tuple(rows[:2]), rows[2], (15, 15))
        terms = model.terms(sample, (by_skill, Grouping.whole(30)))
        loss = model.loss(terms, labels)
    assert loss.device.type == "cuda" and loss.requires_grad


def _on_gpu(mode, value):
    return mode.from_tensor(value).to("cuda") if isinstance(value, torch.Tensor) else value
