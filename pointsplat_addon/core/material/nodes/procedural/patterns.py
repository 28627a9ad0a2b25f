"""Regular patterns: checker, gradient, wave, magic and brick textures."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ....numeric.record import record
from ...expression import Expression, SampleInputs
from ..math_functions import divide_or_zero, fraction, smooth_step
from .blocks import by_columns
from .fractals import FRACTALS, MOST_DETAIL, Octaves

TURN = np.float32(2 * np.pi)
BAND = np.float32(20)  # radians of a wave in a unit of length


def _off_borders(p: np.ndarray) -> np.ndarray:
    """Points moved a little, so that coordinates of unit squares and cubes do not lie on borders of cells."""
    return (p + np.float32(0.000001)) * np.float32(0.999999)


@record
class Checker(Expression):
    """The checker's factor (N, 1): 1 in cells whose coordinates have an odd sum, else 0."""

    vector: Expression
    scale: Expression

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        return by_columns(_checker, 1, *values)


def _checker(vector: np.ndarray, scale: np.ndarray) -> np.ndarray:
    cell = np.floor(_off_borders(vector * scale))
    return np.fmod(np.abs(np.fmod(cell, 2)).sum(axis=0, keepdims=True), 2)


@record
class Gradient(Expression):
    """The gradient texture (N, 1), in [0, 1]; `kind` is one of GRADIENT."""

    vector: Expression
    kind: str = "LINEAR"

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        return by_columns(lambda p: np.clip(GRADIENT[self.kind](*p), 0, 1)[None], 1, *values)


def _ball(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """1 at the origin, 0 from a distance of next to 1 on."""
    return np.maximum(np.float32(0.999999) - np.sqrt(x * x + y * y + z * z), 0)


def _easing(x: np.ndarray) -> np.ndarray:
    x = np.clip(x, 0, 1)
    return 3 * (x * x) - 2 * (x * x) * x


GRADIENT: dict[str, Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]] = {
    "LINEAR": lambda x, y, z: x,
    "QUADRATIC": lambda x, y, z: np.square(np.maximum(x, 0)),
    "EASING": lambda x, y, z: _easing(x),
    "DIAGONAL": lambda x, y, z: (x + y) * np.float32(0.5),
    "RADIAL": lambda x, y, z: np.arctan2(y, x) / TURN + np.float32(0.5),
    "QUADRATIC_SPHERE": lambda x, y, z: np.square(_ball(x, y, z)),
    "SPHERICAL": _ball,
}


@record
class Wave(Expression):
    """Bands or rings (N, 1) in [0, 1], distorted by noise.

    direction: X, Y, Z or DIAGONAL of bands; X, Y, Z (the axis) or SPHERICAL of rings. profile: SIN, SAW, TRI.
    """

    vector: Expression
    scale: Expression
    distortion: Expression
    detail: Expression
    detail_scale: Expression
    detail_roughness: Expression
    phase: Expression
    rings: bool = False
    direction: str = "X"
    profile: str = "SIN"

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        return by_columns(lambda *columns: self._wave(*columns)[None], 1, *values)

    def _wave(self, vector: np.ndarray, scale: np.ndarray, *rest: np.ndarray) -> np.ndarray:
        distortion, detail, detail_scale, roughness, phase = (a[0] for a in rest)
        p = _off_borders(vector * scale)
        n = self._way(p) + phase
        if distortion.any():
            zero = np.zeros(1, np.float32)
            octaves = Octaves(
                np.clip(detail, 0, np.float32(MOST_DETAIL)),
                np.maximum(roughness, 0),
                np.full(1, 2, np.float32),
                zero,
                zero,
            )
            n = n + distortion * (FRACTALS["FBM"](p * detail_scale, octaves) * 2 - 1)
        if self.profile == "SIN":
            half = np.float32(0.5)
            return half + half * np.sin(n - TURN / 4)
        n = n / TURN
        return fraction(n) if self.profile == "SAW" else np.abs(n - np.floor(n + np.float32(0.5))) * 2

    def _way(self, p: np.ndarray) -> np.ndarray:
        """The phase in radians without offset and distortion."""
        axis = "XYZ".find(self.direction)
        if self.rings:
            x, y, z = (p[k] if k != axis else np.zeros(1, np.float32) for k in range(3))
            return np.sqrt(x * x + y * y + z * z) * BAND
        return (p[0] + p[1] + p[2]) * (BAND / 2) if axis < 0 else p[axis] * BAND


