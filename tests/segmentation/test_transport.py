"""The optimal-transport baseline: the plan is a minimum of what is written, and known segments are found."""

import numpy as np
import pytest

from lerobot_buds.segmentation.cuts import CUTS
from lerobot_buds.segmentation.transport import prototypes_of, transport_plan, transport_segments


def objective(plan, cost, radius, structure, balance, entropy):
    """What `transport_plan` says it minimises, a frame's mass being 1, by plain loops over pairs of frames."""
    frames, count = plan.shape
    apart = sum(
        plan[i].sum() * plan[j].sum() - plan[i] @ plan[j]
        for i in range(frames)
        for j in range(max(0, i - radius), min(frames, i + radius + 1))
        if i != j
    )
    share = plan.mean(axis=0)
    unequal = frames * (share * np.log(share * count)).sum()
    near = (1 - structure) * (cost * plan).sum() + structure * apart / (2 * radius)
    return near + balance * unequal + entropy * (plan * np.log(plan)).sum()


@pytest.mark.parametrize("seed", range(4))
def test_no_plan_nearby_is_better(seed):
    rng = np.random.default_rng(seed)
    cost, settings = rng.uniform(0, 2, size=(12, 3)), (3, 0.4, 0.05, 0.2)
    plan = transport_plan(cost, *settings)
    assert plan.shape == (12, 3) and plan.sum(axis=1) == pytest.approx(1)
    best = objective(plan, cost, *settings)
    for _ in range(200):
        other = plan * np.exp(0.05 * rng.normal(size=plan.shape))
        assert objective(other / other.sum(axis=1, keepdims=True), cost, *settings) > best - 1e-6


@pytest.mark.parametrize("seed", range(3))
def test_known_segments_are_found_and_a_moment_elsewhere_is_not_one(demonstrations, seed):
    latents, truth = demonstrations(seed=seed)
    latents[0][20:22] = latents[0][-1]  # two frames of another stage: an outlier, no segment
    prototypes = prototypes_of(latents, 3)
    for episode, stages in zip(latents, truth, strict=True):
        spans = transport_segments(episode, prototypes, 8, 10)
        assert len(spans) == 3
        assert np.abs(spans[1:, 0] - (np.flatnonzero(np.diff(stages)) + 1)).max() <= 6


def test_consistency_is_what_joins_frames():
    cost = np.tile([[0.4, 0.6], [0.6, 0.4]], (20, 1))
    alone, together = (transport_plan(cost, 5, structure=s).argmax(axis=1) for s in (0.0, 0.4))
    assert np.abs(np.diff(alone)).sum() == 39
    assert np.abs(np.diff(together)).sum() < 39


def test_a_prototype_takes_less_where_balance_is_cheap():
    cost = np.tile([0.2, 1.8], (40, 1))
    cost[:4] = [1.0, 0.9]
    shares = [transport_plan(cost, 3, balance=b).mean(axis=0)[1] for b in (0.0, 0.05, 5.0)]
    assert shares[0] < shares[1] < shares[2] and shares[2] > 0.4


def test_the_same_latents_have_the_same_cuts_and_few_frames_few_prototypes(demonstrations):
    latents, _ = demonstrations(noise=1.0)
    first, second = (CUTS["optimal transport"](latents, 20) for _ in range(2))
    assert [s.tolist() for s in first] == [s.tolist() for s in second]
    assert len(prototypes_of([np.zeros((30, 2)), np.ones((5, 2))], 12)) == 2
