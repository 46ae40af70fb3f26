"""Stages are found in short and in long demonstrations without a setting, and every time the same."""

from dataclasses import replace

import numpy as np
import pytest
from sklearn.metrics import adjusted_rand_score, normalized_mutual_info_score

from lerobot_buds.core import segments_of
from lerobot_buds.segmentation import DiscoveryConfig, SkillDiscovery
from lerobot_buds.segmentation.consolidate import consolidate
from lerobot_buds.segmentation.durations import count_segments, min_skill_of, window_of
from lerobot_buds.segmentation.lines import LineFits, line_tree, settle_boundaries

pytestmark = pytest.mark.slow


def movements(
    seconds: float, stages: int, seed: int = 0, count: int = 20, fps: int = 30, jitter: float = 0.2
) -> tuple[list, list]:
    """Latents that rest at a place and move to the next with minimum jerk; the stages are the movements."""
    rng = np.random.default_rng(seed)
    places = rng.normal(size=(stages + 1, 6))
    latents, truth = [], []
    for _ in range(count):
        total = int(seconds * fps)
        cuts = np.arange(1, stages) * total / stages + rng.uniform(-jitter, jitter, stages - 1) * fps
        lengths = np.diff([0, *cuts.astype(int).tolist(), total])
        stage = np.repeat(np.arange(stages), lengths)
        s = np.concatenate([np.linspace(0, 1, length) for length in lengths])[:, None]
        path = places[stage] + (10 * s**3 - 15 * s**4 + 6 * s**5) * (places[stage + 1] - places[stage])
        latents.append(path + 0.02 * rng.normal(size=path.shape))
        truth.append(stage)
    return latents, truth


def nmi(truth: list, found: SkillDiscovery) -> float:
    return float(normalized_mutual_info_score(np.concatenate(truth), np.concatenate(found.labels_)))


@pytest.mark.parametrize(("seconds", "stages"), [(6, 3), (6, 6), (8, 4), (20, 5), (120, 4)])
def test_stages_are_found_at_any_length_without_a_setting(seconds: float, stages: int) -> None:
    latents, truth = movements(seconds, stages)
    found = DiscoveryConfig().build(30).fit(latents)
    assert nmi(truth, found) >= 0.7
    assert found.durations_.window == window_of([len(h) for h in latents]) == max(2, round(seconds * 30 / 50))
    assert stages <= found.durations_.segments_per_episode <= stages + 1


@pytest.mark.parametrize("fps", [5, 10, 60])
def test_the_frame_rate_does_not_matter(fps: int) -> None:
    latents, truth = movements(8, 4, fps=fps)
    assert nmi(truth, DiscoveryConfig().build(fps).fit(latents)) >= 0.7


def test_a_skill_may_recur_within_a_demonstration() -> None:
    latents, truth = movements(8, 4)
    twice = [np.concatenate([h, h + 1e-3]) for h in latents]
    found = SkillDiscovery().fit(twice)
    recurring = [len(segments_of(e)) > len(set(e.tolist())) for e in found.labels_]
    assert np.mean(recurring) > 0.9
    assert nmi([np.concatenate([t, t]) for t in truth], found) >= 0.7


def test_half_a_second_is_enough_for_clean_stages() -> None:
    latents, truth = movements(0.5, 3, fps=60, jitter=0.02)
    assert nmi(truth, DiscoveryConfig().build(60).fit(latents)) >= 0.7


def test_noise_has_no_movements() -> None:
    lines = LineFits(np.random.default_rng(0).normal(size=(300, 5)))
    counts, _ = count_segments([lines], [line_tree(lines, 300, 6)[1]])
    assert counts == [1]
    still = LineFits(np.full((300, 5), 0.1))
    assert still.variation == 0 and count_segments([still], [line_tree(still, 300, 6)[1]])[0] == [1]


def test_residuals_are_those_of_least_squares() -> None:
    latents = np.random.default_rng(0).normal(size=(40, 3)).cumsum(axis=0)
    t = np.arange(7, 29)
    design = np.stack([np.ones(len(t)), t], axis=1)
    expected = np.linalg.lstsq(design, latents[7:29], rcond=None)[1].sum()
    assert float(LineFits(latents).residual(7, 29)) == pytest.approx(expected)
    np.testing.assert_allclose(
        LineFits(latents).residual(np.array([3, 7]), np.array([4, 29])), [0, expected], atol=1e-9
    )


