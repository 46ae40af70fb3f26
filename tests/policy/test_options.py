"""Every option of the policy: what it changes, and that a policy with it trains, is saved, and acts."""

import json
import math
import pickle

import numpy as np
import pytest
import torch

from lerobot_buds.core import ACTION, CheckpointError, ConfigError
from lerobot_buds.policy.modeling_buds import BudsPolicy
from lerobot_buds.policy.rollout import UNDECIDED, Rollout, choose_skills

OPTIONS = [
    {},
    {"skills": "flat"},
    {"skills": "single"},
    {"norm": "batch"},
    {"shared_trunk": True},
    {"shared_trunk": True, "skills": "flat"},
    {"chunk_size": 3},
    {"termination": True, "switch_margin": 0.2},
    {"meta_controllers": "conditioned", "tasks": ["Close the drawer", "Boil the pot"]},
    {"meta_cameras": "all", "decoder_sees_skill": False, "drawn_subgoals": True},
    {"balance_skills": True},
    {"history_dims": [], "current_dims": []},
]


@pytest.fixture
def batch(batch_of):
    """All frames; with chunks, the actions of the next n, which LeRobot's loader adds."""

    def batch(policy):
        batch = batch_of(*range(30))
        n = policy.config.chunk_size
        if n > 1:
            ahead = torch.arange(30)[:, None] + torch.arange(n)
            ends = torch.tensor([12] * 12 + [20] * 8 + [30] * 10)[:, None]
            batch["action_is_pad"] = ahead >= ends
            batch[ACTION] = batch[ACTION][torch.minimum(ahead, ends - 1)]
        return batch

    return batch


@pytest.mark.parametrize("options", OPTIONS, ids=lambda options: ",".join(options) or "defaults")
def test_options_train_are_saved_and_act(build, batch, options, tmp_path):
    policy = build(**options, optimizer_lr=3e-3, crop_padding=0).train()
    assert (policy.config.action_delta_indices or [0]) == list(range(policy.config.chunk_size))
    optimizer = policy.config.get_optimizer_preset().build(policy.get_optim_params())
    data, losses = batch(policy), []
    for _ in range(12):
        loss, metrics = policy(data)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        policy.update()
        losses.append(loss.item())
    assert all(p.grad is not None for p in policy.parameters())
    assert all(math.isfinite(loss) for loss in losses) and losses[-1] < losses[0]
    assert all(math.isfinite(value) for value in metrics.values())
    torch.manual_seed(0)
    assert policy(data, reduction="none")[0].shape == (30,)

    policy.eval()
    policy.save_pretrained(tmp_path)
    again = BudsPolicy.from_pretrained(tmp_path)
    assert int(again.trained_steps) == 12
    observation = {k: v[:2] for k, v in data.items() if k.startswith("observation") or k == "task"}
    for _ in range(7):
        noise = torch.randn(2, 4)
        action = policy.select_action(observation, noise=noise)
        assert action.shape == (2, 4) and action.abs().max() <= 1
        assert torch.equal(again.select_action(observation, noise=noise), action)


def test_a_flat_policy_needs_no_segmentation_and_decides_nothing(build, batch, dataset_root, tmp_path, meta):
    policy = build(skills="flat")
    assert policy.meta_controllers is None and policy.config.segmentation is None
    assert set(policy(batch(policy))[1]) == {"skill_loss", "action_error"}
    assert [group["name"] for group in policy.get_optim_params()] == ["skills"]
    observation = {k: v[:1] for k, v in batch(policy).items() if k.startswith("observation")}
    state = torch.get_rng_state()
    policy.select_action(observation)
    assert torch.equal(torch.get_rng_state(), state) and policy.current_skills.tolist() == [0]


