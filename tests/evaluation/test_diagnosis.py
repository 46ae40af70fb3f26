"""Errors by who decides: where it makes no difference they are the same, and they are what they say."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from lerobot.datasets import LeRobotDatasetMetadata
from lerobot.policies import make_policy

from lerobot_buds.core import ACTION
from lerobot_buds.data import read_table
from lerobot_buds.evaluation import diagnosis
from lerobot_buds.evaluation.diagnosis import diagnose
from lerobot_buds.evaluation.recorded import RecordedFrames
from lerobot_buds.policy import BudsConfig
from lerobot_buds.segmentation import load_labels

EPISODES = np.array([0, 2])


@pytest.fixture
def made(segmented: Path, small: dict):
    """Makes an untrained policy and its frames."""

    def made(**settings):
        torch.manual_seed(0)
        meta = LeRobotDatasetMetadata("tests/x", root=segmented)
        policy = make_policy(BudsConfig(**small | settings), ds_meta=meta)
        return policy, RecordedFrames(segmented, policy)

    return made


def say_nothing(layers: torch.nn.Module) -> None:
    """Makes all outputs of a perceptron 0."""
    torch.nn.init.zeros_(layers[-1].weight)
    torch.nn.init.zeros_(layers[-1].bias)


@pytest.fixture
def rows(segmented: Path):
    """Frames of the episodes, and their skills."""
    table = read_table(segmented, [ACTION])
    numbers = [np.arange(table.starts[e], table.ends[e]) for e in EPISODES]
    _, skills, _ = load_labels(segmented)
    return numbers, [skills[part] for part in numbers], table.columns[ACTION]


def test_skills_that_all_do_the_same_err_the_same_whoever_decides(made, rows) -> None:
    policy, frames = made()
    for skill in policy.model.skills.skills:
        say_nothing(skill.head)
    report = diagnose(policy, frames, EPISODES)
    numbers, _, actions = rows
    done = actions[np.concatenate(numbers)]
    assert report["frames"] == len(done)
    expected = pytest.approx(float((done**2).sum(axis=1).mean()), abs=1e-3)  # of an arm that does not move
    assert report["errors"] == dict.fromkeys(("chosen", "held", "imagined", "shuffled"), expected)
    assert set(report["near"]) == {"0.25 s", "0.5 s", "1 s"}
    assert all(len(set(errors.values())) == 1 for errors in report["near"].values())
    json.dumps(report)


def test_decisions_are_counted_against_the_labels(made, rows) -> None:
    """The meta controller always picks skill 0 and imagines nothing."""
    policy, frames = made(skill_memory=False)
    (controller,) = policy.model.meta_controllers.controllers
    say_nothing(controller.id_head)
    say_nothing(controller.decoder)
    controller.id_head[-1].bias.data[0] = 1.0
    report = diagnose(policy, frames, EPISODES)
    _, skills, _ = rows
    right = np.concatenate([part == 0 for part in skills])
    near = []
    for part in skills:
        bounds = np.flatnonzero(np.diff(part)) + 1
        near.append([any(abs(t - b) < 10 for b in bounds) for t in range(len(part))])
    assert report["skill_ids"] == {
        "right": pytest.approx(right.mean(), abs=1e-4),
        "right_near": pytest.approx(right[np.concatenate(near)].mean(), abs=1e-4),
        "switches": 0.0,
        "switches_demonstrated": np.mean([(np.diff(part) != 0).sum() for part in skills]),
    }
    assert report["errors"]["imagined"] != report["errors"]["held"]
    labels = frames.labels(np.concatenate(rows[0]))
    with torch.no_grad():
        subgoals = policy.model.encode_goals(labels.skill, labels.goal)[0]
    error = float(subgoals.square().sum(dim=1).mean())
    assert report["subgoals"]["imagined_error"] == pytest.approx(error, rel=1e-3)
    assert 0 < report["subgoals"]["spread_within"] < error


def test_a_meta_controller_that_is_right_chooses_what_is_held(made, monkeypatch) -> None:
    """What it chooses are labels and goals: the errors are those of the truth."""
    policy, frames = made(subgoal_space="latent", chunk_size=3, n_action_steps=3)
    act_along, truth = diagnosis._act_along, diagnosis._Truth
    rows, real = diagnosis._lockstep(frames, EPISODES)
    with torch.no_grad():
        known = truth.of(policy.model, frames, rows, torch.from_numpy(real), np.random.default_rng(0))
    always_right = [known.skills, known.exact]
    monkeypatch.setattr(diagnosis, "_act_along", lambda *given: act_along(*given[:3], *(given[3:] or always_right)))
    report = diagnose(policy, frames, EPISODES)
    assert report["errors"]["chosen"] == report["errors"]["held"] != report["errors"]["shuffled"]
    assert report["skill_ids"]["right"] > 0.8  # a decision is at most a quarter of a second late


def test_a_flat_policy_has_one_error(made) -> None:
    policy, frames = made(skills="flat")
    report = diagnose(policy, frames, EPISODES)
    assert set(report) == {"frames", "errors"} and set(report["errors"]) == {"chosen"}


def test_the_seed_shuffles_and_changes_nothing_else(made) -> None:
    policy, frames = made()
    first, again = (diagnose(policy, frames, EPISODES[:1], seed=seed) for seed in (0, 1))
    assert first["errors"].pop("shuffled") != again["errors"].pop("shuffled")
    assert first["errors"] == again["errors"] and first["skill_ids"] == again["skill_ids"]


def test_distances_to_boundaries() -> None:
    skills = np.array([[0, 0, 1, 1, 1, 0], [2, 2, 2, 2, 2, 2], [0, 1, 1, 1, 1, 1]]).T
    real = np.array([[True] * 6, [True] * 6, [True] * 4 + [False] * 2]).T
    distance = diagnosis._to_boundary(skills, real)
    assert distance[:, 0].tolist() == [2, 1, 0, 1, 1, 0]
    assert distance[:4, 2].tolist() == [1, 0, 1, 2] and distance[:, 1].min() > 1e9
    assert diagnosis._switches(skills, real) == 1.0


def test_shuffled_subgoals_stay_with_their_skill() -> None:
    skills = torch.tensor([[0, 1], [0, 1], [0, 1], [1, 1], [1, 1]])
    subgoals = torch.arange(10.0).view(5, 2, 1)
    real = torch.tensor([[True, True]] * 4 + [[True, False]])
    shuffled = diagnosis._shuffled(skills, subgoals, real, np.random.default_rng(3))
    assert not torch.equal(shuffled, subgoals) and shuffled[4, 1] == 9  # padding is dealt out to nobody
    for skill in (0, 1):
        before, after = subgoals[skills == skill].flatten(), shuffled[skills == skill].flatten()
        assert sorted(after.tolist()) == before.tolist()
