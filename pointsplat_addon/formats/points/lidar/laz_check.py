"""Compares what a LAZ file says of its chunks with the file, before a decoder allocates memory for that.

LASzip (Isenburg 2013): points are packed in chunks; a table at the end tells how many bytes and points each has. Chunks
of point formats 6 and above begin with a raw point and the sizes of their layers.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO

from ..reader import PointFileError

HEAD = struct.Struct("<HHBBHIIqqH")  # of LASzip's record: compressor, coder, version, options, chunk size, ..., items
ITEM = struct.Struct("<HHH")  # type, size, version
LAYERED = 3  # the compressor whose chunks have layers
LEAST_CHUNK = 8  # bytes of a chunk, and more
# Layers by the type of item; extra bytes (type 14) have one for each byte.
LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
EXTRA_BYTES = 14


def check_chunks(path: Path, file: BinaryIO, start: int, length: int, record: bytes) -> list[tuple[int, int]]:
    """Returns points and bytes of all chunks, as the file says; the last may have fewer points. Raises
    PointFileError where LASzip's record, the table or a chunk does not fit the file.

    file: the LAZ file; its position is lost. start: bytes before its points. length: bytes of a point. record: LASzip's
    own, of the user id "laszip encoded".
    """
    size = path.stat().st_size
    items = _items(path, record)
    if sum(width for _, width in items) != length:
        raise PointFileError(path, f"has points of {length} bytes, which its compression takes for others")
    compressor = record[0] + 256 * record[1]
    file.seek(start)
    place = file.read(8)
    if len(place) < 8:
        raise PointFileError(path, "ends before its points")
    [table] = struct.unpack("<q", place)
    if table == -1:  # a writer that could not go back: the place stands at the end
        file.seek(size - 8)
        [table] = struct.unpack("<q", file.read(8))
    if not start + 8 <= table <= size - 8:
        raise PointFileError(path, f"says that the table of its chunks is at byte {table:,} of {size:,}")
    file.seek(table)
    _, chunks = struct.unpack("<II", file.read(8))
    if chunks * LEAST_CHUNK > table - start:
        raise PointFileError(path, f"promises {chunks:,} chunks, for which there is no room")
    found = _table(path, file, start, record)
    at = start + 8
    for _, count in found:
        if count < 0 or at + count > table:
            raise PointFileError(path, f"has a chunk of {count:,} bytes at byte {at:,}, beyond the last at {table:,}")
        if compressor == LAYERED and count:
            _check_layers(path, file, at, count, items)
        at += count
    return found


def _items(path: Path, record: bytes) -> list[tuple[int, int]]:
    """Types and sizes of the items of a point."""
    if len(record) < HEAD.size:
        raise PointFileError(path, "has a record of its compression that is too short")
    *_, count = HEAD.unpack_from(record)
    if HEAD.size + count * ITEM.size > len(record):
        raise PointFileError(path, f"promises {count:,} items of a point, for which there is no room")
    return [ITEM.unpack_from(record, HEAD.size + i * ITEM.size)[:2] for i in range(count)]


def _table(path: Path, file: BinaryIO, start: int, record: bytes) -> list[tuple[int, int]]:
    """Points and bytes of all chunks."""
    import lazrs

    file.seek(start)
    try:
        return lazrs.read_chunk_table(file, lazrs.LazVlr(record)) or []
    except (KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # lazrs panics with what is no Exception
        raise PointFileError(path, f"has a table of chunks that cannot be read: {error}") from None


def _check_layers(path: Path, file: BinaryIO, at: int, count: int, items: list[tuple[int, int]]) -> None:
    layers = sum(width if kind == EXTRA_BYTES else LAYERS.get(kind, 0) for kind, width in items)
    first = sum(width for _, width in items)
    file.seek(at + first)
    head = file.read(4 + 4 * layers)
    if len(head) < 4 + 4 * layers or first + len(head) > count:
        raise PointFileError(path, f"has a chunk at byte {at:,} that ends before its layers")
    sizes = struct.unpack(f"<{layers + 1}I", head)[1:]
    if first + len(head) + sum(sizes) > count:
        raise PointFileError(path, f"has layers of {sum(sizes):,} bytes in a chunk of {count:,} at byte {at:,}")
