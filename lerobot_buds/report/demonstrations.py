"""What the page's script draws of every demonstration, as plain data: runs, tree, strips of pictures."""

from typing import Any

from lerobot_buds.core import IntArray, segments_of

from .content import Content, Structure
from .pictures import Pictures

OWN = 0.9
"""Least share of a node's frames that have one skill, for the node to be drawn in its colour."""


def demonstrations(content: Content, pictures: Pictures) -> list[dict[str, Any]]:
    """Describes every demonstration.

    Returns:
        One mapping a demonstration: ``number``, ``tasks``, ``frames``, ``skills`` and ``stages`` (ends and labels of
        the runs), ``segments`` (ends of temporal segments), ``nodes`` of the tree and ``strips`` of the cameras; what
        is not known is empty.
    """
    found: list[dict[str, Any]] = []
    for place, (number, start, labels) in enumerate(zip(content.numbers, content.starts, content.labels, strict=True)):
        structure = content.structures[place] if content.structures else None
        found.append(
            {
                "number": number,
                "tasks": list(content.tasks[place]),
                "frames": len(labels),
                "skills": _runs(labels),
                "stages": _runs(content.stages[place]) if content.stages else [],
                "segments": structure.segments[:, 1].tolist() if structure else [],
                "nodes": _nodes(structure, labels) if structure else [],
                "strips": [pictures.strip(camera, start, len(labels)) for camera in pictures.cameras],
            }
        )
    return found


def _runs(labels: IntArray) -> list[list[int]]:
    return [[run.end, run.label] for run in segments_of(labels)]


def _nodes(structure: Structure, labels: IntArray) -> list[list[int]]:
    """Start, end, earlier and later child of every node, and the skill that it belongs to; -1 where it has none."""
    tree = structure.tree
    if tree is None:
        return []
    nodes: list[list[int]] = []
    for (start, end), children in zip(tree.bounds.tolist(), tree.children.tolist(), strict=True):
        inside = labels[start:end]
        middle = int(inside[len(inside) // 2])
        skill = middle if (inside == middle).mean() >= OWN else -1
        nodes.append([start, end, *children, skill])
    return nodes
