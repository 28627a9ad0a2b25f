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

from ....core.numeric.vectors import each_block
from ..columns import STANDARD, normalised
from ..reader import CHUNK, Attribute, Columns, FileReader, Header, PointFileError, origin_of
from .laz_check import check_chunks
from .laz_chunks import Chunk, batches, side_by_side

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
PLACE = 8  # bytes of the place of the table of chunks, before the first of them
# Layers of LAZ by the names of laspy; what is not here stands in the layer of x and y, which is always decoded.
LAYER_OF = {
    "intensity": "INTENSITY", "classification": "CLASSIFICATION", "scan_angle": "SCAN_ANGLE", "user_data": "USER_DATA",
    "point_source_id": "POINT_SOURCE_ID", "gps_time": "GPS_TIME", "nir": "NIR", **dict.fromkeys(COLORS, "RGB"),
    **dict.fromkeys(("synthetic", "key_point", "withheld", "overlap"), "FLAGS"),
    **dict.fromkeys(("scan_direction_flag", "edge_of_flight_line"), "FLAGS"),
    **dict.fromkeys(("wavepacket_index", "wavepacket_offset", "wavepacket_size"), "WAVEPACKET"),
    **dict.fromkeys(("return_point_wave_location", "x_t", "y_t", "z_t"), "WAVEPACKET"),
}  # fmt: skip


class LasReader(FileReader):
    """A LAS, LAZ or COPC file."""

    def __init__(self, path: Path, threads: bool = True) -> None:
        """`threads`: chunks of LAZ are decoded side by side."""
        self._path, self.warnings = path, []
        self._packed, self._batches = (
            [],
            False,
        )  # chunks of LAZ (points, bytes), and whether batches of them are decoded
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
            record = self._guarded(records[0].record_data_bytes)
            self._packed = check_chunks(self._path, self._file, start, length, record)
            self._file.seek(start)
            self._batches = threads and side_by_side(self._packed, length, MOST_BYTES)
            if self._batches:
                found.laz_backend = laspy.LazBackend.LazrsParallel  # the decoder is made when it is first asked
        return found

    def _guarded(self, read: Any, place: str = "") -> Any:
        """What `read` returns. Raises PointFileError for all that laspy and lazrs raise, also panics of the latter,
        which are no Exceptions; `place`: where in the file."""
        try:
            return read()
        except (KeyboardInterrupt, SystemExit, GeneratorExit, MemoryError, PointFileError):
            raise
        except BaseException as error:
            what = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise PointFileError(self._path, f"cannot be read{place}: {what}") from error

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
        length = self._las.header.point_format.size
        size = max(1, min(size, MOST_BYTES // length))
        found = 0
        for points in self._side_by_side(wanted) if self._batches else self._one_by_one(wanted, size):
            count = len(points["position"])
            found += count
            for first in range(0, count, size):
                yield points if count <= size else {name: a[first : first + size] for name, a in points.items()}
        if found < self.header.count:
            self.warnings = [
                f"{self._path.name}: its header promises {self.header.count:,} points, and it has {found:,}"
            ]

    def _one_by_one(self, wanted: list[Attribute], size: int) -> Iterator[Columns]:
        """Columns of all points in order, at most `size` at a time."""
        self._guarded(lambda: self._las.seek(0) if self.header.count else None)
        left = self.header.count
        while left > 0:
            points = self._guarded(partial(self._las.read_points, min(size, left)))
            if len(points) == 0:
                return
            left -= len(points)
            yield {attribute.name: self._column(points, attribute) for attribute in wanted}

    def _side_by_side(self, wanted: list[Attribute]) -> Iterator[Columns]:
        """Columns of batches of chunks of LAZ in order."""
        header, selection, before = self._las.header, self._selection(wanted), 0
        self._file.seek(header.offset_to_point_data + PLACE)
        for table in batches(self._packed, self.header.count, header.point_format.size, MOST_BYTES):
            packed = self._file.read(sum(size for _, size in table))
            try:
                found = self._unpacked(packed, table, wanted, selection, f" from point {before:,} on")
            except PointFileError:
                # Once more, one by one: those before the one that cannot be read, and then where it is.
                for count, size in table:
                    part, packed = packed[:size], packed[size:]
                    yield self._unpacked(part, [(count, size)], wanted, selection, f" from point {before:,} on")
                    before += count
            else:
                yield found
                before += sum(count for count, _ in table)

    def chunk(self, packed: bytes, count: int, columns: Collection[str] | None = None) -> Columns:
        """Returns the `count` points of one chunk of a LAZ file, from its bytes, as `chunks` does. Raises
        PointFileError."""
        return self._unpacked(packed, [(count, len(packed))], self.wanted(columns), None, "")

    def _unpacked(
        self, packed: bytes, table: list[Chunk], wanted: list[Attribute], selection: Any, place: str
    ) -> Columns:
        """The columns of the chunks of a table; `selection`: what lazrs is to decode, None: all; `place`: of the
        chunks, for messages."""
        import laspy
        import lazrs

        header, count = self._las.header, sum(count for count, _ in table)
        out = bytearray(count * header.point_format.size)
        [record] = [r for r in header.vlrs if r.user_id == "laszip encoded" and r.record_id == LASZIP]
        vlr = record.record_data_bytes()
        self._guarded(lambda: lazrs.decompress_points_with_chunk_table(packed, vlr, out, table, selection), place)
        raw = np.frombuffer(out, header.point_format.dtype(), count)
        points = laspy.ScaleAwarePointRecord(raw, header.point_format, header.scales, header.offsets)
        found = {one.name: np.empty((count, *_shape(one)), one.dtype) for one in wanted}

        def fill(block: slice) -> None:
            part = points[block]
            for attribute in wanted:
                found[attribute.name][block] = self._column(part, attribute)

        each_block(count, fill)
        return found

    def _selection(self, wanted: list[Attribute]) -> Any:
        """What lazrs is to decode of layered points: what is wanted. Of others it decodes all."""
        import lazrs

        flag = lazrs.SELECTIVE_DECOMPRESS_XY_RETURNS_CHANNEL | lazrs.SELECTIVE_DECOMPRESS_Z
        extra = set(self._las.header.point_format.extra_dimension_names)
        for name in (name for attribute in wanted for name in attribute.source):
            layer = "ALL_EXTRA_BYTES" if name in extra else LAYER_OF.get(name)
            flag |= getattr(lazrs, f"SELECTIVE_DECOMPRESS_{layer}") if layer else 0
        return lazrs.DecompressionSelection(flag)

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
            with np.errstate(all="ignore"):  # a header that is damaged may scale by anything
                return raw * scale + offset
        if attribute.source == COLORS:
            return np.stack([np.asarray(points[name]) for name in COLORS], axis=1)
        return np.ascontiguousarray(np.asarray(points[attribute.source[0]]), attribute.dtype)

    def close(self) -> None:
        self._file.close()


def _shape(attribute: Attribute) -> tuple[int, ...]:
    """The shape of one point's value in a column: () for scalars."""
    return (attribute.components,) if attribute.components > 1 else ()


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
