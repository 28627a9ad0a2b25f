"""Nodes over balls whose covered fraction is known: the shape by which the visibility buffer draws them."""

from __future__ import annotations

import numpy as np

from .tree import MOST_SATURATION

WIDER = 2.06  # of its area, in which a node that is wide on the screen thins out: shaders/lib/splat/covered.glsl
OPAQUE = 1 / 512  # of a node that is stored as covered as a whole: what a byte does not tell from nothing


def node_shape(
    normal: np.ndarray, axis: np.ndarray, radii: np.ndarray, covered: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Returns BallTree.shape, (N, 8) float32, and the radii (N,) float32 of balls that look as large across the normal.

    `normal`, `axis` (N, 3): unit, directions of the last and the first of the half-axes `radii` (N, 3); `covered` (N,):
    how much of the ellipse across the normal is covered. Nodes whose balls have the areas t, over that of the ellipse,
    are covered by 1 - exp(-t (1 + s t)): of that t is found.
    """
    across = np.cross(normal, axis)
    squares = radii.astype(np.float64) ** 2
    shape = np.empty((len(radii), 8), np.float32)
    pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    for column, (i, j) in enumerate(pairs):
        shape[:, column] = (
            squares[:, 0] * axis[:, i] * axis[:, j]
            + squares[:, 1] * across[:, i] * across[:, j]
            + squares[:, 2] * normal[:, i] * normal[:, j]
        )
    depth = -np.log(np.clip(1 - covered, OPAQUE, 1.0))
    areas = (np.sqrt(1 + 4 * MOST_SATURATION * depth) - 1) / (2 * MOST_SATURATION)
    shape[:, 6] = np.pi * areas * radii[:, 0] * radii[:, 1]
    shape[:, 7] = MOST_SATURATION
    return shape, np.sqrt(radii[:, 0] * radii[:, 1]).astype(np.float32)
