"""How image textures are laid onto surfaces other than by UV maps: around spheres and tubes, and from six sides.

As Cycles does (its kernel's svm/image.h and util/math's mappings), so that pictures agree.
"""

from __future__ import annotations

import numpy as np

from ...numeric.record import record
from ..expression import Expression, SampleInputs


@record
class Wrapped(Expression):
    """UV coordinates (N, 3) of places `at` in the cube from 0 to 1: around a sphere, or a tube along z, in it."""

    at: Expression
    sphere: bool

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        x, y, z = (2 * values[0] - 1).T
        round_about = np.hypot(x, y)
        u = np.where(round_about > 0, 0.5 - np.arctan2(x, y) / (2 * np.pi), 0)
        if self.sphere:
            length = np.hypot(round_about, z)
            cosine = np.clip(z / np.where(length > 0, length, 1), -1, 1)
            v = np.where(length > 0, 1 - np.arccos(cosine) / np.pi, 0)
        else:
            v = np.where(round_about > 0, 0.5 * (z + 1), 0)
        return np.stack([u, v, np.zeros_like(u)], axis=1).astype(np.float32)


@record
class FromSide(Expression):
    """UV coordinates (N, 3) of places `at`, as seen along an axis from where the `normal` points."""

    at: Expression
    normal: Expression
    axis: int

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        at, normal = values
        across, up = ((1, 2), (0, 2), (1, 0))[self.axis]
        turned = normal[:, self.axis] < 0 if self.axis == 0 else normal[:, self.axis] > 0
        u = np.where(turned, 1 - at[:, across], at[:, across])
        v = np.broadcast_to(at[:, up], u.shape)
        return np.stack([u, v, np.zeros_like(u)], axis=1)


@record
class FromSixSides(Expression):
    """The mean (N, C) of what is seen along x, y and z: along the axis that the `normal` is nearest to, and with a
    `blend` from 0 to 1 along others that it is nearly as near to.
    """

    along_x: Expression
    along_y: Expression
    along_z: Expression
    normal: Expression
    blend: float

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        *seen, normal = values
        weights = self._weights(normal).astype(np.float32)
        return sum(weight[:, None] * color for weight, color in zip(weights.T, seen, strict=True))  # type: ignore[return-value]

    def _weights(self, normal: np.ndarray) -> np.ndarray:
        """(N, 3), 1 together; along x where there is no normal."""
        size = np.abs(normal.astype(np.float64))
        size = np.where(size.any(axis=1, keepdims=True), size, [1, 0, 0])
        size = size / size.sum(axis=1, keepdims=True)
        limit = 0.5 * (1 + self.blend)
        found = np.zeros_like(size)
        left = np.ones(len(size), bool)
        for axis in range(3):
            b, c = ((1, 2), (0, 2), (0, 1))[axis]
            alone = left & (size[:, axis] > limit * (size[:, axis] + size[:, b]))
            alone &= size[:, axis] > limit * (size[:, axis] + size[:, c])
            found[alone, axis] = 1
            left &= ~alone
        if self.blend <= 0:
            found[left, 0] = 1
            return found
        # Between two axes, where the third is far.
        for far, a, b in ((2, 0, 1), (0, 1, 2), (1, 0, 2)):
            two = left & (size[:, far] < (1 - limit) * (size[:, a] + size[:, b]))
            share = size[two, a] / (size[two, a] + size[two, b])
            found[two, a] = np.clip((share - 0.5 * (1 - self.blend)) / self.blend, 0, 1)
            found[two, b] = 1 - found[two, a]
            left &= ~two
        found[left] = ((2 - limit) * size[left] + (limit - 1)) / (2 * limit - 1)
        return found
