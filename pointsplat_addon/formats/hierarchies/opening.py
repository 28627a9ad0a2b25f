"""Which files are read by pages."""

from __future__ import annotations

from pathlib import Path

from ..points.reader import PointFileError
from .copc import CopcPages, is_copc
from .ept import EptPages
from .psh import SUFFIX, PshPages
from .source import PageSource

ENDS = (SUFFIX, "ept.json", ".copc.laz", ".laz")


def open_pages(path: Path) -> PageSource:
    """Opens a scan that is read by pages: a hierarchy of PointSplat's own, the folder of Entwine's octree or its
    ept.json, or a COPC file.

    Raises PointFileError where it is damaged or none, OSError where it cannot be read.
    """
    if path.is_dir():
        path = path / "ept.json"
    name = path.name.lower()
    if name.endswith(SUFFIX):
        return PshPages(path)
    if name.endswith("ept.json"):
        return EptPages(path)
    if name.endswith(".laz") and is_copc(path):
        return CopcPages(path)
    raise PointFileError(
        path, "is read by pages only as PointSplat's own hierarchies (.psh), Entwine (ept.json) or COPC (.copc.laz)"
    )
