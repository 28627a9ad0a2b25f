"""What Entwine and COPC have in common: an octree of cubes, each with points of its own, by level and whole numbers."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ...core.surface.nearest import median_spacing
from ..points.colors import Coding, coding_of, scene_linear
from ..points.reader import Columns, Header
from .source import LARGEST, Directory, PageSource

DEEPEST = 60  # levels: an edge that is halved so often is less than the rounding of the root's


@dataclass(eq=False)
class Octree:
    """Cubes with points, in any order: level and place, (K, 4) int64, and what is in them, (K,) int64 each."""

    key: np.ndarray
    count: np.ndarray
    nbytes: np.ndarray
    low: np.ndarray  # (3,) float64: low corner of the root's cube
    side: float  # of the root's cube
    spacing: float  # typical distance between neighbours in the root
    order: np.ndarray = field(init=False)  # (P,) int64: the cube of each page; -1: the root has none

    def directory(self, header: Header) -> Directory:
        """Returns the pages: parents come first. Raises ValueError where levels are no levels."""
        level = self.key[:, 0]
        if len(self.key) == 0:
            raise ValueError("it has no points")
        if level.min() < 0 or level.max() > DEEPEST:
            raise ValueError(f"it has cubes on level {int(level.max())}")
        if (self.key[:, 1:] < 0).any() or (self.key[:, 1:] >> level[:, None] > 0).any():
            raise ValueError("it has cubes outside of the first one")
        if not (np.abs([*self.low, self.side, self.spacing, *header.origin]) < LARGEST).all():
            raise ValueError("it lies impossibly far away")
        self.order = np.lexsort((*self.key.T[:0:-1], level))
        if level[self.order[0]] > 0:
            self.order = np.concatenate([[-1], self.order])
        key = np.where(self.order[:, None] < 0, 0, self.key[self.order])
        rows = {tuple(one): row for row, one in enumerate(key.tolist())}
        low = self.low + key[:, 1:] * (self.side / 2.0 ** key[:, :1])
        edge = self.side / 2.0 ** key[:, :1]
        bounds = np.stack([low, low + edge], axis=1)
        if header.bounds is not None:
            tight = np.clip(bounds, *header.bounds[:, None])
            bounds = np.where((tight[:, 1] > tight[:, 0]).any(axis=1)[:, None, None], tight, bounds)
        here = self.order >= 0
        return Directory(
            parent=np.array([_parent(one, rows) for one in key.tolist()], np.int32),
            level=key[:, 0].astype(np.int32),
            bounds=bounds - header.origin,
            spacing=(self.spacing / 2.0 ** key[:, 0]).astype(np.float32),
            count=np.where(here, self.count[self.order], 0),
            nbytes=np.where(here, self.nbytes[self.order], 0),
            points=int(self.count.sum()),
            origin=header.origin,
            crs=header.crs,
            cube=np.concatenate([low - header.origin, edge], axis=1),
            additive=True,
        )


def _parent(key: list[int], rows: dict[tuple[int, ...], int]) -> int:
    """The row of the nearest cube above one that there is; -1 for the root."""
    level, *place = key
    while level > 0:
        level, place = level - 1, [x >> 1 for x in place]
        if (row := rows.get((level, *place))) is not None:
            return row
    return -1


class PointsOfPages:
    """Makes elements of pages out of points as readers yield them. What is coded alike in all pages, the first that is
    read tells, which is the root."""

    def __init__(self, header: Header) -> None:
        self._header = header
        self._coding: Coding | None = None
        self._start = 0.0

    def elements(self, points: Columns) -> Columns:
        """Returns points as `PageSource.read` does. gps_time counts from the root's first; all numbers that are not
        whole are float32."""
        if self._coding is None:
            time = points.get("gps_time", np.zeros(0))
            time = time[np.isfinite(time)]
            self._start = float(time[0]) if len(time) else 0.0
            self._coding = coding_of(points["color"]) if "color" in points else Coding()
        # What is damaged may hold anything; positions that are not finite are left out.
        with np.errstate(all="ignore"):
            return {name: self._element(name, values) for name, values in points.items()}

    def _element(self, name: str, values: np.ndarray) -> np.ndarray:
        if name == "position":
            return (values - self._header.origin).astype(np.float32)
        if name == "color":
            return scene_linear(values, self._coding or Coding())
        if name == "gps_time":
            return (values - self._start).astype(np.float32)
        return values.astype(np.float32) if values.dtype.kind == "f" else values


def calibrated(source: PageSource) -> Columns:
    """Reads the root of an additive octree and corrects the spacings of all pages by that of its points: files name the
    edge of the cells that points were sorted into, of which a surface meets several side by side."""
    root, spacing = source.read(0), source.directory.spacing
    measured = median_spacing(root["position"])
    if measured > 0:
        spacing *= np.float32(measured / float(spacing[0]))
    return root


def no_elements() -> Columns:
    """Returns the elements of a page without any."""
    return {"position": np.zeros((0, 3), np.float32)}
