"""Every score of a segmentation equals its definition, spelt out, and does not see how labels are called."""

from itertools import combinations, pairwise
from math import log

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lerobot_buds.evaluation import agreement, label_distance

FPS, TOLERANCE = 10, 2
LABELS = 4

Episodes = list[tuple[list[int], list[int]]]
labels = st.lists(st.integers(0, LABELS - 1), min_size=1, max_size=9)
# Runs, so that whole segments overlap, and single frames, so that boundaries are many.
runs = st.lists(st.tuples(st.integers(0, LABELS - 1), st.integers(1, 6)), min_size=1, max_size=4).map(
    lambda parts: [label for label, length in parts for _ in range(length)]
)
episodes = st.lists(
    st.tuples(labels | runs, labels | runs).map(lambda pair: tuple(x[: min(map(len, pair))] for x in pair)),
    min_size=1,
    max_size=3,
)


def segments(frames: list[int]) -> list[set[int]]:
    """The frames of every run of equal labels."""
    cuts = [0, *(t for t in range(1, len(frames)) if frames[t] != frames[t - 1]), len(frames)]
    return [set(range(a, b)) for a, b in pairwise(cuts)]


def most_pairs(rows: int, columns: int, fits) -> int:
    """Size of the largest one-to-one matching: every row is left out or takes any column that is free."""

    def best(row: int, free: frozenset[int]) -> int:
        if row == rows:
            return 0
        taken = [1 + best(row + 1, free - {column}) for column in free if fits(row, column)]
        return max([best(row + 1, free), *taken])

    return best(0, frozenset(range(columns)))


def share(part: int, whole: int, nothing: bool) -> float:
    return part / whole if whole else float(nothing)


@settings(max_examples=60)
@given(episodes)
def test_scores_of_boundaries(data: Episodes) -> None:
    found = matched = true = 0
    for mine, theirs in data:
        a, b = ([min(s) for s in segments(x)[1:]] for x in (mine, theirs))
        matched += most_pairs(len(a), len(b), lambda i, j, a=a, b=b: abs(a[i] - b[j]) <= TOLERANCE)
        found, true = found + len(a), true + len(b)
    scores = scored(data)
    nothing = found == true == 0
    assert scores.boundary_precision == share(matched, found, nothing)
    assert scores.boundary_recall == share(matched, true, nothing)
    assert scores.boundary_f1 == pytest.approx(share(2 * matched, found + true, nothing))


@settings(max_examples=60)
@given(episodes)
def test_score_of_segments(data: Episodes) -> None:
    matched = total = 0
    for mine, theirs in data:
        a, b = segments(mine), segments(theirs)
        matched += most_pairs(len(a), len(b), lambda i, j, a=a, b=b: 2 * len(a[i] & b[j]) > len(a[i] | b[j]))
        total += len(a) + len(b)
    assert scored(data).segment_f1 == pytest.approx(2 * matched / total)


@settings(max_examples=60)
@given(episodes)
def test_mutual_information(data: Episodes) -> None:
    """Of the labels of all frames, over the mean of both entropies; two labellings without entropy agree."""
    frames = [(p, t) for mine, theirs in data for p, t in zip(mine, theirs, strict=True)]
    n = len(frames)

    def p(values: list) -> dict:
        return {value: values.count(value) / n for value in set(values)}

    both, mine, theirs = p(frames), p([f[0] for f in frames]), p([f[1] for f in frames])
    information = sum(q * log(q / mine[a] / theirs[b]) for (a, b), q in both.items())
    entropy = -sum(q * log(q) for side in (mine, theirs) for q in side.values()) / 2
    assert scored(data).nmi == pytest.approx(information / entropy if entropy else 1.0, abs=1e-9)


@settings(max_examples=60)
@given(episodes)
def test_adjusted_rand_index(data: Episodes) -> None:
    """Over all pairs of frames: are they of one label on one side, on the other, on both?"""
    frames = [(p, t) for mine, theirs in data for p, t in zip(mine, theirs, strict=True)]
    pairs = list(combinations(frames, 2))
    mine = sum(a[0] == b[0] for a, b in pairs)
    theirs = sum(a[1] == b[1] for a, b in pairs)
    both = sum(a == b for a, b in pairs)
    chance = mine * theirs / len(pairs) if pairs else 0.0
    most = (mine + theirs) / 2
    assert scored(data).ari == pytest.approx((both - chance) / (most - chance) if most != chance else 1.0)


@settings(max_examples=60)
@given(episodes, st.permutations(range(LABELS)), st.permutations(range(LABELS)))
def test_names_of_labels_do_not_matter(data: Episodes, mine: list[int], theirs: list[int]) -> None:
    renamed = [([mine[label] for label in p], [theirs[label] for label in t]) for p, t in data]
    before, after = vars(scored(data)), vars(scored(renamed))
    assert after == pytest.approx(before, abs=1e-9)
    distances = [label_distance([np.array(p) for p, _ in x]) for x in (data, renamed)]
    assert distances[0] == distances[1]


def scored(data: Episodes):
    return agreement([np.array(p) for p, _ in data], [np.array(t) for _, t in data], FPS, TOLERANCE / FPS)
