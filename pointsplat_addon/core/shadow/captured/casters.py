"""Captured Gaussian splats in world space, as casters of shadows."""

from __future__ import annotations

import numpy as np

from ...numeric.rotations import rotation_matrices
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
            own = rotation_matrices(splats.rotation[some].T) * (2 * splats.scale[some].T)
            axes[..., block] = (turn @ own.reshape(3, -1)).reshape(own.shape)

    each_block(len(rows), fill)
    origin = linear @ splats.origin + world_from_object[:3, 3]
    found = Casters("CAPTURED", origin, position, axes=axes.transpose(2, 1, 0), opacity=opacity)
    with np.errstate(over="ignore", invalid="ignore"):
        good = np.isfinite(position).all(axis=1) & np.isfinite(found.reach) & (found.reach > 0)
    return found if good.all() else found.take(good)
