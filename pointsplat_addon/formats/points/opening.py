"""Which reader opens which file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from .reader import PointFileError, Reader


def _las(path: Path) -> Reader:
    from .lidar.las import LasReader

    return LasReader(path)


def _ply(path: Path) -> Reader:
    from .ply import PlyReader

    return PlyReader(path)


def _pcd(path: Path) -> Reader:
    from .pcd import PcdReader

    return PcdReader(path)


def _e57(path: Path) -> Reader:
    from .e57.scans import E57Reader

    return E57Reader(path)


def _ptx(path: Path) -> Reader:
    from .text.ptx import PtxReader

    return PtxReader(path)


def _text(path: Path) -> Reader:
    from .text.table import TextReader

    return TextReader(path)


def _ept(path: Path) -> Reader:
    from .lidar.ept import EptReader

    return EptReader(path)


def _potree(path: Path) -> Reader:
    from .lidar.potree import PotreeReader

    return PotreeReader(path)


# By how names end; longer ends come first.
FORMATS: dict[str, Callable[[Path], Reader]] = {
    "ept.json": _ept,
    "cloud.js": _potree,
    ".las": _las,
    ".laz": _las,
    ".e57": _e57,
    ".ply": _ply,
    ".pcd": _pcd,
    ".ptx": _ptx,
    ".pts": _text,
    ".xyz": _text,
    ".txt": _text,
    ".asc": _text,
    ".csv": _text,
}
FOLDERS = "ept.json", "cloud.js"  # files that stand for the folder they lie in


def open_points(path: Path) -> Reader:
    """Opens a scan: a file, or the folder of an Entwine or Potree octree.

    Raises PointFileError where it is damaged or none, OSError where it cannot be read.
    """
    if path.is_dir():
        path = next((path / name for name in FOLDERS if (path / name).exists()), path)
    for end, reader in FORMATS.items():
        if path.name.lower().endswith(end):
            return reader(path)
    raise PointFileError(path, f"is none of {', '.join(FORMATS)}")
