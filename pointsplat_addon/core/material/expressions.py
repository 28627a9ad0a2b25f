"""Expressions over surface samples: the nodes of a material's inputs as a frozen DAG, evaluated with numpy.

A value is a float32 array (N, C): C = 1 for scalars, 3 for vectors and colours, 4 where an attribute or a
picture carries alpha. An expression that does not vary yields (1, C), so constant branches cost nothing.
The formulas are those of Blender's shader nodes as Cycles evaluates them, division by zero included.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np

from .textures import Pyramid, filtered, linear_from_srgb, look_up, uniform_b_spline

CHUNK = 1 << 16  # samples evaluated at once: temporaries stay in the processor's cache
LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)  # Rec. 709, Blender's default scene-linear primaries


@dataclass(frozen=True, eq=False)
class SampleInputs:
    """What is known at N samples of one mesh. Whatever is None or missing reads as Blender's default (zero)."""

    uv: dict[str, np.ndarray] = field(default_factory=dict)  # map name to (N, 2)
    active_uv: str | None = None  # the map that expressions without a name read
    colors: dict[str, np.ndarray] = field(default_factory=dict)  # attribute name to (N, 4), scene-linear
    active_color: str | None = None  # the attribute that expressions without a name read; None: the first
    position: np.ndarray | None = None  # (N, 3), object space
    generated: np.ndarray | None = None  # (N, 3), position in the mesh's texture space, [0, 1] over its bounds
    normal: np.ndarray | None = None  # (N, 3), unit, object space
    tangent: np.ndarray | None = None  # (N, 3), unit, object space, along growing u of the map that is asked for
    bitangent_sign: np.ndarray | None = None  # (N,), bitangent = sign * normal x tangent; None: 1
    count: int | None = None  # N; None: the length of any array given
    # The same at the ends of two conjugate half-diameters of each sample's splat: how wide pictures are to be filtered
    aside: tuple[SampleInputs, SampleInputs] | None = None
    # Where every UV map holds the centres of the texels of a picture of this (width, height), row by row, from the
    # texel `first` on: pictures of that size are then read and not interpolated
    grid: tuple[int, int] | None = None
    first: int = 0

    ARRAYS = ("position", "generated", "normal", "tangent", "bitangent_sign")

    def __len__(self) -> int:
        """N. Raises ValueError when neither `count` nor any array is given."""
        if self.count is not None:
            return self.count
        for array in (*self.uv.values(), *self.colors.values(), *(getattr(self, name) for name in self.ARRAYS)):
            if array is not None:
                return len(array)
        raise ValueError("SampleInputs needs `count` where it holds no array")

    def take(self, part: slice) -> SampleInputs:
        """The samples of a slice of step 1, as views."""
        single = {n: getattr(self, n)[part] for n in self.ARRAYS if getattr(self, n) is not None}
        return replace(
            self,
            uv={name: array[part] for name, array in self.uv.items()},
            colors={name: array[part] for name, array in self.colors.items()},
            count=len(range(*part.indices(len(self)))),
            aside=None if self.aside is None else (self.aside[0].take(part), self.aside[1].take(part)),
            first=self.first + part.indices(len(self))[0],
            **single,
        )

    def color(self, name: str | None) -> np.ndarray | None:
        """A colour attribute by name, None for the active one."""
        if name is None:
            name = self.active_color or next(iter(self.colors), None)
        return None if name is None else self.colors.get(name)


@dataclass(frozen=True, eq=False)
class Image:
    """Texels of one picture, row 0 at the bottom. uint8 texels mean value / 255.

    Raises ValueError when the texels have another shape or type.
    """

    texels: np.ndarray  # (H, W, 4) uint8 or float32
    srgb: bool = False  # encoded with the sRGB curve; decoded after interpolation, as Cycles does
    associated: bool = False  # colour is multiplied by alpha
    key: str = ""  # content key; empty: computed from the texels
    name: str = ""

    def __post_init__(self) -> None:
        shape, dtype = self.texels.shape, self.texels.dtype
        if len(shape) != 3 or shape[2] != 4 or 0 in shape or dtype not in (np.uint8, np.float32):
            raise ValueError(f"Image {self.name!r} has texels {shape} of {dtype}, expected (H, W, 4) uint8 or float32")

    @cached_property
    def digest(self) -> str:
        content = self.key or hashlib.blake2b(np.ascontiguousarray(self.texels).data, digest_size=16).hexdigest()
        return f"{content} {self.texels.shape} {self.texels.dtype} {self.srgb} {self.associated}"

    @property
    def nbytes(self) -> int:
        return self.texels.nbytes

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return self.texels.shape[1], self.texels.shape[0]


