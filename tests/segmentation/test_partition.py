import tracemalloc

import numpy as np
import pytest
from sklearn.metrics import adjusted_rand_score

from lerobot_buds.segmentation import clustering
from lerobot_buds.segmentation.clustering import auto_gamma, cluster
from lerobot_buds.segmentation.partition import dissolve_short_skills, keyframe_features, renumber


def test_keyframes_are_first_middle_last() -> None:
    latents = np.arange(20.0)[:, None]
    bounds = np.array([[0, 9], [9, 20], [3, 4]])
    assert keyframe_features(latents, bounds, 3).tolist() == [[0, 4, 8], [9, 14, 19], [3, 3, 3]]
    assert keyframe_features(latents, bounds, 5)[0].tolist() == [0, 2, 4, 6, 8]


def line(lengths: list[int], labels: list[int]) -> np.ndarray:
    return np.repeat(np.array(labels), lengths)


def dissolve(latents: list[np.ndarray], labels: list[np.ndarray], minimum: int) -> list[list[int]]:
    return [episode.tolist() for episode in dissolve_short_skills(latents, labels, minimum, 3)]


def test_a_short_skill_goes_to_the_nearer_neighbour() -> None:
    labels = line([30, 4, 30], [0, 1, 2])
    latents = np.repeat([[0.0], [6.0], [10.0]], [30, 4, 30], axis=0)
    assert dissolve([latents], [labels], 10) == [line([30, 34], [0, 2]).tolist()]
    latents = np.repeat([[0.0], [4.0], [10.0]], [30, 4, 30], axis=0)
    assert dissolve([latents], [labels], 10) == [line([34, 30], [0, 2]).tolist()]


def test_ties_go_to_the_next() -> None:
    labels = line([30, 4, 30], [0, 1, 2])
    latents = np.repeat([[0.0], [5.0], [10.0]], [30, 4, 30], axis=0)
    assert dissolve([latents], [labels], 10) == [line([30, 34], [0, 2]).tolist()]


def test_a_neighbour_that_stays_is_preferred() -> None:
    # Label 1 is nearer to label 2, which goes as well.
    labels = line([30, 3, 4, 30], [0, 1, 2, 3])
    latents = np.repeat([[0.0], [9.0], [9.5], [10.0]], [30, 3, 4, 30], axis=0)
    assert dissolve([latents], [labels], 10) == [line([33, 34], [0, 3]).tolist()]


def test_a_whole_demonstration_takes_the_nearest_skill_that_stays() -> None:
    labels = [line([40, 40], [0, 1]), line([5], [2])]
    latents = [np.repeat([[0.0], [10.0]], 40, axis=0), np.full((5, 1), 8.0)]
    assert dissolve(latents, labels, 10)[1] == [1] * 5


def test_a_demonstration_of_short_skills_only() -> None:
    labels = [line([60], [0]), line([3, 4, 3], [1, 2, 1])]
    latents = [np.zeros((60, 1)), np.ones((10, 1))]
    assert dissolve(latents, labels, 10)[1] == [0] * 10


def test_the_inputs_are_left_alone() -> None:
    labels = line([30, 4, 30], [0, 1, 2])
    before = labels.copy()
    dissolve([np.zeros((64, 1))], [labels], 10)
    assert labels.tolist() == before.tolist()


def test_renumber_by_first_appearance() -> None:
    assert [e.tolist() for e in renumber([np.array([5, 5, 2]), np.array([], dtype=int), np.array([7, 2])])] == [
        [0, 0, 1],
        [],
        [2, 1],
    ]


def blobs(per: int, count: int = 4, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    truth = np.repeat(np.arange(count), per)
    return rng.normal(size=(count, 6))[truth] * 10 + rng.normal(size=(count * per, 6)), truth


def test_clusters_are_found() -> None:
    features, truth = blobs(20)
    assert adjusted_rand_score(truth, cluster(features, 4, 0)) == 1.0


def test_some_segments_stand_for_many(monkeypatch: pytest.MonkeyPatch) -> None:
    features, truth = blobs(60)
    monkeypatch.setattr(clustering, "MAX_CLUSTERED", 50)
    assert adjusted_rand_score(truth, cluster(features, 4, 0)) == 1.0


def test_the_kernel_of_many_segments_stays_small() -> None:
    features, truth = blobs(2000)
    tracemalloc.start()
    labels = cluster(features, 4, 0)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert adjusted_rand_score(truth, labels) == 1.0
    assert peak < 0.3 * 2**30  # one kernel of all 8,000 would be 0.5 GB


@pytest.mark.parametrize("count", [1, 2, 3])
def test_no_more_clusters_than_distinct_segments(count: int) -> None:
    features = np.repeat(np.eye(count), 5, axis=0)
    assert len(set(cluster(features, 8, 0).tolist())) == count


def test_as_many_clusters_as_segments() -> None:
    assert cluster(np.eye(3), 3, 0).tolist() == [0, 1, 2]
    assert cluster(np.eye(1), 3, 0).tolist() == [0]


def test_far_outliers_do_not_break_the_kernel() -> None:
    features = np.concatenate([blobs(15)[0], np.full((1, 6), 1e6)])
    labels = cluster(features, 5, 0)
    assert len(labels) == 61 and set(labels.tolist()) <= set(range(5))


def test_gamma_is_finite_with_many_copies() -> None:
    features = np.concatenate([np.zeros((50, 2)), np.ones((50, 2))])
    assert np.isfinite(auto_gamma(features)) and auto_gamma(features) > 0
    rng = np.random.default_rng(0).normal(size=(50, 2))
    assert auto_gamma(10 * rng) == pytest.approx(auto_gamma(rng) / 100)
