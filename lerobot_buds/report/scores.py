"""How far the skills agree with true stages, and how sure they are, as plain data for the page."""

from typing import Any

from lerobot_buds.evaluation import agreement, confusion, label_distance, match_labels, matched_scores

from .content import Content


def scores(content: Content) -> dict[str, Any] | None:
    """Scores the shown demonstrations anew, so that a choice of them is scored by itself; None without true stages.

    Returns:
        ``scores`` and ``matched_scores`` (name, value as text, what it says), ``within`` (tolerance of boundaries, as
        text), ``confusion``: for every skill that occurs, the share of its frames in each stage, and whether the two
        are matched; and ``matched``, the number of skills that are.
    """
    if content.stages is None:
        return None
    found, fps = content.labels, content.dataset.fps
    of_time, of_labels = agreement(found, content.stages, fps), matched_scores(found, content.stages)
    within = f"within {of_time.tolerance_s:g} s"
    rows = [
        ("Boundary F1", f"{of_time.boundary_f1:.2f}", f"boundaries matched one to one {within}"),
        ("Boundary precision", f"{of_time.boundary_precision:.2f}", "found boundaries that are true"),
        ("Boundary recall", f"{of_time.boundary_recall:.2f}", "true boundaries that are found"),
        ("Segment F1", f"{of_time.segment_f1:.2f}", "segments that share more than half of their union"),
        ("NMI", f"{of_time.nmi:.2f}", "normalised mutual information of all frames"),
        ("ARI", f"{of_time.ari:.2f}", "adjusted Rand index of all frames"),
        ("Label distance", f"{label_distance(found):.2f}", "between demonstrations; 0 where all agree"),
    ]
    of_matched = [
        ("F1@10", f"{of_labels.f1_10:.1f}", "segments that overlap by 10 % of their union"),
        ("F1@25", f"{of_labels.f1_25:.1f}", "by 25 %"),
        ("F1@50", f"{of_labels.f1_50:.1f}", "by 50 %"),
        ("Edit", f"{of_labels.edit:.1f}", "order of the segments"),
        ("MoF", f"{of_labels.mof:.1f}", "frames whose skill stands for their stage"),
        ("mIoU", f"{of_labels.miou:.1f}", "frames of a stage and of its skill, mean over the stages"),
    ]
    counts, skills, stages = confusion(found, content.stages)
    matched = match_labels(found, content.stages)
    table = [
        {
            "skill": skill,
            "cells": [
                {"share": count / sum(of_skill), "matched": matched.get(skill) == stage}
                for stage, count in zip(stages.tolist(), of_skill, strict=True)
            ],
        }
        for skill, of_skill in zip(skills.tolist(), counts.tolist(), strict=True)
    ]
    return {"scores": rows, "matched_scores": of_matched, "confusion": table, "matched": len(matched), "within": within}
