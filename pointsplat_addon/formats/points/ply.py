"""Reads PLY (Turk 1994), of either byte order or as text: the elements `vertex`, with any properties.

A .ply file is a mesh, a scan, or captured Gaussian splats: `kind_of` looks into the header.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np

from ...core.numeric.record import value_record
from .columns import assemble, attributes_of
from .reader import CHUNK, Columns, FileReader, Header, PointFileError, origin_of
from .records import Records
from .text.rows import TextRows

LONGEST_HEADER = 1 << 18  # bytes
MOST_DIGITS = 18  # of a number of elements
TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8", "int64": "i8", "uint64": "u8",
}  # fmt: skip
ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
SPLAT_PROPERTIES = {"f_dc_0", "opacity", "scale_0", "rot_0"}
PACKED_PROPERTIES = {"packed_position", "packed_rotation", "packed_scale", "packed_color"}


@value_record
class Element:
    """One element of the header."""

    name: str
    count: int
    properties: tuple[tuple[str, str], ...]  # name and NumPy's type; an empty type: a list


@value_record
class PlyHeader:
    """The header of a file."""

    order: str  # of ORDERS
    elements: tuple[Element, ...]
    size: int  # bytes of the header
    comments: tuple[str, ...]

    def element(self, name: str) -> Element | None:
        return next((element for element in self.elements if element.name == name), None)


def kind_of(path: Path) -> str:
    """Returns what a .ply file holds: "SPLATS", "MESH" or "POINTS". Raises PointFileError for no PLY, OSError."""
    header = read_header(path)
    vertex, faces = header.element("vertex"), header.element("face")
    names = {name for name, _ in vertex.properties} if vertex else set()
    if names >= SPLAT_PROPERTIES or names >= PACKED_PROPERTIES:
        return "SPLATS"
    return "MESH" if faces and faces.count else "POINTS"


def read_header(path: Path) -> PlyHeader:
    """Reads a header. Raises PointFileError where it is none."""
    with path.open("rb") as file:
        text = file.read(LONGEST_HEADER)
    end = text.find(b"end_header")
    stop = text.find(b"\n", end)
    if not text.startswith(b"ply") or end < 0 or stop < 0:
        raise PointFileError(path, "is no PLY file, for it has no header that begins with ply and ends with end_header")
    order, comments = "", []
    elements: list[tuple[str, int, list[tuple[str, str]]]] = []
    for number, line in enumerate(text[:end].decode("utf-8", "replace").splitlines(), 1):
        words = line.split()
        match words[:1]:
            case ["format"] if len(words) >= 2 and words[1] in ORDERS:
                order = words[1]
            case ["element"] if len(words) == 3 and words[2].isdecimal() and len(words[2]) <= MOST_DIGITS:
                elements.append((words[1], int(words[2]), []))
            case ["property"] if elements and len(words) == 5 and words[1] == "list":
                elements[-1][2].append((words[4], ""))
            case ["property"] if elements and len(words) == 3 and words[1] in TYPES:
                elements[-1][2].append((words[2], TYPES[words[1]]))
            case ["comment"] | ["obj_info"]:
                comments.append(" ".join(words[1:]))
            case ["ply"] | []:
                pass
            case _:
                raise PointFileError(path, f'line {number} of its header is not understood: "{line[:60]}"')
    if not order:
        raise PointFileError(path, "its header names no format")
    found = tuple(Element(name, count, tuple(properties)) for name, count, properties in elements)
    return PlyHeader(order, found, stop + 1, tuple(comments))


class PlyReader(FileReader):
    """The vertices of a PLY file."""

    def __init__(self, path: Path) -> None:
        header = read_header(path)
        vertex = header.element("vertex")
        if vertex is None:
            raise PointFileError(path, "has no vertices")
        before = header.elements[: header.elements.index(vertex)]
        if any(not dtype for element in (*before, vertex) for _, dtype in element.properties):
            raise PointFileError(path, "has lists before its vertices or in them, so that these cannot be found")
        self._path, self._ply, self._vertex = path, header, vertex
        self.warnings = []
        if header.order == "ascii":
            skipped = sum(element.count for element in before)
            self._rows = TextRows(path, header.size, skipped, vertex.count, len(vertex.properties))
        else:
            order = ORDERS[header.order]
            start = header.size + sum(element.count * _record(element, order).itemsize for element in before)
            record = _record(vertex, order)
            self._records = Records(path, record, start, vertex.count)
        columns = [(name, np.dtype(dtype)) for name, dtype in vertex.properties]
        attributes = attributes_of(columns, path)
        title = f"PLY, {header.order.replace('_', ' ')}"
        self.header = Header(path, title, vertex.count, attributes)
        first = next(self.chunks((), 1 << 16), {"position": np.empty((0, 3))})["position"]
        self.header = Header(path, title, vertex.count, attributes, origin=origin_of(None, first))

    def chunks(self, columns: Collection[str] | None = None, size: int = CHUNK) -> Iterator[Columns]:
        wanted = self.wanted(columns)
        if self._ply.order == "ascii":
            names = [name for name, _ in self._vertex.properties]
            for rows in self._rows.chunks(size):
                yield assemble(dict(zip(names, rows.T, strict=True)), wanted)
            return
        for records in self._records.chunks(size):
            yield assemble(records, wanted)


def _record(element: Element, order: str) -> np.dtype:
    names = [f"{i} {name}" for i, (name, _) in enumerate(element.properties)]
    if len({name for name, _ in element.properties}) == len(names):
        names = [name for name, _ in element.properties]
    return np.dtype([(name, order + dtype) for name, (_, dtype) in zip(names, element.properties, strict=True)])
