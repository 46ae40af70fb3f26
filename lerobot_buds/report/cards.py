"""A card for every skill: examples, lengths, the tasks that use it, and what comes before and after it."""

from collections import Counter
from typing import Any

import numpy as np

from lerobot_buds.core import Segment, segments_of

from .content import Content
from .pictures import Pictures

BINS = 24
"""Bars of a histogram; its range is that of all skills, so that cards can be compared."""

QUARTILES = (0.25, 0.5, 0.75)
"""Which segments of a skill are shown, in the order of their lengths."""

TASKS = 6
"""Most tasks that are listed on a card."""

Place = tuple[int, Segment]
"""A demonstration, by its place in the content, and one of its segments."""


def cards(content: Content, pictures: Pictures) -> list[dict[str, Any]]:
    """Describes every skill; lengths are in seconds, shares in [0, 1]."""
    runs = [segments_of(labels) for labels in content.labels]
    fps, frames = content.dataset.fps, sum(map(len, content.labels))
    longest = max(segment.length for episode in runs for segment in episode)
    before, after = _transitions(runs)
    found: list[dict[str, Any]] = []
    for skill in range(content.record.n_skills):
        places = [(e, segment) for e, episode in enumerate(runs) for segment in episode if segment.label == skill]
        lengths = [segment.length for _, segment in places]
        counts, _ = np.histogram(lengths, bins=BINS, range=(0, longest))
        found.append(
            {
                "skill": skill,
                "name": content.names[skill] if content.names else f"Skill {skill}",
                "segments": len(places),
                "demonstrations": len({episode for episode, _ in places}),
                "share": sum(lengths) / frames,
                "median": float(np.median(lengths)) / fps if lengths else 0.0,
                "shortest": min(lengths, default=0) / fps,
                "longest": max(lengths, default=0) / fps,
                "scale": longest / fps,
                "bars": (counts / max(1, counts.max())).round(3).tolist(),
                "examples": _examples(content, pictures, places),
                "tasks": _tasks(content, places),
                "before": _shares(before.get(skill, Counter())),
                "after": _shares(after.get(skill, Counter())),
            }
        )
    return found


def _examples(content: Content, pictures: Pictures, places: list[Place]) -> list[dict[str, Any]]:
    """Begin, middle and end of segments of different lengths, as the first camera saw them."""
    ranked = sorted(places, key=lambda place: (place[1].length, place[0], place[1].start))
    chosen = dict.fromkeys(ranked[round(share * (len(ranked) - 1))] for share in QUARTILES) if ranked else {}
    fps = content.dataset.fps
    return [
        {
            "place": place,
            "number": content.numbers[place],
            "start": segment.start,
            "seconds": segment.length / fps,
            "frames": [
                pictures.frame(pictures.cameras[0], content.starts[place] + frame)
                for frame in (segment.start, (segment.start + segment.end - 1) // 2, segment.end - 1)
            ]
            if pictures.cameras
            else [],
        }
        for place, segment in chosen
    ]


def _tasks(content: Content, places: list[Place]) -> list[dict[str, Any]]:
    """In how many demonstrations of each task the skill occurs, the highest share first."""
    of_all = Counter(task for tasks in content.tasks for task in tasks)
    using = Counter(task for place in {place for place, _ in places} for task in content.tasks[place])
    ranked = sorted(using, key=lambda task: (-using[task] / of_all[task], task))
    return [{"task": task, "using": using[task], "of": of_all[task]} for task in ranked[:TASKS]]


def _transitions(runs: list[list[Segment]]) -> tuple[dict[int, Counter[int]], dict[int, Counter[int]]]:
    """Counts what stands before and after every skill; -1 is the beginning, or the end, of a demonstration."""
    before: dict[int, Counter[int]] = {}
    after: dict[int, Counter[int]] = {}
    for episode in runs:
        order = [-1, *(segment.label for segment in episode), -1]
        for previous, skill, following in zip(order, order[1:], order[2:], strict=False):
            before.setdefault(skill, Counter())[previous] += 1
            after.setdefault(skill, Counter())[following] += 1
    return before, after


def _shares(counts: Counter[int]) -> list[dict[str, Any]]:
    total = counts.total()
    ranked = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    return [{"skill": skill, "count": count, "share": count / total} for skill, count in ranked]
