"""Reads PLY as the authors of 3D Gaussian splatting write it (Kerbl et al. 2023), in any order of properties.

A vertex has logarithms of scales, the logit of opacity, and a quaternion w, x, y, z of any length. `f_rest_*` hold all
coefficients of red, then green, then blue. Without `scale_2` splats are disks (Huang et al. 2024). `filter_3D` is the
standard deviation that Mip-Splatting adds to scales (Yu et al. 2024, equation 9).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ...core.scene.captured import CapturedSplats
from ..points.ply import ORDERS, Element, PlyHeader
from ..points.reader import PointFileError, origin_of
from ..points.text.rows import TextRows
from .reader import CHUNK, BlockReader, Decoded, SplatHeader, checked_coefficients, exponential, sigmoid

NEEDED = ("x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "rot_0", "rot_1", "rot_2",
          "rot_3")  # fmt: skip
# What programs note about training in comments: Brush, and Postshot.
ANTIALIASED = re.compile(r"\s*(splatrendermode:\s*mip|antialiased\s+1)\s*$", re.IGNORECASE)


class PlySplats(BlockReader):
    """The splats of a PLY file that is not packed."""

    def __init__(self, path: Path, ply: PlyHeader) -> None:
        super().__init__()
        vertex = _vertex(path, ply)
        names = [name for name, _ in vertex.properties]
        self._ply, self._vertex, self._path = ply, vertex, path
        rest = sum(re.fullmatch(r"f_rest_\d+", name) is not None for name in names)
        coefficients = checked_coefficients(path, rest // 3 if rest % 3 == 0 else rest)
        # Coefficient k of channel c is f_rest_(K c + k).
        self._sh = [f"f_rest_{coefficients * c + k}" for k in range(coefficients) for c in range(3)]
        if missing := [name for name in self._sh if name not in names]:
            raise PointFileError(path, f"has {rest} properties f_rest_*, but not {missing[0]}")
        self._sh_columns = np.array([names.index(name) for name in self._sh], np.int64)
        self._scales = [name for name in ("scale_0", "scale_1", "scale_2") if name in names]
        self._filter = "filter_3D" in names
        antialiased = self._filter or any(ANTIALIASED.match(comment) for comment in ply.comments)
        title = f"PLY, {ply.order.replace('_', ' ')}" + (", disks" if len(self._scales) == 2 else "")
        self._origin = np.zeros(3)
        self._open()
        if ply.order != "ascii" and dict(vertex.properties)["x"] == "f8":
            self._origin = origin_of(None, self._columns(slice(0, 1 << 16), ["x", "y", "z"]))
        x, y, z = self._origin.tolist()
        self.header = SplatHeader(path, title, vertex.count, coefficients, antialiased, origin=(x, y, z))

    def _open(self) -> None:
        """Finds the vertices, or their lines."""
        ply, vertex = self._ply, self._vertex
        before = ply.elements[: ply.elements.index(vertex)]
        if ply.order == "ascii":
            skipped = sum(element.count for element in before)
            self._rows = TextRows(self._path, ply.size, skipped, vertex.count, len(vertex.properties))
            self._table: np.ndarray = np.empty((0, len(vertex.properties)))
            return
        start = ply.size + sum(element.count * record_of(element, ply.order).itemsize for element in before)
        records = mapped(self._path, vertex, ply.order, start)
        names = [name for name, _ in vertex.properties]
        single = {dtype for _, dtype in vertex.properties} == {"f4"}
        self._table = records.view(records.dtype[0]).reshape(-1, len(names)) if single and len(records) else records

    def _columns(self, rows: slice, names: list[str]) -> np.ndarray:
        """Properties of some vertices, (n, len(names))."""
        if self._table.dtype.names:
            part = self._table[rows]
            return np.stack([part[name] for name in names], axis=1)
        order = [name for name, _ in self._vertex.properties]
        columns = [order.index(name) for name in names]
        step = columns[1] - columns[0] if len(columns) > 1 else 1
        if step > 0 and columns == list(range(columns[0], columns[-1] + 1, step)):
            return self._table[rows, columns[0] : columns[-1] + 1 : step]
        return self._table[rows][:, columns]

    def decode(self, first: int, out: Decoded) -> None:
        first -= self._first
        rows = slice(first, first + len(out.opacity))
        position = self._columns(rows, ["x", "y", "z"])
        out.position[:] = position - self._origin if self._origin.any() else position
        scales = len(self._scales)
        exponential(self._columns(rows, self._scales).astype(np.float32, copy=False), out.scale[:, :scales])
        out.scale[:, scales:] = 0
        out.rotation[:] = self._columns(rows, ["rot_0", "rot_1", "rot_2", "rot_3"])
        out.base[:] = self._columns(rows, ["f_dc_0", "f_dc_1", "f_dc_2"])
        sigmoid(self._columns(rows, ["opacity"])[:, 0], out.opacity)
        if self._filter:
            widen(out, self._columns(rows, ["filter_3D"]))
        if self._sh:
            self._decode_sh(rows, out.sh)

    def _decode_sh(self, rows: slice, out: np.ndarray) -> None:
        """Coefficients (n, K, 3), whose channels the file has one after another."""
        count = out.shape[1]
        if self._table.dtype == np.float32:
            # Several times as fast as channel by channel.
            np.take(self._table[rows], self._sh_columns, axis=1, out=out.reshape(len(out), -1), mode="clip")
            return
        for c in range(3):
            out[:, :, c] = self._columns(rows, self._sh[c::3]).reshape(-1, count)

    _first = 0  # splat that the table begins with

    def chunks(self, size: int = CHUNK) -> Iterator[CapturedSplats]:
        if self._ply.order != "ascii":
            yield from super().chunks(size)
            return
        self.dropped = self.unturned = 0
        self._first = 0
        for rows in self._rows.chunks(size):
            self._table = rows
            yield self._chunk(self._first, len(rows))
            self._first += len(rows)

    def close(self) -> None:
        self._table = np.empty((0, len(self._vertex.properties)))


def widen(out: Decoded, deviation: np.ndarray) -> None:
    """Convolves splats with a ball (n, 1) of Mip-Splatting's, which keeps their mass: opacity falls as they grow."""
    square = out.scale.astype(np.float64) ** 2
    wider = square + deviation.astype(np.float64) ** 2
    out.opacity[:] *= np.sqrt(np.prod(square / wider, axis=1))
    out.scale[:] = np.sqrt(wider)


