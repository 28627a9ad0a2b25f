"""Quaternions of which files store the smallest three components: the largest follows from unit length."""

from __future__ import annotations

import numpy as np

# The components that are stored, in order, by which of the four is the largest.
STORED = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])


def smallest_three(largest: np.ndarray, stored: np.ndarray, out: np.ndarray) -> None:
    """Puts quaternions together. largest: (n,) int 0 to 3; stored: (n, 3) float32; out: (n, 4) float32, in the
    components' own order."""
    rows = np.arange(len(out))
    rest = 1 - np.einsum("ij,ij->i", stored, stored)
    for i in range(3):
        out[rows, STORED[largest, i]] = stored[:, i]
    out[rows, largest] = np.sqrt(np.maximum(rest, 0))


def pack_smallest_three(rotation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the number of the largest component, (n,) int, and the others, (n, 3), of unit quaternions (n, 4), such
    that the largest one is positive."""
    largest = np.abs(rotation).argmax(axis=1)
    sign = np.where(np.take_along_axis(rotation, largest[:, None], axis=1) < 0, -1, 1)
    return largest, np.take_along_axis(rotation, STORED[largest], axis=1) * sign
