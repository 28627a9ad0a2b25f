"""PointSplat's own hierarchies on disk, `.psh`: pages of an octree of a scan, each with a checksum.

A file holds, little-endian: HEAD (magic, version, where the directory begins, its length, bytes of the file, CRC-32 of
the directory and of the head before it), the pages, and the directory: the length of a text (uint32), the text (JSON:
points, origin, reference system, layout), and one PAGE for each page, breadth first. Pages are coded as `pages` says.
Nothing is allocated before the claimed sizes agree with the file's.
"""

from __future__ import annotations

import json
import struct
import threading
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from ..points.reader import Columns, FileReader, PointFileError
from .pages import Grid, Layout, unpack
from .source import LARGEST, Directory

MAGIC = b"PSPLATH\n"
VERSION = 1
HEAD = struct.Struct("<8sI4xQQQII")
SUFFIX = ".psh"
LEAF, WIDE = 1, 2  # flags
MOST_ELEMENTS = 1 << 24  # of a page
PAGE = np.dtype([
    ("offset", "<u8"), ("bounds", "<f8", (2, 3)), ("low", "<f8", 3), ("step", "<f8", 3), ("cube", "<f8", 4),
    ("parent", "<i4"), ("level", "<i4"), ("count", "<u4"), ("nbytes", "<u4"), ("crc", "<u4"), ("flags", "<u4"),
    ("spacing", "<f4"), ("longest", "<f4"),
])  # fmt: skip


def pack_directory(facts: dict[str, Any], pages: np.ndarray) -> bytes:
    """The bytes of a directory of pages (P,) PAGE."""
    text = json.dumps(facts).encode()
    return struct.pack("<I", len(text)) + text + np.ascontiguousarray(pages, PAGE).tobytes()


def pack_head(directory: bytes, offset: int) -> bytes:
    """The bytes before the pages, of a file whose directory begins at `offset`."""
    fixed = HEAD.pack(MAGIC, VERSION, offset, len(directory), offset + len(directory), zlib.crc32(directory), 0)[:-4]
    return fixed + struct.pack("<I", zlib.crc32(fixed))


class PshPages(FileReader):
    """An open `.psh` file, whose pages any thread may read."""

    def __init__(self, path: Path) -> None:
        """Raises PointFileError where the file is damaged or of another kind, OSError where it cannot be read."""
        self._path, self._lock = path, threading.Lock()
        self._file = path.open("rb")
        try:
            self.layout, self.directory, self._pages = self._open()
        except BaseException:
            self._file.close()
            raise

    def _open(self) -> tuple[Layout, Directory, np.ndarray]:
        size = self._path.stat().st_size
        head = self._file.read(HEAD.size)
        if len(head) < HEAD.size or head[:8] != MAGIC:
            raise PointFileError(self._path, "is no hierarchy of PointSplat")
        _, version, offset, length, whole, crc, own = HEAD.unpack(head)
        if version != VERSION:
            raise PointFileError(self._path, f"has version {version}, and this is read: {VERSION}")
        if own != zlib.crc32(head[:-4]):
            raise PointFileError(self._path, "is damaged: the checksum of its head is wrong")
        if whole != size or offset + length != size:
            raise PointFileError(self._path, f"has {size:,} bytes, and says {whole:,}")
        self._file.seek(offset)
        content = self._file.read(length)
        if zlib.crc32(content) != crc:
            raise PointFileError(self._path, "is damaged: the checksum of its directory is wrong")
        try:
            return parse_directory(content, offset)
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
            raise PointFileError(self._path, f"has a directory that cannot be read: {error}") from None

    def read(self, page: int) -> Columns:
        """The elements of a page, see `PageSource`. Nodes of scans with normals also have `coherence` (N,) float32: the
        length of the mean of the unit normals below them."""
        entry = self._pages[page]
        with self._lock:
            self._file.seek(int(entry["offset"]))
            data = self._file.read(int(entry["nbytes"]))
        if len(data) != int(entry["nbytes"]) or zlib.crc32(data) != int(entry["crc"]):
            raise PointFileError(self._path, f"page {page} is damaged: its checksum is wrong")
        flags = int(entry["flags"])
        grid = Grid(tuple(entry["low"].tolist()), tuple(entry["step"].tolist()), bool(flags & WIDE))
        leaf, longest = bool(flags & LEAF), float(entry["longest"])
        return unpack(data, int(entry["count"]), self.layout, leaf, grid, longest, self.directory.origin)

    def close(self) -> None:
        self._file.close()


