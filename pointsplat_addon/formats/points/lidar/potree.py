"""Reads Potree 1.7: a folder with cloud.js, an octree of files of points, level by level.

A node's name is "r" and the digits of its octants; its file lies in folders of as many digits as a step of the
hierarchy has, and the file .hrc of such a folder lists the nodes of the step. Positions count from the low corner of
the node's cube.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np

from ..reader import CHUNK, Attribute, Columns, FileReader, Header, PointFileError, origin_of
from .las import LasReader

HIERARCHY = np.dtype([("children", "u1"), ("points", "<u4")])
DEEPEST = 30  # levels
# Attributes of a record: name, NumPy's type and components as stored, name here.
STORED = {
    "POSITION_CARTESIAN": ("<u4", 3, "position"), "COLOR_PACKED": ("u1", 4, "color"), "RGBA_PACKED": ("u1", 4, "color"),
    "RGB_PACKED": ("u1", 3, "color"), "NORMAL": ("<f4", 3, "normal"), "NORMAL_FLOATS": ("<f4", 3, "normal"),
    "NORMAL_SPHEREMAPPED": ("u1", 2, "normal"), "NORMAL_OCT16": ("u1", 2, "normal"),
    "INTENSITY": ("<u2", 1, "intensity"),
    "CLASSIFICATION": ("u1", 1, "classification"), "RETURN_NUMBER": ("u1", 1, "return_number"),
    "NUMBER_OF_RETURNS": ("u1", 1, "number_of_returns"), "SOURCE_ID": ("<u2", 1, "point_source_id"),
    "GPS_TIME": ("<f8", 1, "gps_time"), "FILLER_1B": ("u1", 1, ""), "SPACING": ("<f4", 1, "spacing"),
}  # fmt: skip


class PotreeReader(FileReader):
    """A Potree folder, by its cloud.js."""

    def __init__(self, path: Path) -> None:
        self._path, self.warnings = path, []
        try:
            facts = json.loads(path.read_text(encoding="utf-8"))
            low, high = ([float(facts["boundingBox"][end + axis]) for axis in "xyz"] for end in "lu")
            tight = facts.get("tightBoundingBox", facts["boundingBox"])
            box = np.array([[float(tight[end + axis]) for axis in "xyz"] for end in "lu"])
            self._low, self._side = np.array(low), float(max(np.subtract(high, low)))
            self._scale, self._step = float(facts["scale"]), max(1, int(facts["hierarchyStepSize"]))
            stored = facts["pointAttributes"]
            self._data = path.parent / Path(str(facts["octreeDir"])).name
        except FileNotFoundError:
            raise
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
            raise PointFileError(path, f"is no cloud.js of Potree 1.7: {error}") from None
        self._end = str(stored).lower() if stored in ("LAS", "LAZ") else "bin"
        if self._end == "bin":
            if not isinstance(stored, list):
                raise PointFileError(path, "has no list of attributes")
            names = [str(item.get("name") if isinstance(item, dict) else item) for item in stored]
            unknown = [name for name in names if name not in STORED]
            if unknown or "POSITION_CARTESIAN" not in names:
                raise PointFileError(path, f"has attributes that are not known: {', '.join(unknown) or 'no position'}")
            self._record = np.dtype(
                [(f"{i} {n}", STORED[n][0], (STORED[n][1],) if STORED[n][1] > 1 else ()) for i, n in enumerate(names)]
            )
        self._nodes = self._hierarchy()
        if self._end == "bin":
            attributes = [_attribute(name) for name in dict.fromkeys(names) if STORED[name][2]]
            attributes.sort(key=lambda attribute: attribute.name != "position")
        else:
            with LasReader(self._file("r")) as first:
                attributes = list(first.header.attributes)
        count = sum(self._nodes.values())
        title = f"Potree 1.7 of {len(self._nodes):,} nodes"
        self.header = Header(path, title, count, tuple(attributes), box, origin_of(box))

    def _folder(self, node: str) -> Path:
        digits = node[1:]
        steps = [digits[i : i + self._step] for i in range(0, len(digits) - self._step + 1, self._step)]
        return self._data.joinpath("r", *steps)

    def _file(self, node: str) -> Path:
        """The file of a node's points. Raises PointFileError where there is none."""
        path = self._folder(node) / f"{node}.{self._end}"
        if not path.exists():
            raise PointFileError(path, "is missing")
        return path

    def _hierarchy(self) -> dict[str, int]:
        """Points of each node that has some, level by level."""
        found: dict[str, int] = {}
        pages = ["r"]
        while pages:
            root = pages.pop()
            path = self._folder(root) / f"{root}.hrc"
            if not path.exists():
                raise PointFileError(path, "is missing")
            rows = np.frombuffer(path.read_bytes()[: path.stat().st_size // 5 * 5], HIERARCHY)
            level = [root]
            first = 0
            while level and first < len(rows):
                below = []
                for name, row in zip(level, rows[first:], strict=False):
                    found[name] = int(row["points"])
                    below += [f"{name}{digit}" for digit in range(8) if int(row["children"]) >> digit & 1]
                first += len(level)
                level = below
                if len(below) and len(below[0]) > DEEPEST:
                    raise PointFileError(path, f"has more than {DEEPEST} levels")
                if below and (len(below[0]) - 1) % self._step == 0:
                    # Nodes at the end of a step stand in this file, too; what is below them, in their own.
                    for name, row in zip(below, rows[first:], strict=False):
                        found[name] = int(row["points"])
                        pages += [name] if row["children"] else []
                    break
        return {name: count for name, count in sorted(found.items(), key=lambda item: (len(item[0]), item[0])) if count}

    def chunks(self, columns: Collection[str] | None = None, size: int = CHUNK) -> Iterator[Columns]:
        wanted = self.wanted(columns)
        for node, count in self._nodes.items():
            path = self._file(node)
            if self._end != "bin":
                with LasReader(path) as reader:
                    yield from reader.chunks([attribute.name for attribute in wanted], size)
                continue
            there = path.stat().st_size // self._record.itemsize
            if there < count:
                raise PointFileError(path, f"has {there:,} points, where its hierarchy says {count:,}")
            records = np.fromfile(path, self._record, count)
            for first in range(0, count, size):
                part = records[first : first + size]
                yield {attribute.name: self._column(part, attribute, node) for attribute in wanted}

    def _column(self, records: np.ndarray, attribute: Attribute, node: str) -> np.ndarray:
        field = next(name for name in records.dtype.names or () if name.partition(" ")[2] == attribute.source[0])
        value = records[field]
        if attribute.name == "position":
            return value * self._scale + self._corner(node)
        if attribute.source[0] == "NORMAL_SPHEREMAPPED":
            return sphere_mapped(value)
        if attribute.source[0] == "NORMAL_OCT16":
            return octahedral(value)
        return np.ascontiguousarray(value)

    def _corner(self, node: str) -> np.ndarray:
        """The low corner of a node's cube, (3,) float64: the bits of a digit are x, y and z from the highest on."""
        low, side = self._low.copy(), self._side
        for digit in map(int, node[1:]):
            side /= 2
            low += side * np.array([digit >> 2 & 1, digit >> 1 & 1, digit & 1])
        return low


def _attribute(stored: str) -> Attribute:
    dtype, components, name = STORED[stored]
    if name in ("position", "normal"):
        return Attribute(name, np.dtype(np.float64 if name == "position" else np.float32), 3, (stored,))
    return Attribute(name, np.dtype(dtype).newbyteorder("="), components, (stored,))


def sphere_mapped(value: np.ndarray) -> np.ndarray:
    """Unit normals (N, 3) float32 of sphere map coordinates (N, 2) uint8 (Mittring 2009: the Lambert azimuthal
    equal-area projection)."""
    at = value.astype(np.float32) / 255 * 2 - 1
    length = np.maximum(1 - (at * at).sum(axis=1), 0)
    across = at * 2 * np.sqrt(length)[:, None]
    found = np.concatenate([across, (2 * length - 1)[:, None]], axis=1)
    size = np.sqrt((found * found).sum(axis=1, keepdims=True))
    return (found / np.where(size > 0, size, 1)).astype(np.float32)


def octahedral(value: np.ndarray) -> np.ndarray:
    """Unit normals (N, 3) float32 of octahedral coordinates (N, 2) uint8 (Meyer et al. 2010)."""
    u, v = (value.astype(np.float32) / 255 * 2 - 1).T
    z = 1 - np.abs(u) - np.abs(v)
    below = z < 0
    x = np.where(below, np.copysign(1 - np.abs(v), u), u)
    y = np.where(below, np.copysign(1 - np.abs(u), v), v)
    found = np.stack([x, y, z], axis=1)
    return found / np.maximum(np.sqrt((found * found).sum(axis=1, keepdims=True)), 1e-12)
