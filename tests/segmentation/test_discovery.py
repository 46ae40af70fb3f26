import itertools
import logging
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.metrics import adjusted_rand_score, normalized_mutual_info_score

from lerobot_buds.core import ConfigError, SegmentationError, labels_of, segments_of
from lerobot_buds.segmentation import PRESETS, DiscoveryConfig, SkillDiscovery, preset, temporal_segments
from lerobot_buds.segmentation.cuts import CUTS


def assert_partition(found: SkillDiscovery, latents: list[np.ndarray]) -> None:
    for labels, segments, bounds, episode in zip(
        found.labels_, found.segments_, found.temporal_segments_, latents, strict=True
    ):
        assert labels.dtype == np.int64 and labels.shape == (len(episode),)
        np.testing.assert_array_equal(labels_of(segments), labels)
        assert all(a.end == b.start and a.label != b.label for a, b in itertools.pairwise(segments))
        assert sum(e - s for s, e in bounds.tolist()) == len(episode)
    joined = np.concatenate(found.labels_)
    assert sorted(set(joined.tolist())) == list(range(found.n_skills_))


@pytest.mark.parametrize("seed", range(3))
def test_stages_are_found(demonstrations: Callable[..., tuple], seed: int) -> None:
    latents, truth = demonstrations(seed=seed)
    found = SkillDiscovery(max_skills=4).fit(latents)
    assert_partition(found, latents)
    assert normalized_mutual_info_score(np.concatenate(truth), np.concatenate(found.labels_)) > 0.8


def test_scale_changes_nothing_and_the_penalty_does(demonstrations: Callable[..., tuple]) -> None:
    latents, _ = demonstrations(noise=1.0)
    for feature in ("line", "mean"):
        small = SkillDiscovery(feature=feature).fit([0.01 * h for h in latents])
        large = SkillDiscovery(feature=feature).fit([100 * h for h in latents])
        assert np.concatenate(small.labels_).tolist() == np.concatenate(large.labels_).tolist()
    plain = SkillDiscovery(feature="mean", length_penalty=0).fit(latents)
    assert [b.tolist() for b in plain.temporal_segments_] != [b.tolist() for b in large.temporal_segments_]


def test_same_seed_same_labels(demonstrations: Callable[..., tuple]) -> None:
    latents, _ = demonstrations(noise=2.0)
    first, second = (SkillDiscovery(random_state=3).fit(latents) for _ in range(2))
    assert np.concatenate(first.labels_).tolist() == np.concatenate(second.labels_).tolist()


@pytest.mark.parametrize("cut", CUTS)
def test_a_baseline_may_cut_in_the_place_of_the_tree(demonstrations: Callable[..., tuple], cut: str) -> None:
    latents, _ = demonstrations()
    estimator = DiscoveryConfig(cut=cut, max_skills=4).build(fps=20)
    found = estimator.fit(latents)
    assert_partition(found, latents)
    expected = [bounds.tolist() for bounds in CUTS[cut](latents, 20)]
    assert [bounds.tolist() for bounds in found.temporal_segments_] == expected
    assert [bounds.tolist() for bounds in estimator.cut(latents)] == expected


def test_an_unknown_cut_is_refused() -> None:
    with pytest.raises(ConfigError, match="Did you mean 'mean change points'"):
        DiscoveryConfig(cut="mean change point").build(fps=20)


@pytest.mark.parametrize("n_skills", [1, 3, 6, 9, 11])
def test_exact_number_of_skills(demonstrations: Callable[..., tuple], n_skills: int) -> None:
    latents, _ = demonstrations(noise=1.0)
    found = SkillDiscovery(n_skills=n_skills).fit(latents)
    assert_partition(found, latents)
    assert found.n_skills_ == n_skills


def test_more_skills_than_segments_is_refused_at_once(demonstrations: Callable[..., tuple]) -> None:
    latents, _ = demonstrations(count=2)
    with pytest.raises(SegmentationError, match=r"n_skills = 500 .* only \d+ temporal segments. Lower n_skills to"):
        SkillDiscovery(n_skills=500).fit(latents)


def test_what_cannot_work_is_refused_before_there_are_latents() -> None:
    SkillDiscovery(window=10, n_skills=12).check([100, 5, 0, 30])  # 9 bottom elements, 1, none and 2
    with pytest.raises(SegmentationError, match=r"4 demonstrations have only 12 temporal segments\. Lower n_skills"):
        SkillDiscovery(window=10, n_skills=13).check([100, 5, 0, 30])
    with pytest.raises(ConfigError, match="window = 0 cannot work"):
        SkillDiscovery(window=0).check([100])


