"""Every option of the policy: what it changes, and that a policy with it trains, is saved, and acts."""

import json
import math
import pickle

import numpy as np
import pytest
import torch

from lerobot_buds.core import ACTION, CheckpointError, ConfigError
from lerobot_buds.policy.inputs import read_actions, read_inputs
from lerobot_buds.policy.labels import Labels
from lerobot_buds.policy.meta_controller import Situation
from lerobot_buds.policy.modeling_buds import BudsPolicy

pytestmark = pytest.mark.slow

OPTIONS = [
    {},
    {"skills": "flat"},
    {"skills": "single"},
    {"norm": "batch"},
    {"shared_trunk": True},
    {"shared_trunk": True, "skills": "flat"},
    {"chunk_size": 3},
    {"chunk_size": 3, "n_action_steps": 2},
    {"heads": "residual"},
    {"heads": "residual", "shared_trunk": True, "skills": "single"},
    {"shared_trunk": True, "meta_trunk": "skills"},
    {"subgoal_space": "latent"},
    {"skill_memory": False, "meta_proprioception": False, "boundary_overlap_s": 0.0},
    {"skills": "flat", "tasks": ["Close the drawer", "Boil the pot"]},
    {"meta_controllers": "conditioned", "tasks": ["Close the drawer", "Boil the pot"]},
    {"meta_cameras": "all", "decoder_sees_skill": False, "drawn_subgoals": True},
    {"balance_skills": True},
    {"history_dims": [], "current_dims": []},
]


def situation(images, task):
    """What a meta controller that has no memory yet decides from; proprioception of the small policies."""
    rows = len(images)
    memory, remembers = torch.zeros(rows, 5), torch.zeros(rows, 1, dtype=torch.bool)
    return Situation(images, torch.zeros(rows, 12), memory, remembers, task)


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
        losses.append(loss.item())
    assert all(p.grad is not None for p in policy.parameters())
    assert all(math.isfinite(loss) for loss in losses) and losses[-1] < losses[0]
    assert all(math.isfinite(value) for value in metrics.values())
    torch.manual_seed(0)
    assert policy(data, reduction="none")[0].shape == (30,)

    policy.eval()
    policy.save_pretrained(tmp_path)
    again = BudsPolicy.from_pretrained(tmp_path)
    observation = {k: v[:2] for k, v in data.items() if k.startswith("observation") or k == "task"}
    for _ in range(7):
        noise = torch.randn(2, 4)
        action = policy.select_action(observation, noise=noise)
        assert action.shape == (2, 4) and action.abs().max() <= 1
        assert torch.equal(again.select_action(observation, noise=noise), action)


def test_a_flat_policy_needs_no_segmentation_and_decides_nothing(build, batch, dataset_root, tmp_path, meta):
    policy = build(skills="flat")
    assert policy.model.meta_controllers is None and policy.config.segmentation is None
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
    assert len(convolved) == len(layers) >= 3  # of images, goals and the meta controller; those of skills may share one


def test_a_shared_trunk_is_run_once_for_all_skills(build, batch):
    policy = build(shared_trunk=True)
    runs = []
    policy.model.skills.image_trunk.register_forward_hook(lambda *_: runs.append(1))
    policy(batch(policy))
    assert len(runs) == 1
    assert sum(p.numel() for p in policy.model.skills.parameters()) < sum(
        p.numel() for p in build().model.skills.parameters()
    )


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
    data = batch(policy)
    rows = Labels.of(data)
    plain = policy.model(read_inputs(policy.config, data), rows, read_actions(policy.config, data), None)["skill_loss"]
    by_skill = [plain[rows.skill == k].mean().item() for k in (0, 1)]
    assert losses[False] == pytest.approx(plain.mean().item())
    assert losses[True] == pytest.approx(np.mean(by_skill))


def test_a_decoder_that_sees_the_skill_imagines_for_it(build, batch):
    for sees in (False, True):
        meta = build(decoder_sees_skill=sees).model.meta_controllers
        task = torch.zeros(1, dtype=torch.int64)
        feature, _ = meta.propose(situation(torch.rand(1, 3, 32, 32), task))
        subgoals = [meta.imagine(feature, task, torch.tensor([k]), torch.zeros(1, 4)) for k in (0, 1)]
        assert torch.equal(*subgoals) is not sees


