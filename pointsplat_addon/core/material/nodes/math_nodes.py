"""Mathematical nodes: Math, Vector Math, Clamp, Map Range and Mapping."""

from __future__ import annotations

import numpy as np

from ...numeric.record import record
from ..expression import Expression, SampleInputs
from .math_functions import MATH, VECTOR_MATH, divide_or_zero, normalize_rows, rotate_euler, smooth_step


@record
class Math(Expression):
    """A scalar operation of MATH."""

    a: Expression
    b: Expression
    c: Expression
    operation: str
    clamp: bool = False

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        out = MATH[self.operation](*values)
        return np.clip(out, 0, 1) if self.clamp else out


@record
class VectorMath(Expression):
    """A vector operation of VECTOR_MATH; DOT_PRODUCT, DISTANCE and LENGTH yield scalars."""

    a: Expression
    b: Expression
    c: Expression
    scale: Expression
    operation: str

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        return VECTOR_MATH[self.operation](*values)


@record
class Clamp(Expression):
    """A value limited to a range."""

    value: Expression
    low: Expression
    high: Expression
    ordered: bool = False  # swap the limits where low > high (the RANGE type)

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        value, low, high = values
        if self.ordered:
            low, high = np.minimum(low, high), np.maximum(low, high)
        return np.minimum(np.maximum(value, low), high)


@record
class MapRange(Expression):
    """A value mapped from one range to another."""

    value: Expression
    from_low: Expression
    from_high: Expression
    to_low: Expression
    to_high: Expression
    steps: Expression
    interpolation: str = "LINEAR"  # LINEAR, STEPPED, SMOOTHSTEP, SMOOTHERSTEP
    clamp: bool = True
    vector: bool = False

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        value, low, high, to_low, to_high, steps = values
        factor = divide_or_zero(value - low, high - low)
        if self.interpolation == "STEPPED":
            factor = np.where(steps > 0, divide_or_zero(np.floor(factor * (steps + 1)), steps), 0)
        elif self.interpolation in ("SMOOTHSTEP", "SMOOTHERSTEP"):
            degree = 3 if self.interpolation == "SMOOTHSTEP" else 5
            step = smooth_step(np.minimum(low, high), np.maximum(low, high), value, degree)
            factor = np.where(low > high, 1 - step, step)
        out = to_low + factor * (to_high - to_low)
        # The scalar node yields 0 for an empty source range, the vector node the lower end
        if not self.vector:
            out = np.where(low == high, 0, out)
        if self.clamp and self.interpolation in ("LINEAR", "STEPPED"):
            out = np.clip(out, np.minimum(to_low, to_high), np.maximum(to_low, to_high))
        return out


@record
class Mapping(Expression):
    """Blender's Mapping node; rotation in radians, XYZ Euler."""

    vector: Expression
    location: Expression
    rotation: Expression
    scale: Expression
    kind: str = "POINT"  # POINT, TEXTURE (the inverse of POINT), VECTOR (no translation), NORMAL

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        vector, location, rotation, scale = values
        if self.kind == "TEXTURE":
            return divide_or_zero(rotate_euler(vector - location, rotation, inverse=True), scale)
        if self.kind == "NORMAL":
            return normalize_rows(rotate_euler(divide_or_zero(vector, scale), rotation))
        rotated = rotate_euler(vector * scale, rotation)
        return rotated + location if self.kind == "POINT" else rotated
