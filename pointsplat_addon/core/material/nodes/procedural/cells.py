"""The pseudo-random points and colours of the Voronoi texture's cells.

Since Blender 5.0 they come from permuted congruential generators of two to four words (Jarzynski and Olano 2020, Hash
Functions for GPU Rendering), before from Jenkins' hash, as they still do in one dimension.
"""

from __future__ import annotations

import numpy as np

from .hashes import float_words, hash_floats, lookup3, unit_float

MULTIPLIER, INCREMENT = np.int32(1664525), np.int32(1013904223)  # a linear congruential generator modulo 2^32
# Which word takes in the product of which two others, by the number of words
PRODUCTS = {3: ((0, 1, 2), (1, 2, 0), (2, 0, 1)), 4: ((0, 1, 3), (1, 2, 0), (2, 0, 1), (3, 1, 2))}
UNIT = np.float32(1 / 0x7FFFFFFF)
LIMIT = np.float32(2.0**30)  # of lattice coordinates


class Cells:
    """The cells of a lattice that hold some points, and their neighbours.

    `cell`: (D, n) float32, whole numbers; `local`: (D, n) float32, the points within their cells. Steps from cell to
    cell are (D, 1) or (D, n) float32.
    """

    def __init__(self, p: np.ndarray, congruential: bool) -> None:
        """p: (D, n) float32. congruential: the hash of Blender 5, else that of Blender 4."""
        floor = np.floor(p)
        self.local = p - floor
        self.cell = np.clip(np.nan_to_num(floor), -LIMIT, LIMIT)
        # The generators' first step is linear, so that it is done once for all neighbours
        congruential &= len(p) > 1
        self._words = self.cell.astype(np.int32) * MULTIPLIER + INCREMENT if congruential else None

    def points(self, step: np.ndarray) -> np.ndarray:
        """Points (D, n) float32 in [0, 1] of the cells that lie a step away."""
        if self._words is not None:
            return _unit(_mixed(self._words + step.astype(np.int32) * MULTIPLIER))
        cell = self.cell + step
        if len(cell) < 4:
            return _numbered(cell, len(cell))
        x, y, z, w = cell
        orders = (x, y, z, w), (w, x, y, z), (z, w, x, y), (y, z, w, x)
        return np.stack([hash_floats(*order) for order in orders])

    def colors(self, step: np.ndarray) -> np.ndarray:
        """Colours (3, n) float32 in [0, 1] of the cells that lie a step away."""
        if self._words is not None:
            words = self._words + step.astype(np.int32) * MULTIPLIER
            if len(words) == 2:  # the third coordinate is 0
                words = np.concatenate([words, np.full_like(words[:1], INCREMENT)])
            return _unit(_mixed(words)[:3])
        cell = self.cell + step
        if len(cell) < 4:
            return _numbered(cell, 3)
        x, y, z, w = cell
        return np.stack([hash_floats(*order) for order in ((x, y, z, w), (z, x, w, y), (w, z, y, x))])

    def known_colors(self, step: np.ndarray, points: np.ndarray) -> np.ndarray:
        """`colors`, where `points` are those of the same cells: in three dimensions they are the same numbers."""
        same = len(points) == 3 or (len(points) == 4 and self._words is not None)
        return points[:3] if same else self.colors(step)


def _numbered(cell: np.ndarray, count: int) -> np.ndarray:
    """(count, n) hashes of one to three coordinates, and of these and the numbers 1 to count - 1."""
    found = np.empty((count, cell.shape[1]), np.float32)
    words = float_words(*cell)
    found[0] = unit_float(lookup3(words))
    if count > 1:
        found[1:] = unit_float(lookup3([*words, *float_words(np.arange(1, count)[:, None])]))
    return found


def _mixed(words: np.ndarray) -> np.ndarray:
    """Words (2..4, n) int32, changed in place: mixed modulo 2^32, without their sign bits."""
    v = list(words)
    for again in (False, True):
        if again:
            words ^= words >> np.int32(16)
        if len(v) == 2:
            v[0] += v[1] * MULTIPLIER
            v[1] += v[0] * MULTIPLIER
        else:
            for i, j, k in PRODUCTS[len(v)]:
                v[i] += v[j] * v[k]
    words &= np.int32(0x7FFFFFFF)
    return words


def _unit(words: np.ndarray) -> np.ndarray:
    """Words (D, n) int32 without sign bits as float32 in [0, 1]."""
    out = words.astype(np.float32)
    out *= UNIT
    return out
