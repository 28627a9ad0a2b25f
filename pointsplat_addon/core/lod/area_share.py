"""The share of its ellipse that each splat stands for on its surface: out of focus, these areas add up to coverage.

What each sample of a mesh stands for is known (`sampling.areas`). Points of a scan have radii that close gaps and
overlap by any amount; their density tells the area of each. A node with n points and the moments of a square has the
area 12 sqrt(det V) (half-axes a, b: 3 a b), and each of its points the n-th part of it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..scene.cloud import PointCloud
from ..splat.ewa import CELL_SHARE
from .hierarchy import Hierarchy
from .nodes.tree import Tree, sum_over_nodes

# The largest share of its ellipse that a node covers: a square with its moments.
NODE_SHARE = 3 / np.pi
MIN_POINTS = 8  # points of a node whose moments tell their density, at least
STEPS = 3  # of the fixed-point iteration in `_point_areas`; another one changes areas by less than 1e-3


def area_shares(entry: Hierarchy | PointCloud, areas: Callable[[], np.ndarray] | None = None) -> np.ndarray | float:
    """The share of its ellipse that each splat covers: (N,) float32 of a cloud; of a hierarchy (N + M,), first the
    points in tree order, then the nodes; 1 where points have no radii.

    `areas` returns the areas (N,) of the points in their original order, object units squared. Without it they are
    estimated from the density of points in nodes, or, of a cloud, as that of the cell that each ellipse goes around.
    Disconnected splats cover all of their ellipse. Nodes cover what their points do, as far as these do not overlap.
    """
    tree = entry if isinstance(entry, Hierarchy) else None
    cloud = entry.cloud if isinstance(entry, Hierarchy) else entry
    if cloud.radii is None:
        return 1.0
    ellipse = np.pi * _product(cloud.radii)
    if areas is not None:
        area = areas() if tree is None else areas()[tree.order]
    else:
        area = ellipse * CELL_SHARE if tree is None else np.minimum(_point_areas(tree), ellipse)
    if cloud.disconnected is not None:
        area = np.where(cloud.disconnected, ellipse, area)
    share = area / np.maximum(ellipse, 1e-300)
    if tree is not None:
        below = sum_over_nodes(tree.tree, len(cloud), lambda which: area[None, which])[0]
        nodes = np.minimum(below / np.maximum(np.pi * _product(tree.radii[:, :2]), 1e-300), NODE_SHARE)
        nodes = nodes if tree.disconnected is None else np.where(tree.disconnected, 1.0, nodes)
        share = np.concatenate([share, nodes])
    return share.astype(np.float32)


def _product(radii: np.ndarray) -> np.ndarray:
    """The product of the two half-axes in the plane, (n,) float64."""
    return radii[:, 0].astype(np.float64) * radii[:, min(1, radii.shape[1] - 1)]


def _point_areas(hierarchy: Hierarchy) -> np.ndarray:
    """The area of each point in tree order, (N,) float64, from the nearest node above it with MIN_POINTS points."""
    tree, cloud = hierarchy.tree, hierarchy.cloud
    count = tree.point_count.astype(np.float64)
    assert cloud.radii is not None
    squared = _product(cloud.radii)
    own = sum_over_nodes(tree, len(cloud), lambda which: 0.25 * squared[None, which])[0] / count
    # The moments of a node are those of its points' positions and of the cells around them. The areas of cells are
    # wanted; the first guess are the points' own, which single points keep.
    positions = np.maximum(0.25 * hierarchy.radii[:, :2].T.astype(np.float64) ** 2 - own, 0)
    each = 4 * np.pi * CELL_SHARE * own
    for _ in range(STEPS):
        each = 12 * np.sqrt((positions + each / 12).prod(axis=0)) / count
    return _spread_to_points(tree, each)


def _spread_to_points(tree: Tree, values: np.ndarray) -> np.ndarray:
    """For each point in tree order, the value of the nearest node above it with MIN_POINTS points; `values` (M,)."""
    found = values.copy()
    for first, last in zip(tree.levels[:-1], tree.levels[1:], strict=True):
        parents = first + np.flatnonzero(tree.child_count[first:last])
        if len(parents):
            begin = int(tree.first_child[parents[0]])
            end = int(tree.first_child[parents[-1]]) + int(tree.child_count[parents[-1]])
            above = np.repeat(found[parents], tree.child_count[parents])
            found[begin:end] = np.where(tree.point_count[begin:end] >= MIN_POINTS, values[begin:end], above)
    leaves = np.flatnonzero(tree.child_count == 0)
    leaves = leaves[np.argsort(tree.first_point[leaves], kind="stable")]
    return np.repeat(found[leaves], tree.point_count[leaves])
