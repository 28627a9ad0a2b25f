"""Flat parts of a mesh, with their principal axes and the triangles of one of their two sides."""

from __future__ import annotations

import numpy as np

from ...numeric.record import record
from .measures import area_vectors, sums_by_row, triangle_areas
from .result import AREA_ERROR, FLAT_RATIO

MOST_TRIANGLES = 128  # triangles that a leaf has at most
CURLED_RATIO = 0.1  # a leaf's variance across its plane over that of its narrower axis, at most


@record
class FlatParts:
    """C flat parts, and the T triangles of one side of each."""

    part: np.ndarray  # (C,) int64: the mesh's
    own: np.ndarray  # (T,) int64: rows of parts
    vertex: np.ndarray  # (T, 3) int64
    corner: np.ndarray  # (T, 3, 3) float64
    height: np.ndarray  # (T, 3) float64: of corners along the longest axis, from the part's middle
    sideways: np.ndarray  # (T, 3) float64: along the second one
    axes: np.ndarray  # (C, 3, 3) float64, orthonormal: the longest axis, the next, and what is across both
    middle: np.ndarray  # (C, 3) float64
    area: np.ndarray  # (C,) float64, of the projection along the third axis
    facing: np.ndarray  # (T, 3) float64, unit normals
    vertices: np.ndarray  # (C,) int64: how many the part has, those of the other side as well

    def total(self, values: np.ndarray) -> np.ndarray:
        """(C, ...) sums over each part of values (T, ...) of its triangles."""
        return sums_by_row(self.own, values, len(self.part))

    def only(self, rows: np.ndarray) -> FlatParts:
        """The parts that `rows` (C,) bool selects."""
        new, kept = np.cumsum(rows) - 1, rows[self.own]
        return FlatParts(
            self.part[rows], new[self.own[kept]], self.vertex[kept], self.corner[kept], self.height[kept],
            self.sideways[kept], self.axes[rows], self.middle[rows], self.area[rows], self.facing[kept],
            self.vertices[rows],
        )  # fmt: skip


def find_flat_parts(position: np.ndarray, triangles: np.ndarray, part: np.ndarray, other: np.ndarray) -> FlatParts:
    """The thin parts of 5 to MOST_TRIANGLES triangles among `other` (B,) bool. Of parts with two sides, such as thin
    closed ones, one side is taken."""
    count = len(other)
    many = np.bincount(part, minlength=count)
    chosen = np.flatnonzero(other & (many > 4) & (many <= MOST_TRIANGLES))
    row = np.full(count, -1)
    row[chosen] = np.arange(len(chosen))
    rows = np.flatnonzero(row[part] >= 0)
    part_of = np.zeros(len(position), np.int64)
    part_of[triangles] = part[:, None]
    own, corner = row[part[rows]], position[triangles[rows]]
    vertices = np.bincount(row[part_of[np.unique(triangles[rows])]], minlength=len(chosen))

    area = triangle_areas(corner)
    whole = np.maximum(sums_by_row(own, area, len(chosen)), 1e-300)
    middle = sums_by_row(own, area[:, None] * corner.mean(axis=1), len(chosen)) / whole[:, None]
    off = corner - middle[own][:, None]
    # Of a triangle's second moments, from its corners and their mean
    spread = np.einsum("tki,tkj->tij", off, off) + 9 * np.einsum("ti,tj->tij", off.mean(axis=1), off.mean(axis=1))
    spread = sums_by_row(own, area[:, None, None] * spread, len(chosen))
    variance, axes = np.linalg.eigh(spread / (12 * whole[:, None, None]))
    facing = area_vectors(corner)
    sense = np.einsum("ti,ti->t", facing, axes[own, :, 0])
    sides = np.stack([np.bincount(own, np.maximum(s * sense, 0) / 2, len(chosen)) for s in (1, -1)])
    upper = sides[0] >= sides[1]
    counts = (sense > 0) == upper[own]
    whole, hidden = sides.max(axis=0), sides.min(axis=0)
    two_sided = hidden > AREA_ERROR * whole
    thin = variance[:, 0] <= np.where(two_sided, FLAT_RATIO, CURLED_RATIO) * variance[:, 1]
    thin &= (variance[:, 1] > 0) & (~two_sided | (whole - hidden <= AREA_ERROR * whole))
    # What is kept, renumbered
    kept = np.flatnonzero(thin)
    new = np.full(len(chosen), -1)
    new[kept] = np.arange(len(kept))
    vertex = triangles[rows]
    rows = np.flatnonzero(counts & thin[own])
    axes = np.stack([axes[:, :, 2], axes[:, :, 1], np.cross(axes[:, :, 2], axes[:, :, 1])], axis=1)
    height, sideways = (np.einsum("tki,ti->tk", off[rows], axes[own[rows], k]) for k in (0, 1))
    length = np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-300)
    # The area along the plane falls short of that of what is curled
    whole = np.bincount(own[rows], area[rows], len(chosen))
    return FlatParts(
        chosen[kept], new[own[rows]], vertex[rows], corner[rows],
        height, sideways, axes[kept], middle[kept], whole[kept], (facing / length)[rows], vertices[kept],
    )  # fmt: skip