@dataclass(frozen=True, eq=False)
class Expression:
    """A node of the DAG. Fields that are expressions are its arguments, all others are parameters."""

    @cached_property
    def arguments(self) -> tuple[Expression, ...]:
        values = (getattr(self, f.name) for f in fields(self))
        return tuple(v for v in values if isinstance(v, Expression))

    @cached_property
    def digest(self) -> str:
        """Content key: equal digests mean equal values for equal samples."""
        parts = [type(self).__name__]
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, np.ndarray):
                value = (value.shape, value.dtype.str, value.tobytes())
            parts.append(value.digest if isinstance(value, Expression | Image) else repr(value))
        return hashlib.blake2b("\0".join(parts).encode(), digest_size=16).hexdigest()

    @cached_property
    def varies(self) -> bool:
        """Whether the value may differ from sample to sample."""
        return any(a.varies for a in self.arguments)

    def read(self, inputs: SampleInputs) -> tuple[Expression, ...]:
        """The arguments whose values `compute` takes at these samples."""
        return self.arguments

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        """The value (N | 1, C) from the samples and the values of what it reads."""
        raise NotImplementedError


def walk(*roots: Expression | None) -> Iterator[Expression]:
    """Every expression that the roots depend on, themselves included, each once."""
    seen: set[int] = set()
    stack = [r for r in roots if r is not None]
    while stack:
        node = stack.pop()
        if id(node) not in seen:
            seen.add(id(node))
            stack.extend(node.arguments)
            yield node


def evaluate(output: Expression, inputs: SampleInputs) -> np.ndarray:
    """The value of an expression at every sample, (N, C) float32."""
    count = len(inputs)
    if not output.varies:
        value = _evaluate(output, replace(inputs, count=1), {})
        return np.broadcast_to(value, (count, value.shape[1])).copy()
    parts = [_evaluate(output, inputs.take(slice(i, i + CHUNK)), {}) for i in range(0, count, CHUNK)]
    sizes = [min(CHUNK, count - i) for i in range(0, count, CHUNK)]
    whole = [np.broadcast_to(p, (n, p.shape[1])) for p, n in zip(parts, sizes, strict=True)]
    if not whole:
        whole = [_evaluate(output, inputs, {})]
    return np.concatenate(whole).astype(np.float32, copy=False)


def constant(output: Expression) -> np.ndarray | None:
    """The value (C,) float32 of an expression that does not vary, else None."""
    return None if output.varies else _evaluate(output, SampleInputs(count=1), {})[0]


def _evaluate(node: Expression, inputs: SampleInputs, known: dict[int, np.ndarray]) -> np.ndarray:
    """Depth first; shared branches are computed once."""
    value = known.get(id(node))
    if value is None:
        values = [_evaluate(a, inputs, known) for a in node.read(inputs)]
        with np.errstate(all="ignore"):
            value = node.compute(inputs, *values).astype(np.float32, copy=False)
        known[id(node)] = value
    return value


# Sources


@dataclass(frozen=True, eq=False)
class Constant(Expression):
    value: tuple[float, ...]

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        return np.array([self.value], np.float32)


@dataclass(frozen=True, eq=False)
class Source(Expression):
    """Reads the samples."""

    @property
    def varies(self) -> bool:
        return True


@dataclass(frozen=True, eq=False)
class UV(Source):
    """A UV map as (u, v, 0); None is the active map."""

    name: str | None = None

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        name = inputs.active_uv if self.name is None else self.name
        return _three(None if name is None else inputs.uv.get(name), len(inputs))


@dataclass(frozen=True, eq=False)
class ColorAttribute(Source):
    """A colour attribute with its alpha, (N, 4); None is the active one."""

    name: str | None = None

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        color = inputs.color(self.name)
        return np.zeros((len(inputs), 4), np.float32) if color is None else color


