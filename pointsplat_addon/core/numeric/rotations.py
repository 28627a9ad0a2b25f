"""Rotation matrices of unit quaternions."""

from __future__ import annotations

import numpy as np


def rotation_matrices(quaternion: np.ndarray) -> np.ndarray:
    """Returns the matrices (3, 3, n) of unit quaternions (4, n), w first, in their dtype."""
    w, x, y, z = quaternion
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
