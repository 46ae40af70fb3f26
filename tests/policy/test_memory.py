"""What the meta controller decides from: images, proprioception, and a memory that may be left out."""

import dataclasses
import threading

import pytest
import torch

from lerobot_buds.policy.inputs import Observation, read_actions, read_inputs
from lerobot_buds.policy.labels import UNDECIDED, Labels
from lerobot_buds.policy.meta_controller import MEMORY_SAY
from lerobot_buds.policy.modeling_buds import BudsPolicy

META = ("skill_id_loss", "subgoal_loss", "kl_loss")


def logits_of(model, held, held_for, finished, images=None, state=None):
    """Rates the skills of rows that see and feel the same."""
    rows = len(held)
    generator = torch.Generator().manual_seed(0)
    images = torch.rand(1, 6, 32, 32, generator=generator) if images is None else images
    state = torch.zeros(1, 5) if state is None else state
    seen = Observation(images.expand(rows, -1, -1, -1), state.expand(rows, -1), torch.zeros(rows, dtype=torch.int64))
    encoded = model.encode(seen, torch.zeros(rows, 5, 2))
    situation = model.situation(encoded, torch.tensor(held), torch.tensor(held_for), torch.tensor(finished))
    return model.meta_controllers.propose(situation)[1]


PASTS = [0, 1, UNDECIDED], [5, 40, 0], [[0.0, 1.0], [2.0, 1.0], [0.0, 0.0]]


def test_the_memory_has_its_say(build):
    logits = logits_of(build().model.eval(), *PASTS)
    assert not any(torch.allclose(logits[i], logits[j]) for i, j in ((0, 1), (0, 2), (1, 2)))


@pytest.mark.parametrize("settings", [{"memory_dropout": 0.9999999}, {"skill_memory": False}])
def test_a_memory_that_does_not_count_changes_nothing(build, settings):
    """In training with (almost) all of it dropped, and without a memory always."""
    logits = logits_of(build(**settings).model.train(), *PASTS)
    torch.testing.assert_close(logits, logits[:1].expand(3, -1))


def test_what_is_seen_keeps_its_say_where_the_memory_counts(build):
    """Logits of both add up."""
    model = build(memory_dropout=0.9999999).model
    seen = logits_of(model.train(), *PASTS)
    (controller,) = model.meta_controllers.controllers
    memory = model.memory(*(torch.tensor(value) for value in PASTS))
    torch.testing.assert_close(
        logits_of(model.eval(), *PASTS), seen + MEMORY_SAY * torch.tanh(controller.memory_head(memory))
    )


def test_the_memory_is_forgotten_for_its_share_of_the_rows(build, batch_of):
    model, rows = build(memory_dropout=0.3).model, 4000
    seen = read_inputs(model.config, batch_of(0))[torch.zeros(rows, dtype=torch.int64)]
    percept = model.encode(seen, torch.zeros(rows, 5, 2))
    memory = torch.zeros(rows, dtype=torch.int64), torch.zeros(rows, dtype=torch.int64), torch.zeros(rows, 2)
    torch.manual_seed(0)
    forgotten = ~model.train().situation(percept, *memory).remembers
    assert forgotten.float().mean() == pytest.approx(0.3, abs=0.03)
    assert model.eval().situation(percept, *memory).remembers.all()


@pytest.mark.parametrize("feels", [False, True])
def test_the_meta_controller_feels_where_it_shall(build, feels):
    model = build(meta_proprioception=feels).model.eval()
    logits = [logits_of(model, [UNDECIDED], [0], [[0.0, 0.0]], state=torch.full((1, 5), s)) for s in (0.0, 3.0)]
    assert torch.allclose(*logits) is not feels


def terms_of(policy, batch):
    labels, config = Labels.of(batch), policy.config
    return policy.model(read_inputs(config, batch), labels, read_actions(config, batch), None)