@record
class Magic(Expression):
    """The magic texture's colour (N, 3): sines of sums of sines, `depth` (0 to 10) times."""

    vector: Expression
    scale: Expression
    distortion: Expression
    depth: int = 2
    wrapped: bool = True  # whether points are first taken modulo 2 pi, as since Blender 5.0

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        return by_columns(self._columns, 3, *values)

    def _columns(self, vector: np.ndarray, scale: np.ndarray, distortion: np.ndarray) -> np.ndarray:
        p = vector * scale
        px, py, pz = np.fmod(p, TURN) if self.wrapped else p
        five, d = np.float32(5), distortion[0]
        c = [
            np.sin((px + py + pz) * five),
            np.cos((-px + py - pz) * five),
            -np.cos((-px - py + pz) * five),
        ]
        if self.depth > 0:
            c = [a * d for a in c]
        for axis, function, sign, (i, j, k) in MAGIC[: self.depth]:
            c[axis] = sign * function(i * c[0] + j * c[1] + k * c[2]) * d
        divisor = np.where(d != 0, 2 * d, 1)
        return np.float32(0.5) - np.stack(np.broadcast_arrays(*c)) / divisor


# Which of x, y, z changes, to what function of which sum of them, with which sign
MAGIC = (
    (1, np.cos, -1, (1, -1, 1)),
    (0, np.cos, 1, (1, -1, -1)),
    (2, np.sin, 1, (-1, -1, -1)),
    (0, np.cos, -1, (-1, 1, -1)),
    (1, np.sin, -1, (-1, 1, 1)),
    (1, np.cos, -1, (-1, 1, 1)),
    (0, np.cos, 1, (1, 1, 1)),
    (2, np.sin, 1, (1, 1, -1)),
    (0, np.cos, -1, (-1, -1, 1)),
    (1, np.sin, -1, (1, -1, 1)),
)


@record
class Brick(Expression):
    """Rows of bricks, (N, 4): colour, and a factor of 1 in mortar, 0 in bricks."""

    vector: Expression
    color1: Expression
    color2: Expression
    mortar: Expression
    scale: Expression
    mortar_size: Expression
    mortar_smooth: Expression
    bias: Expression
    width: Expression
    height: Expression
    offset: float = 0.5  # of every `offset_frequency`th row, in widths
    offset_frequency: int = 2
    squash: float = 1.0  # factor of the widths of every `squash_frequency`th row
    squash_frequency: int = 2

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        return by_columns(self._columns, 4, *values)

    def _columns(
        self,
        vector: np.ndarray,
        color1: np.ndarray,
        color2: np.ndarray,
        mortar: np.ndarray,
        scale: np.ndarray,
        *rest: np.ndarray,
    ) -> tuple[np.ndarray, ...]:
        size, smooth, bias, width, height = (a[0] for a in rest)
        px, py, _ = vector * scale
        row = np.floor(divide_or_zero(py, height))
        shift = np.zeros(1, np.float32)
        if self.offset_frequency and self.squash_frequency:
            width = np.where(np.fmod(row, self.squash_frequency) != 0, width, width * np.float32(self.squash))
            shift = np.where(np.fmod(row, self.offset_frequency) != 0, 0, width * np.float32(self.offset))
        column = np.floor(divide_or_zero(px + shift, width))
        x, y = px + shift - width * column, py - height * row
        tint = np.clip(_brick_hash(row, column) + bias, 0, 1)
        inside = np.minimum(np.minimum(x, y), np.minimum(width - x, height - y))
        edge = 1 - divide_or_zero(inside, size)
        soft = np.where(smooth != 0, smooth_step(np.zeros(1, np.float32), smooth, edge, 3), 1)
        factor = np.where(inside >= size, 0, soft).astype(np.float32)
        brick = color1 * (1 - tint) + color2 * tint
        return *(brick * (1 - factor) + mortar * factor), factor


def _brick_hash(row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """A pseudo-random float32 in [0, 1] for a brick: Perlin's integer noise of 31 bits (Elias 1998)."""
    low, high = -(2.0**31), 2.0**31 - 1
    words = [
        np.nan_to_num(np.clip(a.astype(np.float64), low, high)).astype(np.int64).astype(np.uint32)
        for a in (row, column)
    ]
    n = (words[0] << np.uint32(16)) + (words[1] & np.uint32(0xFFFF))
    n = (n + np.uint32(1013)) & np.uint32(0x7FFFFFFF)
    n = (n >> np.uint32(13)) ^ n
    n = (n * (n * n * np.uint32(60493) + np.uint32(19990303)) + np.uint32(1376312589)) & np.uint32(0x7FFFFFFF)
    return np.float32(0.5) * (n.astype(np.float32) / np.float32(1073741824))