def _vertex(path: Path, ply: PlyHeader) -> Element:
    """The vertices, which have all that splats need and come before any lists."""
    vertex = ply.element("vertex")
    if vertex is None:
        raise PointFileError(path, "holds no captured splats: it has no vertices")
    names = {name for name, _ in vertex.properties}
    if missing := [name for name in NEEDED if name not in names]:
        raise PointFileError(path, f"holds no captured splats: its vertices have no {', '.join(missing)}")
    if len(names) < len(vertex.properties):
        raise PointFileError(path, "has vertices with two properties of the same name")
    before = ply.elements[: ply.elements.index(vertex)]
    if any(not dtype for element in (*before, vertex) for _, dtype in element.properties):
        raise PointFileError(path, "has lists before its vertices or in them, so that these cannot be found")
    return vertex


def record_of(element: Element, order: str) -> np.dtype:
    """The type of an element's record in a binary file; its properties' names are distinct or do not matter."""
    distinct = len({name for name, _ in element.properties}) == len(element.properties)
    names = [name if distinct else f"{i} {name}" for i, (name, _) in enumerate(element.properties)]
    return np.dtype([(n, ORDERS[order] + dtype) for n, (_, dtype) in zip(names, element.properties, strict=True)])


def mapped(path: Path, element: Element, order: str, start: int) -> np.ndarray:
    """An element's records, from a byte on, mapped into memory. Raises PointFileError where the file is too short."""
    record = record_of(element, order)
    there = max(0, path.stat().st_size - start)
    if record.itemsize * element.count > there:
        what = f"promises {element.count:,} of the element {element.name} and ends after"
        raise PointFileError(path, f"{what} {there // max(record.itemsize, 1):,}")
    if element.count == 0 or record.itemsize == 0:
        return np.empty(0, record)
    return np.memmap(path, record, "r", start, (element.count,))
