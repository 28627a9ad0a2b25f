"""Finds out whether a mesh is closed: whether its surface has an inside that nobody sees from outside."""

from __future__ import annotations

import numpy as np

from ..scene.mesh import Mesh

# Odd 64-bit constants of splitmix64 (Steele et al. 2014).
MULTIPLIERS = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)


def is_closed(mesh: Mesh) -> bool:
    """Tells whether each edge has as many triangles that run along it as there are against it.

    Vertices at one place count as one. Each edge adds a hash of its ends where it is run along one way, and takes it
    away where the other: the sum is 0 for closed, evenly oriented meshes, and for others with a probability of 2^-64.
    """
    if len(mesh.triangles) == 0:
        return False
    total = np.uint64(0)
    with np.errstate(over="ignore"):
        corners = _hashed_places(mesh.position)[mesh.triangles.T]
        for start, end in ((0, 1), (1, 2), (2, 0)):
            a, b = corners[start], corners[end]
            edge = scrambled(np.minimum(a, b) + MULTIPLIERS[0] * np.maximum(a, b))
            upwards = a < b
            total += edge[upwards].sum(dtype=np.uint64) - edge[~upwards & (a != b)].sum(dtype=np.uint64)
    return bool(total == 0)


def _hashed_places(position: np.ndarray) -> np.ndarray:
    """(V,) uint64: equal where positions (V, 3) float32 are."""
    bits = np.ascontiguousarray(position + np.float32(0)).view(np.uint32).astype(np.uint64)  # -0 is 0
    found = scrambled(bits[:, 0])
    for column in (1, 2):
        found = scrambled(found ^ bits[:, column])
    return found


def scrambled(x: np.ndarray) -> np.ndarray:
    x = (x ^ (x >> np.uint64(30))) * MULTIPLIERS[0]
    x = (x ^ (x >> np.uint64(27))) * MULTIPLIERS[1]
    return x ^ (x >> np.uint64(31))