@pytest.mark.parametrize("kind", ["per_task", "conditioned"])
def test_every_task_has_decisions_of_its_own(build, batch, kind):
    tasks = ["Close the drawer", "Boil the pot"]
    policy = build(meta_controllers=kind, tasks=tasks)
    assert len(policy.model.meta_controllers.controllers) == (2 if kind == "per_task" else 1)
    image = torch.rand(1, 3, 32, 32)
    propose = policy.model.meta_controllers.propose
    together = propose(situation(image.expand(2, -1, -1, -1), torch.tensor([1, 0])))[1]
    for row, task in enumerate((1, 0)):
        alone = propose(situation(image, torch.tensor([task])))[1]
        torch.testing.assert_close(together[row : row + 1], alone)
    assert not torch.allclose(together[0], together[1])
    observation = {k: v[:2] for k, v in batch(policy).items() if k.startswith("observation")}
    policy.select_action({**observation, "task": tasks})
    with pytest.raises(ConfigError, match=r"'Boil the pott'.*Did you mean 'Boil the pot'"):
        policy.select_action({**observation, "task": ["Close the drawer", "Boil the pott"]})


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
    skills = policy.model.skills.state_dict()
    assert all(torch.equal(value, skills[name]) for name, value in source.model.skills.state_dict().items())
    assert not any(
        torch.equal(a, b)
        for a, b in zip(
            policy.model.meta_controllers.parameters(), source.model.meta_controllers.parameters(), strict=True
        )
    )
    policy.save_pretrained(tmp_path / "new")
    for file in library.iterdir():
        file.unlink()
    again = BudsPolicy.from_pretrained(tmp_path / "new")  # the library is not needed any more
    assert torch.equal(again.model.proprioception.mean, source.model.proprioception.mean)
    assert not any(p.requires_grad for p in again.model.skills.parameters())


@pytest.mark.parametrize("space", ["image", "latent"])
def test_skills_of_a_library_act_as_they_did(build, batch, tmp_path, space):
    """Given the same decisions; a library of latent goals brings its scaling of them."""
    source = build(subgoal_space=space, chunk_size=3, heads="residual")
    if space == "latent":
        source.model.goals.std.mul_(2)
    source.save_pretrained(tmp_path)
    policy = build(skills_path=str(tmp_path), chunk_size=2)
    assert policy.config.subgoal_space == space and policy.config.chunk_size == 3
    labels, seen = Labels.of(batch(policy)), read_inputs(policy.config, batch(policy))
    outputs = []
    for model in (source.model.eval(), policy.model.eval()):
        percept = model.encode(seen, labels.history)
        subgoal, _ = model.encode_goals(labels.skill, labels.goal)
        outputs.append(model.act(percept, labels.skill, subgoal))
    assert torch.equal(*outputs)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"shared_trunk": True, "meta_trunk": "skills"}, "needs shared_trunk"),
    ],
)
def test_settings_that_do_not_fit_the_library_are_refused(build, library, settings, message):
    with pytest.raises(ConfigError, match=message):
        build(skills_path=str(library), **settings)


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
        ({"chunk_size": 0}, "chunk_size=0"),
        ({"n_action_steps": 2}, "n_action_steps=2 is more than chunk_size=1"),
        ({"boundary_overlap_s": -0.1}, "boundary_overlap_s=-0.1"),
        ({"memory_dropout": 1.1}, "memory_dropout=1.1"),
        ({"heads": "residul"}, "Did you mean 'residual'"),
        ({"subgoal_space": "latents"}, "Did you mean 'latent'"),
        ({"subgoal_space": "latent", "skills": "single"}, "'single' has none"),
        ({"meta_trunk": "skills"}, "needs shared_trunk"),
        ({"skills": "flat", "skills_path": "x"}, "no meta controller to train"),
    ],
)
def test_settings_that_cannot_work_are_refused(build, wrong, message):
    with pytest.raises(ConfigError, match=message):
        build(**wrong)
