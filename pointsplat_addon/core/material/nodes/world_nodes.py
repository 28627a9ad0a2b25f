"""Coordinates and directions in world space and in spaces of objects."""

from __future__ import annotations

import numpy as np

from ...numeric.record import record
from ..expression import Expression, SampleInputs
from .math_functions import normalize_rows


@record
class Transformed(Expression):
    """A point or a normal (N, 3) of one space in another, such as of object space in world space; normals are unit."""

    vector: Expression
    matrix: Expression  # (N, 12): three rows of four
    normal: bool = False

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        vector, matrix = values[0], values[1].reshape(-1, 3, 4)
        linear, move = matrix[:, :, :3], matrix[:, :, 3]
        if not self.normal:
            return _turned(vector, linear) + move
        # Cofactors are inverse transposes but for a factor, and what is flattened has them as well
        cofactors = np.stack([np.cross(linear[:, :, (k + 1) % 3], linear[:, :, (k + 2) % 3]) for k in range(3)], axis=2)
        mirrored = np.einsum("nij,nij->n", linear, cofactors) < 0
        turned = _turned(vector, np.where(mirrored[:, None, None], -cofactors, cofactors))
        return normalize_rows(np.where(turned.any(axis=1, keepdims=True), turned, vector))


@record
class Lengthened(Expression):
    """A length (N, 1) of one space in another, along the diagonal (1, 1, 1), as Cycles has radii of points."""

    length: Expression
    matrix: Expression  # (N, 12): three rows of four

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        diagonal = values[1].reshape(-1, 3, 4)[:, :, :3].sum(axis=2) / np.sqrt(np.float32(3))
        return values[0] * np.linalg.norm(diagonal, axis=1, keepdims=True)


def _turned(vectors: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """Vectors (N, 3) by matrices (N | 1, 3, 3)."""
    return vectors @ matrices[0].T if len(matrices) == 1 else np.einsum("nij,nj->ni", matrices, vectors)
