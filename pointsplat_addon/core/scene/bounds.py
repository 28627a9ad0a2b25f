"""Computes bounding boxes and balls of points, triangles and clouds, and of boxes under transforms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..numeric.vectors import column_ranges, dot, each_block
from .cloud import PointCloud
from .mesh import Joined, Mesh, joined


def mesh_centre(mesh: Mesh) -> np.ndarray:
    """(3,) float64: the middle of the vertices' bounding box, rounded to float32: a sum is then exact."""
    low, high = bounding_box(mesh.position)
    return ((low + high) / 2).astype(np.float32).astype(np.float64)


def bounding_box(position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Low and high corner, (3,) float64, of points (V, 3); zeros where there are none."""
    if len(position) == 0:
        return np.zeros(3), np.zeros(3)
    low, high = column_ranges(position)
    return low.astype(float), high.astype(float)


def box_corners(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The corners (..., 8, 3) of the boxes between two opposite corners (..., 3)."""
    return np.stack([np.where(which, high, low) for which in np.ndindex(2, 2, 2)], axis=-2)


def used_positions(mesh: Mesh) -> np.ndarray:
    """(U, 3) float32: the positions of those vertices of a mesh with valid triangles that some triangle has."""
    used = np.zeros(len(mesh.position), bool)

    def mark(block: slice) -> None:
        used[mesh.triangles[block].reshape(-1)] = True  # threads may write the same

    each_block(len(mesh.triangles), mark)
    return mesh.position if used.all() else mesh.position[used]


def triangle_boxes(meshes: Sequence[Mesh]) -> list[tuple[np.ndarray, np.ndarray]]:
    """The corners, as of `bounding_box`, of boxes around all triangles of each mesh."""
    found: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    for some in joined(meshes):
        found |= zip(some.rows, zip(*_boxes(some)[1:], strict=True), strict=True)
    return [found.get(row) or bounding_box(used_positions(mesh)) for row, mesh in enumerate(meshes)]


def triangles_balls(meshes: Sequence[Mesh]) -> list[tuple[np.ndarray, float]]:
    """`triangles_ball` of each mesh."""
    found: dict[int, tuple[np.ndarray, float]] = {}
    for some in joined(meshes):
        corners, low, high = _boxes(some)
        middle = (low + high) / 2
        offset = corners.T - np.repeat(middle.T, 3 * np.diff(some.first), axis=1)
        squared = np.maximum.reduceat(dot(offset, offset), 3 * some.first[:-1])
        found |= zip(some.rows, zip(middle, np.sqrt(squared).tolist(), strict=True), strict=True)
    return [found.get(row) or triangles_ball(mesh) for row, mesh in enumerate(meshes)]


def _boxes(some: Joined) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corners of triangles (3T, 3), and the low and high corner of each mesh, (M, 3) float64."""
    corners, start = some.corners, 3 * some.first[:-1]
    low, high = (extreme.reduceat(corners, start, axis=0).astype(float) for extreme in (np.minimum, np.maximum))
    return corners, low, high


def triangles_ball(mesh: Mesh) -> tuple[np.ndarray, float]:
    """Centre (3,) float64 and radius, in object space, of a ball that holds all triangles of a mesh."""
    used = used_positions(mesh)
    low, high = bounding_box(used)
    middle, squared = (low + high) / 2, []

    def measure(block: slice) -> None:
        offset = used[block].T - middle[:, None]
        squared.append(float(dot(offset, offset).max()))

    each_block(len(used), measure)
    return middle, float(np.sqrt(max(squared)))


def cloud_ball(cloud: PointCloud) -> tuple[np.ndarray, float, float]:
    """Centre (3,) float64 of a cloud in object space, the greatest distance of a point from it, and the greatest radius
    of a splat."""
    low, high = bounding_box(cloud.position)
    middle, squared = (low + high) / 2, []
    side = max(float((high - low).max()), np.finfo(np.float32).tiny)  # squares of 1e30 are no float32

    def measure(block: slice) -> None:
        offset = (cloud.position[block].T - middle.astype(np.float32)[:, None]) * np.float32(1 / side)
        squared.append(float(dot(offset, offset).max()))

    each_block(len(cloud), measure)
    radius = 0.0 if cloud.radii is None else float(cloud.radii[:, 0].max(initial=0.0))
    # Rounding of the middle and of float32 sums is far below a millionth of what is measured.
    distance = side * np.sqrt(max(squared)) + 2.0**-23 * np.abs(middle).max()
    return cloud.origin + middle, float(distance) * (1 + 1e-6), radius


def within(position: np.ndarray, box_from_object: np.ndarray) -> np.ndarray:
    """(N,) bool: which points (N, 3) lie in one of the boxes (B, 4, 4), cubes from -1 to 1 in their own space."""
    found = np.zeros(len(position), bool)
    matrices = box_from_object.astype(np.float32)

    def fill(block: slice) -> None:
        columns = np.ascontiguousarray(position[block].T)
        with np.errstate(invalid="ignore"):  # what is not a number lies in none
            for matrix in matrices:
                x, y, z = np.abs(matrix[:3, :3] @ columns + matrix[:3, 3:]) <= 1
                found[block] |= x & y & z

    each_block(len(position), fill)
    return found
