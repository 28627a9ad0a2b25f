"""Finds out whether a mesh is closed: whether its surface has an inside that nobody sees from outside."""

from __future__ import annotations

import numpy as np

from ..scene.mesh import Mesh

# Odd 64-bit constants of splitmix64 (Steele et al. 2014).
MULTIPLIERS = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)


def is_closed(mesh: Mesh) -> bool:
    """Tells whether each edge has as many triangles that run along it as there are against it.

    Each edge adds a hash of its vertices where it is run along upwards, and takes it away downwards: the sum is 0 for
    closed, evenly oriented meshes, and for others with a probability of 2^-64.
    """
    if len(mesh.triangles) == 0:
        return False
    corners = mesh.triangles.T.astype(np.uint64)
    total = np.uint64(0)
    with np.errstate(over="ignore"):
        for start, end in ((0, 1), (1, 2), (2, 0)):
            low, high = np.minimum(corners[start], corners[end]), np.maximum(corners[start], corners[end])
            hashed = _scrambled(low << np.uint64(32) | high)
            upwards = corners[start] < corners[end]
            total += hashed[upwards].sum(dtype=np.uint64) - hashed[~upwards].sum(dtype=np.uint64)
    return bool(total == 0)


def _scrambled(x: np.ndarray) -> np.ndarray:
    x = (x ^ (x >> np.uint64(30))) * MULTIPLIERS[0]
    x = (x ^ (x >> np.uint64(27))) * MULTIPLIERS[1]
    return x ^ (x >> np.uint64(31))
