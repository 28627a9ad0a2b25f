"""Which splats of an opaque cloud stand apart, as leaves do: light passes between them.

Surfaces are closed between their splats; between leaves there is nothing to close. What tells them from each other is
how much of it there is: the splats around a place have about the area of the ellipsoid that has their moments where
they tile a surface of whatever shape, much more where surfaces overlap, and little of it where they are strewn.
"""

from __future__ import annotations

import numpy as np

from ..numeric.linear import outer_product, principal_axes
from ..scene.cloud import PointCloud
from ..splat.ellipsoids import half_surface, splat_frames, splat_weight
from .nodes.octree import partition
from .nodes.tree import Tree, sum_over_nodes

FILLED = 0.5  # area over half the ellipsoid's surface, below which splats stand apart; tiled ones have 0.95 and more
MIN_SPLATS = 8  # splats from which a shape is judged
LEAF_SIZE = 12
WINDOW, WINDOWS = 4096, 8  # looked at first: points that follow one another
OPEN_EDGES = 0.1  # open edges to a triangle; a square of 20 x 20 has so many, a maple 0.15
FOLIAGE_VERTICES = (
    0.5 + OPEN_EDGES / 2 - 0.03
)  # vertices to a triangle where there are so many open edges, less what handles take
NEGLIGIBLE_SHARE = 0.02  # share of the splats up to which those that seem to stand apart are taken for ends and corners


def disconnected_splats(cloud: PointCloud) -> np.ndarray | None:
    """(N,) bool: the splats that stand apart; None where there are none, or the cloud is not of opaque disks.

    Whether a splat does is judged with its neighbours: the least node of the point-octree that holds `LEAST` of them.
    Points are finite, and neighbours follow one another in most of the cloud (`cloud.coherent`).
    """
    flat = cloud.normal is not None and cloud.radii is not None and (cloud.axis is None or cloud.radii.shape[1] > 1)
    if not flat or cloud.opacity is not None or cloud.extinction is not None or len(cloud) < MIN_SPLATS:
        return None
    if len(cloud) > 2 * WINDOWS * WINDOW:
        # Windows that jump seem sparser than the cloud is: then it is looked at as a whole.
        first = np.linspace(0, len(cloud) - WINDOW, WINDOWS).astype(np.int64)
        seen = [_sparsely_filled(cloud.take(slice(at, at + WINDOW))) for at in first]
        if np.mean(seen) <= NEGLIGIBLE_SHARE:
            return None
    found = _sparsely_filled(cloud)
    return found if np.count_nonzero(found) > NEGLIGIBLE_SHARE * len(found) else None


def _sparsely_filled(cloud: PointCloud) -> np.ndarray:
    """(N,) bool, whatever their share."""
    order, tree = partition(cloud.position, LEAF_SIZE)
    ordered = cloud.take(order)
    parent = np.zeros(len(tree), np.int64)
    inner = np.flatnonzero(tree.child_count)
    parent[1:] = np.repeat(inner, tree.child_count[inner])
    leaves = np.flatnonzero(tree.child_count == 0)
    leaves = leaves[np.argsort(tree.first_point[leaves])]
    judges, which = np.unique(
        np.where(tree.point_count[leaves] >= MIN_SPLATS, leaves, parent[leaves]), return_inverse=True
    )
    sums = sum_over_nodes(tree, len(cloud), lambda some: _moments(ordered, some))[:, judges]
    found = np.empty(len(cloud), bool)
    found[order] = np.repeat((_filling(sums) < FILLED)[which.reshape(-1)], tree.point_count[leaves])
    return found


def is_foliage(position: np.ndarray, triangles: np.ndarray) -> bool:
    """Whether a mesh is of leaves: of its triangles (T, 3) over `position` (N, 3), many have edges that no other has.
    Disks that cover such triangles reach over their edges. Vertices in one place are one."""
    if len(np.unique(triangles)) < FOLIAGE_VERTICES * len(triangles):
        return False
    # Bits of the coordinates, mixed; that two places share a number is as unlikely as it is harmless.
    bits = np.ascontiguousarray(position + np.float32(0), np.float32).view(np.uint32).astype(np.uint64)
    mixed = (bits * np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)).sum(axis=1)
    place = np.unique(mixed, return_inverse=True)[1].reshape(-1)[triangles].astype(np.int64)
    ends = np.stack([place, np.roll(place, 1, axis=1)]).reshape(2, -1)
    low, high = ends.min(axis=0), ends.max(axis=0)
    _, count = np.unique(low * len(position) + high, return_counts=True)
    return bool(np.count_nonzero(count == 1) > OPEN_EDGES * len(triangles))


def _moments(cloud: PointCloud, which: slice) -> np.ndarray:
    """(11, n) float64: weight, first and second moments about the cloud's middle, and area of splats."""
    middle = (cloud.position.min(axis=0) + cloud.position.max(axis=0)).astype(np.float64) / 2
    p = (cloud.position[which] - middle).T
    normal, axis, radii = splat_frames(cloud, which)
    weight = splat_weight(cloud, which)
    minor = np.cross(normal.T, axis.T).T
    second = outer_product(p) + 0.25 * (radii[0] ** 2 * outer_product(axis) + radii[1] ** 2 * outer_product(minor))
    return np.concatenate([weight[None], weight * p, weight * second, np.pi * (radii[0] * radii[1])[None]])


def _filling(sums: np.ndarray) -> np.ndarray:
    """(n,) the area of splats over half the surface of the ellipsoid of their moments."""
    mean = sums[1:4] / sums[0]
    radii = principal_axes(sums[4:10] / sums[0] - outer_product(mean))[2]
    return sums[10] / half_surface(radii)


CELL_SURFACE = 4.5 / np.pi  # surface of a cube over that of the ellipsoid that has its moments


def disconnected_nodes(cloud: PointCloud, tree: Tree, radii: np.ndarray) -> dict[str, np.ndarray]:
    """Hierarchy.disconnected and .section of nodes of these kernels (3, M), from points in tree order.

    Disks of area s that are strewn over a cell of surface 2 S hide S (1 - exp(-s / S)) as one disk does, more by
    s_i^2 / 2 S, in the second order, since none hides itself.
    """
    cell = CELL_SURFACE * half_surface(radii)

    def columns(which: slice) -> np.ndarray:
        _, _, axes = splat_frames(cloud, which)
        area = np.pi * axes[0] * axes[1]
        return np.stack([area, area**2, area * cloud.disconnected[which]])  # type: ignore[index]

    area, square, strewn = sum_over_nodes(tree, len(cloud), columns)
    section = np.minimum(cell * -np.expm1(-area / cell) + square / (2 * cell), area)
    return {"disconnected": strewn > 0.5 * area, "section": section.astype(np.float32)}
