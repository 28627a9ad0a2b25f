"""Reads PCD, the Point Cloud Library's format, versions .5 to .7: as text, binary, and compressed by LZF.

Organised clouds hold NaN where a camera saw nothing. Fields `rgb` and `rgba` hold bytes in the place of a number.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np

from ...core.numeric.record import record
from .columns import assemble, attributes_of
from .reader import CHUNK, Attribute, Columns, FileReader, Header, PointFileError, origin_of
from .records import Records
from .text.rows import TextRows

LONGEST_HEADER = 1 << 16  # bytes
TYPES = {
    ("F", 4): "<f4", ("F", 8): "<f8", ("U", 1): "u1", ("U", 2): "<u2", ("U", 4): "<u4", ("U", 8): "<u8",
    ("I", 1): "i1", ("I", 2): "<i2", ("I", 4): "<i4", ("I", 8): "<i8",
}  # fmt: skip
PACKED = {"rgb": 3, "rgba": 4}  # components of a number that holds b, g, r, a
COMPRESSION = 130  # the most bytes that a byte of LZF stands for, roughly: 264 of 3, 32 of 33


@record
class PcdHeader:
    """The header of a file."""

    record: np.dtype
    count: int
    data: str  # ascii, binary, binary_compressed
    size: int  # bytes of the header
    viewpoint: tuple[float, ...]  # x y z, and a quaternion w x y z


class PcdReader(FileReader):
    """A PCD file."""

    def __init__(self, path: Path) -> None:
        self._path, self.warnings = path, []
        self._pcd = header = _header(path)
        fields = [(name, header.record.fields[name][0]) for name in header.record.names or ()]  # pyright: ignore
        plain = [(name, dtype) for name, dtype in fields if name.lower() not in PACKED and dtype.shape == ()]
        attributes = list(attributes_of(plain, path))
        self._packed = next((name for name, dtype in fields if name.lower() in PACKED and dtype.itemsize == 4), "")
        if self._packed:
            components = PACKED[self._packed.lower()]
            attributes = [a for a in attributes if a.name != "color"]
            attributes.append(Attribute("color", np.dtype(np.uint8), components))
        attributes += [
            Attribute(name, dtype.base, dtype.shape[0], (name,)) for name, dtype in fields if len(dtype.shape) == 1
        ]
        if header.data == "ascii":
            width = sum(int(np.prod(dtype.shape, dtype=np.int64)) for _, dtype in fields)
            self._rows = TextRows(path, header.size, 0, header.count, width)
        elif header.data == "binary":
            self._records = Records(path, header.record, header.size, header.count)
        title = f"PCD, {header.data.replace('_', ' ')}"
        pose = np.array(header.viewpoint)
        known = len(pose) == 7 and np.isfinite(pose).all() and bool(pose.any()) and tuple(pose[:3]) != (0, 0, 0)
        stations = pose[None, :3] if known else np.empty((0, 3))
        self.header = Header(path, title, header.count, tuple(attributes), stations=stations)
        first = next(self.chunks((), 1 << 16), {"position": np.empty((0, 3))})["position"]
        self.header = Header(
            path, title, header.count, tuple(attributes), origin=origin_of(None, first), stations=stations
        )

    def chunks(self, columns: Collection[str] | None = None, size: int = CHUNK) -> Iterator[Columns]:
        wanted = self.wanted(columns)
        for records in self._chunks_of_records(size):
            found = assemble(records, [attribute for attribute in wanted if attribute.source])
            if self._packed and any(attribute.name == "color" for attribute in wanted):
                components = PACKED[self._packed.lower()]
                words = np.ascontiguousarray(records[self._packed])
                found["color"] = words.view(np.uint8).reshape(-1, 4)[:, [2, 1, 0, 3][:components]].copy()
            yield found

    def _chunks_of_records(self, size: int) -> Iterator[np.ndarray]:
        header = self._pcd
        if header.data == "ascii":
            for rows in self._rows.chunks(size):
                yield _from_text(rows, header.record)
            return
        if header.data == "binary":
            yield from self._records.chunks(size)
            return
        records = self._decompressed()
        for first in range(0, len(records), size):
            yield records[first : first + size]

    def _decompressed(self) -> np.ndarray:
        """Records out of LZF, which holds each field of all points on its own."""
        header, path = self._pcd, self._path
        try:
            import lzf
        except ImportError:
            raise PointFileError(path, "needs the library python-neo-lzf, which the extension brings") from None
        with path.open("rb") as file:
            file.seek(header.size)
            sizes = file.read(8)
            packed, unpacked = struct.unpack("<II", sizes) if len(sizes) == 8 else (0, 0)
            there = path.stat().st_size - header.size - 8
            wanted = header.count * header.record.itemsize
            if packed > there or unpacked < wanted or unpacked > COMPRESSION * packed + 64:
                raise PointFileError(path, f"promises {packed:,} bytes that hold {unpacked:,}, and has {there:,}")
            data = file.read(packed)
        try:
            bytes_of_fields = lzf.decompress(data, unpacked) if packed else b""
        except ValueError:
            bytes_of_fields = None
        if bytes_of_fields is None or len(bytes_of_fields) != unpacked:
            raise PointFileError(path, f"is damaged after byte {header.size + 8:,}: its LZF data cannot be unpacked")
        records = np.empty(header.count, header.record)
        start = 0
        for name in header.record.names or ():
            dtype = header.record[name]
            count = header.count * int(np.prod(dtype.shape, dtype=np.int64))
            values = np.frombuffer(bytes_of_fields, dtype.base, count, start)
            records[name] = values.reshape(header.count, *dtype.shape)
            start += values.nbytes
        return records


def _from_text(rows: np.ndarray, record: np.dtype) -> np.ndarray:
    """Records of rows (N, C) of numbers."""
    records = np.empty(len(rows), record)
    column = 0
    for name in record.names or ():
        dtype = record[name]
        count = int(np.prod(dtype.shape, dtype=np.int64))
        values = rows[:, column : column + count].reshape(len(rows), *dtype.shape)
        # A colour's bytes are written as the number that they are, in words of either kind.
        packed = (
            name.lower() in PACKED
            and dtype.kind == "f"
            and bool((values == np.trunc(values)).all() & (values > 1).any())
        )
        with np.errstate(over="ignore", invalid="ignore"):
            records[name] = values.astype(np.uint32).view(np.float32) if packed else values.astype(dtype.base)
        column += count
    return records


def _header(path: Path) -> PcdHeader:
    """Reads a header. Raises PointFileError where it is none."""
    with path.open("rb") as file:
        text = file.read(LONGEST_HEADER)
    words: dict[str, list[str]] = {}
    start = 0
    while "DATA" not in words:
        stop = text.find(b"\n", start)
        if stop < 0:
            raise PointFileError(path, "is no PCD file, for it has no header that ends with DATA")
        line = text[start:stop].decode("utf-8", "replace").split("#")[0].split()
        start = stop + 1
        if line:
            words[line[0].upper()] = line[1:]
    names = words.get("FIELDS", words.get("COLUMNS", []))
    try:
        sizes = [int(word) for word in words["SIZE"]]
        counts = [int(word) for word in words.get("COUNT", ["1"] * len(names))]
        types = [TYPES[key] for key in zip(words["TYPE"], sizes, strict=True)]
        width, height = (int((words.get(key) or ["1"])[0]) for key in ("WIDTH", "HEIGHT"))
        count = int(words["POINTS"][0]) if words.get("POINTS") else width * height
        viewpoint = tuple(float(word) for word in words.get("VIEWPOINT", []))
        # Fields named _ are padding.
        distinct = [f"_{i}" if name == "_" else name for i, name in enumerate(names)]
        if min(counts, default=0) < 1 or max(counts) > 1 << 16 or count < 0 or count > 1 << 40:
            raise ValueError
        shapes = [() if n == 1 else (n,) for n in counts]
        record = np.dtype(list(zip(distinct, types, shapes, strict=True)))
    except (KeyError, ValueError, IndexError):
        raise PointFileError(path, "has a header whose SIZE, TYPE, COUNT and POINTS do not belong together") from None
    data = words["DATA"][0].lower() if words["DATA"] else ""
    if data not in ("ascii", "binary", "binary_compressed"):
        raise PointFileError(path, f'has data of the kind "{data}", expected ascii, binary or binary_compressed')
    if math.prod((count, record.itemsize)) > 1 << 62:
        raise PointFileError(path, f"promises {count:,} points")
    return PcdHeader(record, count, data, start, viewpoint)