@pytest.mark.parametrize("total", [1, 2, 3, 5])
def test_short_episodes_are_one_segment(total: int, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        found = SkillDiscovery().fit([np.random.default_rng(0).normal(size=(total, 2)), np.empty((0, 2))])
    assert found.temporal_segments_[0].tolist() == [[0, total]]
    assert [found.labels_[0].tolist(), found.labels_[1].tolist()] == [[0] * total, []]
    assert "No demonstration was cut" in caplog.text


def test_too_few_segments_are_told_with_a_number_that_works(caplog: pytest.LogCaptureFixture) -> None:
    latents = [np.random.default_rng(seed).normal(size=(60, 2)) for seed in range(3)]
    SkillDiscovery(feature="mean", window=10).fit(latents)
    assert "3 of 3 demonstrations are too short for 24 temporal segments" in caplog.text
    advised = int(caplog.text.split("segments_per_episode to at most ")[1].split(",")[0])
    caplog.clear()
    SkillDiscovery(feature="mean", window=10, segments_per_episode=advised).fit(latents)
    assert "too short" not in caplog.text


def test_uncut_demonstrations_are_cut_as_the_warning_says(caplog: pytest.LogCaptureFixture) -> None:
    latents = [np.random.default_rng(seed).normal(size=(200, 4)) for seed in range(4)]
    assert {len(bounds) for bounds in SkillDiscovery().fit(latents).temporal_segments_} == {1}
    assert "set segments_per_episode" in caplog.text
    caplog.clear()
    found = SkillDiscovery(segments_per_episode=4, min_skill_length=1).fit(latents)
    assert {len(bounds) for bounds in found.temporal_segments_} == {4}
    assert found.n_skills_ > 1 and not caplog.text


def test_constant_latents_are_one_skill() -> None:
    latents = [np.full((100, 3), 0.1), np.full((70, 3), 0.1)]
    assert SkillDiscovery().fit(latents).n_skills_ == 1
    with pytest.raises(SegmentationError, match="distinct groups only"):
        SkillDiscovery(n_skills=2).fit(latents)


def test_every_skill_under_the_minimum_leaves_one(
    demonstrations: Callable[..., tuple], caplog: pytest.LogCaptureFixture
) -> None:
    latents, _ = demonstrations()
    assert SkillDiscovery(min_skill_length=10_000).fit(latents).n_skills_ == 1
    assert "only the longest stays" in caplog.text
    advised = int(caplog.text.split("(min_skill_s) to at most ")[1].split(" ")[0])
    assert SkillDiscovery(min_skill_length=advised).fit(latents).n_skills_ > 1


def test_non_finite_latents_are_refused_with_their_place() -> None:
    latents = [np.zeros((30, 4)), np.zeros((30, 4))]
    latents[1][7, 2] = np.nan
    with pytest.raises(SegmentationError, match="episode 1, frame 7, dimension 2 is nan"):
        SkillDiscovery().fit(latents)


def test_shapes_and_emptiness_are_refused() -> None:
    with pytest.raises(SegmentationError, match=r"episode 1 have shape \(5, 3\)"):
        SkillDiscovery().fit([np.zeros((5, 2)), np.zeros((5, 3))])
    with pytest.raises(SegmentationError, match="no demonstrations"):
        SkillDiscovery().fit([])
    with pytest.raises(SegmentationError, match="no demonstrations"):
        SkillDiscovery().fit([np.empty((0, 2))])


@pytest.mark.parametrize("name", ["window", "max_skills", "num_keyframes", "passes", "length_penalty"])
def test_bad_parameters_are_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=f"{name} = -1 cannot work"):
        SkillDiscovery(**{name: -1}).fit([np.zeros((5, 2))])


def test_parameters_are_stored_unchanged() -> None:
    estimator = SkillDiscovery(window=7, n_skills=3)
    assert clone(estimator).get_params() == estimator.get_params()
    assert estimator.window == 7 and estimator.segments_per_episode is None


def test_config_converts_seconds() -> None:
    at20 = DiscoveryConfig().build(fps=20)
    assert at20.get_params() == SkillDiscovery().get_params()
    at50 = replace(DiscoveryConfig(), seed=4).build(fps=50)
    assert (at50.window, at50.min_segment_length, at50.min_skill_length) == (None, None, None)
    given = DiscoveryConfig(window_s=0.5, min_segment_s=1.0, min_skill_s=1.5).build(fps=50)
    assert (given.window, given.min_segment_length, given.min_skill_length) == (25, 50, 75)
    assert at50.length_penalty == pytest.approx(0.08) and at50.random_state == 4


def test_segments_from_elsewhere_take_the_trees_place(demonstrations: Callable[..., tuple]) -> None:
    latents, truth = demonstrations()
    bounds = [np.array([[s.start, s.end] for s in segments_of(stages)]) for stages in truth]
    found = SkillDiscovery(n_skills=3).fit(latents, segments=bounds)
    assert_partition(found, latents)
    assert found.temporal_segments_[0].tolist() == bounds[0].tolist()
    assert normalized_mutual_info_score(np.concatenate(truth), np.concatenate(found.labels_)) > 0.99


