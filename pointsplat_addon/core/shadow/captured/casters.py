"""Captured Gaussian splats in world space, as casters of shadows."""

from __future__ import annotations

import numpy as np

from ...numeric.vectors import each_block
from ...scene.captured import CapturedSplats
from ...splat.captured import LEAST_ALPHA, MOST_ALPHA
from ..casters import Casters


def captured_casters(splats: CapturedSplats, world_from_object: np.ndarray) -> Casters:
    """The splats of an instance, (4, 4) float64, in world space.

    Those that no view shows, of too little opacity, and those whose size is no number there are left out.
    """
    linear = np.asarray(world_from_object[:3, :3], float)
    turn = linear.astype(np.float32)
    rows = np.flatnonzero(splats.opacity >= LEAST_ALPHA)
    position = np.empty((len(rows), 3), np.float32)
    axes = np.empty((3, 3, len(rows)), np.float32)  # coordinate, which, splat
    opacity = np.minimum(splats.opacity[rows], np.float32(MOST_ALPHA))

    def fill(block: slice) -> None:
        some = rows[block]
        with np.errstate(over="ignore", invalid="ignore"):
            position[block] = splats.position[some] @ turn.T
            own = _rotations(splats.rotation[some].T) * (2 * splats.scale[some].T)
            axes[..., block] = (turn @ own.reshape(3, -1)).reshape(own.shape)

    each_block(len(rows), fill)
    origin = linear @ splats.origin + world_from_object[:3, 3]
    found = Casters("CAPTURED", origin, position, axes=axes.transpose(2, 1, 0), opacity=opacity)
    with np.errstate(over="ignore", invalid="ignore"):
        good = np.isfinite(position).all(axis=1) & np.isfinite(found.reach) & (found.reach > 0)
    return found if good.all() else found.take(good)


def _rotations(quaternion: np.ndarray) -> np.ndarray:
    """(3, 3, n): the rotation matrices of unit quaternions (4, n), w first."""
    w, x, y, z = quaternion
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
