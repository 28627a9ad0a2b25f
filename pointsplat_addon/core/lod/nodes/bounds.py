"""Bounds of nodes: the smallest elliptic cylinder about a node's kernel, and ball, that hold those of its children."""

from __future__ import annotations

import numpy as np

from ...numeric.vectors import cross, dot, lengths
from .rows import NodeRows

MIN_ASPECT = 1e-3  # smallest ratio of the axes of a bounding ellipse
ROUNDING = 1 + 4e-7  # float32 copies of bounds are rounded outwards


def bounds_of_runs(
    rows: NodeRows,
    begin: np.ndarray,
    owner: np.ndarray,
    center: np.ndarray,
    normal: np.ndarray,
    axis: np.ndarray,
    radii: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of nodes that each merge a run of rows: cylinders' half-axes (3, n) and balls' radii (n,), float32.

    The kernel of a node (`center`, `normal`, `axis`, `radii`, (3, n) each) is enlarged until its cylinder holds those
    of its rows. `begin` (n,) is the first row of each run, `owner` (m,) the node of each row. Rounded outwards.
    """
    binormal = cross(normal, axis).astype(np.float64)
    major = np.maximum(radii[0].astype(np.float64), 1e-30)
    minor = np.maximum(radii[1], MIN_ASPECT * major)

    # Where the parent's ellipse is the unit circle, a row's base is an ellipse of known center and largest half-axis.
    a = (axis / major).take(owner, axis=1)
    b = (binormal / minor).take(owner, axis=1)
    n = normal.take(owner, axis=1).astype(np.float64)
    step = rows.center.astype(np.float64) - center.take(owner, axis=1)
    e0 = rows.axis * rows.bound[0].astype(np.float64)
    e1 = cross(rows.normal, rows.axis) * rows.bound[1].astype(np.float64)
    e2 = rows.normal * rows.bound[2].astype(np.float64)
    a0, a1, a2, b0, b1, b2 = dot(a, e0), dot(a, e1), dot(a, e2), dot(b, e0), dot(b, e1), dot(b, e2)
    trace = a0 * a0 + a1 * a1 + b0 * b0 + b1 * b1
    determinant = a0 * b1 - a1 * b0
    largest = np.sqrt((trace + np.sqrt(np.maximum(trace * trace - 4 * determinant * determinant, 0))) / 2)
    extent = np.minimum(largest + np.hypot(a2, b2), rows.sphere / minor.take(owner))
    scale = np.maximum.reduceat(np.hypot(dot(a, step), dot(b, step)) + extent, begin)

    n0, n1, n2 = dot(n, e0), dot(n, e1), dot(n, e2)
    height = np.abs(dot(n, step)) + np.minimum(np.hypot(n0, n1) + np.abs(n2), rows.sphere)
    height = np.maximum.reduceat(height, begin)
    bound = np.stack([scale * major, scale * minor, height])

    sphere = np.maximum.reduceat(lengths(step) + rows.sphere, begin)
    sphere = np.minimum(sphere, np.hypot(np.maximum(bound[0], bound[1]), bound[2]))
    return (bound * ROUNDING).astype(np.float32), (sphere * ROUNDING).astype(np.float32)
