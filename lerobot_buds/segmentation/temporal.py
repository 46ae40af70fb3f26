"""Temporal segments of one demonstration: a cut through its tree that is fine enough."""

from collections.abc import Callable
from typing import Literal

from lerobot_buds.core import IntArray

from .tree import TaskStructure


def by_levels(tree: TaskStructure, count: int, min_length: int) -> list[int]:
    """Descends the tree level by level until there are enough segments (paper, breadth-first search).

    The search stops before the next level once there are at least `count` nodes, or when nothing can be split, so it
    always ends; the released code loops for ever on short demonstrations.
    """
    frontier = [tree.root]
    while len(frontier) < count:
        finer: list[int] = []
        for node in frontier:
            finer.extend(tree.children[node].tolist() if _can_split(tree, node, min_length) else [node])
        if len(finer) == len(frontier):
            break
        frontier = finer
    return frontier


def by_merges(tree: TaskStructure, count: int, min_length: int) -> list[int]:
    """Undoes the tree's merges, the latest first, until there are exactly enough segments (ours)."""
    frontier = {tree.root}
    # Nodes are numbered in the order of their making, and no node is made before its children.
    for node in range(tree.root, -1, -1):
        if len(frontier) >= count:
            break
        if node in frontier and _can_split(tree, node, min_length):
            frontier.remove(node)
            frontier.update(tree.children[node].tolist())
    return sorted(frontier, key=lambda node: int(tree.bounds[node, 0]))


Search = Literal["levels", "best_first"]
SEARCHES: dict[Search, Callable[[TaskStructure, int, int], list[int]]] = {"levels": by_levels, "best_first": by_merges}
"""How to cut a tree: the paper's search by levels, or by the order of the merges."""


def temporal_segments(tree: TaskStructure, count: int, min_length: int, search: Search = "levels") -> IntArray:
    """Cuts a tree into temporal segments.

    A node is split unless it is a bottom element or too short.

    Args:
        tree: The demonstration's hierarchical task structure.
        count: Segments wanted; fewer come out only if the tree has no more to give, more only by ``levels``.
        min_length: Nodes of this many frames or fewer are not split.
        search: A key of `SEARCHES`.

    Returns:
        ``(S, 2)`` int64 half-open spans in time order that tile ``[0, T)``.
    """
    bounds: IntArray = tree.bounds[SEARCHES[search](tree, count, min_length)]
    return bounds


def _can_split(tree: TaskStructure, node: int, min_length: int) -> bool:
    start, end = tree.bounds[node]
    return bool(tree.children[node, 0] >= 0 and end - start > min_length)
