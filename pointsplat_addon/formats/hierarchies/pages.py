"""How pages of PointSplat's own hierarchies are coded: columns, one after the other, each with few bytes an element.

Leaves hold points; the pages above them hold nodes, which have half-axes and a covered fraction. Positions count steps
from the page's low corner: 16 bits on each axis, or 24 where a page of points is so wide that steps would be coarse.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from ...core.material.color_models import linear_from_srgb, srgb_from_linear
from ...core.numeric.record import value_record
from ...core.numeric.vectors import basis
from ..points.reader import Columns

FINE = 1e-3  # steps of points are no wider, in the file's unit: millimetres of metres
MOST_16, MOST_24 = (1 << 16) - 1, (1 << 24) - 1
OCTAVES = 20  # range of half-axes below the longest of a page
LENGTH_STEPS = 254 / OCTAVES  # code values per octave; 0 is length 0
LINEAR_STEPS = (1 << 14) - 1  # linear colours that the table of codes tells apart: 4 in the finest step of sRGB
TYPES = ("u1", "<u2", "<f4")  # of attributes


@value_record
class Layout:
    """What the elements of a file have.

    Raises ValueError for what no file has.
    """

    color: bool
    normal: bool  # points have one; nodes always have that of their kernel
    attributes: tuple[tuple[str, str], ...] = ()  # names, and one of TYPES each

    def __post_init__(self) -> None:
        names = [name for name, _ in self.attributes]
        if len(set(names)) < len(names) or set(names) & {"position", "color", "normal", "axis", "radii", "covered"}:
            raise ValueError("has attributes of one name")
        if any(kind not in TYPES for _, kind in self.attributes):
            raise ValueError("has attributes of a type that there is not")

    def columns(self, leaf: bool, wide: bool = False) -> list[tuple[str, str, int]]:
        """Name, type and components of each column of a page."""
        found = [("low", "<u2", 3)]
        if wide:
            found.append(("high", "u1", 3))
        found += [(name, kind, 1) for name, kind in self.attributes if kind != "u1"]
        found += [(name, kind, 1) for name, kind in self.attributes if kind == "u1"]
        if self.color:
            found.append(("color", "u1", 3))
        if leaf:
            return [*found, *([("normal", "u1", 2)] if self.normal else [])]
        found += [("normal", "u1", 2), ("angle", "u1", 1), ("radii", "u1", 3), ("covered", "u1", 1)]
        return [*found, *([("coherence", "u1", 1)] if self.normal else [])]

    def nbytes(self, leaf: bool, wide: bool = False) -> int:
        """Bytes of an element."""
        return sum(np.dtype(kind).itemsize * width for _, kind, width in self.columns(leaf, wide))


@value_record
class Grid:
    """Steps that the positions of a page count."""

    low: tuple[float, float, float]
    step: tuple[float, float, float]
    wide: bool  # 24 bits


def grid_of(low: np.ndarray, high: np.ndarray, leaf: bool) -> Grid:
    """Returns the steps of positions between two corners (3,), float64."""
    extent = high - low
    wide = leaf and bool(extent.max() > FINE * MOST_16)
    step = extent / (MOST_24 if wide else MOST_16)
    return Grid(tuple(low.tolist()), tuple(step.tolist()), wide)


def encode_position(position: np.ndarray, grid: Grid) -> dict[str, np.ndarray]:
    """Columns `low` and, of wide pages, `high` of positions (3, N) float64 in the grid's frame."""
    most = MOST_24 if grid.wide else MOST_16
    code = np.empty(position.shape, np.uint32)
    for out, column, low, step in zip(code, position, grid.low, grid.step, strict=True):
        counted = (column - low) * (1 / step if step > 0 else 0.0)
        counted += 0.5
        np.minimum(counted, most, out=counted)
        out[:] = counted
    found: dict[str, np.ndarray] = {"low": code.astype(np.uint16)}
    if grid.wide:
        found["high"] = (code >> np.uint32(16)).astype(np.uint8)
    return found


def decode_position(columns: dict[str, np.ndarray], grid: Grid, origin: np.ndarray) -> np.ndarray:
    """Positions (N, 3) float32 relative to the origin (3,), of columns (3, N)."""
    found = np.empty((columns["low"].shape[1], 3), np.float32)
    for axis in range(3):
        code = columns["low"][axis].astype(np.float64)
        if grid.wide:
            code += columns["high"][axis] * 65536.0
        found[:, axis] = code * grid.step[axis] + (grid.low[axis] - origin[axis])
    return found


@cache
def _color_codes() -> np.ndarray:
    """(LINEAR_STEPS + 1,) uint8: sRGB codes of linear values."""
    linear = np.arange(LINEAR_STEPS + 1) / LINEAR_STEPS
    return np.round(srgb_from_linear(linear) * 255).astype(np.uint8)


@cache
def linear_of_code() -> np.ndarray:
    """(256,) float32: scene-linear values of sRGB codes."""
    return linear_from_srgb(np.arange(256) / 255.0).astype(np.float32)


