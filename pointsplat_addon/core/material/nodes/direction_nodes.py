"""Nodes of worlds: where pictures of all directions are looked up."""

from __future__ import annotations

import numpy as np

from ...numeric.record import record
from ...sky.sky import Disc, Sky
from ..expression import Expression, SampleInputs
from .math_functions import normalize_rows


@record
class Equirectangular(Expression):
    """UV (N, 3), the last 0, of directions in Blender's equirectangular layout (core/light/environment.py)."""

    direction: Expression

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        x, y, z = values[0].T
        u = np.where((x == 0) & (y == 0), 0.5, 0.5 - np.arctan2(y, x) / (2 * np.pi))
        v = 0.5 + np.arctan2(z, np.hypot(x, y)) / np.pi
        return np.stack([u, v, np.zeros_like(v)], axis=1)


@record
class MirrorBall(Expression):
    """UV (N, 3), the last 0, of directions in the picture of a mirror ball that is seen along +Y from infinitely far.

    What the ball shows of direction d lies where its normal is the half vector of d and the way back to the eye.
    """

    direction: Expression

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        normal = normalize_rows(normalize_rows(values[0]) - np.array([0, 1, 0], np.float32))
        return np.stack([0.5 + 0.5 * normal[:, 0], 0.5 + 0.5 * normal[:, 2], np.zeros(len(normal))], axis=1)


@record
class SkyTexture(Expression):
    """The colour (N, 3) of a sky in directions, with the sun's disc if there is one; none is negative, as in Cycles."""

    direction: Expression
    sky: Sky
    disc: Disc | None = None

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        direction = normalize_rows(values[0].astype(float))
        found = self.sky.radiance(direction)
        return np.maximum(found if self.disc is None else found + self.disc.radiance(direction), 0)
