"""Scores of unsupervised action segmentation as papers print them, of skills that are matched with true stages.

Each skill stands for at most one stage and the other way round; the pairing is the one that makes most frames right
over all demonstrations (Hungarian assignment). A skill without a stage is wrong wherever it occurs.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from lerobot_buds.core import IntArray, Segment, segments_of

from .agreement import edit_distance, require_same_frames

OVERLAPS = (0.10, 0.25, 0.50)
"""Least intersection over union of a segment that counts in F1@10, F1@25 and F1@50."""


@dataclass(frozen=True)
class MatchedScores:
    """Scores of matched labels, in percent; 100 is best.

    Attributes:
        f1_10: Segmental F1 (Lea et al. 2017) of segments that overlap by 10 % of their union at least, pooled over all
            demonstrations.
        f1_25: The same with 25 %.
        f1_50: The same with 50 %.
        edit: Edit score (Lea et al. 2016): 100 less the normalised edit distance between the orders of segments, the
            mean over the demonstrations.
        mof: Mean over frames: the share of frames whose skill stands for their stage.
        miou: Intersection over union of the frames of a stage and of its skill, the mean over the stages.
    """

    f1_10: float
    f1_25: float
    f1_50: float
    edit: float
    mof: float
    miou: float


def confusion(predicted: Sequence[IntArray], true: Sequence[IntArray]) -> tuple[IntArray, IntArray, IntArray]:
    """Counts the frames of every skill in every stage.

    Args:
        predicted: ``(T,)`` labels of every demonstration.
        true: ``(T,)`` true stages of every demonstration.

    Returns:
        ``(K, S)`` counts, and the labels of the rows, ``(K,)``, and of the columns, ``(S,)``, both ascending.
    """
    skills, rows = np.unique(np.concatenate(predicted), return_inverse=True)
    stages, columns = np.unique(np.concatenate(true), return_inverse=True)
    counts = np.zeros((len(skills), len(stages)), dtype=np.int64)
    np.add.at(counts, (rows, columns), 1)
    return counts, skills, stages


def match_labels(predicted: Sequence[IntArray], true: Sequence[IntArray]) -> dict[int, int]:
    """Pairs skills with stages one to one, so that most frames are right; for the arguments see `confusion`."""
    counts, skills, stages = confusion(predicted, true)
    pairs = zip(*linear_sum_assignment(counts, maximize=True), strict=True)
    # What shares no frame is no pair, though the assignment has to make one.
    return {int(skills[row]): int(stages[column]) for row, column in pairs if counts[row, column]}


def matched_scores(predicted: Sequence[IntArray], true: Sequence[IntArray]) -> MatchedScores:
    """Scores a segmentation against true stages after `match_labels`.

    Args:
        predicted: ``(T,)`` labels of every demonstration.
        true: ``(T,)`` true stages of every demonstration.

    Raises:
        DatasetError: The numbers of demonstrations or of their frames differ.
    """
    require_same_frames(predicted, true)
    stage_of = match_labels(predicted, true)
    pairs = [(_renamed(p, stage_of), segments_of(t)) for p, t in zip(predicted, true, strict=True)]
    counts, skills, stages = confusion(predicted, true)
    right = {stage: counts[skills == skill, stages == stage].item() for skill, stage in stage_of.items()}
    union = {
        stage: counts[skills == skill].sum() + counts[:, stages == stage].sum() - right[stage]
        for skill, stage in stage_of.items()
    }
    f1_10, f1_25, f1_50 = (100 * _segment_f1(pairs, overlap) for overlap in OVERLAPS)
    return MatchedScores(
        f1_10,
        f1_25,
        f1_50,
        edit=100 * float(np.mean([_order(mine, theirs) for mine, theirs in pairs if theirs])),
        mof=100 * sum(right.values()) / int(counts.sum()),
        miou=100 * float(sum(right[stage] / union[stage] for stage in right)) / len(stages),
    )


def _renamed(labels: IntArray, stage_of: dict[int, int]) -> list[Segment]:
    """Calls segments by their stages; skills without one keep names that no stage has, so that they stay apart."""
    beyond = 1 + max(stage_of.values(), default=0)
    return [run._replace(label=stage_of.get(run.label, beyond + run.label)) for run in segments_of(labels)]


def _segment_f1(pairs: Sequence[tuple[list[Segment], list[Segment]]], least: float) -> float:
    """Each segment claims the true one of its label that it overlaps most; the first to claim one gets it."""
    hits = total = 0
    for mine, theirs in pairs:
        taken: set[Segment] = set()
        total += len(mine) + len(theirs)
        for segment in mine:
            best = max((t for t in theirs if t.label == segment.label), key=lambda t: _iou(segment, t), default=None)
            if best is not None and best not in taken and _iou(segment, best) >= least:
                taken.add(best)
        hits += len(taken)
    return 2 * hits / total


def _iou(one: Segment, other: Segment) -> float:
    shared = max(0, min(one.end, other.end) - max(one.start, other.start))
    return shared / (one.length + other.length - shared)


def _order(mine: list[Segment], theirs: list[Segment]) -> float:
    one, other = (tuple(segment.label for segment in segments) for segments in (mine, theirs))
    return 1 - edit_distance(one, other) / max(len(one), len(other))
