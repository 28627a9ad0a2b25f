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


def cell_point(cell: np.ndarray, congruential: bool) -> np.ndarray:
    """Points (D, n) float32 in [0, 1] of cells (D, n) float32 that are whole numbers."""
    if len(cell) == 1:
        return hash_floats(cell[0])[None]
    if congruential:
        return _unit(_mixed(cell.astype(np.int32)))
    if len(cell) == 4:
        x, y, z, w = cell
        return np.stack([hash_floats(x, y, z, w), hash_floats(w, x, y, z), hash_floats(z, w, x, y), hash_floats(y, z, w, x)])
    return _numbered(cell, len(cell))


def cell_color(cell: np.ndarray, congruential: bool) -> np.ndarray:
    """Colours (3, n) float32 in [0, 1] of cells (D, n) float32 that are whole numbers."""
    if congruential and len(cell) > 1:
        words = cell.astype(np.int32)
        if len(words) == 2:
            words = np.concatenate([words, np.zeros_like(words[:1])])
        return _unit(_mixed(words)[:3])
    if len(cell) == 4:
        x, y, z, w = cell
        return np.stack([hash_floats(x, y, z, w), hash_floats(z, x, w, y), hash_floats(w, z, y, x)])
    return _numbered(cell, 3)


def _numbered(cell: np.ndarray, count: int) -> np.ndarray:
    """(count, n) hashes of one to three coordinates, and of these and the numbers 1 to count - 1."""
    found = np.empty((count, cell.shape[1]), np.float32)
    words = float_words(*cell)
    found[0] = unit_float(lookup3(words))
    found[1:] = unit_float(lookup3([*words, *float_words(np.arange(1, count)[:, None])]))
    return found


def _mixed(words: np.ndarray) -> list[np.ndarray]:
    """Words (2..4, n) int32, mixed modulo 2^32 and without their sign bits."""
    v = list(words * MULTIPLIER + INCREMENT)
    for again in (False, True):
        if again:
            for w in v:
                w ^= w >> np.int32(16)
        if len(v) == 2:
            v[0] += v[1] * MULTIPLIER
            v[1] += v[0] * MULTIPLIER
        else:
            for i, j, k in PRODUCTS[len(v)]:
                v[i] += v[j] * v[k]
    for w in v:
        w &= np.int32(0x7FFFFFFF)
    return v


def _unit(words: list[np.ndarray]) -> np.ndarray:
    out = np.empty((len(words), len(words[0])), np.float32)
    for row, word in zip(out, words, strict=True):
        np.multiply(word.astype(np.float32), UNIT, out=row)
    return out
