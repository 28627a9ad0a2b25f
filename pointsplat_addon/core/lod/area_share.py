"""How much of a surface each splat stands for: opaque splats that are blurred add up to what they cover of the lens.

What each sample of a mesh stands for is known (`sampling.areas`). Points of a scan have radii that close gaps, and may
overlap as they like; how dense they lie tells what is theirs. A node with n points whose moments are those of a square
has the area 12 sqrt(det V) (half-axes a, b: 3 a b), and each of its points the n-th part.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..scene.cloud import PointCloud
from ..splat.ewa import CELL_SHARE
from .hierarchy import Hierarchy
from .nodes.tree import Tree, sum_over_nodes

# A node covers no more than this of its ellipse, whatever lies in it: a square of its moments.
NODE_SHARE = 3 / np.pi
MIN_POINTS = 8  # points of a node whose moments say how dense they lie
STEPS = 3  # of the fixed point in `_densities`; the next one changes areas by less than 1e-3


def area_shares(entry: Hierarchy | PointCloud, areas: Callable[[], np.ndarray] | None = None) -> np.ndarray | float:
    """What of its ellipse each splat covers: (N,) float32 of a cloud, (N + M,) of points in tree order, then nodes.

    `areas`: (N,) of the points in their original order, object units squared; None: they are estimated from how dense
    points lie where there are nodes, else as that of the cell that their ellipse goes around. What stands apart covers
    all of itself; nodes cover what their points do, as far as these lie side by side. 1 where points have no radii.
    """
    tree = entry if isinstance(entry, Hierarchy) else None
    cloud = entry.cloud if isinstance(entry, Hierarchy) else entry
    if cloud.radii is None:
        return 1.0
    ellipse = np.pi * _product(cloud.radii)
    if areas is not None:
        area = areas() if tree is None else areas()[tree.order]
    else:
        area = ellipse * CELL_SHARE if tree is None else np.minimum(_densities(tree), ellipse)
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
    """(n,) float64: of the half-axes in the plane."""
    return radii[:, 0].astype(np.float64) * radii[:, min(1, radii.shape[1] - 1)]


def _densities(hierarchy: Hierarchy) -> np.ndarray:
    """(N,) float64: the area of each point in tree order, from the nearest node above it that has ENOUGH points."""
    tree, cloud = hierarchy.tree, hierarchy.cloud
    count = tree.point_count.astype(np.float64)
    assert cloud.radii is not None
    squared = _product(cloud.radii)
    own = sum_over_nodes(tree, len(cloud), lambda which: 0.25 * squared[None, which])[0] / count
    # Moments of the points' places alone, and of the cells around them, whose area is what is asked for: at first that
    # of the points themselves, which single ones keep.
    places = np.maximum(0.25 * hierarchy.radii[:, :2].T.astype(np.float64) ** 2 - own, 0)
    each = 4 * np.pi * CELL_SHARE * own
    for _ in range(STEPS):
        each = 12 * np.sqrt((places + each / 12).prod(axis=0)) / count
    return np.repeat(*_of_leaves(tree, each))


def _of_leaves(tree: Tree, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of the leaves in the order of their points: the value of the nearest node with ENOUGH points, and how many points
    they have."""
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
    return found[leaves], tree.point_count[leaves]