@dataclass(frozen=True, eq=False)
class Attribute(Source):
    """A named attribute, (N, 5): colour, alpha, and the mean that Blender's Fac output gives.

    Colour attributes come before UV maps of the same name. Without alpha (a UV map, a missing name) alpha is 1.
    """

    name: str

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        color = inputs.colors.get(self.name)
        if color is not None:
            return np.column_stack([color, color[:, :3].mean(axis=1)])
        uv = _three(inputs.uv.get(self.name), len(inputs))
        return np.column_stack([uv, np.ones(len(uv), np.float32), uv[:, 0]])


@dataclass(frozen=True, eq=False)
class Coordinates(Source):
    """`position`, `generated` or `normal` of SampleInputs."""

    kind: str

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        return _three(getattr(inputs, self.kind), len(inputs))


def _three(array: np.ndarray | None, count: int) -> np.ndarray:
    """(N, 2 | 3) padded to (N, 3) float32; None is zero."""
    out = np.zeros((count, 3), np.float32)
    if array is not None:
        out[:, : array.shape[1]] = array
    return out


# Pictures

_FROM_BYTES = linear_from_srgb(np.arange(256, dtype=np.uint8) / np.float32(255))


@dataclass(frozen=True, eq=False)
class ImageTexture(Expression):
    """Colour and alpha (N, 4) of a picture at `uv`; texel centres lie at (i + 1/2) / size.

    With `straight` the colour is divided by alpha; Cycles does so only where the node's Alpha is used.
    """

    uv: Expression
    image: Image
    interpolation: str = "Linear"  # Linear, Closest, Cubic (B-spline)
    extension: str = "REPEAT"  # REPEAT, EXTEND, CLIP (transparent black), MIRROR
    straight: bool = False

    def read(self, inputs: SampleInputs) -> tuple[Expression, ...]:
        at_texels = inputs.grid == self.image.size and isinstance(self.uv, UV) and self.interpolation != "Cubic"
        return () if at_texels else self.arguments

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        if not values:
            return self._texels(slice(inputs.first, inputs.first + len(inputs)))
        uv, footprint = values[0], self._footprint(inputs, values[0])
        if footprint is None:
            return self._decoded(look_up(self.image.texels, uv, self.interpolation, self.extension))
        return filtered(self._level, self.image.size, uv[:, :2], footprint)

    def _footprint(self, inputs: SampleInputs, uv: np.ndarray) -> np.ndarray | None:
        """(N, 2, 2): how far `uv` changes along both half-diameters of each sample; None where that is not known."""
        if inputs.aside is None or not self.uv.varies:
            return None
        return np.stack([_evaluate(self.uv, moved, {})[:, :2] - uv[:, :2] for moved in inputs.aside], axis=1)

    def _level(self, level: int, uv: np.ndarray) -> np.ndarray:
        """Colours (N, 4) of the picture at half its size, `level` times."""
        if level == 0:
            return self._decoded(look_up(self.image.texels, uv, self.interpolation, self.extension))
        smaller = self._pyramid.levels[min(level, len(self._pyramid.levels)) - 1]
        return look_up(smaller, uv, "Cubic", self.extension)

    @cached_property
    def _pyramid(self) -> Pyramid:
        def rows(part: slice) -> np.ndarray:
            texels = self.image.texels[part]
            values = texels.reshape(-1, 4).astype(np.float32)
            if texels.dtype == np.uint8:
                values /= np.float32(255)
            return self._decoded(values).reshape(texels.shape)

        return Pyramid(rows, self.image.size)

    def _texels(self, part: slice) -> np.ndarray:
        """Colours (N, 4) of the picture's own texels, row by row."""
        texels = self.image.texels.reshape(-1, 4)[part]
        if texels.dtype != np.uint8:
            return self._decoded(texels.copy())
        if not self.image.srgb or (self.straight and self.image.associated):
            return self._decoded(texels / np.float32(255))
        color = _FROM_BYTES.take(texels)
        color[:, 3] = texels[:, 3] / np.float32(255)
        return color

    def _decoded(self, color: np.ndarray) -> np.ndarray:
        """Scene-linear colours from stored ones, in place."""
        if self.straight and self.image.associated:
            alpha = color[:, 3:]
            color[:, :3] /= np.where(alpha == 0, 1, alpha)
        if self.image.srgb:
            color[:, :3] = linear_from_srgb(color[:, :3])
        return color


