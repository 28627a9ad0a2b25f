"""What all readers of scans offer: a header, and the points in chunks.

A reader takes nothing for granted that a file says of itself: sizes are compared with the bytes in the file before
memory is allocated for them, and nothing is read whole that grows with the number of points.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import field
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

import numpy as np

from ...core.numeric.record import record, value_record

CHUNK = 1 << 20  # points
Columns = dict[str, np.ndarray]  # (N, ...) by the name of the attribute


class PointFileError(ValueError):
    """A file is damaged, or no scan; the message names the file, and where in it."""

    def __init__(self, path: Path, what: str) -> None:
        super().__init__(f"{path.name}: {what}")
        self._given = path, what

    def __reduce__(self) -> tuple:
        return type(self), self._given  # so that it comes back from other processes


@value_record
class Attribute:
    """One attribute of the points, as `chunks` yields it."""

    name: str  # see columns.STANDARD; else the file's own
    dtype: np.dtype
    components: int = 1
    source: tuple[str, ...] = ()  # columns of the file


@record
class Header:
    """What a file says of its points before they are read."""

    path: Path
    format: str  # for people: "LAS 1.4, point format 7"
    count: int  # records of the file, of which some may be no points
    attributes: tuple[Attribute, ...]  # `position` comes first
    bounds: np.ndarray | None = None  # (2, 3) float64, low and high corner, by the header; None: it has none
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))  # (3,) float64 near the points, for float32
    crs: str = ""  # coordinate reference system: WKT, or "EPSG:2154"; empty: the file names none
    time_start: float = 0.0  # seconds of gps_time's clock before the file's first ones, where the file tells it
    stations: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))  # (S, 3) float64, where scanners stood
    warnings: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(attribute.name for attribute in self.attributes)


class OpenFile(Protocol):
    """What is closed at the end of a `with` block."""

    def close(self) -> None: ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class Reader(OpenFile, Protocol):
    """An open scan."""

    header: Header
    warnings: list[str]  # what was found while reading; complete when `chunks` has ended

    def chunks(self, columns: Collection[str] | None = None, size: int = CHUNK) -> Iterator[Columns]:
        """Yields the points in order, at most `size` at a time: `position` (N, 3) float64 in the file's unit, and of
        the other attributes those in `columns`; None: all.

        Raises PointFileError where the file is damaged, after the chunks before that place.
        """
        ...


class FileReader:
    """What the readers share: they close themselves."""

    header: Header
    warnings: list[str]

    def close(self) -> None:
        """Closes the file."""

    def wanted(self, columns: Collection[str] | None) -> list[Attribute]:
        """Returns the attributes of which `columns` names the others than the position."""
        return [a for a in self.header.attributes if a.name == "position" or columns is None or a.name in columns]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def origin_of(bounds: np.ndarray | None, position: np.ndarray | None = None) -> np.ndarray:
    """Returns (3,) float64, whole kilometres where the coordinates are far from zero and else zero: what is subtracted
    so that float32 keeps millimetres. `position`: some of the points, where there are no bounds."""
    if bounds is None and position is not None and len(position):
        finite = position[np.isfinite(position).all(axis=1)]
        bounds = np.stack([finite.min(axis=0), finite.max(axis=0)]) if len(finite) else None
    if bounds is None or not np.isfinite(bounds).all():
        return np.zeros(3)
    middle = bounds.mean(axis=0)
    return np.where(np.abs(middle) > 1000.0, np.round(middle, -3), 0.0) + 0.0
