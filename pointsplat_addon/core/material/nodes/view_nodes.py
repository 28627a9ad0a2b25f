"""Nodes that depend on the eye, with Cycles' formulas: a dielectric's reflectance (Fresnel), and falloff by the cosine.

Where there is no eye, as at points, which are seen from all sides, cosines are the mean over what is seen of a ball.
"""

from __future__ import annotations

import numpy as np

from ...numeric.record import record
from ..expression import Expression, SampleInputs
from .math_functions import normalize_rows

LEAST_INDEX = 1e-5
MEAN_COSINE = 2 / 3  # over the picture of a ball


@record
class Incoming(Expression):
    """Unit directions to the eye, (N, 3), from positions, all in world space; zeros where there is none."""

    position: Expression

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        eye = inputs.eye
        if eye is None:
            return np.zeros((1, 3), np.float32)
        if not eye.perspective:
            return eye.view_from_world[2:3, :3].astype(np.float32)
        linear, move = eye.view_from_world[:3, :3], eye.view_from_world[:3, 3]
        return normalize_rows(-(linear.T @ move) - values[0])


@record
class InView(Expression):
    """Positions (N, 3) in the space of the eye, which looks along z; zeros where there is none."""

    position: Expression  # in world space

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        if inputs.eye is None:
            return np.zeros((1, 3), np.float32)
        matrix = inputs.eye.view_from_world
        return (values[0] @ matrix[:3, :3].T + matrix[:3, 3]) * [1, 1, -1]


@record
class InWindow(Expression):
    """Where in the picture positions (N, 3) are seen, (x, y, 0), from 0 to 1; zeros where there is no eye."""

    position: Expression  # in world space

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        eye = inputs.eye
        if eye is None:
            return np.zeros((1, 3), np.float32)
        matrix = eye.clip_from_view @ eye.view_from_world
        x, y, _, w = matrix[:, :3] @ values[0].T + matrix[:, 3:]
        return np.stack([0.5 + 0.5 * x / w, 0.5 + 0.5 * y / w, np.zeros_like(x)], axis=1)


@record
class Cosine(Expression):
    """(N, 1): the cosine of the angle between a normal, to either side, and the way to the eye."""

    incoming: Expression
    normal: Expression  # unit, in world space

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        if inputs.eye is None:
            return np.full((1, 1), MEAN_COSINE, np.float32)
        return np.abs((values[0] * values[1]).sum(axis=1, keepdims=True))


@record
class Reflectance(Expression):
    """(N, 1): the share of unpolarised light that a dielectric reflects."""

    cosine: Expression
    index: Expression  # (N, 1): of refraction, of what lies behind the front
    backfacing: Expression  # (N, 1): 1 where the back is seen

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        cosine, index, back = values
        index = np.maximum(index, LEAST_INDEX)
        index = np.where(back > 0.5, 1 / index, index)
        squared = index**2 - 1 + cosine**2
        g = np.sqrt(np.maximum(squared, 0))
        across = (g - cosine) / (g + cosine)
        along = (cosine * (g + cosine) - 1) / (cosine * (g - cosine) + 1)
        return np.where(squared > 0, 0.5 * across**2 * (1 + along**2), 1.0)


@record
class Facing(Expression):
    """(N, 1): Layer Weight's falloff, 0 where the surface faces the eye, 1 where it is seen along itself."""

    cosine: Expression
    blend: Expression  # (N, 1)

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        cosine, blend = values[0], np.clip(values[1], 0, 1 - 1e-5)
        return 1 - cosine ** np.where(blend < 0.5, 2 * blend, 0.5 / (1 - blend))


@record
class Reflected(Expression):
    """Directions (N, 3) in which normals mirror the way to the eye; zeros where there is none."""

    incoming: Expression
    normal: Expression  # unit, in world space

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        incoming, normal = values
        return 2 * (incoming * normal).sum(axis=1, keepdims=True) * normal - incoming


READ_EYE = Incoming, InView, InWindow, Cosine