# Components and conversions


@dataclass(frozen=True, eq=False)
class Component(Expression):
    """One channel, (N, 1)."""

    source: Expression
    index: int

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        return values[0][:, self.index : self.index + 1]


@dataclass(frozen=True, eq=False)
class Color(Expression):
    """The first three channels of a value with alpha; one channel becomes grey."""

    source: Expression

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        value = values[0]
        return np.repeat(value, 3, axis=1) if value.shape[1] == 1 else value[:, :3]


@dataclass(frozen=True, eq=False)
class Gray(Expression):
    """Luminance of a colour, or the mean of a vector: Blender's implicit conversions to a scalar."""

    source: Expression
    mean: bool = False

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        value = values[0][:, :3]
        return value.mean(axis=1, keepdims=True) if self.mean else (value @ LUMINANCE)[:, None]


@dataclass(frozen=True, eq=False)
class Combine(Expression):
    """Three scalars as a vector or colour."""

    x: Expression
    y: Expression
    z: Expression

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        return np.concatenate(np.broadcast_arrays(*values), axis=1)


def rgb_to_hsv(rgb: np.ndarray) -> np.ndarray:
    """(N, 3) to hue, saturation, value; hue in [0, 1), 0 for grey."""
    high, low = rgb.max(axis=1), rgb.min(axis=1)
    saturation = np.where(high != 0, (high - low) / np.where(high != 0, high, 1), 0)
    return np.stack([_hue(rgb, high, low), saturation, high], axis=1)


def rgb_to_hsl(rgb: np.ndarray) -> np.ndarray:
    """(N, 3) to hue, saturation, lightness."""
    high, low = rgb.max(axis=1), rgb.min(axis=1)
    lightness = np.minimum(1, (high + low) / 2)
    spread = np.where(lightness > 0.5, 2 - high - low, high + low)
    saturation = np.where(high == low, 0, (high - low) / np.where(spread != 0, spread, 1))
    return np.stack([_hue(rgb, high, low), saturation, lightness], axis=1)


def _hue(rgb: np.ndarray, high: np.ndarray, low: np.ndarray) -> np.ndarray:
    r, g, b = rgb.T
    delta = np.where(high != low, high - low, 1)
    sector = np.where(r == high, (g - b) / delta, np.where(g == high, 2 + (b - r) / delta, 4 + (r - g) / delta))
    return np.where(high != low, (sector / 6) % 1, 0)


def _pure_hue(hue: np.ndarray) -> np.ndarray:
    """The saturated colour of a hue in [0, 1], (N, 3)."""
    h = hue * 6
    return np.clip(np.stack([np.abs(h - 3) - 1, 2 - np.abs(h - 2), 2 - np.abs(h - 4)], axis=1), 0, 1)


def hsv_to_rgb(hsv: np.ndarray) -> np.ndarray:
    """(N, 3); a hue outside [0, 1] stays in the last sextant, as in Cycles."""
    h, s, v = hsv.T
    h = np.where(h == 1, 0, h) * 6
    sextant = np.floor(h)
    p, q, t = v * (1 - s), v * (1 - s * (h - sextant)), v * (1 - s * (1 - (h - sextant)))
    which = np.where((sextant >= 0) & (sextant < 5), np.nan_to_num(sextant), 5).astype(np.intp)
    r, g, b = (np.choose(which, order) for order in ((v, q, p, p, t, v), (t, v, v, q, p, p), (p, p, t, v, v, q)))
    return np.where(s[:, None] != 0, np.stack([r, g, b], axis=1), v[:, None])


def hsl_to_rgb(hsl: np.ndarray) -> np.ndarray:
    h, s, lightness = hsl[:, 0], hsl[:, 1:2], hsl[:, 2:]
    return (_pure_hue(h) - 0.5) * (1 - np.abs(2 * lightness - 1)) * s + lightness


COLOR_MODELS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "HSV_FROM_RGB": rgb_to_hsv,
    "HSL_FROM_RGB": rgb_to_hsl,
    "RGB_FROM_HSV": hsv_to_rgb,
    "RGB_FROM_HSL": hsl_to_rgb,
}


