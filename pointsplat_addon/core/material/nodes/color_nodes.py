"""Colour nodes: channels, conversions, blending and adjustments."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...numeric.record import record
from ..blackbody import blackbody
from ..color_models import COLOR_MODELS, LUMINANCE, hsv_to_rgb, rgb_to_hsv
from ..expression import Expression, SampleInputs
from .math_functions import divide_or_zero, fraction, linear_blend


@record
class Component(Expression):
    """One channel of a value, (N, 1)."""

    source: Expression
    index: int

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        return values[0][:, self.index : self.index + 1]


@record
class Color(Expression):
    """The first three channels of a value with alpha; one channel becomes grey."""

    source: Expression

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        value = values[0]
        return np.repeat(value, 3, axis=1) if value.shape[1] == 1 else value[:, :3]


@record
class Blackbody(Expression):
    """The colour (N, 3) of a black body of a temperature in kelvin, of luminance 1."""

    temperature: Expression

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        return blackbody(values[0][:, 0])


@record
class Gray(Expression):
    """Luminance of a colour, or the mean of a vector: Blender's implicit conversions to a scalar."""

    source: Expression
    mean: bool = False

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        value = values[0][:, :3]
        return value.mean(axis=1, keepdims=True) if self.mean else (value @ LUMINANCE)[:, None]


@record
class Combine(Expression):
    """Three scalars as a vector or colour."""

    x: Expression
    y: Expression
    z: Expression

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        return np.concatenate(np.broadcast_arrays(*values), axis=1)


@record
class ColorModel(Expression):
    """A change of colour model, one of COLOR_MODELS."""

    source: Expression
    model: str

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        return COLOR_MODELS[self.model](values[0])


def _mix_overlay(a: np.ndarray, b: np.ndarray, t: np.ndarray) -> np.ndarray:
    dark = a * (1 - t + 2 * t * b)
    return np.where(a < 0.5, dark, 1 - (1 - t + 2 * t * (1 - b)) * (1 - a))


def _mix_divide(a: np.ndarray, b: np.ndarray, t: np.ndarray) -> np.ndarray:
    return np.where(b != 0, (1 - t) * a + t * divide_or_zero(a, b), a)


def _mix_dodge(a: np.ndarray, b: np.ndarray, t: np.ndarray) -> np.ndarray:
    rest = 1 - t * b
    return np.where(a == 0, 0, np.where(rest <= 0, 1, np.minimum(divide_or_zero(a, rest), 1)))


def _mix_burn(a: np.ndarray, b: np.ndarray, t: np.ndarray) -> np.ndarray:
    rest = 1 - t + t * b
    return np.where(rest <= 0, 0, np.clip(1 - divide_or_zero(1 - a, rest), 0, 1))


def _mix_soft_light(a: np.ndarray, b: np.ndarray, t: np.ndarray) -> np.ndarray:
    screen = 1 - (1 - b) * (1 - a)
    return (1 - t) * a + t * ((1 - a) * b * a + a * screen)


def _mix_hsv(a: np.ndarray, b: np.ndarray, t: np.ndarray, blend: str) -> np.ndarray:
    """HUE, SATURATION, COLOR and VALUE: components of b in the HSV model of a."""
    a, b, t3 = np.broadcast_arrays(a, b, t)
    hsv, other, t1 = rgb_to_hsv(a), rgb_to_hsv(b), t3[:, 0]
    if blend == "VALUE":
        hsv[:, 2] = (1 - t1) * hsv[:, 2] + t1 * other[:, 2]
        return hsv_to_rgb(hsv)
    if blend == "SATURATION":
        hsv[:, 1] = np.where(hsv[:, 1] != 0, (1 - t1) * hsv[:, 1] + t1 * other[:, 1], hsv[:, 1])
        return hsv_to_rgb(hsv)
    hsv[:, 0] = other[:, 0]
    if blend == "COLOR":
        hsv[:, 1] = other[:, 1]
    return np.where(other[:, 1:2] != 0, linear_blend(a, hsv_to_rgb(hsv), t), a)


BLEND: dict[str, Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]] = {
    "MIX": linear_blend,
    "DARKEN": lambda a, b, t: linear_blend(a, np.minimum(a, b), t),
    "MULTIPLY": lambda a, b, t: linear_blend(a, a * b, t),
    "BURN": _mix_burn,
    "LIGHTEN": lambda a, b, t: linear_blend(a, np.maximum(a, b), t),
    "SCREEN": lambda a, b, t: 1 - (1 - t + t * (1 - b)) * (1 - a),
    "DODGE": _mix_dodge,
    "ADD": lambda a, b, t: a + b * t,
    "OVERLAY": _mix_overlay,
    "SOFT_LIGHT": _mix_soft_light,
    "LINEAR_LIGHT": lambda a, b, t: a + t * (2 * b - 1),
    "DIFFERENCE": lambda a, b, t: linear_blend(a, np.abs(a - b), t),
    "EXCLUSION": lambda a, b, t: np.maximum(linear_blend(a, a + b - 2 * a * b, t), 0),
    "SUBTRACT": lambda a, b, t: linear_blend(a, a - b, t),
    "DIVIDE": _mix_divide,
    "HUE": lambda a, b, t: _mix_hsv(a, b, t, "HUE"),
    "SATURATION": lambda a, b, t: _mix_hsv(a, b, t, "SATURATION"),
    "COLOR": lambda a, b, t: _mix_hsv(a, b, t, "COLOR"),
    "VALUE": lambda a, b, t: _mix_hsv(a, b, t, "VALUE"),
}


@record
class Mix(Expression):
    """Two scalars, vectors or colours blended by a factor."""

    factor: Expression
    a: Expression
    b: Expression
    blend: str = "MIX"
    clamp_factor: bool = True
    clamp_result: bool = False

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        t, a, b = values
        out = BLEND[self.blend](a, b, np.clip(t, 0, 1) if self.clamp_factor else t)
        return np.clip(out, 0, 1) if self.clamp_result else out


@record
class Invert(Expression):
    """The complement of a colour, blended in by a factor."""

    factor: Expression
    color: Expression

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        t, color = values
        return t * (1 - color) + (1 - t) * color


@record
class Gamma(Expression):
    """A colour raised to a power; channels that are not positive stay."""

    color: Expression
    gamma: Expression

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        color, gamma = values
        positive = color > 0
        out = np.where(positive, np.power(np.where(positive, color, 1), gamma), color)
        return np.where(gamma == 0, 1, out)


@record
class BrightContrast(Expression):
    """A colour with changed brightness and contrast, at least 0."""

    color: Expression
    bright: Expression
    contrast: Expression

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        color, bright, contrast = values
        return np.maximum((1 + contrast) * color + bright - contrast / 2, 0)


@record
class HueSaturation(Expression):
    """A colour with changed hue, saturation and value; 0.5, 1 and 1 change nothing."""

    hue: Expression
    saturation: Expression
    value: Expression
    factor: Expression
    color: Expression

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        hue, saturation, value, factor, color = values
        h, s, v = (c[:, None] for c in rgb_to_hsv(color).T)
        h, s, v = fraction(h + hue + np.float32(0.5)), np.clip(s * saturation, 0, 1), v * value
        changed = hsv_to_rgb(np.concatenate(np.broadcast_arrays(h, s, v), axis=1))
        return np.maximum(linear_blend(color, changed, factor), 0)
