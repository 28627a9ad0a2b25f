"""Normals of captured splats, which training does not know: those of the surfaces on which they lie.

A flat splat lies in its surface, across its shortest axis (as in Guédon and Lepetit 2024, SuGaR). Round ones tell
nothing, and those of flat ones are noisy: a normal is the principal axis of the sum of n nᵀ over a splat and its
nearest neighbours, each weighted by its opacity and by how flat it is. Which side of a surface is the outside is not
known.
"""

from __future__ import annotations

import numpy as np

from ...numeric.vectors import each_block
from ...scene.captured import CapturedSplats
from .nearest import make_orders, nearest
from .planes import eigenvalues, smallest_eigenvector

NEIGHBOURS = 8
OWN = 4.0  # of its neighbours' weights: that of a splat itself
DEFINITE = 0.5  # of the sum's trace: least of its largest eigenvalue; a third where all directions are alike
BLOCK = 1 << 13
PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def captured_normals(splats: CapturedSplats) -> np.ndarray:
    """Returns (N, 3) float32: unit normals in the splats' object, of either side; zero where none is definite."""
    orders = make_orders(splats.position)
    own = np.zeros((6, len(orders)), np.float32)
    there = np.flatnonzero(orders.place >= 0)
    place = orders.place[there]
    for row, tensor in zip(own, _tensors(splats), strict=True):
        row += np.bincount(place, tensor[there], len(orders)).astype(np.float32)
    normal = np.zeros((len(orders), 3), np.float32)

    def find(block: slice) -> None:
        index, squared = nearest(orders, block, NEIGHBOURS)
        near = np.isfinite(squared)
        total = np.stack([OWN * row[block] + np.where(near, row.take(index), 0).sum(axis=1) for row in own])
        values = eigenvalues(-total.astype(np.float64))
        vector = smallest_eigenvector(-total.astype(np.float64), values)
        trace = total[0] + total[3] + total[5]
        definite = (-values[0] >= DEFINITE * trace) & (trace > 0)
        normal[block] = np.where(definite, vector, 0).T

    if len(orders):
        each_block(len(orders), find, BLOCK)
    found = np.zeros((len(splats), 3), np.float32)
    found[there] = normal[place]
    return found


def _tensors(splats: CapturedSplats) -> np.ndarray:
    """(6, N) float32: n nᵀ of the shortest axes, weighted; the pairs of PAIRS."""
    found = np.empty((6, len(splats)), np.float32)

    def fill(block: slice) -> None:
        scale = np.sort(splats.scale[block], axis=1)
        flat = 1 - scale[:, 0] / np.maximum(scale[:, 1], np.float32(1e-30))
        weight = splats.opacity[block] * flat**2
        axis = _axes(splats.rotation[block].T, splats.scale[block].argmin(axis=1))
        for row, (i, j) in enumerate(PAIRS):
            found[row, block] = weight * axis[i] * axis[j]

    each_block(len(splats), fill)
    return found


def _axes(quaternion: np.ndarray, which: np.ndarray) -> np.ndarray:
    """(3, n): of the rotations of unit quaternions (4, n), w first, the column that is asked for (n,)."""
    w, x, y, z = quaternion
    columns = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
        [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
        [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
    return columns[which, :, np.arange(len(which))].T