@pytest.mark.parametrize("norm", ["batch", "group"])
def test_mixed_precision_gives_the_same_loss_about(build, batch, norm):
    policy = build(norm=norm, crop_padding=0, subgoal_noise=0.0).train()
    losses = []
    for mixed in (False, True):
        torch.manual_seed(0)
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=mixed):
            loss, metrics = policy(batch(policy))
        loss.backward()
        losses.append(metrics)
    assert losses[0] != losses[1]
    assert losses[1] == pytest.approx(losses[0], rel=0.05, abs=0.05)


def test_every_encoder_is_compiled_whole_and_computes_the_same(build, batch, monkeypatch):
    layers = []

    def backend(graph, inputs):  # the real one would take minutes
        layers.append({str(node.target) for node in graph.graph.nodes if node.op == "call_function"})
        return graph

    compile_module = torch.nn.Module.compile
    monkeypatch.setattr(torch.nn.Module, "compile", lambda self, **how: compile_module(self, backend=backend, **how))
    torch.compiler.reset()
    # The limit lies below the number of encoders, as PyTorch's does at the paper's sizes.
    with torch.compiler.config.patch(recompile_limit=2, fail_on_recompile_limit_hit=True):
        policy, compiled = (build(compile_model=value, crop_padding=0, subgoal_noise=0.0) for value in (False, True))
        compiled.load_state_dict(policy.state_dict())
        for training in (True, False):
            metrics = []
            for each in (policy, compiled):
                torch.manual_seed(0)
                metrics.append(each.train(training)(batch(each))[1])
            assert metrics[1] == pytest.approx(metrics[0])
    convolved = [names for names in layers if any("conv2d" in name for name in names)]
    assert len(convolved) == len(layers) == 2 * policy.config.n_skills + 1  # the meta controller's is one more


def test_a_shared_trunk_is_run_once_for_all_skills(build, batch):
    policy = build(shared_trunk=True)
    runs = []
    policy.skills.image_trunk.register_forward_hook(lambda *_: runs.append(1))
    policy(batch(policy))
    assert len(runs) == 1
    assert sum(p.numel() for p in policy.skills.parameters()) < sum(p.numel() for p in build().skills.parameters())


def test_padded_actions_have_no_weight(build, batch):
    policy = build(chunk_size=3).eval()
    data = batch(policy)
    loss = policy(data)[1]["skill_loss"]
    data[ACTION] = torch.where(data["action_is_pad"][..., None], torch.tensor(100.0), data[ACTION])
    assert policy(data)[1]["skill_loss"] == loss


def test_balanced_skills_weigh_the_same(build, batch):
    losses = {}
    for balanced in (False, True):
        policy = build(balance_skills=balanced).eval()
        losses[balanced] = policy(batch(policy))[1]["skill_loss"]
        per_frame = policy(batch(policy), reduction="none")[0]
        assert per_frame.shape == (30,)
    policy = build().eval()
    labels = policy._label_table()
    images, state, _ = policy._inputs(batch(policy))
    labels.goals.recognise(torch.arange(30), images[:, :3])
    rows = labels.lookup(torch.arange(30))
    plain = policy._skill_terms(batch(policy), rows, images, state, policy._encoded_goals(rows)[0])["skill_loss"]
    by_skill = [plain[rows.skill == k].mean().item() for k in (0, 1)]
    assert losses[False] == pytest.approx(plain.mean().item())
    assert losses[True] == pytest.approx(np.mean(by_skill))


def test_overlapping_predictions_are_averaged_as_in_act():
    n, decay = 4, 0.3
    rng = np.random.default_rng(0)
    chunks = rng.normal(size=(9, 1, n, 2)).astype(np.float32)
    rollout = Rollout.start(torch.zeros(1, 0), 1, 1, (n, 2), skill=0)
    for t, chunk in enumerate(chunks):
        found = rollout.advance(torch.zeros(1, 0), torch.from_numpy(chunk), torch.ones(1, dtype=torch.bool), decay)
        votes = [chunks[s, 0, t - s] for s in range(max(0, t - n + 1), t + 1)]  # oldest first
        weights = np.exp(-decay * np.arange(len(votes)))
        np.testing.assert_allclose(found[0], np.average(votes, axis=0, weights=weights), rtol=1e-5, atol=1e-6)


