"""Temporal segments of one demonstration: a level of its tree that is fine enough."""

from lerobot_buds.core import IntArray

from .tree import TaskStructure


def temporal_segments(tree: TaskStructure, count: int, min_length: int) -> IntArray:
    """Descends the tree level by level until there are enough segments (paper, breadth-first search).

    A node is split unless it is a bottom element or too short. The search stops before the next level once there are
    at least `count` segments, or when nothing can be split, so it always ends; the released code loops for ever on
    short demonstrations.

    Args:
        tree: The demonstration's hierarchical task structure.
        count: Segments wanted; the result has this many or more, fewer only if the tree has no more to give.
        min_length: Nodes of this many frames or fewer are not split.

    Returns:
        ``(S, 2)`` int64 half-open spans in time order that tile ``[0, T)``.
    """
    frontier = [tree.root]
    while len(frontier) < count:
        finer: list[int] = []
        for node in frontier:
            start, end = tree.bounds[node]
            children = tree.children[node]
            split = children[0] >= 0 and end - start > min_length
            finer.extend(children.tolist() if split else [node])
        if len(finer) == len(frontier):
            break
        frontier = finer
    bounds: IntArray = tree.bounds[frontier]
    return bounds
