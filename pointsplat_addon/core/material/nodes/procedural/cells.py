"""The pseudo-random points and colours of the Voronoi texture's cells.

In one dimension by Jenkins' hash, in more by permuted congruential generators of two to four words (Jarzynski and
Olano 2020, Hash Functions for GPU Rendering).
"""

from __future__ import annotations

import numpy as np

from .hashes import hash_floats

MULTIPLIER, INCREMENT = np.int32(1664525), np.int32(1013904223)  # Knuth's and Lewis's linear congruential generator


def _pcg(words: list[np.ndarray]) -> list[np.ndarray]:
    """The words (n,) int32 mixed; the sign bit is cleared."""
    d = len(words)
    v = [w * MULTIPLIER + INCREMENT for w in words]
    orders = {2: ((0, 1, 1), (1, 0, 0)), 3: ((0, 1, 2), (1, 2, 0), (2, 0, 1)), 4: ((0, 1, 3), (1, 2, 0), (2, 0, 1), (3, 1, 2))}[d]
    for shift in (True, False):
        for i, j, k in orders:
            v[i] = v[i] + (v[j] * MULTIPLIER if d == 2 else v[j] * v[k])
        if shift:
            v = [w ^ (w >> np.int32(16)) for w in v]
    return [w & np.int32(0x7FFFFFFF) for w in v]


def _unit(words: list[np.ndarray]) -> np.ndarray:
    out = np.empty((len(words), len(words[0])), np.float32)
    for row, word in zip(out, words, strict=True):
        np.multiply(word, np.float32(1 / 0x7FFFFFFF), out=row, casting="unsafe")
    return out


def cell_point(cell: np.ndarray) -> np.ndarray:
    """Points (D, n) float32 in [0, 1] of cells (D, n) float32 that are whole numbers."""
    if len(cell) == 1:
        return hash_floats(cell[0])[None]
    return _unit(_pcg(list(cell.astype(np.int32))))


def cell_color(cell: np.ndarray) -> np.ndarray:
    """Colours (3, n) float32 in [0, 1] of cells (D, n) float32 that are whole numbers."""
    if len(cell) == 1:
        return np.stack([hash_floats(cell[0]), hash_floats(cell[0], 1.0), hash_floats(cell[0], 2.0)])
    words = list(cell.astype(np.int32))
    if len(words) == 2:
        words.append(np.zeros_like(words[0]))
    return _unit(_pcg(words)[:3])
