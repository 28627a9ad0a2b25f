"""Entwine folders as pages: each node's file is one."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..points.lidar.ept import EptReader
from ..points.reader import Columns, FileReader, PointFileError
from .octree import Octree, PointsOfPages, calibrated, no_elements

SPAN = 128  # of points along an edge of a node, where ept.json does not say
PACKED = 0.3  # bytes of a file over those of its points, until it is read: LAZ and Zstandard


class EptPages(FileReader):
    """An Entwine folder, by its ept.json. What a page's file is long is known once it was read, and a guess before."""

    def __init__(self, path: Path) -> None:
        """Raises PointFileError where the folder is damaged, OSError where it cannot be read."""
        reader = self._reader = EptReader(path)
        self.header, self.warnings = reader.header, reader.warnings
        self._names = list(reader.nodes)
        try:
            cube = np.array(reader.facts["bounds"], np.float64).reshape(2, 3)
            span = float(reader.facts.get("span", SPAN))
            size = sum(int(d["size"]) for d in reader.facts["schema"])
            side = float((cube[1] - cube[0]).max())
            if not (np.isfinite(cube).all() and side > 0 and span > 0):
                raise ValueError
        except (KeyError, TypeError, ValueError, OverflowError):
            raise PointFileError(path, "has no bounds and span") from None
        count = np.array([reader.nodes[name] for name in self._names], np.int64)
        packed = 1.0 if reader.facts.get("dataType") == "binary" else PACKED
        keys = np.array([[int(n) for n in name.split("-")] for name in self._names], np.int64).reshape(-1, 4)
        octree = Octree(keys, count, (count * size * packed).astype(np.int64), cube[0], side, side / span)
        try:
            self.directory = octree.directory(reader.header)
        except ValueError as error:
            raise PointFileError(path, f"has an octree that is none: {error}") from None
        self._order, self._points = octree.order, PointsOfPages(reader.header)
        self._root: Columns | None = None
        self._root = calibrated(self)

    def read(self, page: int) -> Columns:
        """See `PageSource`."""
        root, self._root = self._root, None
        if page == 0 and root is not None:
            return root
        if self._order[page] < 0:
            return no_elements()
        points, self.directory.nbytes[page] = self._reader.node(self._names[self._order[page]])
        return self._points.elements(points)
