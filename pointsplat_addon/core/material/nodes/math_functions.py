"""The operations of Blender's Math and Vector Math nodes on arrays, as Cycles defines them.

Rows of arrays are values at samples. Operations that are undefined at some values yield 0 there.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np


def divide_or_zero(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a / b, 0 where b is 0."""
    return np.where(b != 0, a / np.where(b != 0, b, 1), 0)


def _power(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    defined = (a >= 0) | (b == np.floor(b))
    return np.where(defined, np.power(np.where(defined, a, 1), b), 0)


def _logarithm(a: np.ndarray, base: np.ndarray) -> np.ndarray:
    defined = (a > 0) & (base > 0)
    return np.where(defined, divide_or_zero(np.log(np.where(defined, a, 1)), np.log(np.where(defined, base, 1))), 0)


def _modulo(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.where(b != 0, np.fmod(a, np.where(b != 0, b, 1)), 0)


def _wrap_value(value: np.ndarray, high: np.ndarray, low: np.ndarray) -> np.ndarray:
    span = high - low
    return np.where(span != 0, value - span * np.floor(divide_or_zero(value - low, span)), low)


def _ping_pong(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    turn = divide_or_zero(a - b, b * 2)
    return np.where(b != 0, np.abs((turn - np.floor(turn)) * b * 2 - b), 0)


def _smooth_minimum(a: np.ndarray, b: np.ndarray, k: np.ndarray) -> np.ndarray:
    """Quilez's cubic smooth minimum."""
    h = divide_or_zero(np.maximum(k - np.abs(a - b), 0), k)
    return np.minimum(a, b) - h * h * h * k / np.float32(6)


def _compare(a: np.ndarray, b: np.ndarray, distance: np.ndarray) -> np.ndarray:
    return (a == b) | (np.abs(a - b) <= np.maximum(distance, np.finfo(np.float32).eps))


def _round(a: np.ndarray) -> np.ndarray:
    return np.floor(a + np.float32(0.5))


def fraction(a: np.ndarray) -> np.ndarray:
    """a - floor(a), in [0, 1)."""
    return a - np.floor(a)


MATH: dict[str, Callable[..., np.ndarray]] = {
    "ADD": lambda a, b, c: a + b,
    "SUBTRACT": lambda a, b, c: a - b,
    "MULTIPLY": lambda a, b, c: a * b,
    "DIVIDE": lambda a, b, c: divide_or_zero(a, b),
    "MULTIPLY_ADD": lambda a, b, c: a * b + c,
    "POWER": lambda a, b, c: _power(a, b),
    "LOGARITHM": lambda a, b, c: _logarithm(a, b),
    "SQRT": lambda a, b, c: np.sqrt(np.maximum(a, 0)),
    "INVERSE_SQRT": lambda a, b, c: np.where(a > 0, 1 / np.sqrt(np.where(a > 0, a, 1)), 0),
    "ABSOLUTE": lambda a, b, c: np.abs(a),
    "EXPONENT": lambda a, b, c: np.exp(a),
    "MINIMUM": lambda a, b, c: np.minimum(a, b),
    "MAXIMUM": lambda a, b, c: np.maximum(a, b),
    "LESS_THAN": lambda a, b, c: a < b,
    "GREATER_THAN": lambda a, b, c: a > b,
    "SIGN": lambda a, b, c: np.sign(a),
    "COMPARE": _compare,
    "SMOOTH_MIN": _smooth_minimum,
    "SMOOTH_MAX": lambda a, b, c: -_smooth_minimum(-a, -b, c),
    "ROUND": lambda a, b, c: _round(a),
    "FLOOR": lambda a, b, c: np.floor(a),
    "CEIL": lambda a, b, c: np.ceil(a),
    "TRUNC": lambda a, b, c: np.trunc(a),
    "FRACT": lambda a, b, c: fraction(a),
    "MODULO": lambda a, b, c: _modulo(a, b),
    "FLOORED_MODULO": lambda a, b, c: np.where(b != 0, a - np.floor(divide_or_zero(a, b)) * b, 0),
    "WRAP": _wrap_value,
    "SNAP": lambda a, b, c: np.floor(divide_or_zero(a, b)) * b,
    "PINGPONG": lambda a, b, c: _ping_pong(a, b),
    "SINE": lambda a, b, c: np.sin(a),
    "COSINE": lambda a, b, c: np.cos(a),
    "TANGENT": lambda a, b, c: np.tan(a),
    "ARCSINE": lambda a, b, c: np.arcsin(np.clip(a, -1, 1)),
    "ARCCOSINE": lambda a, b, c: np.arccos(np.clip(a, -1, 1)),
    "ARCTANGENT": lambda a, b, c: np.arctan(a),
    "ARCTAN2": lambda a, b, c: np.arctan2(a, b),
    "SINH": lambda a, b, c: np.sinh(a),
    "COSH": lambda a, b, c: np.cosh(a),
    "TANH": lambda a, b, c: np.tanh(a),
    "RADIANS": lambda a, b, c: np.radians(a),
    "DEGREES": lambda a, b, c: np.degrees(a),
}


def row_dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(N, 1) dot products of rows (N, C)."""
    return (a * b).sum(axis=1, keepdims=True)


def row_length(a: np.ndarray) -> np.ndarray:
    """(N, 1) lengths of rows (N, C)."""
    return np.sqrt(row_dot(a, a))


def normalize_rows(a: np.ndarray) -> np.ndarray:
    """Normalises rows (N, C); a zero row stays zero."""
    return divide_or_zero(a, row_length(a))


def _reflect(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    n = normalize_rows(b)
    return a - 2 * row_dot(n, a) * n


def _refract(a: np.ndarray, b: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    n = normalize_rows(b)
    cosine = row_dot(n, a)
    k = 1 - ratio * ratio * (1 - cosine * cosine)
    return np.where(k < 0, 0, ratio * a - (ratio * cosine + np.sqrt(np.maximum(k, 0))) * n)


VECTOR_MATH: dict[str, Callable[..., np.ndarray]] = {
    "ADD": lambda a, b, c, s: a + b,
    "SUBTRACT": lambda a, b, c, s: a - b,
    "MULTIPLY": lambda a, b, c, s: a * b,
    "DIVIDE": lambda a, b, c, s: divide_or_zero(a, b),
    "MULTIPLY_ADD": lambda a, b, c, s: a * b + c,
    "CROSS_PRODUCT": lambda a, b, c, s: np.cross(a, b),
    "PROJECT": lambda a, b, c, s: divide_or_zero(row_dot(a, b), row_dot(b, b)) * b,
    "REFLECT": lambda a, b, c, s: _reflect(a, b),
    "REFRACT": lambda a, b, c, s: _refract(a, b, s),
    "FACEFORWARD": lambda a, b, c, s: np.where(row_dot(c, b) < 0, a, -a),
    "DOT_PRODUCT": lambda a, b, c, s: row_dot(a, b),
    "DISTANCE": lambda a, b, c, s: row_length(a - b),
    "LENGTH": lambda a, b, c, s: row_length(a),
    "SCALE": lambda a, b, c, s: a * s,
    "NORMALIZE": lambda a, b, c, s: normalize_rows(a),
    "ABSOLUTE": lambda a, b, c, s: np.abs(a),
    "POWER": lambda a, b, c, s: _power(a, b),
    "SIGN": lambda a, b, c, s: np.sign(a),
    "MINIMUM": lambda a, b, c, s: np.minimum(a, b),
    "MAXIMUM": lambda a, b, c, s: np.maximum(a, b),
    "ROUND": lambda a, b, c, s: _round(a),
    "FLOOR": lambda a, b, c, s: np.floor(a),
    "CEIL": lambda a, b, c, s: np.ceil(a),
    "FRACTION": lambda a, b, c, s: fraction(a),
    "MODULO": lambda a, b, c, s: _modulo(a, b),
    "WRAP": lambda a, b, c, s: _wrap_value(a, b, c),
    "SNAP": lambda a, b, c, s: np.floor(divide_or_zero(a, b)) * b,
    "SINE": lambda a, b, c, s: np.sin(a),
    "COSINE": lambda a, b, c, s: np.cos(a),
    "TANGENT": lambda a, b, c, s: np.tan(a),
}


def smooth_step(low: np.ndarray, high: np.ndarray, x: np.ndarray, degree: int) -> np.ndarray:
    """Smooth step from 0 at or below `low` to 1 at or above `high`, a polynomial of degree 3 or 5."""
    t = np.clip(divide_or_zero(x - low, high - low), 0, 1)
    return t * t * (3 - 2 * t) if degree == 3 else t * t * t * (t * (t * 6 - 15) + 10)


def rotate_euler(vector: np.ndarray, angles: np.ndarray, inverse: bool = False) -> np.ndarray:
    """Rotates vectors (N, 3) by XYZ Euler angles (N | 1, 3) in radians: about X first, then Y, then Z.

    With `inverse` it undoes that rotation.
    """
    for axis in (2, 1, 0) if inverse else (0, 1, 2):
        angle = -angles[:, axis] if inverse else angles[:, axis]
        i, j = (axis + 1) % 3, (axis + 2) % 3
        c, s = np.cos(angle), np.sin(angle)
        rotated = np.array(np.broadcast_to(vector, (max(len(vector), len(angle)), 3)))
        rotated[:, i], rotated[:, j] = c * vector[:, i] - s * vector[:, j], s * vector[:, i] + c * vector[:, j]
        vector = rotated
    return vector


def linear_blend(a: np.ndarray, b: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Interpolates from a (t = 0) to b (t = 1)."""
    return a * (1 - t) + b * t
