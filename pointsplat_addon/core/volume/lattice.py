"""Sparse voxel indices as sortable 64-bit numbers."""

from __future__ import annotations

import numpy as np

from ..numeric.vectors import column_ranges

ROWS = 1 << 20  # voxels that are handled together: temporary arrays stay small


def lattice_keys(index: np.ndarray, low: np.ndarray, extent: np.ndarray) -> np.ndarray:
    """(N,) int64: one number for each index (N, 3), in lexicographic order, x first.

    Indices lie in low + [0, extent). Raises ValueError where so many cells have no 64-bit number.
    """
    if float(extent[0]) * float(extent[1]) * float(extent[2]) >= 2.0**62:
        raise ValueError("the voxels lie too far apart: " + " x ".join(str(int(e)) for e in extent))
    key = index[:, 0].astype(np.int64)
    key -= low[0]
    for k in (1, 2):
        key *= extent[k]
        key += index[:, k]
        key -= low[k]
    return key


def index_bounds(index: np.ndarray, margin: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """The low corner (3,) and extent (3,) int64 of the box of indices (N, 3), N > 0, with a margin on all sides."""
    low, high = (corner.astype(np.int64) for corner in column_ranges(index))
    return low - margin, high - low + 1 + 2 * margin


def group_equal_rows(index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """An order (N,) that brings equal rows of indices (N, 3) together, and the K positions in it where groups begin."""
    key = lattice_keys(index, *index_bounds(index))
    order = np.argsort(key, kind="stable")
    key = key[order]
    return order, np.flatnonzero(np.append(True, key[1:] != key[:-1]))