@pytest.mark.parametrize(
    "bounds", [[[0, 10]], [[0, 10], [11, 30]], [[5, 30]], [[0, 20], [10, 30]], [[0, 30], [30, 30]]]
)
def test_segments_that_do_not_tile_are_refused(bounds: list[list[int]]) -> None:
    with pytest.raises(SegmentationError, match="demonstration 0 do not tile its 30 frames"):
        SkillDiscovery().fit([np.zeros((30, 2))], segments=[np.array(bounds)])
    with pytest.raises(SegmentationError, match="segments of 0 demonstrations, but latents of 1"):
        SkillDiscovery().fit([np.zeros((30, 2))], segments=[])


def test_presets_follow_the_paper_and_the_release(demonstrations: Callable[..., tuple]) -> None:
    config = DiscoveryConfig(max_skills=4, num_keyframes=3)
    paper, released = (preset(name, config).build(20) for name in ("paper", "released"))
    assert (paper.feature, paper.length_penalty, paper.passes, paper.gamma) == ("mean", 0, 1, None)
    for published in (paper, released):
        assert (published.window, published.min_skill_length, published.search) == (10, 30, "levels")
        assert not published.consolidate
    assert (paper.min_segment_length, released.min_segment_length) == (20, 1)
    assert preset("paper", replace(config, window_s=1.0, min_skill_s=1.0)).build(20).window == 20
    assert (released.feature, released.passes) == ("three_frames", 2)
    assert released.length_penalty == pytest.approx(1 / 5) and not released.relative_penalty
    assert released.gamma == pytest.approx(0.0025) and released.max_skills == 4 and released.num_keyframes == 3
    assert preset("default", config) == config
    assert [preset(name, DiscoveryConfig()).build(20).max_skills for name in PRESETS] == [12, 10, 10]
    latents, _ = demonstrations(noise=1.0)
    for name in PRESETS:
        assert_partition(preset(name, config).build(20).fit(latents), latents)
    with pytest.raises(ConfigError, match="Did you mean 'paper'"):
        preset("papers", config)


def test_the_releases_penalty_depends_on_the_scale(demonstrations: Callable[..., tuple]) -> None:
    latents, _ = demonstrations(noise=1.0)
    cuts = [
        SkillDiscovery(feature="mean", relative_penalty=False).fit([scale * h for h in latents]).temporal_segments_
        for scale in (0.01, 100)
    ]
    assert [b.tolist() for b in cuts[0]] != [b.tolist() for b in cuts[1]]


@pytest.mark.parametrize(("name", "value"), [("feature", "median"), ("gamma", 0.0)])
def test_bad_choices_are_refused(name: str, value: object) -> None:
    with pytest.raises(ConfigError, match=str(value)):
        SkillDiscovery(**{name: value}).fit([np.zeros((5, 2))])


@pytest.mark.parametrize("stages", [2, 3, 5])
def test_the_number_of_skills_is_found(demonstrations: Callable[..., tuple], stages: int) -> None:
    latents, truth = demonstrations(count=8, stages=stages, seed=stages)
    pieces = [  # none straddles a boundary: whole stages, cut into thirds
        np.array([(s.start + i * s.length // 3, s.start + (i + 1) * s.length // 3) for s in runs for i in range(3)])
        for runs in map(segments_of, truth)
    ]
    found = SkillDiscovery(n_skills="auto", max_skills=8, min_skill_length=10).fit(latents, segments=pieces)
    assert found.n_skills_ == stages
    assert max(found.scores_, key=found.scores_.__getitem__) == stages
    assert set(found.scores_) == set(range(2, 9)) and all(-1 <= score <= 1 for score in found.scores_.values())
    assert adjusted_rand_score(np.concatenate(truth), np.concatenate(found.labels_)) > 0.9


def test_one_segment_is_one_skill_when_the_number_is_free() -> None:
    found = SkillDiscovery(n_skills="auto").fit([np.random.default_rng(0).normal(size=(12, 3))])
    assert found.n_skills_ == 1 and found.scores_ == {}


def test_best_first_gives_the_count_that_was_asked_for(demonstrations: Callable[..., tuple]) -> None:
    latents, _ = demonstrations()
    found = SkillDiscovery(segments_per_episode=7, search="best_first").fit(latents)
    assert {len(bounds) for bounds in found.temporal_segments_} == {7}


def test_trees_are_those_that_are_cut(demonstrations: Callable[..., tuple]) -> None:
    latents = [*demonstrations()[0], np.empty((0, 8))]
    discovery = SkillDiscovery(window=5, segments_per_episode=4, min_segment_length=5, feature="mean")
    trees = discovery.trees(latents)
    assert list(trees) == list(range(len(latents) - 1))
    for place, tree in trees.items():
        assert (temporal_segments(tree, 4, 5, "best_first") == discovery.cut(latents)[place]).all()
    by_line = discovery.set_params(feature="line").trees(latents)
    assert [tree.bounds[tree.root].tolist() for tree in by_line.values()] == [[0, len(x)] for x in latents[:-1]]
