"""Unpacks data whose size is known, by as much as there is: a false size takes no memory that the file cannot fill."""

from __future__ import annotations

import zlib
from pathlib import Path

from ..points.reader import PointFileError

PIECE = 1 << 20  # bytes
DEFLATE_RATIO = 1032  # bytes that one of deflate's makes at most
ZSTD_RATIO = 1 << 15  # of zstd's, by blocks of 128 KB that repeat one byte in four


def gunzip(path: Path, data: memoryview, wanted: int) -> bytearray:
    """Returns up to `wanted` bytes of gzip's data. Raises PointFileError where they are damaged."""
    unpack = zlib.decompressobj(wbits=31)
    found = bytearray()
    at = 0
    try:
        while len(found) < wanted and not unpack.eof:
            piece = unpack.unconsumed_tail or data[at : at + PIECE]
            if not unpack.unconsumed_tail:
                at += len(piece)
            if not piece:
                break
            found += unpack.decompress(piece, min(PIECE, wanted - len(found)))
    except zlib.error as error:
        raise PointFileError(path, f"is damaged before byte {at:,}: {error}") from None
    return found


def unzstd(path: Path, data: memoryview, wanted: int, what: str) -> bytearray:
    """Returns `wanted` bytes of zstd's data. Raises PointFileError where there are fewer, or they are damaged."""
    try:
        import zstandard
    except ImportError:
        raise PointFileError(path, "needs the Python package zstandard, which comes with Blender") from None
    found = bytearray()
    if wanted > ZSTD_RATIO * (len(data) + 1):
        raise PointFileError(path, f"promises {wanted:,} bytes of {what} in {len(data):,}")
    try:
        with zstandard.ZstdDecompressor().stream_reader(data) as stream:
            while len(found) < wanted and (piece := stream.read(min(PIECE, wanted - len(found)))):
                found += piece
    except (zstandard.ZstdError, MemoryError) as error:
        raise PointFileError(path, f"is damaged in its {what}: {error}") from None
    if len(found) < wanted:
        raise PointFileError(path, f"has {len(found):,} bytes of {what}, expected {wanted:,}")
    return found
