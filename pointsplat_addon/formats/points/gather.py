"""Brings the points of one or several files together as arrays, of what is wanted of them."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, field

import numpy as np

from ...core.numeric.record import value_record
from .colors import coded, coding_of
from .reader import CHUNK, Attribute, Columns, Reader, origin_of

GROWTH = 1.25  # of a column whose memory is full


@value_record
class Selection:
    """Which points, and what of them."""

    attributes: frozenset[str] | None = None  # beside the position; None: all
    every: int = 1  # of so many points one
    box: tuple[tuple[float, float, float], tuple[float, float, float]] | None = (
        None  # low and high corner, map coordinates
    )
    classes: frozenset[int] | None = None  # of classification; None: all


@dataclass(eq=False)
class Gathered:
    """Points of all files, N of them."""

    origin: np.ndarray  # (3,) float64, which positions are relative to
    columns: Columns = field(default_factory=dict)  # position (N, 3) float32; color (N, 4) uint8 or float32, sRGB
    time_start: float = 0.0  # GPS time of the first point; gps_time counts from it
    dropped: int = 0  # points without a finite position
    stations: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))  # (S, 3) float64, relative to the origin
    warnings: list[str] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.columns["position"])


def gather(readers: Sequence[Reader], selection: Selection, size: int = CHUNK) -> Generator[float, None, Gathered]:
    """Reads all files; yields the share that is read, and returns what was found.

    The origin is near the first points, whatever headers say of the bounds.
    Attributes that some files lack are zero there; those that are zero everywhere are left out. Raises PointFileError
    and OSError.
    """
    found = Gathered(np.zeros(3))
    types = _types(readers, selection)
    total = sum(reader.header.count for reader in readers)
    parts = {name: _Column(dtype, shape, total) for name, (dtype, shape) in types.items()}
    seen, first_station = 0, 0
    start: float | None = None
    read = {
        *types,
        *(("classification",) if selection.classes is not None else ()),
        "gps_time" if "gps_time" in types else "",
    }
    for reader in readers:
        stations = reader.header.stations
        before = 0  # points of this file
        for chunk in reader.chunks(read, size):
            count = len(chunk["position"])
            seen += count
            yield min(seen / max(total, 1), 1.0)
            rows = _chosen(chunk, selection, before)
            before += count
            if not np.isfinite(chunk["position"]).all():  # which takes less time than to look at each point
                finite = np.asarray(np.isfinite(chunk["position"]).all(axis=1))
                rows = np.arange(count)[rows]
                found.dropped += int(np.count_nonzero(~finite[rows]))
                rows = rows[finite[rows]]
            position = chunk["position"][rows]
            if len(position) == 0:
                continue
            if len(parts["position"]) == 0:
                found.origin = origin_of(None, position)
            if "gps_time" in chunk and start is None:
                time = chunk["gps_time"][rows] + reader.header.time_start
                known = time[np.isfinite(time)]
                start = float(known[0]) if len(known) else None
            offsets = {
                "position": -found.origin,
                "gps_time": reader.header.time_start - (start or 0.0),
                "station": first_station,
            }
            for name, column in parts.items():
                given = chunk[name][rows] if name in chunk else None
                column.add(given, offsets.get(name, 0), len(position))
        found.warnings += reader.warnings
        first_station += len(stations)
        found.stations = np.concatenate([found.stations, stations])
    found.time_start = start or 0.0
    found.stations = found.stations - found.origin
    for name in types:
        column = parts.pop(name)
        if name == "color":
            array = column.taken()
            found.columns[name] = coded(array, coding_of(array))
        elif name == "position" or column.some:
            found.columns[name] = column.taken()
    return found


class _Column:
    """A column that grows, in one piece of memory, so that its parts are nowhere held twice. While all of it is zero,
    as most columns of most scans are, it takes none."""

    def __init__(self, dtype: np.dtype, shape: tuple[int, ...], promised: int) -> None:
        self._dtype, self._shape = dtype, shape  # of a point's value
        self._promised = promised  # points, by the headers
        self._values: np.ndarray | None = None
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def some(self) -> bool:
        """Whether any value is not zero."""
        return self._values is not None

    def add(self, given: np.ndarray | None, offset: np.ndarray | float, count: int) -> None:
        """Appends `count` values and their offset; zeros where a file has no such column or fewer components."""
        first, self._count = self._count, self._count + count
        moved = bool(np.any(offset))
        if given is not None and (moved or given.any() or self.some):
            part = self._room()[first : self._count]
            there = part[:, : given.shape[1]] if self._shape and given.ndim == 2 else part
            there[...] = given + offset if moved else given
        elif self.some:
            self._room()

    def _room(self) -> np.ndarray:
        """Memory for all values, zero where none was written."""
        if self._values is None:
            self._values = np.zeros((self._count, *self._shape), self._dtype)
        if len(self._values) < self._count:
            # Headers may promise more points than there are: memory grows with what is found.
            size = min(int(GROWTH * self._count), max(self._promised, self._count))
            self._values.resize((size, *self._shape), refcheck=False)
        return self._values

    def taken(self) -> np.ndarray:
        """The values, (N, ...); the column gives them up."""
        values = self._room()
        values.resize((self._count, *self._shape), refcheck=False)
        self._values = None
        return values


def _types(readers: Sequence[Reader], selection: Selection) -> dict[str, tuple[np.dtype, tuple[int, ...]]]:
    """The columns that are kept: type and shape of a point's value."""
    attributes: dict[str, Attribute] = {}
    for attribute in (a for reader in readers for a in reader.header.attributes):
        if (
            attribute.name != "position"
            and selection.attributes is not None
            and attribute.name not in selection.attributes
        ):
            continue
        known = attributes.get(attribute.name, attribute)
        dtype = np.result_type(known.dtype, attribute.dtype)
        components = max(known.components, attribute.components)
        attributes[attribute.name] = Attribute(attribute.name, dtype, components)
    found = {}
    for name, attribute in attributes.items():
        dtype = np.dtype(np.float32) if name in ("position", "gps_time", "normal") else attribute.dtype
        dtype = np.dtype(np.float32) if dtype == np.float64 else dtype
        found[name] = dtype, () if attribute.components == 1 else (attribute.components,)
    return found


def _chosen(chunk: Columns, selection: Selection, before: int) -> np.ndarray | slice:
    """Rows of a chunk that are wanted; `before`: points of the file that precede it."""
    first = -before % selection.every
    if selection.box is None and (selection.classes is None or "classification" not in chunk):
        return slice(first, None, selection.every)
    rows = np.arange(first, len(chunk["position"]), selection.every)
    if selection.box is not None:
        low, high = np.array(selection.box)
        position = chunk["position"][rows]
        rows = rows[((position >= low) & (position <= high)).all(axis=1)]
    if selection.classes is not None and "classification" in chunk:
        rows = rows[np.isin(chunk["classification"][rows], list(selection.classes))]
    return rows