@dataclass(frozen=True, eq=False)
class ColorModel(Expression):
    """A change of colour model, one of COLOR_MODELS."""

    source: Expression
    model: str

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        return COLOR_MODELS[self.model](values[0])


# Arithmetic


def _divide(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.where(b != 0, a / np.where(b != 0, b, 1), 0)


def _power(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    defined = (a >= 0) | (b == np.floor(b))
    return np.where(defined, np.power(np.where(defined, a, 1), b), 0)


def _logarithm(a: np.ndarray, base: np.ndarray) -> np.ndarray:
    defined = (a > 0) & (base > 0)
    return np.where(defined, _divide(np.log(np.where(defined, a, 1)), np.log(np.where(defined, base, 1))), 0)


def _modulo(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.where(b != 0, np.fmod(a, np.where(b != 0, b, 1)), 0)


def _wrap_value(value: np.ndarray, high: np.ndarray, low: np.ndarray) -> np.ndarray:
    span = high - low
    return np.where(span != 0, value - span * np.floor(_divide(value - low, span)), low)


def _ping_pong(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    turn = _divide(a - b, b * 2)
    return np.where(b != 0, np.abs((turn - np.floor(turn)) * b * 2 - b), 0)


def _smooth_minimum(a: np.ndarray, b: np.ndarray, k: np.ndarray) -> np.ndarray:
    """Quilez's cubic smooth minimum."""
    h = _divide(np.maximum(k - np.abs(a - b), 0), k)
    return np.minimum(a, b) - h * h * h * k / np.float32(6)


def _compare(a: np.ndarray, b: np.ndarray, distance: np.ndarray) -> np.ndarray:
    return (a == b) | (np.abs(a - b) <= np.maximum(distance, np.finfo(np.float32).eps))


def _round(a: np.ndarray) -> np.ndarray:
    return np.floor(a + np.float32(0.5))


def _fraction(a: np.ndarray) -> np.ndarray:
    return a - np.floor(a)


MATH: dict[str, Callable[..., np.ndarray]] = {
    "ADD": lambda a, b, c: a + b,
    "SUBTRACT": lambda a, b, c: a - b,
    "MULTIPLY": lambda a, b, c: a * b,
    "DIVIDE": lambda a, b, c: _divide(a, b),
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
    "FRACT": lambda a, b, c: _fraction(a),
    "MODULO": lambda a, b, c: _modulo(a, b),
    "FLOORED_MODULO": lambda a, b, c: np.where(b != 0, a - np.floor(_divide(a, b)) * b, 0),
    "WRAP": _wrap_value,
    "SNAP": lambda a, b, c: np.floor(_divide(a, b)) * b,
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


@dataclass(frozen=True, eq=False)
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


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a * b).sum(axis=1, keepdims=True)


def _length(a: np.ndarray) -> np.ndarray:
    return np.sqrt(_dot(a, a))


def normalize(a: np.ndarray) -> np.ndarray:
    """Unit rows; a zero row stays zero."""
    return _divide(a, _length(a))


def _reflect(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    n = normalize(b)
    return a - 2 * _dot(n, a) * n


def _refract(a: np.ndarray, b: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    n = normalize(b)
    cosine = _dot(n, a)
    k = 1 - ratio * ratio * (1 - cosine * cosine)
    return np.where(k < 0, 0, ratio * a - (ratio * cosine + np.sqrt(np.maximum(k, 0))) * n)


VECTOR_MATH: dict[str, Callable[..., np.ndarray]] = {
    "ADD": lambda a, b, c, s: a + b,
    "SUBTRACT": lambda a, b, c, s: a - b,
    "MULTIPLY": lambda a, b, c, s: a * b,
    "DIVIDE": lambda a, b, c, s: _divide(a, b),
    "MULTIPLY_ADD": lambda a, b, c, s: a * b + c,
    "CROSS_PRODUCT": lambda a, b, c, s: np.cross(a, b),
    "PROJECT": lambda a, b, c, s: _divide(_dot(a, b), _dot(b, b)) * b,
    "REFLECT": lambda a, b, c, s: _reflect(a, b),
    "REFRACT": lambda a, b, c, s: _refract(a, b, s),
    "FACEFORWARD": lambda a, b, c, s: np.where(_dot(c, b) < 0, a, -a),
    "DOT_PRODUCT": lambda a, b, c, s: _dot(a, b),
    "DISTANCE": lambda a, b, c, s: _length(a - b),
    "LENGTH": lambda a, b, c, s: _length(a),
    "SCALE": lambda a, b, c, s: a * s,
    "NORMALIZE": lambda a, b, c, s: normalize(a),
    "ABSOLUTE": lambda a, b, c, s: np.abs(a),
    "POWER": lambda a, b, c, s: _power(a, b),
    "SIGN": lambda a, b, c, s: np.sign(a),
    "MINIMUM": lambda a, b, c, s: np.minimum(a, b),
    "MAXIMUM": lambda a, b, c, s: np.maximum(a, b),
    "ROUND": lambda a, b, c, s: _round(a),
    "FLOOR": lambda a, b, c, s: np.floor(a),
    "CEIL": lambda a, b, c, s: np.ceil(a),
    "FRACTION": lambda a, b, c, s: _fraction(a),
    "MODULO": lambda a, b, c, s: _modulo(a, b),
    "WRAP": lambda a, b, c, s: _wrap_value(a, b, c),
    "SNAP": lambda a, b, c, s: np.floor(_divide(a, b)) * b,
    "SINE": lambda a, b, c, s: np.sin(a),
    "COSINE": lambda a, b, c, s: np.cos(a),
    "TANGENT": lambda a, b, c, s: np.tan(a),
}


@dataclass(frozen=True, eq=False)
class VectorMath(Expression):
    """A vector operation of VECTOR_MATH; DOT_PRODUCT, DISTANCE and LENGTH yield scalars."""

    a: Expression
    b: Expression
    c: Expression
    scale: Expression
    operation: str

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        return VECTOR_MATH[self.operation](*values)


@dataclass(frozen=True, eq=False)
class Clamp(Expression):
    value: Expression
    low: Expression
    high: Expression
    ordered: bool = False  # swap the limits where low > high (the RANGE type)

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        value, low, high = values
        if self.ordered:
            low, high = np.minimum(low, high), np.maximum(low, high)
        return np.minimum(np.maximum(value, low), high)


def _smooth_step(low: np.ndarray, high: np.ndarray, x: np.ndarray, degree: int) -> np.ndarray:
    t = np.clip(_divide(x - low, high - low), 0, 1)
    return t * t * (3 - 2 * t) if degree == 3 else t * t * t * (t * (t * 6 - 15) + 10)


@dataclass(frozen=True, eq=False)
class MapRange(Expression):
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
        factor = _divide(value - low, high - low)
        if self.interpolation == "STEPPED":
            factor = np.where(steps > 0, _divide(np.floor(factor * (steps + 1)), steps), 0)
        elif self.interpolation in ("SMOOTHSTEP", "SMOOTHERSTEP"):
            degree = 3 if self.interpolation == "SMOOTHSTEP" else 5
            step = _smooth_step(np.minimum(low, high), np.maximum(low, high), value, degree)
            factor = np.where(low > high, 1 - step, step)
        out = to_low + factor * (to_high - to_low)
        # The scalar node yields 0 for an empty source range, the vector node the lower end
        if not self.vector:
            out = np.where(low == high, 0, out)
        if self.clamp and self.interpolation in ("LINEAR", "STEPPED"):
            out = np.clip(out, np.minimum(to_low, to_high), np.maximum(to_low, to_high))
        return out


def rotate_euler(vector: np.ndarray, angles: np.ndarray, inverse: bool = False) -> np.ndarray:
    """Rotate (N, 3) by XYZ Euler angles (N | 1, 3) in radians: about X first, then Y, then Z."""
    for axis in (2, 1, 0) if inverse else (0, 1, 2):
        angle = -angles[:, axis] if inverse else angles[:, axis]
        i, j = (axis + 1) % 3, (axis + 2) % 3
        c, s = np.cos(angle), np.sin(angle)
        rotated = np.array(np.broadcast_to(vector, (max(len(vector), len(angle)), 3)))
        rotated[:, i], rotated[:, j] = c * vector[:, i] - s * vector[:, j], s * vector[:, i] + c * vector[:, j]
        vector = rotated
    return vector


@dataclass(frozen=True, eq=False)
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
            return _divide(rotate_euler(vector - location, rotation, inverse=True), scale)
        if self.kind == "NORMAL":
            return normalize(rotate_euler(_divide(vector, scale), rotation))
        rotated = rotate_euler(vector * scale, rotation)
        return rotated + location if self.kind == "POINT" else rotated


# Colour


def _mix_mix(a: np.ndarray, b: np.ndarray, t: np.ndarray) -> np.ndarray:
    return a * (1 - t) + b * t


def _mix_overlay(a: np.ndarray, b: np.ndarray, t: np.ndarray) -> np.ndarray:
    dark = a * (1 - t + 2 * t * b)
    return np.where(a < 0.5, dark, 1 - (1 - t + 2 * t * (1 - b)) * (1 - a))


def _mix_divide(a: np.ndarray, b: np.ndarray, t: np.ndarray) -> np.ndarray:
    return np.where(b != 0, (1 - t) * a + t * _divide(a, b), a)


def _mix_dodge(a: np.ndarray, b: np.ndarray, t: np.ndarray) -> np.ndarray:
    rest = 1 - t * b
    return np.where(a == 0, 0, np.where(rest <= 0, 1, np.minimum(_divide(a, rest), 1)))


def _mix_burn(a: np.ndarray, b: np.ndarray, t: np.ndarray) -> np.ndarray:
    rest = 1 - t + t * b
    return np.where(rest <= 0, 0, np.clip(1 - _divide(1 - a, rest), 0, 1))


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
    return np.where(other[:, 1:2] != 0, _mix_mix(a, hsv_to_rgb(hsv), t), a)


BLEND: dict[str, Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]] = {
    "MIX": _mix_mix,
    "DARKEN": lambda a, b, t: _mix_mix(a, np.minimum(a, b), t),
    "MULTIPLY": lambda a, b, t: _mix_mix(a, a * b, t),
    "BURN": _mix_burn,
    "LIGHTEN": lambda a, b, t: _mix_mix(a, np.maximum(a, b), t),
    "SCREEN": lambda a, b, t: 1 - (1 - t + t * (1 - b)) * (1 - a),
    "DODGE": _mix_dodge,
    "ADD": lambda a, b, t: a + b * t,
    "OVERLAY": _mix_overlay,
    "SOFT_LIGHT": _mix_soft_light,
    "LINEAR_LIGHT": lambda a, b, t: a + t * (2 * b - 1),
    "DIFFERENCE": lambda a, b, t: _mix_mix(a, np.abs(a - b), t),
    "EXCLUSION": lambda a, b, t: np.maximum(_mix_mix(a, a + b - 2 * a * b, t), 0),
    "SUBTRACT": lambda a, b, t: _mix_mix(a, a - b, t),
    "DIVIDE": _mix_divide,
    "HUE": lambda a, b, t: _mix_hsv(a, b, t, "HUE"),
    "SATURATION": lambda a, b, t: _mix_hsv(a, b, t, "SATURATION"),
    "COLOR": lambda a, b, t: _mix_hsv(a, b, t, "COLOR"),
    "VALUE": lambda a, b, t: _mix_hsv(a, b, t, "VALUE"),
}


@dataclass(frozen=True, eq=False)
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


@dataclass(frozen=True, eq=False)
class Invert(Expression):
    factor: Expression
    color: Expression

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        t, color = values
        return t * (1 - color) + (1 - t) * color


@dataclass(frozen=True, eq=False)
class Gamma(Expression):
    color: Expression
    gamma: Expression

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        color, gamma = values
        positive = color > 0
        out = np.where(positive, np.power(np.where(positive, color, 1), gamma), color)
        return np.where(gamma == 0, 1, out)


@dataclass(frozen=True, eq=False)
class BrightContrast(Expression):
    color: Expression
    bright: Expression
    contrast: Expression

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        color, bright, contrast = values
        return np.maximum((1 + contrast) * color + bright - contrast / 2, 0)


@dataclass(frozen=True, eq=False)
class HueSaturation(Expression):
    """Hue 0.5, saturation 1 and value 1 change nothing."""

    hue: Expression
    saturation: Expression
    value: Expression
    factor: Expression
    color: Expression

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        hue, saturation, value, factor, color = values
        h, s, v = (c[:, None] for c in rgb_to_hsv(color).T)
        h, s, v = _fraction(h + hue + np.float32(0.5)), np.clip(s * saturation, 0, 1), v * value
        changed = hsv_to_rgb(np.concatenate(np.broadcast_arrays(h, s, v), axis=1))
        return np.maximum(_mix_mix(color, changed, factor), 0)


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


@dataclass(frozen=True, eq=False)
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
        t = np.clip(np.where(start == end, at_end, _divide(x - start, end - start)), 0, 1)
        if interpolation in ("CARDINAL", "B_SPLINE"):
            weights = (_cardinal if interpolation == "CARDINAL" else uniform_b_spline)(t)
            neighbours = (np.maximum(after - 2, 0), left, right, np.minimum(after + 1, last))
            total = sum(w[:, None] * self.colors[i] for w, i in zip(weights, neighbours, strict=True))
            return np.clip(total, 0, 1)
        if interpolation == "EASE":
            t = t * t * (3 - 2 * t)
        t = t[:, None]
        if self.mode == "RGB":
            return _mix_mix(self.colors[left], self.colors[right], t)
        t = np.where(left == right, 0, t[:, 0])[:, None]  # FAR would run through all hues beyond the ends
        return self._blend_in_model(left, right, t)

    def _blend_in_model(self, left: np.ndarray, right: np.ndarray, t: np.ndarray) -> np.ndarray:
        model = COLOR_MODELS[f"{self.mode}_FROM_RGB"](self.colors[:, :3])
        out = _mix_mix(model[left], model[right], t)
        out[:, 0] = _blend_hue(model[left, 0], model[right, 0], t[:, 0], self.hue)
        alpha = _mix_mix(self.colors[left, 3:], self.colors[right, 3:], t)
        return np.concatenate([COLOR_MODELS[f"RGB_FROM_{self.mode}"](out), alpha], axis=1)


@dataclass(frozen=True)
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
        inside = _mix_mix(table[i], table[i + 1], np.clip(position - i, 0, 1))
        return inside + before * np.minimum(x - self.low, 0) + after * np.maximum(x - self.high, 0)


@dataclass(frozen=True, eq=False)
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
        return _mix_mix(value, curved, t)


# Normals


@dataclass(frozen=True, eq=False)
class NormalMap(Expression):
    """Unit normal (N, 3) in object space from a normal map's colour.

    In tangent space, n = normalize(x T + y B + z N) with (x, y, z) = 2 c - 1, and strength s turns it into
    (s x, s y, mix(1, z, s)); in object space the map's normal is blended with the surface's by s.
    """

    strength: Expression
    color: Expression
    uv: UV | None = None  # the map of the tangent; None: the map holds normals in object space
    flip: tuple[float, float, float] = (1.0, 1.0, 1.0)  # signs of the axes

    @property
    def varies(self) -> bool:
        return True

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        strength, color = values[:2]
        n = (2 * color - 1) * np.array(self.flip, np.float32)
        strength = np.maximum(strength, 0)
        normal = _three(inputs.normal, len(inputs))
        if self.uv is None:
            return normalize(normal + (normalize(n) - normal) * strength)
        if inputs.tangent is None:
            return normal
        tangent, bitangent = _tangent_frame(normal, inputs)
        depth = 1 + (n[:, 2:] - 1) * np.minimum(strength, 1)
        bent = normalize(n[:, :1] * strength * tangent + n[:, 1:2] * strength * bitangent + depth * normal)
        return np.where(_dot(bent, bent) > 0, bent, normal)


def _tangent_frame(normal: np.ndarray, inputs: SampleInputs) -> tuple[np.ndarray, np.ndarray]:
    """Tangent and bitangent (N, 3); the tangent as given, Cycles does not make it orthogonal again."""
    tangent = _three(inputs.tangent, len(inputs))
    sign = 1 if inputs.bitangent_sign is None else inputs.bitangent_sign[:, None]
    return tangent, np.cross(normal, tangent) * sign