def test_predictions_of_a_skill_that_is_left_are_forgotten():
    rollout = Rollout.start(torch.zeros(2, 0), 1, 1, (3, 1), skill=0)
    ended = torch.ones(2, dtype=torch.bool)
    rollout.advance(torch.zeros(2, 0), torch.ones(2, 3, 1), ended, 0.0)
    rollout.decide(torch.ones(2, dtype=torch.bool), torch.tensor([0, 1]), torch.zeros(2, 1), 5)
    action = rollout.advance(torch.zeros(2, 0), torch.zeros(2, 3, 1), ended, 0.0)
    assert action.tolist() == [[0.5], [0.0]]


def test_a_skill_is_kept_until_another_is_better_by_the_margin_and_it_has_ended():
    logits = torch.tensor([[0.6, 0.4], [0.4, 0.6], [0.1, 0.9], [0.1, 0.9], [0.4, 0.6]]).log()
    held = torch.tensor([0, 0, 0, 0, UNDECIDED])
    ended = torch.tensor([True, True, True, False, False])
    assert choose_skills(logits, held, ended, margin=0.5).tolist() == [0, 0, 1, 0, 1]
    assert choose_skills(logits, held, ended, margin=0.0).tolist() == [0, 1, 1, 0, 1]


def test_a_decoder_that_sees_the_skill_imagines_for_it(build, batch):
    for sees in (False, True):
        meta = build(decoder_sees_skill=sees).meta_controllers
        task = torch.zeros(1, dtype=torch.int64)
        feature, _ = meta.propose(torch.rand(1, 3, 32, 32), task)
        subgoals = [meta.imagine(feature, task, torch.tensor([k]), torch.zeros(1, 4)) for k in (0, 1)]
        assert torch.equal(*subgoals) is not sees


@pytest.mark.parametrize("kind", ["per_task", "conditioned"])
def test_every_task_has_decisions_of_its_own(build, batch, kind):
    tasks = ["Close the drawer", "Boil the pot"]
    policy = build(meta_controllers=kind, tasks=tasks)
    assert len(policy.meta_controllers.controllers) == (2 if kind == "per_task" else 1)
    image = torch.rand(1, 3, 32, 32)
    together = policy.meta_controllers.propose(image.expand(2, -1, -1, -1), torch.tensor([1, 0]))[1]
    for row, task in enumerate((1, 0)):
        alone = policy.meta_controllers.propose(image, torch.tensor([task]))[1]
        torch.testing.assert_close(together[row : row + 1], alone)
    assert not torch.allclose(together[0], together[1])
    observation = {k: v[:2] for k, v in batch(policy).items() if k.startswith("observation")}
    policy.select_action({**observation, "task": tasks})
    with pytest.raises(ConfigError, match=r"'Boil the pott'.*Did you mean 'Boil the pot'"):
        policy.select_action({**observation, "task": ["Close the drawer", "Boil the pott"]})


def test_skills_first_then_meta_controllers(build, batch):
    policy = build(schedule="sequential", skill_steps=2, norm="batch", optimizer_lr=1e-2).train()
    assert policy.config.get_scheduler_preset() is None
    optimizer = policy.config.get_optimizer_preset().build(policy.get_optim_params())
    data, keys = batch(policy), set()
    for step in range(4):
        before = {name: value.clone() for name, value in policy.state_dict().items()}
        policy.train()
        loss, metrics = policy(data)
        keys.add(tuple(metrics))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        policy.update()
        moved = {n.split(".")[0] for n, v in policy.state_dict().items() if not torch.equal(v, before[n])}
        # Not even the batch statistics of the idle part move.
        assert moved == {"trained_steps", "skills" if step < 2 else "meta_controllers"}
        assert (metrics["skill_loss"] > 0) == (step < 2) and (metrics["subgoal_loss"] > 0) == (step >= 2)
    assert len(keys) == 1
    # Kept targets are what the finished encoders say.
    policy.eval()
    labels = policy._label_table().lookup(torch.arange(30))
    torch.testing.assert_close(policy._targets.lookup(torch.arange(30), None), policy._encoded_goals(labels)[1])


