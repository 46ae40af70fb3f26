"""Agreement of a segmentation with known stages, and of the segmentations of demonstrations with one another."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from sklearn.metrics import adjusted_rand_score, normalized_mutual_info_score

from lerobot_buds.core import DatasetError, IntArray, segments_of


@dataclass(frozen=True)
class Agreement:
    """Scores of predicted against true labels, pooled over all demonstrations; 1 is best, 0 is none.

    Attributes:
        boundary_precision: Share of predicted boundaries that are matched.
        boundary_recall: Share of true boundaries that are matched.
        boundary_f1: Harmonic mean of both.
        segment_f1: The same of whole segments; a pair is matched that shares more than half of its union in time.
        nmi: Normalised mutual information (arithmetic mean) of the labels of all frames.
        ari: Adjusted Rand index of the labels of all frames; below 0 for less agreement than chance.
        tolerance_s: Largest distance of a matched pair of boundaries (seconds).
    """

    boundary_precision: float
    boundary_recall: float
    boundary_f1: float
    segment_f1: float
    nmi: float
    ari: float
    tolerance_s: float


def matched_boundaries(predicted: IntArray, true: IntArray, tolerance: float) -> int:
    """Counts the most boundaries that can be paired one to one within a tolerance.

    Args:
        predicted: Ascending boundary frames.
        true: Ascending boundary frames.
        tolerance: Largest distance of a pair (frames).
    """
    count = i = j = 0
    # With one tolerance for all, pairing the earliest possible ones is optimal.
    while i < len(predicted) and j < len(true):
        if abs(int(predicted[i]) - int(true[j])) <= tolerance:
            count, i, j = count + 1, i + 1, j + 1
        elif predicted[i] < true[j]:
            i += 1
        else:
            j += 1
    return count


def agreement(
    predicted: Sequence[IntArray], true: Sequence[IntArray], fps: float, tolerance_s: float = 0.5
) -> Agreement:
    """Scores a segmentation against true stages; the names of the labels do not matter (ours).

    A boundary is the first frame of a segment, but for the first segment of a demonstration. A score of boundaries
    without anything to count is 1 if neither side has a boundary, else 0.

    Args:
        predicted: ``(T,)`` labels of every demonstration.
        true: ``(T,)`` true stages of every demonstration.
        fps: Frame rate (frames per second).
        tolerance_s: Largest distance of a matched pair of boundaries (seconds).

    Raises:
        DatasetError: The numbers of demonstrations or of their frames differ.
    """
    require_same_frames(predicted, true)
    tolerance = tolerance_s * fps + 1e-9  # 0.15 s at 20 frames per second is 3 frames, not 2.999...
    pairs = [(_boundaries(p), _boundaries(t)) for p, t in zip(predicted, true, strict=True)]
    matched = sum(matched_boundaries(p, t, tolerance) for p, t in pairs)
    n_predicted, n_true = sum(len(p) for p, _ in pairs), sum(len(t) for _, t in pairs)
    nothing = float(n_predicted == n_true == 0)
    all_true, all_predicted = np.concatenate(true), np.concatenate(predicted)
    nmi = float(normalized_mutual_info_score(all_true, all_predicted))
    overlapping = sum(_overlapping(p, t) for p, t in zip(predicted, true, strict=True))
    segments = sum(len(segments_of(episode)) for episode in (*predicted, *true))
    return Agreement(
        boundary_precision=matched / n_predicted if n_predicted else nothing,
        boundary_recall=matched / n_true if n_true else nothing,
        boundary_f1=2 * matched / (n_predicted + n_true) if n_predicted + n_true else nothing,
        segment_f1=2 * overlapping / segments,
        nmi=min(max(nmi, 0.0), 1.0),
        ari=float(adjusted_rand_score(all_true, all_predicted)),
        tolerance_s=tolerance_s,
    )


def require_same_frames(predicted: Sequence[IntArray], true: Sequence[IntArray]) -> None:
    """Refuses labels and true stages that are not of the same demonstrations.

    Args:
        predicted: ``(T,)`` labels of every demonstration.
        true: ``(T,)`` true stages of every demonstration.

    Raises:
        DatasetError: The numbers of demonstrations or of their frames differ, or there are no frames.
    """
    lengths, true_lengths = [len(p) for p in predicted], [len(t) for t in true]
    if lengths != true_lengths or not sum(lengths):
        raise DatasetError(
            f"Segmentation and true stages do not fit: {len(lengths)} episodes of {sum(lengths)} frames against "
            f"{len(true_lengths)} of {sum(true_lengths)}, which must be equal, with the same lengths, and not empty."
        )


def label_distance(labels: Sequence[IntArray]) -> float:
    """Measures how differently demonstrations are labelled (release, with Levenshtein's distance made right).

    Args:
        labels: ``(T,)`` labels of every demonstration.

    Returns:
        Edit distance between the sequences of two demonstrations' segment labels over the length of the longer one, the
        mean over all pairs; in [0, 1], 0 where all agree.
    """
    counts = Counter(tuple(segment.label for segment in segments_of(episode)) for episode in labels)
    words = list(counts.items())
    total, pairs = 0.0, len(labels) * (len(labels) - 1) / 2
    for i, (first, n) in enumerate(words):
        for second, m in words[i + 1 :]:
            total += n * m * edit_distance(first, second) / max(len(first), len(second))
    return total / pairs if pairs else 0.0


def edit_distance(first: Sequence[int], second: Sequence[int]) -> int:
    """Counts the insertions, deletions and exchanges that make one sequence of labels the other (Levenshtein)."""
    row = list(range(len(second) + 1))
    for i, a in enumerate(first, 1):
        above, row[0] = row[0], i
        for j, b in enumerate(second, 1):
            above, row[j] = row[j], min(row[j] + 1, row[j - 1] + 1, above + (a != b))
    return row[-1]


def _overlapping(predicted: IntArray, true: IntArray) -> int:
    """Counts the pairs of segments that share more than half of their union; no segment is in two of them."""
    mine, theirs = segments_of(predicted), segments_of(true)
    count = 0
    for p in mine:
        for t in theirs:
            shared = min(p.end, t.end) - max(p.start, t.start)
            count += 2 * shared > p.length + t.length - shared
    return count


def _boundaries(labels: IntArray) -> IntArray:
    return np.array([segment.start for segment in segments_of(labels)[1:]], dtype=np.int64)