@pytest.mark.parametrize("settings", [{}, {"shared_trunk": True}, {"shared_trunk": True, "meta_trunk": "skills"}])
@pytest.mark.parametrize("space", ["image", "latent"])
def test_deciding_teaches_the_skills_nothing(build, batch_of, settings, space):
    """Not what is their own; the trunk learns from both where the meta controller stands on it."""
    policy = build(subgoal_space=space, **settings).train()
    terms = terms_of(policy, batch_of(*range(30)))
    sum(terms[name].sum() for name in META).backward()
    taught = {name for name, p in policy.model.skills.named_parameters() if p.grad is not None and p.grad.any()}
    assert {name.split(".")[0] for name in taught} == ({"image_trunk"} if "meta_trunk" in settings else set())
    assert any(p.grad is not None and p.grad.any() for p in policy.model.meta_controllers.parameters())


def test_on_the_skills_trunk_it_needs_none_of_its_own(build, batch_of):
    policy = build(shared_trunk=True, meta_trunk="skills").eval()
    kernels = [p for p in policy.model.meta_controllers.parameters() if p.ndim == 4]
    assert [tuple(kernel.shape) for kernel in kernels] == [(4, 8, 1, 1)]  # keypoints of the trunk's maps
    labels = Labels.of(batch_of(0, 12))
    seen = read_inputs(policy.config, batch_of(0, 12))
    percept = policy.model.encode(seen, labels.history)
    situation = policy.model.situation(percept, labels.held, labels.held_for, labels.finished)
    assert situation.images is percept.maps and situation.images.requires_grad


def test_a_rollout_keeps_count_of_what_was_done(build, batch_of):
    """By hand: a decision every five steps; skill 0 takes 20 frames at least, skill 1 takes 11."""
    policy = build()
    policy.model.memory.shortest.copy_(torch.tensor([20.0, 11.0]))
    told = iter([0, 0, 1, 0, 0, 0, 1, 1, 0])
    before = []

    def tell(rows, skill, subgoal):
        rollout = policy._rollouts.get(threading.get_ident())
        if rollout is not None:
            before.append((rollout.skill.item(), rollout.held_for.item(), rollout.finished[0].tolist()))
        return torch.full_like(skill, next(told)), subgoal

    observation = {k: v for k, v in batch_of(0).items() if k.startswith("observation")}
    for _ in range(45):
        policy.select_action(observation, override=tell)
    assert before == [
        (UNDECIDED, 0, [0, 0]),
        (0, 5, [0, 0]),
        (0, 10, [0, 0]),
        (1, 5, [1, 0]),  # half of 20 was enough
        (0, 20, [0, 0]),  # half of 11 was not: skill 0 goes on as if it had not been left
        (0, 25, [0, 0]),
        (0, 30, [0, 0]),
        (1, 5, [1, 0]),
        (1, 10, [1, 0]),
    ]
    assert policy._rollouts[threading.get_ident()].finished.tolist() == [[1, 1]]


def test_a_checkpoint_takes_in_the_segments_of_the_dataset_it_is_trained_on(build, meta, tmp_path):
    policy = build()
    policy.model.memory.shortest.fill_(40.0)
    policy.model.memory.longest.fill_(2.0)
    policy.save_pretrained(tmp_path)
    memory = BudsPolicy.from_pretrained(tmp_path, dataset_meta=meta).model.memory
    fresh = build().model.memory
    assert torch.equal(memory.shortest, fresh.shortest) and torch.equal(memory.longest, fresh.longest)


def test_labels_of_a_validation_are_those_of_the_frames(build, batch_of):
    """The loss of evaluation knows neither neighbours nor dropout."""
    policy = build(boundary_overlap_s=0.1).eval()
    batch = batch_of(*range(30))
    labels = Labels.of(batch)
    assert (labels.neighbour != labels.skill).any()
    swapped = dataclasses.replace(labels, neighbour=1 - labels.skill, neighbour_goal=labels.goal.flip(0))
    assert policy(batch)[1] == policy({**batch, **swapped.in_batch()})[1]
