"""Computes bounding boxes and balls of points, triangles and clouds, and of boxes under transforms."""

from __future__ import annotations

import numpy as np

from .mesh import Mesh


def mesh_centre(mesh: Mesh) -> np.ndarray:
    """(3,) float64: the middle of the vertices' bounding box, rounded to float32: a sum is then exact."""
    low, high = bounding_box(mesh.position)
    return ((low + high) / 2).astype(np.float32).astype(np.float64)


def bounding_box(position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Low and high corner, (3,) float64, of points (V, 3); zeros where there are none."""
    if len(position) == 0:
        return np.zeros(3), np.zeros(3)
    # Column by column, which is several times faster than along the first axis.
    return np.array([c.min() for c in position.T], float), np.array([c.max() for c in position.T], float)
