"""A tree of boxes over triangles, in which rays are traced.

It is complete: node i has the children 2 i and 2 i + 1, and all leaves hold equally many triangles, so that it needs no
links. Triangles are divided at the median along the longest side of their middles' box, level by level.
"""

from __future__ import annotations

import numpy as np

from ..numeric.record import record

MOST_IN_LEAF = 4  # triangles; at least half of it


@record
class TriangleTree:
    """T triangles in L leaves, L a power of two. Some fill places that would be empty, and are there twice."""

    order: np.ndarray  # (L * K,) int64: triangles, those of one leaf after the other
    leaves: int
    low: np.ndarray  # (2 L, 3) float32: corners of the boxes of nodes, the root's in row 1, the leaves' from row L on
    high: np.ndarray  # (2 L, 3) float32

    @property
    def in_leaf(self) -> int:
        """How many triangles a leaf has, K."""
        return len(self.order) // self.leaves


def triangle_tree(corners: np.ndarray) -> TriangleTree:
    """Returns the tree of triangles, (T, 3, 3) float32, T > 0."""
    count = len(corners)
    leaves = 1
    while leaves * MOST_IN_LEAF < count:
        leaves *= 2
    in_leaf = -(-count // leaves)
    order = np.arange(leaves * in_leaf) % count
    low, high = corners.min(axis=1), corners.max(axis=1)
    middle = 0.5 * (low + high)
    segments = 1
    while segments < leaves:
        rows = order.reshape(segments, -1)
        own = middle[rows]  # (segments, n, 3)
        axis = (own.max(axis=1) - own.min(axis=1)).argmax(axis=1)
        along = np.take_along_axis(own, axis[:, None, None], axis=2)[..., 0]
        half = np.argpartition(along, rows.shape[1] // 2, axis=1)
        order = np.take_along_axis(rows, half, axis=1).ravel()
        segments *= 2
    boxes = []
    for bounds, least in ((low, True), (high, False)):
        nodes = np.zeros((2 * leaves, 3), np.float32)
        in_leaves = bounds[order].reshape(leaves, in_leaf, 3)
        nodes[leaves:] = in_leaves.min(axis=1) if least else in_leaves.max(axis=1)
        level = leaves
        while level > 1:
            pairs = nodes[level : 2 * level].reshape(-1, 2, 3)
            nodes[level // 2 : level] = pairs.min(axis=1) if least else pairs.max(axis=1)
            level //= 2
        boxes.append(nodes)
    return TriangleTree(order, leaves, *boxes)
