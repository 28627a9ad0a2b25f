"""Reads LAS 1.0 to 1.4, LAZ and COPC by laspy and lazrs: all point formats, and extra bytes.

A header is checked against the file before laspy sees it, which would allocate what it promises.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from ..columns import STANDARD, normalised
from ..reader import CHUNK, Attribute, Columns, FileReader, Header, PointFileError, origin_of
from .laz_check import check_chunks

if TYPE_CHECKING:
    from laspy import LasReader as LaspyReader

SMALLEST_HEADER = 227  # bytes of LAS 1.0's header
RECORD_HEADER, EXTENDED_HEADER = 54, 60  # bytes before a variable length record, and before one behind the points
LASZIP = 22204  # the record of LASzip
# Bytes of points that are taken at once. Decoding side by side holds chunks of LAZ whole, as large as the file says
# that they are: larger ones are decoded one by one. LASzip's own have 50,000 points, or 3 MB.
MOST_BYTES = 1 << 26
GPS_START = 1e9  # seconds that "adjusted standard" GPS time leaves out
COORDINATES = {"X", "Y", "Z"}
COLORS = ("red", "green", "blue")


class LasReader(FileReader):
    """A LAS, LAZ or COPC file."""

    def __init__(self, path: Path, threads: bool = True) -> None:
        """`threads`: chunks of LAZ are decoded side by side."""
        self._path, self.warnings = path, []
        records = _check_header(path)
        self._file = path.open("rb")
        try:
            self._las = self._opened(threads)
        except BaseException:
            self._file.close()
            raise
        header = self._las.header
        names = [str(name) for name in header.point_format.dimension_names]
        extra = set(header.point_format.extra_dimension_names)
        attributes = [Attribute("position", np.dtype(np.float64), 3, ("X", "Y", "Z"))]
        if set(COLORS) <= set(names):
            attributes.append(Attribute("color", np.dtype(np.uint16), 3, COLORS))
        taken = {"position", "color"}
        for name in names:
            if name in COORDINATES or name in COLORS:
                continue
            standard = name if name in extra else STANDARD.get(normalised(name), name) or name
            standard = f"{name}_extra" if standard in taken else standard
            taken.add(standard)
            dimension = header.point_format.dimension_by_name(name)
            dtype = np.dtype(dimension.dtype.base) if dimension.dtype is not None else np.dtype(np.uint8)
            components = dimension.num_elements if dimension.dtype is not None and dimension.dtype.shape else 1
            scaled = dimension.is_scaled
            attributes.append(Attribute(standard, np.dtype(np.float64) if scaled else dtype, components, (name,)))
        bounds = np.stack([np.array(header.mins, np.float64), np.array(header.maxs, np.float64)])
        count, warnings = header.point_count, []
        if records is not None and records < count:
            warnings.append(f"{path.name}: its header promises {count:,} points, and it has {records:,}")
        self.warnings += warnings
        self.header = Header(
            path,
            f"{'LAZ' if header.are_points_compressed else 'LAS'} {header.version}, point format "
            f"{header.point_format.id}",
            count,
            tuple(attributes),
            bounds,
            origin_of(bounds, None),
            crs=self._crs(),
            time_start=GPS_START if header.global_encoding.gps_time_type.value == 1 else 0.0,
        )

    def _opened(self, threads: bool) -> LaspyReader:
        try:
            import laspy
        except ImportError:
            raise PointFileError(self._path, "needs the library laspy, which the extension brings") from None
        one_by_one = laspy.LazBackend.Lazrs
        found = self._guarded(lambda: laspy.open(self._file, laz_backend=one_by_one, closefd=False))
        header = found.header
        if header.are_points_compressed and header.point_count:
            records = [r for r in header.vlrs if r.user_id == "laszip encoded" and r.record_id == LASZIP]
            if not records:
                raise PointFileError(self._path, "has compressed points, and no record that says how")
            start, length = header.offset_to_point_data, header.point_format.size
            points = check_chunks(self._path, self._file, start, length, self._guarded(records[0].record_data_bytes))
            self._file.seek(start)
            if threads and points * length <= MOST_BYTES:
                found.laz_backend = laspy.LazBackend.LazrsParallel  # the decoder is made when it is first asked
        return found

    def _guarded(self, read: Any) -> Any:
        """What `read` returns. Raises PointFileError for all that laspy and lazrs raise, also panics of the latter,
        which are no Exceptions."""
        try:
            return read()
        except (KeyboardInterrupt, SystemExit, GeneratorExit, MemoryError, PointFileError):
            raise
        except BaseException as error:
            what = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise PointFileError(self._path, f"cannot be read: {what}") from error

    def _crs(self) -> str:
        """WKT, else the code of EPSG, of the file's records; empty where there is none that can be read."""
        for record in self._las.header.vlrs:
            if record.user_id == "LASF_Projection" and record.record_id == 2112:
                text = getattr(record, "string", "").strip("\0 ")
                if text:
                    return text
        for record in self._las.header.vlrs:
            for key in getattr(record, "geo_keys", None) or ():
                if key.id in (3072, 2048) and 1024 <= key.value_offset < 32767:
                    return f"EPSG:{key.value_offset}"
        return ""

    def chunks(self, columns: Collection[str] | None = None, size: int = CHUNK) -> Iterator[Columns]:
        wanted = self.wanted(columns)
        self._guarded(lambda: self._las.seek(0) if self.header.count else None)
        size = max(1, min(size, MOST_BYTES // self._las.header.point_format.size))
        found = 0
        while found < self.header.count:
            count = min(size, self.header.count - found)
            points = self._guarded(partial(self._las.read_points, count))
            if len(points) == 0:
                break
            found += len(points)
            yield {attribute.name: self._column(points, attribute) for attribute in wanted}
        if found < self.header.count:
            self.warnings = [
                f"{self._path.name}: its header promises {self.header.count:,} points, and it has {found:,}"
            ]

    def chunk(self, packed: bytes, count: int, columns: Collection[str] | None = None) -> Columns:
        """Returns the `count` points of one chunk of a LAZ file, from its bytes, as `chunks` does. Threads may call it
        side by side. Raises PointFileError."""
        import laspy
        import lazrs

        header = self._las.header
        out = bytearray(count * header.point_format.size)
        [record] = [r for r in header.vlrs if r.user_id == "laszip encoded" and r.record_id == LASZIP]
        table = [(count, len(packed))]
        self._guarded(lambda: lazrs.decompress_points_with_chunk_table(packed, record.record_data_bytes(), out, table))
        raw = np.frombuffer(out, header.point_format.dtype(), count)
        points = laspy.ScaleAwarePointRecord(raw, header.point_format, header.scales, header.offsets)
        return {attribute.name: self._column(points, attribute) for attribute in self.wanted(columns)}

    def part(self, first: int, count: int, columns: Collection[str] | None = None) -> Iterator[Columns]:
        """Yields, as `chunks` does, at most `count` points from number `first` on: those that there are."""
        wanted = self.wanted(columns)
        count = max(min(count, self.header.count - first), 0)
        if count:
            self._guarded(lambda: self._las.seek(first))
        size = max(1, min(CHUNK, MOST_BYTES // self._las.header.point_format.size))
        while count > 0:
            points = self._guarded(partial(self._las.read_points, min(count, size)))
            if len(points) == 0:
                break
            count -= len(points)
            yield {attribute.name: self._column(points, attribute) for attribute in wanted}

    def _column(self, points: Any, attribute: Attribute) -> np.ndarray:
        if attribute.name == "position":
            scale, offset = self._las.header.scales, self._las.header.offsets
            raw = np.stack([points.array[axis] for axis in "XYZ"], axis=1)
            return raw * scale + offset
        if attribute.source == COLORS:
            return np.stack([np.asarray(points[name]) for name in COLORS], axis=1)
        return np.ascontiguousarray(np.asarray(points[attribute.source[0]]), attribute.dtype)

    def close(self) -> None:
        self._file.close()


def _check_header(path: Path) -> int | None:
    """Compares what a header promises with the file; returns how many points it has room for where they are not
    compressed. Raises PointFileError where laspy would be misled."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(375)
        if len(head) < SMALLEST_HEADER or head[:4] != b"LASF":
            raise PointFileError(path, "is no LAS file, for it does not begin with LASF and a header")
        header_size, start, records = struct.unpack_from("<HII", head, 94)
        point_format, length = struct.unpack_from("<BH", head, 104)
        if not SMALLEST_HEADER <= header_size <= start <= size:
            raise PointFileError(path, f"says that its points begin at byte {start:,} of {size:,}")
        if records * RECORD_HEADER > start - header_size:
            raise PointFileError(path, f"promises {records:,} records before its points, for which there is no room")
        if head[25] >= 4 and len(head) == 375:
            first, extended = struct.unpack_from("<QI", head, 235)
            _check_extended(path, file, first, extended, size)
    if point_format & 0x80:
        return None
    if length == 0:
        raise PointFileError(path, "has points of no bytes")
    return (size - start) // length


def _check_extended(path: Path, file: BinaryIO, first: int, count: int, size: int) -> None:
    """Compares the `count` records behind the points, from byte `first` of `size` on, with the file. Raises
    PointFileError."""
    if count and (first > size or EXTENDED_HEADER * count > size - first):
        raise PointFileError(path, f"promises {count:,} records behind its points, for which there is no room")
    at = first
    for _ in range(count):
        file.seek(at)
        record = file.read(EXTENDED_HEADER)
        at += EXTENDED_HEADER + (struct.unpack_from("<Q", record, 20)[0] if len(record) == EXTENDED_HEADER else size)
        if at > size:
            raise PointFileError(path, f"has a record behind its points that ends at byte {at:,} of {size:,}")