@pytest.fixture
def library(build, batch, tmp_path):
    torch.manual_seed(5)
    policy = build(norm="batch")
    policy.train()
    policy(batch(policy))  # moves the batch statistics
    policy.save_pretrained(tmp_path / "library")
    return tmp_path / "library"


def test_only_a_meta_controller_is_trained_on_skills_of_a_library(build, batch, library, tmp_path):
    # What the skills are is the library's to say, whatever the new configuration says.
    policy = build(skills_path=str(library), optimizer_lr=1e-2, image_feature=16)
    source = BudsPolicy.from_pretrained(library)
    assert policy.config.norm == "batch" and policy.config.image_feature == 8
    assert [group["name"] for group in policy.get_optim_params()] == ["meta_controllers"]
    optimizer = policy.config.get_optimizer_preset().build(policy.get_optim_params())
    for _ in range(3):
        policy.train()
        loss, _ = policy(batch(policy))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    skills = policy.skills.state_dict()
    assert all(torch.equal(value, skills[name]) for name, value in source.skills.state_dict().items())
    assert not any(
        torch.equal(a, b)
        for a, b in zip(policy.meta_controllers.parameters(), source.meta_controllers.parameters(), strict=True)
    )
    policy.save_pretrained(tmp_path / "new")
    for file in library.iterdir():
        file.unlink()
    again = BudsPolicy.from_pretrained(tmp_path / "new")  # the library is not needed any more
    assert torch.equal(again.proprioception.mean, source.proprioception.mean)
    assert not any(p.requires_grad for p in again.skills.parameters())


def test_libraries_that_do_not_fit_are_refused(build, library, tmp_path):
    with pytest.raises(CheckpointError, match="neither a folder"):
        build(skills_path="not a name")
    config = json.loads((library / "config.json").read_text())

    def rewrite(**changes):
        (library / "config.json").write_text(json.dumps({**config, **changes}))

    rewrite(n_skills=3)
    with pytest.raises(CheckpointError, match=r"n_skills=3.*has 2"):
        build(skills_path=str(library))
    rewrite(segmentation="0123")
    with pytest.raises(CheckpointError, match="segmentation='0123'"):
        build(skills_path=str(library))
    features = {**config["input_features"], "observation.state": {"type": "STATE", "shape": [7]}}
    rewrite(input_features=features)
    with pytest.raises(CheckpointError, match=r"observation.state of shape \(7,\), the data has \(5,\)"):
        build(skills_path=str(library))
    rewrite(keypoints=5)
    with pytest.raises(CheckpointError, match="do not fit their configuration"):
        build(skills_path=str(library))
    rewrite()
    for content in (b"\xff" * 64, pickle.dumps({"skills": [0.0]})):  # the first claims a header of 2**64 bytes
        (library / "model.safetensors").write_bytes(content)
        with pytest.raises(CheckpointError, match="no readable policy"):
            build(skills_path=str(library))
    (library / "model.safetensors").rename(library / "model.pth")  # is not even looked at
    with pytest.raises(CheckpointError, match="no readable policy"):
        build(skills_path=str(library))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"skills": "segment"}, "Did you mean 'segments'"),
        ({"schedule": "sequential"}, "needs skill_steps"),
        ({"chunk_size": 0}, "chunk_size=0"),
        ({"switch_margin": -0.1}, "switch_margin=-0.1"),
        ({"skills": "flat", "skills_path": "x"}, "no meta controller to train"),
    ],
)
def test_settings_that_cannot_work_are_refused(build, wrong, message):
    with pytest.raises(ConfigError, match=message):
        build(**wrong)
