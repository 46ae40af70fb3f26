from itertools import combinations, permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lerobot_buds.core import DatasetError
from lerobot_buds.evaluation import agreement, label_distance, matched_boundaries

boundaries = st.lists(st.integers(0, 30), max_size=5, unique=True).map(sorted)
label_arrays = st.lists(st.integers(0, 4), min_size=1, max_size=40).map(lambda x: np.array(x, dtype=np.int64))
pairs = st.lists(
    st.integers(1, 30).flatmap(
        lambda n: st.tuples(*[st.lists(st.integers(0, 3), min_size=n, max_size=n).map(np.array) for _ in range(2)])
    ),
    min_size=1,
    max_size=3,
)


@given(boundaries, boundaries, st.integers(0, 10))
def test_matching_equals_brute_force(predicted: list[int], true: list[int], tolerance: int) -> None:
    best = 0
    for size in range(1, min(len(predicted), len(true)) + 1):
        for some in combinations(predicted, size):
            if any(
                all(abs(a - b) <= tolerance for a, b in zip(some, other, strict=True))
                for other in permutations(true, size)
            ):
                best = size
    assert matched_boundaries(np.array(predicted), np.array(true), tolerance) == best


@given(st.lists(label_arrays, min_size=1, max_size=3))
def test_a_segmentation_agrees_with_itself(labels: list[np.ndarray]) -> None:
    scores = agreement(labels, [9 - episode for episode in labels], 20, 0.0)
    assert scores.boundary_f1 == scores.boundary_precision == scores.boundary_recall == 1
    assert scores.nmi == pytest.approx(1)


@given(pairs)
def test_precision_and_recall_swap(episodes: list[tuple[np.ndarray, np.ndarray]]) -> None:
    predicted, true = [p for p, _ in episodes], [t for _, t in episodes]
    one, other = agreement(predicted, true, 10, 0.2), agreement(true, predicted, 10, 0.2)
    assert one.boundary_precision == other.boundary_recall
    assert one.boundary_f1 == other.boundary_f1
    assert one.nmi == pytest.approx(other.nmi)


def test_tolerance_is_in_seconds() -> None:
    true = np.repeat([0, 1], [20, 20])
    predicted = np.repeat([0, 1], [23, 17])
    assert agreement([predicted], [true], 20, 0.15).boundary_f1 == 1
    assert agreement([predicted], [true], 20, 0.14).boundary_f1 == 0
    assert agreement([predicted], [true], 30, 0.1).boundary_f1 == 1


def test_one_boundary_matches_one_boundary() -> None:
    true = np.repeat([0, 1], [20, 20])
    predicted = np.repeat([0, 1, 0, 1], [18, 2, 2, 18])
    scores = agreement([predicted], [true], 20)
    assert (scores.boundary_precision, scores.boundary_recall) == (pytest.approx(1 / 3), 1)


def test_no_boundaries() -> None:
    flat, cut = np.zeros(10, dtype=int), np.repeat([0, 1], 5)
    assert agreement([flat], [flat], 20).boundary_f1 == 1
    assert agreement([flat], [cut], 20).boundary_precision == 0
    assert agreement([cut], [flat], 20).boundary_recall == 0
    assert agreement([flat], [cut], 20).nmi == 0


def test_other_lengths_are_refused() -> None:
    with pytest.raises(DatasetError, match="do not fit: 1 episodes of 3 frames against 1 of 4"):
        agreement([np.zeros(3, dtype=int)], [np.zeros(4, dtype=int)], 20)
    with pytest.raises(DatasetError, match="do not fit"):
        agreement([], [], 20)


@given(st.lists(label_arrays, min_size=1, max_size=3))
def test_segments_of_a_segmentation_match_themselves(labels: list[np.ndarray]) -> None:
    scores = agreement(labels, labels, 20)
    assert scores.segment_f1 == 1
    assert scores.ari == pytest.approx(1)


def test_segments_match_that_share_more_than_half_of_their_union() -> None:
    true = np.repeat([0, 1], [10, 10])
    assert agreement([np.repeat([0, 1], [13, 7])], [true], 20).segment_f1 == 1  # 10 / 13 and 7 / 10
    assert agreement([np.repeat([0, 1], [15, 5])], [true], 20).segment_f1 == 0.5  # 10 / 15 and 5 / 10
    assert agreement([np.repeat([0], [20])], [true], 20).segment_f1 == 0


def levenshtein(a: tuple[int, ...], b: tuple[int, ...]) -> int:
    if not a or not b:
        return len(a) + len(b)
    return min(levenshtein(a[1:], b) + 1, levenshtein(a, b[1:]) + 1, levenshtein(a[1:], b[1:]) + (a[0] != b[0]))


@given(st.lists(st.lists(st.integers(0, 2), min_size=1, max_size=5), min_size=2, max_size=4))
def test_label_distances_equal_brute_force(labels: list[list[int]]) -> None:
    words = [tuple(label for i, label in enumerate(x) if i == 0 or x[i - 1] != label) for x in labels]
    expected = [levenshtein(a, b) / max(len(a), len(b)) for a, b in combinations(words, 2)]
    assert label_distance([np.array(x) for x in labels]) == pytest.approx(np.mean(expected))


def test_a_single_demonstration_differs_from_none() -> None:
    assert label_distance([np.array([0, 1, 1])]) == 0
