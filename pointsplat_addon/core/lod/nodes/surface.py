"""Nodes over the surface of a mesh that is so far away that many of its triangles fall into a pixel.

Samples of the surface fall into the cells of a grid. Those in one cell whose normals lie on the same of six sides
become one elliptical disk with their moments (Pajarola 2003, section 5), which keeps how much surface there is: where
its samples fill the ellipse less than those of an even surface would, a fraction of it is covered. Attributes are
means, weighted by area.
"""

from __future__ import annotations

import numpy as np

from ...numeric.segments import starts
from ...scene.cloud import PointCloud
from ..levels import SIDE_AXES

# Squared half-axes of a node's ellipse over the variances of its surface. The circle around a square that is evenly
# filled, 6, makes far things wider than they are; 4, a circle of its area, leaves gaps.
SPREAD = 5.0
FULL = 0.6  # of its ellipse that a node's surface fills, from which on all of it is covered: a square fills 0.76
AVERAGED = ("color", "surface", "emission")
LEAST = 1e-6  # of its major half-axis, that a minor one has


def surface_nodes(cloud: PointCloud, area: np.ndarray, edge: float) -> PointCloud:
    """Returns one elliptical disk for each side of the surface in each cell, with PointCloud.share.

    `cloud`: N > 0 samples with normals and half-axes; `area` (N,) float64: what each stands for, object units squared;
    `edge`: of the cells, object units. A node has the material of its largest sample.
    """
    assert cloud.normal is not None
    position, normal = cloud.position.T.astype(np.float64), cloud.normal.T.astype(np.float64)
    order, first = _together(_cell_and_side(position, normal, edge), area)
    weight = area[order]
    total = np.add.reduceat(weight, first)
    count = np.diff(np.append(first, len(order)))

    def mean(columns: np.ndarray) -> np.ndarray:
        return np.add.reduceat(weight * columns[:, order], first, axis=1) / total

    middle, facing = mean(position), mean(normal)
    length = np.maximum(np.sqrt((facing * facing).sum(axis=0)), 1e-12)
    plane = facing / length
    away = position[:, order] - np.repeat(middle, count, axis=1)
    axis, half = _ellipses(away, normal[:, order], np.repeat(plane, count, axis=1), weight, first, total)
    filled = length * total / (np.pi * half[0] * half[1])
    rows = order[first]
    arrays = {name: mean(of.T.astype(np.float64)) for name in AVERAGED if (of := getattr(cloud, name)) is not None}
    if cloud.shading_normal is not None:
        shading = mean(cloud.shading_normal.T.astype(np.float64))
        arrays["shading_normal"] = shading / np.maximum(np.sqrt((shading * shading).sum(axis=0)), 1e-12)
    arrays |= {"normal": plane, "axis": axis, "radii": half, "share": np.minimum(filled / FULL, 1.0)}
    kept = {name: np.ascontiguousarray(columns.T, np.float32) for name, columns in arrays.items()}
    material = None if cloud.material is None else cloud.material[rows]
    return PointCloud(np.ascontiguousarray(middle.T, np.float32), cloud.origin, material=material, **kept)


def _cell_and_side(position: np.ndarray, normal: np.ndarray, edge: float) -> np.ndarray:
    """(N,) int64: equal for samples, (3, N) each, in one cell whose normals lie on one side."""
    cell = np.floor((position - position.min(axis=1, keepdims=True)) / edge).astype(np.int64)
    turned = SIDE_AXES.T.astype(np.float64) @ normal
    face = np.abs(turned).argmax(axis=0)
    side = 2 * face + (turned[face, np.arange(len(face))] < 0)
    _, y, z = cell.max(axis=1) + 1
    return ((cell[0] * y + cell[1]) * z + cell[2]) * 6 + side


def _together(key: np.ndarray, area: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The order (N,) in which samples of equal keys follow one another, the largest first, and where each run of them
    begins."""
    order = np.lexsort((-area, key))
    _, count = np.unique(key, return_counts=True)
    return order, starts(count)


def _ellipses(
    away: np.ndarray, normal: np.ndarray, plane: np.ndarray, weight: np.ndarray, first: np.ndarray, total: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Major axes (3, M) and half-axes (2, M) of the nodes' ellipses, in their planes.

    (3, N) each: where samples lie from their node's middle, their normals, and the normals of their nodes' planes; (N,)
    weights. A sample counts as a square of its area in its own plane.
    """
    middle_plane = plane[:, first]
    across = np.cross(middle_plane.T, _least(middle_plane)).T
    across /= np.sqrt((across * across).sum(axis=0))
    along = np.cross(middle_plane.T, across.T).T
    count = np.diff(np.append(first, len(weight)))
    x, y = (np.repeat(axis, count, axis=1) for axis in (across, along))
    at_x, at_y, tilt_x, tilt_y = ((a * b).sum(axis=0) for a in (away, normal) for b in (x, y))

    def moment(p: np.ndarray, q: np.ndarray, same: float, tilt: np.ndarray) -> np.ndarray:
        return np.add.reduceat(weight * (p * q + weight / 12 * (same - tilt)), first) / total

    xx, xy = moment(at_x, at_x, 1.0, tilt_x * tilt_x), moment(at_x, at_y, 0.0, tilt_x * tilt_y)
    yy = moment(at_y, at_y, 1.0, tilt_y * tilt_y)
    middle, apart = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    turn = 0.5 * np.arctan2(2 * xy, xx - yy)
    major = np.sqrt(SPREAD * (middle + apart))
    minor = np.maximum(np.sqrt(SPREAD * np.maximum(middle - apart, 0.0)), LEAST * major)
    return np.cos(turn) * across + np.sin(turn) * along, np.stack([major, minor])


def _least(vectors: np.ndarray) -> np.ndarray:
    """(n, 3): for each of the vectors (3, n) the coordinate axis along which it is shortest."""
    return np.eye(3)[np.abs(vectors).argmin(axis=0)]