def parse_directory(content: bytes, end: int) -> tuple[Layout, Directory, np.ndarray]:
    """The layout, the directory and the entries (P,) PAGE of a directory's bytes; pages lie before byte `end`.

    Raises ValueError, KeyError, TypeError, OverflowError or RecursionError for what `pack_directory` would not have
    written.
    """
    [length] = struct.unpack_from("<I", content.ljust(4, b"\0"))
    rest = len(content) - 4 - length
    if rest < PAGE.itemsize or rest % PAGE.itemsize:
        raise ValueError("it holds no whole pages")
    facts = json.loads(content[4 : 4 + length])
    attributes = tuple((str(name), str(kind)) for name, kind in facts["attributes"])
    layout = Layout(facts["color"] is True, facts["normal"] is True, attributes)
    pages = np.frombuffer(content, PAGE, rest // PAGE.itemsize, 4 + length)
    _check(layout, pages, end)
    origin = np.array(facts["origin"], np.float64)
    points, crs = facts["points"], facts["crs"]
    if origin.shape != (3,) or not (np.abs(origin) < LARGEST).all():
        raise ValueError("impossible origin")
    if type(points) is not int or points != int(pages["count"][(pages["flags"] & LEAF) > 0].sum()):
        raise ValueError(f"its leaves do not hold {points} points")
    if not isinstance(crs, str):
        raise ValueError("impossible reference system")
    directory = Directory(
        parent=pages["parent"].astype(np.int32),
        level=pages["level"].astype(np.int32),
        bounds=pages["bounds"] - origin,
        spacing=pages["spacing"].astype(np.float32),
        count=pages["count"].astype(np.int64),
        nbytes=pages["nbytes"].astype(np.int64),
        points=points,
        origin=origin,
        crs=crs,
        cube=pages["cube"] - np.append(origin, 0.0),
    )
    return layout, directory, pages


def _check(layout: Layout, pages: np.ndarray, end: int) -> None:
    """Raises ValueError where entries make no tree, breadth first, or promise what they have no bytes for."""
    count = len(pages)
    for name in ("bounds", "low", "step", "cube", "spacing", "longest"):
        if not (np.abs(pages[name]) < LARGEST).all():
            raise ValueError(f"impossible {name}")
    parent, level, flags = pages["parent"].astype(np.int64), pages["level"], pages["flags"]
    rows = np.arange(count)
    if parent[0] != -1 or level[0] != 0 or (parent[1:] < 0).any() or (parent[1:] >= rows[1:]).any():
        raise ValueError("its pages are no tree")
    if (parent[1:-1] > parent[2:]).any() or (level[1:] != level[parent[1:]] + 1).any():
        raise ValueError("its pages are not breadth first")
    inner = np.zeros(count, bool)
    inner[parent[1:]] = True
    if (((flags & LEAF) > 0) == inner).any():
        raise ValueError("points lie above nodes")
    if (pages["step"] < 0).any() or (pages["spacing"] < 0).any() or (pages["cube"][:, 3] < 0).any():
        raise ValueError("negative lengths")
    if (pages["count"] > MOST_ELEMENTS).any() or (pages["count"] == 0).any():
        raise ValueError("pages of impossibly many elements")
    sizes = np.zeros(4, np.int64)
    for kind in range(4):
        sizes[kind] = layout.nbytes(bool(kind & LEAF), bool(kind & WIDE))
    if (flags > 3).any() or (sizes[flags] * pages["count"] != pages["nbytes"]).any():
        raise ValueError("pages of another size than their elements")
    offset = pages["offset"]
    if (offset < HEAD.size).any() or (offset > end).any() or (pages["nbytes"] > end - offset).any():
        raise ValueError("pages outside of the file")
