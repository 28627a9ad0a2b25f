"""Links of a tree over points, breadth first, and sums over its nodes.

The children of a node follow one another, so that a level is a slice and a coarse model a prefix; points lie in tree
order, so that the points below a node are one range.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...numeric.record import record
from ...numeric.segments import batches, starts

MAX_DEPTH = 64  # levels; only geometric sequences of points come near it
CHUNK = 1 << 15  # points or children that are merged together, so that their working arrays stay in the cache


@record
class Tree:
    """Links of M nodes over N points, breadth first: node 0 is the root."""

    child_count: np.ndarray  # (M,) uint8; 0 for leaves
    first_child: np.ndarray  # (M,) int32; 0 for leaves
    point_count: np.ndarray  # (M,) int32
    first_point: np.ndarray  # (M,) int32, index in tree order
    levels: np.ndarray  # (L + 1,) int64: level l is the nodes levels[l] to levels[l + 1]

    def __len__(self) -> int:
        return len(self.child_count)


def link(child_count: np.ndarray, first_point: np.ndarray, point_count: np.ndarray, levels: np.ndarray) -> Tree:
    """The tree with first_child filled in: in breadth-first order it is a prefix sum of the numbers of children."""
    first_child = (starts(child_count) + 1).astype(np.int32) if len(child_count) else np.empty(0, np.int32)
    first_child[child_count == 0] = 0
    return Tree(child_count, first_child, point_count, first_point, levels)


def tree_from_counts(child_count: np.ndarray, leaf_points: np.ndarray, points: int) -> Tree:
    """The tree in which nodes have these numbers of children (M,), and leaves these numbers of points (M,).

    Raises ValueError where they do not make one breadth-first tree over `points` points.
    """
    child_count, nodes = np.ascontiguousarray(child_count), len(child_count)
    if nodes == 0 and points == 0:
        return link(child_count, np.empty(0, np.int32), np.empty(0, np.int32), np.zeros(1, np.int64))
    if nodes == 0 or int(child_count.sum(dtype=np.int64)) != nodes - 1:
        raise ValueError(f"{nodes} nodes have {int(child_count.sum(dtype=np.int64))} children in total")
    below = np.cumsum(child_count, dtype=np.int64)
    levels = [0, 1]
    while levels[-1] < nodes:
        levels.append(1 + int(below[levels[-1] - 1]))
        if levels[-1] == levels[-2] or len(levels) > MAX_DEPTH + 2:
            raise ValueError("nodes are not connected to the root, or in too many levels")

    # Points are counted upward, then every node hands ranges down to its children.
    count = np.where(child_count == 0, leaf_points, 0).astype(np.int64)
    if int(count.sum()) != points or (count[child_count == 0] == 0).any():
        raise ValueError(f"leaves hold {int(count.sum())} of {points} points, or none")
    first = np.zeros(nodes, np.int64)
    families = [family_of_levels(child_count, *levels[i : i + 3]) for i in range(len(levels) - 2)]
    for parents, children, begin in reversed(families):
        count[parents] = np.add.reduceat(count[children], begin)
    for parents, children, begin in families:
        before = starts(count[children])
        first[children] = np.repeat(first[parents] - before[begin], child_count[parents]) + before
    return link(child_count, first.astype(np.int32), count.astype(np.int32), np.array(levels))


def family_of_levels(child_count: np.ndarray, low: int, middle: int, high: int) -> tuple[np.ndarray, slice, np.ndarray]:
    """The parents in the level from `low` to `middle`, the slice of all their children up to `high`, and the first
    child of each parent within it."""
    parents = low + np.flatnonzero(child_count[low:middle])
    return parents, slice(middle, high), starts(child_count[parents])


def smallest_below(tree: Tree, bound: np.ndarray, sphere: np.ndarray) -> np.ndarray:
    """The least size among each node and its descendants of two or more points: (M,), from the bounds of nodes.

    `bound` (M, 3) and `sphere` (M,) as in Hierarchy.
    """
    size = np.minimum(sphere, np.hypot(bound[:, 0], bound[:, 2]))
    smallest = np.where(tree.point_count > 1, size, np.float32(np.inf))
    for i in range(len(tree.levels) - 3, -1, -1):
        parents, children, begin = family_of_levels(tree.child_count, *tree.levels[i : i + 3])
        smallest[parents] = np.minimum(smallest[parents], np.minimum.reduceat(smallest[children], begin))
    return smallest


def sum_over_nodes(tree: Tree, points: int, columns: Callable[[slice], np.ndarray]) -> np.ndarray:
    """Sums (B, M) float64 over the points below each node, bottom up.

    `columns` returns the summands (B, n) of a range of points in tree order; `points` is the number of all points.
    """
    total = np.empty((len(columns(slice(0, 0))), len(tree)))
    leaves = leaves_in_tree_order(tree, points)
    begin = np.append(tree.first_point[leaves], points)
    for a, b in batches(tree.point_count[leaves], CHUNK):
        total[:, leaves[a:b]] = np.add.reduceat(columns(slice(begin[a], begin[b])), begin[a:b] - begin[a], axis=1)
    for first, last in zip(tree.levels[-2::-1], tree.levels[:0:-1], strict=True):
        parents = first + np.flatnonzero(tree.child_count[first:last])
        if len(parents):
            begin, end = tree.first_child[parents], tree.first_child[parents[-1]] + tree.child_count[parents[-1]]
            total[:, parents] = np.add.reduceat(total[:, begin[0] : end], begin - begin[0], axis=1)
    return total


def leaves_in_tree_order(tree: Tree, points: int) -> np.ndarray:
    """Indices (K,) of the leaves in the order of their points, int32."""
    at = np.full(points, -1, np.int32)
    leaves = np.flatnonzero(tree.child_count == 0)
    at[tree.first_point[leaves]] = leaves
    return at[at >= 0]
