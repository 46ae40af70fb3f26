"""Baselines: each tiles any demonstration, and finds what it is made to find."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lerobot_buds.segmentation import baselines, prediction, transport


def steps(lengths=(60, 80, 50), dims=6, noise=0.2, seed=0):
    """Latents that stay at one place per stage, and where the stages begin."""
    rng = np.random.default_rng(seed)
    places = rng.normal(size=(len(lengths), dims)) * 3
    latents = np.repeat(places, lengths, axis=0)
    return latents + noise * rng.normal(size=latents.shape), np.cumsum(lengths)[:-1]


CUTTERS = {
    "uniform": lambda x, n: baselines.uniform_segments(len(x), n),
    "kernel": lambda x, n: baselines.kernel_change_points(x, n, baselines.kernel_width([x])),
    "mean": baselines.mean_change_points,
    "map": lambda x, n: baselines.map_change_points(x, 5, 60, 30, n),
    "uvd": lambda x, n: baselines.visual_subgoals(x, n, 2.5),
    "prediction": lambda x, n: prediction.surprising_moments(prediction.prediction_errors([x], 5), n, 2.5)[0],
    "transport": lambda x, n: transport.transport_segments(x, transport.prototypes_of([x], 5), 8, n),
    "grip": lambda x, n: baselines.grip_and_rest(x[:, :3], x[:, 0], n, 2.5),
}


@pytest.mark.parametrize("name", CUTTERS)
@settings(max_examples=25)
@given(
    total=st.integers(1, 150),
    min_length=st.integers(2, 25),
    kind=st.sampled_from(["walk", "still"]),
    seed=st.integers(0, 99),
)
def test_any_result_tiles_the_demonstration(name, total, min_length, kind, seed):
    x = np.zeros((total, 4)) if kind == "still" else np.random.default_rng(seed).normal(size=(total, 4)).cumsum(axis=0)
    bounds = CUTTERS[name](x, min_length)
    assert bounds.dtype == np.int64
    assert (bounds[0, 0], bounds[-1, 1]) == (0, total)
    assert all(a[1] == b[0] for a, b in itertools.pairwise(bounds.tolist()))
    lengths = bounds[:, 1] - bounds[:, 0]
    assert len(bounds) == 1 or lengths.min() >= min_length


def test_no_frames_have_no_segments():
    assert baselines.tile([], 0).shape == (0, 2)


@pytest.mark.parametrize("name", ["kernel", "mean", "map"])
@pytest.mark.parametrize("seed", range(3))
def test_change_points_find_clear_changes_and_nothing_else(name, seed):
    latents, true = steps(seed=seed)
    found = CUTTERS[name](latents, 20)[1:, 0]
    assert len(found) == len(true)
    assert np.abs(found - true).max() <= 3


def test_the_map_segmentation_is_the_best_of_all():
    rng = np.random.default_rng(0)
    latents = np.repeat(rng.normal(size=(3, 2)), [4, 3, 5], axis=0) + 0.3 * rng.normal(size=(12, 2))
    lines = baselines._LineFits(latents)

    def value(cuts):
        edges = [0, *cuts, 12]
        return sum(
            float(lines.evidence(np.array([a]), b)[0]) - 0.5 * ((b - a - 4) / 2) ** 2 - np.log(2)
            for a, b in itertools.pairwise(edges)
        )

    every = [
        cuts
        for n in range(6)
        for cuts in itertools.combinations(range(1, 12), n)
        if all(b - a >= 2 for a, b in itertools.pairwise([0, *cuts, 12]))
    ]
    found = baselines.map_change_points(latents, 1, 4, 2, 2)
    assert value(found[1:, 0].tolist()) == pytest.approx(max(map(value, every)))


def test_a_line_has_more_evidence_than_a_bent_one():
    t = np.linspace(0, 1, 20)[:, None]
    noise = 0.01 * np.random.default_rng(0).normal(size=(20, 1))
    straight, bent = baselines._LineFits(t + noise), baselines._LineFits(np.abs(t - 0.5) + noise)
    whole = np.array([0])
    assert straight.evidence(whole, 20)[0] > bent.evidence(whole, 20)[0] + 10


def test_uvd_walks_back_from_the_end():
    """Two straight legs with a turn: seen from the end, the distance grows back to the start of the second leg."""
    out = np.linspace([0, 0], [10, 0], 60)
    back = np.linspace([10, 0], [0, 1], 60)
    found = baselines.visual_subgoals(np.concatenate([out, back]), 15, 2.5)
    assert len(found) == 2 and abs(found[1, 0] - 60) <= 4


def test_the_heuristic_cuts_at_grips_and_rests():
    way = np.concatenate([np.linspace(0, 1, 40), np.ones(10), np.linspace(1, 2, 50)])
    gripper = np.where(np.arange(100) < 80, 0.04, 0.0)
    cuts = baselines.grip_and_rest(np.stack([way, way, way], 1), gripper, 12, 1.5)[1:, 0]
    assert 80 in cuts.tolist()
    assert any(38 <= cut <= 52 for cut in cuts.tolist())
    assert len(cuts) <= 3


def test_stages_are_cut_where_they_change():
    assert baselines.stage_segments(np.array([0, 0, 3, 3, 3, 0])).tolist() == [[0, 2], [2, 5], [5, 6]]


def test_the_kernels_width_does_not_mind_still_frames():
    assert baselines.kernel_width([np.zeros((50, 3))]) == 1.0
    x = np.random.default_rng(0).normal(size=(3000, 5))
    assert baselines.kernel_width([x]) == pytest.approx(1 / 9.3, rel=0.15)  # squared distances: 2 chi-squared, 5 dims
