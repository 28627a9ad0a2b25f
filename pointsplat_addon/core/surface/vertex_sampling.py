"""Samples a mesh at its vertices: the disk of each vertex covers its share of the triangles around it."""

from __future__ import annotations

import math

import numpy as np

from ..numeric.vectors import blocks, cross, dot
from ..scene.mesh import Mesh, squared_edges, triangle_corners
from .samples import Samples
from .triangles import rows_of


def sample_vertices(mesh: Mesh, which: np.ndarray | None = None) -> Samples:
    """One sample at each vertex that a valid triangle uses, in the order of vertices.

    The sample belongs to the first of its triangles, whose corner gives its UV and colour.
    """
    rows = rows_of(mesh, which)
    # The last assignment to a place stays; backwards, that is the first corner.
    corners = (rows[:, None] * 3 + np.arange(3))[::-1, ::-1].ravel()
    corner_of_vertex = np.full(len(mesh.position), -1, np.int64)
    corner_of_vertex[mesh.triangles.reshape(-1)[corners]] = corners
    triangle, corner = np.divmod(corner_of_vertex[corner_of_vertex >= 0], 3)
    barycentric = np.stack([corner == 1, corner == 2], axis=1).astype(np.float32)
    return Samples("VERTICES", triangle.astype(np.int32), barycentric)


def normalised(vectors: np.ndarray, length: np.ndarray, fallback: np.ndarray | int = 2) -> np.ndarray:
    """vectors (3, n) over their length (n,); where that is zero or no number, `fallback`: (3, n), or an axis' index."""
    good = (length > 0) & (length < np.inf)
    if good.all():
        return vectors / length
    other = np.eye(3)[fallback][:, None] if isinstance(fallback, int) else fallback
    return np.where(good, vectors / np.where(good, length, 1), other)


def one_rings(mesh: Mesh, which: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """For each vertex, from its valid triangles: area-weighted mean normal (V, 3) and disk radius (V,), float32.

    The disks of a triangle's corners cover it: the radius is that of `_covering_radius`, over the cosine between
    the triangle's normal and the disk's (up to 60 degrees), because seen along the triangle's normal the disk is
    that much narrower.
    """
    rows = rows_of(mesh, which)
    vertex_of_corner = mesh.triangles.take(rows, axis=0).T.astype(np.intp, order="C")  # (3, M)
    count, vertices = len(rows), len(mesh.position)
    covering = np.empty(count)
    product = np.empty((3, count))
    for block in blocks(count):
        corners = triangle_corners(mesh, rows[block])
        product[:, block] = cross(corners[1] - corners[0], corners[2] - corners[0])
        covering[block] = _covering_radius(squared_edges(corners), np.sqrt(dot(product[:, block], product[:, block])))

    total = np.zeros((3, vertices))
    for c in range(3):
        for vertex in vertex_of_corner:
            total[c] += np.bincount(vertex, product[c], vertices)
    mean = np.ascontiguousarray(normalised(total, np.sqrt(dot(total, total))).T, np.float32)

    radius = np.zeros(vertices)
    for block in blocks(count):
        face = product[:, block] / np.sqrt(dot(product[:, block], product[:, block]))
        for vertex in vertex_of_corner[:, block]:
            cosine = np.maximum(np.abs(dot(face, mean.take(vertex, axis=0).T)), 0.5)
            np.maximum.at(radius, vertex, covering[block] / cosine)
    return mean, (radius * (1 + 2.0**-22)).astype(np.float32)


def _covering_radius(squared: np.ndarray, double_area: np.ndarray) -> np.ndarray:
    """(n,) the least radius at which equal disks at its corners cover a triangle.

    Acute: the circumradius. Otherwise the bisector of the longer of the two other edges, b, meets the longest
    edge, c, at the point farthest from all corners, c b^2 / (b^2 + c^2 - a^2) from b's end.
    """
    x, y, z = squared
    a, c = np.minimum(np.minimum(x, y), z), np.maximum(np.maximum(x, y), z)
    b = np.maximum(np.minimum(x, y), np.minimum(np.maximum(x, y), z))
    c_length = np.sqrt(c)
    circumradius = np.sqrt(a) * np.sqrt(b) * c_length / np.maximum(2 * double_area, np.finfo(np.float64).tiny)
    # Of acute triangles the circumradius is between these bounds, whatever rounding makes of the area.
    acute = np.clip(circumradius, c_length / 2, c_length / math.sqrt(3))
    return np.where(a + b > c, acute, c_length * b / np.maximum(b + c - a, np.finfo(np.float64).tiny))
