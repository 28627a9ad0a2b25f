"""Coordinates and directions of world space, for materials of what lies in one place."""

from __future__ import annotations

import numpy as np

from ...numeric.record import record
from ..expression import Expression, SampleInputs
from .math_functions import normalize_rows


@record
class ToWorld(Expression):
    """A point or a normal (N, 3) of object space in world space; normals are unit."""

    vector: Expression
    world_from_object: tuple[tuple[float, ...], ...]  # three rows of four
    normal: bool = False

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        matrix = np.array(self.world_from_object)
        if not self.normal:
            return values[0] @ matrix[:, :3].T.astype(np.float32) + matrix[:, 3].astype(np.float32)
        if abs(np.linalg.det(matrix[:, :3])) < 1e-30:  # flattened: there is no inverse
            return normalize_rows(values[0])
        return normalize_rows(values[0] @ np.linalg.inv(matrix[:, :3]).astype(np.float32))
