"""Foliage: which splats of an opaque cloud are disconnected, as leaves are, so that light passes between them.

Renderers close a surface between its splats; between leaves there is nothing to close. The area of the splats tells:
where they tile a surface of any shape, neighbouring splats have together about the surface of the ellipsoid with their
moments; where surfaces overlap, much more; where they are scattered in space, much less.
"""

from __future__ import annotations

import numpy as np

from ..numeric.linear import outer_product, principal_axes
from ..scene.cloud import PointCloud
from ..splat.ellipsoids import half_surface, splat_frames, splat_weight
from .nodes.octree import partition
from .nodes.tree import Tree, sum_over_nodes

FILLED = (
    0.5  # area over half the ellipsoid's surface below which splats are disconnected; tiled ones have 0.95 and more
)
MIN_SPLATS = 8  # splats that a shape is judged by, at least
LEAF_SIZE = 12  # points
CELL_SURFACE = 4.5 / np.pi  # surface of a cube over that of the ellipsoid with its moments
WINDOW, WINDOWS = 4096, 8  # length and number of the runs of points that are looked at first
OPEN_EDGES = 0.1  # boundary edges per triangle; a square of 20 x 20 has that many, a maple 0.15
FOLIAGE_VERTICES = 0.5 + OPEN_EDGES / 2 - 0.03  # vertices per triangle of a mesh with OPEN_EDGES and some handles
NEGLIGIBLE_SHARE = 0.02  # share of the splats up to which seemingly disconnected ones are ends and corners of surfaces


def disconnected_splats(cloud: PointCloud) -> np.ndarray | None:
    """Which splats of a cloud are disconnected, (N,) bool; returns None if none is, or they are not opaque disks.

    A splat is judged together with its neighbours: the smallest node of the point-octree that holds MIN_SPLATS of them.
    Points must be finite, and in most of the cloud neighbours must follow one another (`cloud.coherent`).
    """
    flat = cloud.normal is not None and cloud.radii is not None and (cloud.axis is None or cloud.radii.shape[1] > 1)
    if not flat or cloud.opacity is not None or cloud.extinction is not None or len(cloud) < MIN_SPLATS:
        return None
    if len(cloud) > 2 * WINDOWS * WINDOW:
        # Runs that jump about seem sparser than the cloud is; the whole cloud is judged then.
        first = np.linspace(0, len(cloud) - WINDOW, WINDOWS).astype(np.int64)
        seen = [_sparsely_filled(cloud.take(slice(at, at + WINDOW))) for at in first]
        if np.mean(seen) <= NEGLIGIBLE_SHARE:
            return None
    found = _sparsely_filled(cloud)
    return found if np.count_nonzero(found) > NEGLIGIBLE_SHARE * len(found) else None


def _sparsely_filled(cloud: PointCloud) -> np.ndarray:
    """Which splats lie in nodes whose splats have less than FILLED of the ellipsoid's surface, (N,) bool."""
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
    """Whether a mesh consists of leaves: more than OPEN_EDGES of its edges per triangle belong to one triangle only.

    `position` (N, 3) float32, `triangles` (T, 3). Vertices with the same position count as one. Disks that cover such
    triangles would extend over their edges.
    """
    if len(np.unique(triangles)) < FOLIAGE_VERTICES * len(triangles):
        return False
    # Hashes of the coordinates' bits; collisions are as unlikely as they are harmless.
    bits = np.ascontiguousarray(position + np.float32(0), np.float32).view(np.uint32).astype(np.uint64)
    mixed = (bits * np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)).sum(axis=1)
    vertex = np.unique(mixed, return_inverse=True)[1].reshape(-1)[triangles].astype(np.int64)
    ends = np.stack([vertex, np.roll(vertex, 1, axis=1)]).reshape(2, -1)
    low, high = ends.min(axis=0), ends.max(axis=0)
    _, count = np.unique(low * len(position) + high, return_counts=True)
    return bool(np.count_nonzero(count == 1) > OPEN_EDGES * len(triangles))


def _moments(cloud: PointCloud, which: slice) -> np.ndarray:
    """Weight, first and second moments about the cloud's centre, and area of some splats: (11, n) float64."""
    middle = (cloud.position.min(axis=0) + cloud.position.max(axis=0)).astype(np.float64) / 2
    p = (cloud.position[which] - middle).T
    normal, axis, radii = splat_frames(cloud, which)
    weight = splat_weight(cloud, which)
    minor = np.cross(normal.T, axis.T).T
    second = outer_product(p) + 0.25 * (radii[0] ** 2 * outer_product(axis) + radii[1] ** 2 * outer_product(minor))
    return np.concatenate([weight[None], weight * p, weight * second, np.pi * (radii[0] * radii[1])[None]])


def _filling(sums: np.ndarray) -> np.ndarray:
    """The area of splats over half the surface of the ellipsoid with their moments, (n,), from sums of `_moments`."""
    mean = sums[1:4] / sums[0]
    radii = principal_axes(sums[4:10] / sums[0] - outer_product(mean))[2]
    return sums[10] / half_surface(radii)


def disconnected_nodes(cloud: PointCloud, tree: Tree, radii: np.ndarray) -> dict[str, np.ndarray]:
    """Hierarchy.disconnected and .section by name, of nodes with kernels `radii` (3, M) over points in tree order.

    Disks of a total area s, scattered over a cell of surface 2 S, hide as much as one disk of the area
    S (1 - exp(-s / S)); to second order s_i^2 / 2 S more for each, since no disk hides itself.
    """
    cell = CELL_SURFACE * half_surface(radii)

    def columns(which: slice) -> np.ndarray:
        radii = splat_frames(cloud, which).radii
        area = np.pi * radii[0] * radii[1]
        return np.stack([area, area**2, area * cloud.disconnected[which]])  # type: ignore[index]

    area, square, disconnected = sum_over_nodes(tree, len(cloud), columns)
    section = np.minimum(cell * -np.expm1(-area / cell) + square / (2 * cell), area)
    return {"disconnected": disconnected > 0.5 * area, "section": section.astype(np.float32)}
