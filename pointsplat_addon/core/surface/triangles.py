"""Measures the triangles of a mesh: longest edge, height, area, and which vertices they use."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..numeric.record import record
from ..numeric.vectors import blocks, cross, dot, each_block
from ..scene.mesh import Mesh, squared_edges, triangle_corners


@record
class Measures:
    """Shape of the M valid triangles of a mesh."""

    triangle: np.ndarray  # (M,) int32, rows of Mesh.triangles
    apex: np.ndarray  # (M,) uint8, the corner opposite the longest edge
    base: np.ndarray  # (M,) float64, length of the longest edge
    height: np.ndarray  # (M,) float64, of the apex over the base
    foot: np.ndarray  # (M,) float64 in [0, 1], where the apex stands on the base, from corner apex + 1
    longest: float  # edge of all
    vertices: int  # that the triangles use

    @property
    def area(self) -> float:
        return float((0.5 * self.base * self.height).sum())

    @property
    def nbytes(self) -> int:
        return sum(a.nbytes for a in (self.triangle, self.apex, self.base, self.height, self.foot))


def rows_of(mesh: Mesh, which: np.ndarray | None) -> np.ndarray:
    """(n,) int64: the rows of the triangles `which` (T,) bool; None: of all."""
    return np.arange(len(mesh.triangles)) if which is None else np.flatnonzero(which)


def measure_triangles(mesh: Mesh, which: np.ndarray | None = None) -> Measures:
    """Measures the triangles `which` (T,) bool of a mesh; None: all of them."""
    rows = rows_of(mesh, which).astype(np.int32)
    count = len(rows)
    apex = np.empty(count, np.uint8)
    base, height, foot = np.empty((3, count))

    def look(block: slice) -> None:
        corners = triangle_corners(mesh, rows[block])
        opposite_0, opposite_1, opposite_2 = squared = squared_edges(corners)
        product = cross(corners[1] - corners[0], corners[2] - corners[0])
        longest = squared.max(axis=0)
        # The first of equally long ones.
        first = opposite_0 == longest
        second = ~first & (opposite_1 == longest)
        # The edges opposite the base's end and opposite its start.
        from_start = np.where(first, opposite_2, np.where(second, opposite_0, opposite_1))
        from_end = np.where(first, opposite_1, np.where(second, opposite_2, opposite_0))
        apex[block] = np.where(first, 0, np.where(second, 1, 2))
        base[block] = np.sqrt(longest)
        height[block] = np.sqrt(dot(product, product)) / base[block]
        foot[block] = np.clip(0.5 + (from_start - from_end) / (2 * longest), 0.0, 1.0)

    each_block(count, look)
    vertices = int(np.count_nonzero(used_vertices(mesh, which)))
    return Measures(rows, apex, base, height, foot, float(base.max(initial=0.0)), vertices)


def _take(m: Measures, rows: np.ndarray) -> Measures:
    return Measures(m.triangle[rows], m.apex[rows], m.base[rows], m.height[rows], m.foot[rows], m.longest, m.vertices)


def triangle_areas(mesh: Mesh, rows: np.ndarray) -> np.ndarray:
    area = np.empty(len(rows))
    for block in blocks(len(rows)):
        corners = triangle_corners(mesh, rows[block])
        product = cross(corners[1] - corners[0], corners[2] - corners[0])
        area[block] = 0.5 * np.sqrt(dot(product, product))
    return area


def measures_of_some(m: Measures, which: np.ndarray) -> Measures:
    """Of some triangles, `which` (M,) bool. What vertices they use is estimated by their share."""
    share = np.count_nonzero(which) / max(len(which), 1)
    part = _take(m, which)
    return replace(part, longest=float(part.base.max(initial=0.0)), vertices=math.ceil(share * m.vertices))


def used_vertices(mesh: Mesh, which: np.ndarray | None = None) -> np.ndarray:
    """(V,) bool: vertices of valid triangles."""
    used = np.zeros(len(mesh.position), bool)
    used[(mesh.triangles if which is None else mesh.triangles[which]).reshape(-1)] = True
    return used
