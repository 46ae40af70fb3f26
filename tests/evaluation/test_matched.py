"""What papers print: cases computed by hand, and the definitions spelt out."""

from itertools import pairwise, permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lerobot_buds.core import DatasetError
from lerobot_buds.evaluation import confusion, match_labels, matched_scores

LABELS = 3


def frames(*runs):
    """Labels of one demonstration from ``(label, length)``."""
    return np.concatenate([np.full(length, label) for label, length in runs])


def test_other_names_are_no_fault():
    true = [frames((0, 5), (1, 5)), frames((1, 3), (0, 4))]
    scores = matched_scores([7 - episode for episode in true], true)
    assert set(vars(scores).values()) == {100.0}


def test_a_late_boundary_by_hand():
    """10 + 10 frames; the boundary is found 5 frames late."""
    scores = matched_scores([frames((0, 15), (1, 5))], [frames((0, 10), (1, 10))])
    assert scores.mof == pytest.approx(100 * 15 / 20)
    assert scores.miou == pytest.approx(100 * (10 / 15 + 5 / 10) / 2)
    assert scores.edit == scores.f1_50 == 100  # 10 / 15, and 5 / 10 is just enough


def test_overlaps_have_three_thresholds():
    """The second stage is found late and short: it shares 2 frames of a union of 13."""
    true = [frames((0, 10), (1, 10), (2, 10))]
    found = [frames((0, 18), (1, 5), (2, 7))]  # unions: 18, 13 and 10; shared: 10, 2 and 7
    scores = matched_scores(found, true)
    assert (scores.f1_10, scores.f1_25, scores.f1_50) == pytest.approx((100, 200 / 3, 200 / 3))
    assert scores.mof == pytest.approx(100 * 19 / 30)
    assert scores.miou == pytest.approx(100 * (10 / 18 + 2 / 13 + 7 / 10) / 3)


def test_a_true_segment_is_hit_once():
    """Stage 0 is found in two pieces with a stray skill between them, which stands for no stage."""
    scores = matched_scores([frames((0, 4), (5, 2), (0, 4), (1, 10))], [frames((0, 10), (1, 10))])
    # Both pieces claim stage 0 with 4 / 10; one of them gets it: 2 hits, 4 and 2 segments.
    assert (scores.f1_10, scores.f1_25) == pytest.approx((100 * 4 / 6, 100 * 4 / 6))
    assert scores.f1_50 == pytest.approx(100 * 2 / 6)
    assert scores.edit == pytest.approx(50)  # 0 5 0 1 -> 0 1
    assert scores.mof == pytest.approx(90)
    assert scores.miou == pytest.approx(100 * (8 / 10 + 1) / 2)


def test_one_skill_for_everything():
    scores = matched_scores([frames((0, 20))], [frames((0, 8), (1, 12))])
    assert scores.mof == scores.miou * 2 == pytest.approx(60)
    assert scores.edit == pytest.approx(50)


def test_the_pairing_is_of_all_demonstrations():
    """In the second demonstration alone, skill 1 would be stage 0."""
    predicted, true = [frames((0, 9), (1, 9)), frames((1, 2))], [frames((0, 9), (1, 9)), frames((0, 2))]
    assert match_labels(predicted, true) == {0: 0, 1: 1}
    assert matched_scores(predicted, true).edit == 50


def test_frames_are_counted_by_skill_and_stage():
    counts, skills, stages = confusion([frames((4, 3), (2, 2))], [frames((9, 2), (1, 3))])
    assert (counts.tolist(), skills.tolist(), stages.tolist()) == ([[2, 0], [1, 2]], [2, 4], [1, 9])


def test_other_lengths_are_refused():
    with pytest.raises(DatasetError, match="do not fit"):
        matched_scores([frames((0, 3))], [frames((0, 4))])


episode = st.integers(1, 12).flatmap(
    lambda n: st.tuples(*[st.lists(st.integers(0, LABELS - 1), min_size=n, max_size=n).map(np.array)] * 2)
)


@settings(max_examples=80)
@given(st.lists(episode, min_size=1, max_size=3))
def test_scores_equal_their_definitions(data):
    predicted, true = [p for p, _ in data], [t for _, t in data]
    scores = matched_scores(predicted, true)
    p, t = np.concatenate(predicted), np.concatenate(true)
    best = max(np.mean([order[a] == b for a, b in zip(p, t, strict=True)]) for order in permutations(range(LABELS)))
    assert scores.mof == pytest.approx(100 * best)
    stage_of = match_labels(predicted, true)
    assert len(set(stage_of.values())) == len(stage_of)
    q = np.array([stage_of.get(int(label), -1 - label) for label in p])  # no stage is negative
    stages = np.unique(t)
    overlaps = [((q == s) & (t == s)).sum() / ((q == s) | (t == s)).sum() for s in stages]
    assert scores.miou == pytest.approx(100 * np.mean(overlaps))
    for least, found in ((0.1, scores.f1_10), (0.25, scores.f1_25), (0.5, scores.f1_50)):
        assert found == pytest.approx(100 * segmental_f1(np.split(q, np.cumsum([len(x) for x in true])), true, least))


def segmental_f1(predicted, true, least):
    """As the code of the temporal convolutional networks counts, frame by frame."""
    hits = misses = wrong = 0
    for p, t in zip(predicted, true, strict=False):
        mine, theirs = runs(p), runs(t)
        taken = [False] * len(theirs)
        for label, at in mine:
            ious = [len(at & other) / len(at | other) if name == label else 0.0 for name, other in theirs]
            place = int(np.argmax(ious))
            if ious[place] >= least and not taken[place]:
                hits, taken[place] = hits + 1, True
            else:
                wrong += 1
        misses += taken.count(False)
    return 2 * hits / (2 * hits + wrong + misses)


def runs(labels):
    """Label and frames of every run of equal labels."""
    cuts = [0, *(np.flatnonzero(np.diff(labels)) + 1).tolist(), len(labels)]
    return [(labels[a], set(range(a, b))) for a, b in pairwise(cuts)]