def test_boundaries_settle_where_the_motion_turns() -> None:
    up = np.linspace(0, 1, 50)[:, None]
    latents = np.concatenate([up, 1 - up])
    settled = settle_boundaries(LineFits(latents), np.array([[0, 35], [35, 100]]), 3)
    assert settled.tolist() in ([[0, 50], [50, 100]], [[0, 51], [51, 100]], [[0, 49], [49, 100]])


def test_pieces_of_one_movement_are_joined_and_others_are_not() -> None:
    up = np.linspace(0, 1, 60)[:, None]
    latents = np.concatenate([up, 1 - up]) + 1e-3 * np.random.default_rng(0).normal(size=(120, 1))
    labels = np.repeat([0, 1, 2], [25, 35, 60])
    lines = [LineFits(latents)] * 4
    assert consolidate([labels] * 4, lines, 0.02)[0].tolist() == np.repeat([0, 2], 60).tolist()
    apart = np.repeat([1, 3, 2], [25, 35, 60])  # label 1 occurs without label 0 as often as with it
    assert len(np.unique(consolidate([labels, labels, apart, apart], lines, 0.02)[0])) == 3


def test_the_same_skills_from_slightly_different_latents() -> None:
    latents, _ = movements(8, 4)
    found = SkillDiscovery().fit(latents)
    single = SkillDiscovery().fit([h.astype(np.float32) for h in latents])
    assert adjusted_rand_score(np.concatenate(found.labels_), np.concatenate(single.labels_)) == 1.0
    rng = np.random.default_rng(1)
    noisy = SkillDiscovery(random_state=5).fit([h * (1 + 1e-3 * rng.normal(size=h.shape)) for h in latents])
    assert adjusted_rand_score(np.concatenate(found.labels_), np.concatenate(noisy.labels_)) >= 0.95
    assert found.check_stability(latents) == found.stability_ >= 0.9


def test_stability_is_low_where_nothing_holds() -> None:
    latents = [np.random.default_rng(seed).normal(size=(120, 4)) for seed in range(8)]
    found = SkillDiscovery(segments_per_episode=6, min_skill_length=1).fit(latents)
    assert found.check_stability(latents) < 0.6
    assert SkillDiscovery(n_skills=1).fit(latents).check_stability(latents) == 1.0


def test_settings_keep_the_durations_that_were_found() -> None:
    latents, _ = movements(8, 4)
    found = DiscoveryConfig().build(30).fit(latents)
    settled = DiscoveryConfig().settled(found, 30)
    again = settled.build(30)
    again.cut(latents[:1])
    assert again.durations_ == found.durations_
    assert settled.max_skills == again.max_skills == found.max_skills
    open_again = dict.fromkeys(("max_skills", "window_s", "min_segment_s", "min_skill_s", "segment_worth"))
    assert replace(settled, **open_again) == DiscoveryConfig()
    assert found.durations_.min_skill_length == min_skill_of([240])


def test_skills_that_take_turns_are_rounds_and_no_pieces() -> None:
    """On one line throughout, so that nothing but the order speaks against joining them."""
    lines = [LineFits(np.linspace(0, 1, 120)[:, None])] * 4
    turns, once = np.repeat([0, 1, 0, 1], 30), np.repeat([0, 1], 60)
    assert len(np.unique(consolidate([turns] * 4, lines, 0.02)[0])) == 2
    assert len(np.unique(consolidate([once] * 4, lines, 0.02)[0])) == 1


def test_one_skill_is_said_to_be_one_and_the_advice_works(caplog: pytest.LogCaptureFixture) -> None:
    latents, _ = movements(8, 4)
    assert SkillDiscovery(min_skill_length=200).fit(latents).n_skills_ == 1
    assert "came out as one skill" in caplog.text and "set n_skills" in caplog.text
    caplog.clear()
    assert SkillDiscovery(min_skill_length=200, n_skills=4).fit(latents).n_skills_ == 4
    assert "one skill" not in caplog.text
