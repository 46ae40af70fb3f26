import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lerobot_buds.core import SegmentationError
from lerobot_buds.segmentation.temporal import temporal_segments
from lerobot_buds.segmentation.tree import adjacent_distances, build_tree, window_bounds


def mean(latents: np.ndarray, start: int, end: int) -> np.ndarray:
    return latents[start:end].mean(axis=0)


def three_frames(latents: np.ndarray, start: int, end: int) -> np.ndarray:
    """The released code's feature of the closed interval whose last frame is the next segment's first."""
    last = min(end, len(latents) - 1)
    return np.mean([latents[start], latents[(start + last) // 2], latents[last]], axis=0)


def naive_merges(latents: np.ndarray, window: int, penalty: float, feature=mean) -> list[tuple[int, int]]:
    """The published loop: every feature and every distance from scratch before every merge."""
    parts = [tuple(b) for b in window_bounds(len(latents), window).tolist()]
    merges = []
    while len(parts) > 1:
        means = [feature(latents, s, e) for s, e in parts]
        costs = [
            np.linalg.norm(means[i] - means[i + 1]) + penalty * (parts[i + 1][1] - parts[i][0]) / len(parts)
            for i in range(len(parts) - 1)
        ]
        i = int(np.argmin(costs))
        parts[i : i + 2] = [(parts[i][0], parts[i + 1][1])]
        merges.append(parts[i])
    return merges


@pytest.mark.parametrize("penalty", [0.0, 0.2])
@pytest.mark.parametrize("total", [5, 21, 22, 23, 57, 200, 501, 2000])
def test_tree_equals_the_naive_loop(total: int, penalty: float) -> None:
    latents = np.random.default_rng(total).normal(size=(total, 4)).cumsum(axis=0)
    tree = build_tree(latents, 10, penalty)
    bottom = len(window_bounds(total, 10))
    assert [tuple(b) for b in tree.bounds[bottom:].tolist()] == naive_merges(latents, 10, penalty)
    released = build_tree(latents, 10, penalty, "three_frames")
    assert [tuple(b) for b in released.bounds[bottom:].tolist()] == naive_merges(latents, 10, penalty, three_frames)


@settings(max_examples=40)
@given(st.integers(5, 300), st.integers(1, 12), st.sampled_from([0.0, 0.05, 1.0]), st.integers(0, 1000))
def test_random_trees_equal_the_naive_loop(total: int, window: int, penalty: float, seed: int) -> None:
    latents = np.random.default_rng(seed).normal(size=(total, 3))
    tree = build_tree(latents, window, penalty)
    bottom = len(window_bounds(total, window))
    assert [tuple(b) for b in tree.bounds[bottom:].tolist()] == naive_merges(latents, window, penalty)


@given(st.integers(1, 500), st.integers(1, 40))
def test_windows_tile_and_follow_the_published_count(total: int, window: int) -> None:
    bounds = window_bounds(total, window)
    assert len(bounds) == max(1, int(np.ceil((total - 1) / window)) - 1)
    assert bounds[0, 0] == 0 and bounds[-1, 1] == total
    assert (bounds[1:, 0] == bounds[:-1, 1]).all()
    assert (bounds[:-1, 1] - bounds[:-1, 0] == window).all()
    assert len(bounds) == 1 or window + 2 <= bounds[-1, 1] - bounds[-1, 0] <= 2 * window + 1


@given(st.integers(1, 300), st.integers(0, 1000))
def test_nodes_span_their_children_in_time_order(total: int, seed: int) -> None:
    tree = build_tree(np.random.default_rng(seed).normal(size=(total, 2)), 10, 0.2)
    assert tree.bounds[tree.root].tolist() == [0, total]
    for bounds, children in zip(tree.bounds, tree.children, strict=True):
        if children[0] >= 0:
            left, right = tree.bounds[children]
            assert left[1] == right[0]
            assert bounds.tolist() == [left[0], right[1]]


def test_equal_latents_merge_from_the_left() -> None:
    tree = build_tree(np.ones((60, 3)), 10)
    assert tree.bounds[5:].tolist() == [[0, 20], [0, 30], [0, 40], [0, 60]]


def test_an_empty_demonstration_is_refused() -> None:
    assert len(window_bounds(0, 10)) == 0
    with pytest.raises(SegmentationError, match="empty episode"):
        build_tree(np.empty((0, 2)), 10)


def test_adjacent_distances_see_the_step() -> None:
    latents = np.repeat([[0.0], [3.0], [3.0]], [10, 10, 12], axis=0)
    np.testing.assert_allclose(adjacent_distances(latents, 10), [3.0, 0.0], atol=1e-12)


@given(st.integers(1, 400), st.integers(1, 40), st.integers(0, 60), st.integers(0, 1000))
def test_temporal_segments_tile_and_stop(total: int, count: int, min_length: int, seed: int) -> None:
    tree = build_tree(np.random.default_rng(seed).normal(size=(total, 3)), 10)
    bounds = temporal_segments(tree, count, min_length)
    assert bounds[0, 0] == 0 and bounds[-1, 1] == total
    assert (bounds[1:, 0] == bounds[:-1, 1]).all()
    bottom = {tuple(b) for b in window_bounds(total, 10).tolist()}
    if len(bounds) < count:  # nothing was left to split
        assert all(e - s <= min_length or (s, e) in bottom for s, e in bounds.tolist())
    for start, end in bounds.tolist():  # every segment's parent was worth splitting
        parents = [
            tree.bounds[i] for i in range(len(tree.bounds)) if [start, end] in tree.bounds[tree.children[i]].tolist()
        ]
        assert end - start == total or any(e - s > min_length for s, e in parents)


def test_the_search_stops_at_the_first_level_that_is_fine_enough() -> None:
    tree = build_tree(np.random.default_rng(1).normal(size=(600, 3)), 10, 0.5)
    sizes = [len(temporal_segments(tree, count, 0)) for count in range(1, 20)]
    assert sizes[0] == 1 and sizes[1] == 2
    assert all(size >= count for count, size in enumerate(sizes, start=1))
    levels = sorted(set(sizes))
    assert all(b <= 2 * a for a, b in itertools.pairwise(levels))