def encode_color(linear: np.ndarray) -> np.ndarray:
    """sRGB codes, uint8, of linear colours of any shape."""
    return _color_codes()[(np.clip(linear, 0, 1) * LINEAR_STEPS + 0.5).astype(np.intp)]


@cache
def frames() -> np.ndarray:
    """(65536, 9) float32: the unit vectors that the codes of normals stand for, and two axes across each (`basis`).

    Octahedral (Meyer et al. 2010), 255 steps to a side, so that the axes are among them; NONE stands for no vector.
    """
    y, x = np.divmod(np.arange(65536), 256)
    x, y = (np.minimum(c, 254) / 127.0 - 1 for c in (x, y))
    z = 1 - np.abs(x) - np.abs(y)
    fold = np.maximum(-z, 0)
    normal = np.stack([x - np.copysign(fold, x), y - np.copysign(fold, y), z])
    normal /= np.sqrt((normal * normal).sum(axis=0))
    found = np.concatenate([normal, *basis(normal)]).T
    found[NONE] = 0
    return np.ascontiguousarray(found, np.float32)


NONE = 65535  # the code of no normal


def encode_normal(normal: np.ndarray) -> np.ndarray:
    """Codes (N,) uint16 of vectors (3, N) of any length; NONE of zeros. Off by at most a degree."""
    x, y, z = normal
    size = np.abs(x) + np.abs(y)
    size += np.abs(z)
    scale = 127.0 / np.maximum(size, 1e-30)
    x, y = x * scale, y * scale
    below = z < 0
    folded = (127.0 - np.abs(y)) * np.copysign(1.0, x), (127.0 - np.abs(x)) * np.copysign(1.0, y)
    x, y = (np.where(below, f, c) for f, c in zip(folded, (x, y), strict=True))
    code = (x + 127.5).astype(np.uint16)
    code += (y + 127.5).astype(np.uint16) << np.uint16(8)
    code[size < 1e-20] = NONE
    return code


def encode_length(length: np.ndarray, longest: float) -> np.ndarray:
    """Lengths as uint8 logarithms, to the nearest; those far below the longest become the shortest that there is."""
    with np.errstate(divide="ignore"):
        code = 255.5 + LENGTH_STEPS * np.log2(length * (1 / longest))
    return np.clip(code, 1, 255).astype(np.uint8)


def decode_length(code: np.ndarray, longest: float) -> np.ndarray:
    """Lengths, float32, of codes of any shape."""
    table = longest * np.exp2((np.arange(256) - 255.0) / LENGTH_STEPS)
    table[0] = 0
    return table.astype(np.float32)[code]


def pack(layout: Layout, leaf: bool, wide: bool, columns: dict[str, np.ndarray]) -> bytes:
    """The bytes of a page of columns, (N,) or (components, N) each, in their types."""
    parts = []
    for name, kind, width in layout.columns(leaf, wide):
        column = columns[name]
        if width == 2 and column.ndim == 1:
            column = column.astype("<u2").view(np.uint8)  # low byte and high byte of each
        parts.append(np.ascontiguousarray(column, kind).tobytes())
    return b"".join(parts)


def unpack(
    data: bytes, count: int, layout: Layout, leaf: bool, grid: Grid, longest: float, origin: np.ndarray
) -> Columns:
    """Elements of a page, as `PageSource.read` returns them.

    Raises ValueError where there are other bytes than `count` elements have.
    """
    if len(data) != count * layout.nbytes(leaf, grid.wide):
        raise ValueError("has another size than its elements")
    raw: dict[str, np.ndarray] = {}
    at = 0
    for name, kind, width in layout.columns(leaf, grid.wide):
        dtype = np.dtype("<u2" if width == 2 else kind)
        rows = 1 if width == 2 else width
        found = np.frombuffer(data, dtype, count * rows, at)
        at += found.nbytes
        raw[name] = found.reshape(rows, count) if rows > 1 else found
    columns: Columns = {"position": decode_position(raw, grid, origin)}
    if layout.color:
        columns["color"] = linear_of_code()[np.ascontiguousarray(raw["color"].T)]
    for name, kind in layout.attributes:
        columns[name] = raw[name].astype(np.dtype(kind).newbyteorder("="))
    if leaf:
        if layout.normal:
            columns["normal"] = frames()[raw["normal"], :3]
        return columns
    frame = frames()[raw["normal"]]
    turn = raw["angle"] * np.float32(np.pi / 256)
    columns["normal"] = np.ascontiguousarray(frame[:, :3])
    columns["axis"] = np.cos(turn)[:, None] * frame[:, 3:6] + np.sin(turn)[:, None] * frame[:, 6:]
    columns["radii"] = decode_length(np.ascontiguousarray(raw["radii"].T), longest)
    columns["covered"] = raw["covered"] * np.float32(1 / 255)
    if layout.normal:
        columns["coherence"] = raw["coherence"] * np.float32(1 / 255)
    return columns
