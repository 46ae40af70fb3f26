"""Agreement of a segmentation with known stages, by its boundaries and by the labels of its frames."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from sklearn.metrics import normalized_mutual_info_score

from lerobot_buds.core import DatasetError, IntArray, segments_of


@dataclass(frozen=True)
class Agreement:
    """Scores of predicted against true labels, pooled over all demonstrations; each in ``[0, 1]``, 1 is best.

    Attributes:
        boundary_precision: Share of predicted boundaries that are matched.
        boundary_recall: Share of true boundaries that are matched.
        boundary_f1: Harmonic mean of both.
        nmi: Normalised mutual information (arithmetic mean) of the labels of all frames.
        tolerance_s: Largest distance of a matched pair of boundaries (seconds).
    """

    boundary_precision: float
    boundary_recall: float
    boundary_f1: float
    nmi: float
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
    lengths, true_lengths = [len(p) for p in predicted], [len(t) for t in true]
    if lengths != true_lengths or not sum(lengths):
        raise DatasetError(
            f"Segmentation and true stages do not fit: {len(lengths)} episodes of {sum(lengths)} frames against "
            f"{len(true_lengths)} of {sum(true_lengths)}, which must be equal, with the same lengths, and not empty."
        )
    tolerance = tolerance_s * fps + 1e-9  # 0.15 s at 20 frames per second is 3 frames, not 2.999...
    pairs = [(_boundaries(p), _boundaries(t)) for p, t in zip(predicted, true, strict=True)]
    matched = sum(matched_boundaries(p, t, tolerance) for p, t in pairs)
    n_predicted, n_true = sum(len(p) for p, _ in pairs), sum(len(t) for _, t in pairs)
    nothing = float(n_predicted == n_true == 0)
    nmi = float(normalized_mutual_info_score(np.concatenate(true), np.concatenate(predicted)))
    return Agreement(
        boundary_precision=matched / n_predicted if n_predicted else nothing,
        boundary_recall=matched / n_true if n_true else nothing,
        boundary_f1=2 * matched / (n_predicted + n_true) if n_predicted + n_true else nothing,
        nmi=min(max(nmi, 0.0), 1.0),
        tolerance_s=tolerance_s,
    )


def _boundaries(labels: IntArray) -> IntArray:
    return np.array([segment.start for segment in segments_of(labels)[1:]], dtype=np.int64)
