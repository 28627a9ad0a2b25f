"""Colour ramps and curves."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ...numeric.record import record, value_record
from ..color_models import COLOR_MODELS
from ..expression import Expression, SampleInputs
from ..textures import uniform_b_spline
from .math_functions import divide_or_zero, linear_blend


def _cardinal(t: np.ndarray) -> tuple[np.ndarray, ...]:
    """Weights of four neighbours of the cardinal spline with Blender's tension 0.71."""
    f, t2, t3 = 0.71, t * t, t * t * t
    first = -f * t3 + 2 * f * t2 - f * t
    second = (2 - f) * t3 + (f - 3) * t2 + 1
    third = (f - 2) * t3 + (3 - 2 * f) * t2 + f * t
    return first, second, third, f * t3 - f * t2


def _blend_hue(left: np.ndarray, right: np.ndarray, t: np.ndarray, path: str) -> np.ndarray:
    """Hues in [0, 1) interpolated the NEAR, FAR, CW or CCW way round."""
    gap = right - left
    if path == "NEAR":
        turn = np.where(gap > 0.5, -1, np.where(gap < -0.5, 1, 0))
    elif path == "FAR":
        turn = np.where((gap > 0) & (gap < 0.5), -1, np.where((gap <= 0) & (gap > -0.5), 1, 0))
    elif path == "CCW":
        turn = np.where(gap > 0, -1, 0)
    else:
        turn = np.where(gap < 0, 1, 0)
    return (left + t * (gap + turn)) % 1


@record
class ColorRamp(Expression):
    """Colour and alpha (N, 4) of a gradient, as Blender's ColorRamp.evaluate gives them."""

    factor: Expression
    positions: np.ndarray  # (K,) float32, ascending
    colors: np.ndarray  # (K, 4) float32
    interpolation: str = "LINEAR"  # LINEAR, EASE, CONSTANT, CARDINAL, B_SPLINE
    mode: str = "RGB"  # RGB, HSV, HSL; only RGB knows other interpolations than LINEAR
    hue: str = "NEAR"  # NEAR, FAR, CW, CCW

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        x, stops, last = values[0][:, 0], self.positions, len(self.positions) - 1
        interpolation = self.interpolation if self.mode == "RGB" else "LINEAR"
        after = np.searchsorted(stops, x, side="right")  # the first stop beyond x
        left, right = np.maximum(after - 1, 0), np.minimum(after, last)
        if interpolation == "CONSTANT":
            return self.colors[left]
        # Beyond the ends the outer stops are repeated at 0 and 1; only splines notice
        start = np.where(after == 0, 0, stops[left])
        end = np.where(after > last, 1, stops[right])
        at_end = np.where(after > last, 0, 1)
        t = np.clip(np.where(start == end, at_end, divide_or_zero(x - start, end - start)), 0, 1)
        if interpolation in ("CARDINAL", "B_SPLINE"):
            weights = (_cardinal if interpolation == "CARDINAL" else uniform_b_spline)(t)
            neighbours = (np.maximum(after - 2, 0), left, right, np.minimum(after + 1, last))
            total = sum(w[:, None] * self.colors[i] for w, i in zip(weights, neighbours, strict=True))
            return np.clip(total, 0, 1)
        if interpolation == "EASE":
            t = t * t * (3 - 2 * t)
        t = t[:, None]
        if self.mode == "RGB":
            return linear_blend(self.colors[left], self.colors[right], t)
        t = np.where(left == right, 0, t[:, 0])[:, None]  # FAR would run through all hues beyond the ends
        return self._blend_in_model(left, right, t)

    def _blend_in_model(self, left: np.ndarray, right: np.ndarray, t: np.ndarray) -> np.ndarray:
        model = COLOR_MODELS[f"{self.mode}_FROM_RGB"](self.colors[:, :3])
        out = linear_blend(model[left], model[right], t)
        out[:, 0] = _blend_hue(model[left, 0], model[right, 0], t[:, 0], self.hue)
        alpha = linear_blend(self.colors[left, 3:], self.colors[right, 3:], t)
        return np.concatenate([COLOR_MODELS[f"RGB_FROM_{self.mode}"](out), alpha], axis=1)


@value_record
class CurveTable:
    """A curve as equidistant samples with straight continuations."""

    low: float  # abscissa of the first value
    high: float  # abscissa of the last value
    values: tuple[float, ...]
    slopes: tuple[float, float] = (0.0, 0.0)  # before low, after high

    @cached_property
    def array(self) -> np.ndarray:
        return np.array(self.values, np.float32)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        table, (before, after) = self.array, self.slopes
        position = (x - self.low) * ((len(table) - 1) / (self.high - self.low))
        i = np.clip(np.nan_to_num(np.floor(position)), 0, len(table) - 2).astype(np.int64)
        inside = linear_blend(table[i], table[i + 1], np.clip(position - i, 0, 1))
        return inside + before * np.minimum(x - self.low, 0) + after * np.maximum(x - self.high, 0)


@record
class Curves(Expression):
    """Curves for each channel, after `combined` (if any) for all: RGB, vector and float curves."""

    factor: Expression
    value: Expression
    channels: tuple[CurveTable, ...]
    combined: CurveTable | None = None

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        t, value = values
        x = value if self.combined is None else self.combined(value)
        curved = np.stack([curve(x[:, i]) for i, curve in enumerate(self.channels)], axis=1)
        return linear_blend(value, curved, t)
