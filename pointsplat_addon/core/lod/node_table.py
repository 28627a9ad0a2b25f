"""The nodes of all hierarchies of a scene in one table of columns, as level-of-detail selection reads them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..numeric.record import record
from ..numeric.segments import starts
from ..numeric.vectors import golden_ratio_sequence
from ..scene.cloud import PointCloud
from .hierarchy import Hierarchy


@record
class NodeTable:
    """What a cut reads of M nodes of several geometries, one geometry after the other; made once per set of
    hierarchies.

    Columns are contiguous. G is the largest geometry index plus one.
    """

    root: np.ndarray  # (G,) int64: row of the geometry's root node; -1 for a cloud without nodes
    points: np.ndarray  # (G,) int64; 0 for geometries that are not drawn as points
    origin: np.ndarray  # (G, 3) float64
    first_child: np.ndarray  # (M,) int64, row in this table
    child_count: np.ndarray  # (M,) uint8
    first_point: np.ndarray  # (M,) int32
    point_count: np.ndarray  # (M,) int32
    center: np.ndarray  # (3, M) float32
    normal: np.ndarray  # (3, M) float32
    cone: np.ndarray  # (2, M) float32
    sphere: np.ndarray  # (M,) float32
    size: np.ndarray  # (M,) float32
    smallest: np.ndarray  # (M,) float32
    jitter: np.ndarray  # (M,) float32 in [0, 1): a fixed number of each node, whatever else the table holds


def node_table(hierarchies: Mapping[int, Hierarchy | PointCloud]) -> NodeTable:
    """The table of hierarchies, given by geometry index. A PointCloud has no nodes and is always drawn whole."""
    geometries = max(hierarchies, default=-1) + 1
    root, points, origin = np.full(geometries, -1), np.zeros(geometries, np.int64), np.zeros((geometries, 3))
    trees: list[Hierarchy] = []
    base = 0
    for geometry, entry in hierarchies.items():
        cloud = entry if isinstance(entry, PointCloud) else entry.cloud
        points[geometry], origin[geometry] = len(cloud), cloud.origin
        if isinstance(entry, Hierarchy) and len(entry):
            root[geometry] = base
            base += len(entry)
            trees.append(entry)
    bases = starts([len(h) for h in trees])
    first_child = [h.tree.first_child.astype(np.int64) + b for h, b in zip(trees, bases, strict=True)]

    def joined(arrays: list[np.ndarray], dtype: type) -> np.ndarray:
        return np.concatenate([np.empty((*arrays[0].shape[:-1], 0) if arrays else 0, dtype), *arrays], axis=-1)

    return NodeTable(
        root, points, origin,
        first_child=joined(first_child, np.int64),
        child_count=joined([h.tree.child_count for h in trees], np.uint8),
        first_point=joined([h.tree.first_point for h in trees], np.int32),
        point_count=joined([h.tree.point_count for h in trees], np.int32),
        center=joined([h.center.T for h in trees], np.float32),
        normal=joined([h.normal.T for h in trees], np.float32),
        cone=joined([h.cone.T for h in trees], np.float32),
        sphere=joined([h.sphere for h in trees], np.float32),
        size=joined([h.size for h in trees], np.float32),
        smallest=joined([h.smallest for h in trees], np.float32),
        jitter=joined([golden_ratio_sequence(np.arange(len(h))) for h in trees], np.float32),
    )  # fmt: skip
