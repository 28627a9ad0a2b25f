"""What every scan offers that is read by pages: a directory, small enough to be kept, and pages, read one by one."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ...core.numeric.record import record
from ..points.reader import Columns, OpenFile

LARGEST = 1e15  # coordinate, edge or length: squares of float32 stay finite


@record
class Directory:
    """The pages of a scan, breadth first: parents come before their children, the root is page 0.

    Lengths are in the file's unit and relative to `origin`.
    """

    parent: np.ndarray  # (P,) int32, -1 for the root
    level: np.ndarray  # (P,) int32, 0 for the root
    bounds: np.ndarray  # (P, 2, 3) float64, low and high corner of all that the page and those below it hold
    spacing: np.ndarray  # (P,) float32, typical distance between neighbours of the page's elements
    count: np.ndarray  # (P,) int64 elements
    nbytes: np.ndarray  # (P,) int64 bytes in the file
    points: int  # of the whole scan
    origin: np.ndarray  # (3,) float64 map coordinate
    crs: str = ""  # coordinate reference system, as in `points.reader.Header`
    cube: np.ndarray | None = None  # (P, 4) float64, low corner and edge of the pages' cubes; None: they have none
    additive: bool = False  # children add points to those of their parent (Entwine, COPC); else they stand in for it

    def __len__(self) -> int:
        return len(self.parent)


class PageSource(OpenFile, Protocol):
    """An open scan whose pages are read in any order, by any thread."""

    directory: Directory

    def read(self, page: int) -> Columns:
        """The elements of one page: `position` (N, 3) float32 relative to the directory's origin, and those of the
        following that the scan has: `color` (N, 3) float32 scene-linear; `normal`, `axis` (N, 3) and `radii` (N, 3)
        float32, the half-axes of the kernel; `covered` (N,) float32, the fraction of the kernel's area that is filled;
        further attributes of points by the names in `points.columns`.

        Raises PointFileError where the page is damaged (its checksum is wrong) or cannot be read.
        """
        ...
