"""The records of an E57 file's compressed vectors: packets of byte streams, one for each field.

A stream holds floats or packed integers.

Integers take as many bits as their range needs, the lowest first, without gaps between them or between packets.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ....core.numeric.record import value_record
from ..reader import PointFileError
from .pages import Pages

SECTION_HEADER, PACKET_HEADER = 32, 4  # bytes
DATA = 1  # the type of a packet that holds records
MOST_GATHERED = 56  # bits that eight bytes hold wherever they begin within a byte


@value_record
class Field:
    """A field of a record's prototype."""

    name: str
    dtype: np.dtype | None  # None: an integer
    least: int = 0  # of an integer
    bits: int = 0  # of an integer
    scale: float | None = None  # of a scaled integer
    offset: float = 0.0

    @property
    def value_type(self) -> np.dtype:
        """What values become: integers whole, scaled ones float64."""
        if self.dtype is not None:
            return self.dtype.newbyteorder("=")
        if self.scale is not None:
            return np.dtype(np.float64)
        small = [t for t in (np.uint8, np.uint16, np.int32) if self._fits(t)]
        return np.dtype(small[0] if small else np.int64)

    def _fits(self, dtype: type) -> bool:
        return np.iinfo(dtype).min <= self.least and self.least + (1 << self.bits) - 1 <= np.iinfo(dtype).max

    @property
    def width(self) -> int:
        """Bits of a value."""
        return self.bits if self.dtype is None else 8 * self.dtype.itemsize


class Stream:
    """The bytes of one field that are not decoded yet."""

    def __init__(self, field: Field) -> None:
        self.field = field
        self._parts: list[bytes] = []
        self._bits = 0  # of the first byte that are decoded already
        self._size = 0  # bytes

    def add(self, data: bytes) -> None:
        self._parts.append(data)
        self._size += len(data)

    @property
    def available(self) -> int | None:
        """Values that are complete; None: any number."""
        return None if self.field.width == 0 else (8 * self._size - self._bits) // self.field.width

    def take(self, count: int) -> np.ndarray:
        """Returns the next values (N,)."""
        field = self.field
        if field.width == 0:
            return self._scaled(np.zeros(count, np.int64))
        data = b"".join(self._parts)
        end = self._bits + count * field.width
        if field.dtype is not None:
            values = np.frombuffer(data, field.dtype, count, 0).astype(field.value_type)
        else:
            values = self._scaled(unpacked(data, self._bits, field.bits, count))
        self._parts, self._size, self._bits = [data[end // 8 :]], len(data) - end // 8, end % 8
        return values

    def _scaled(self, values: np.ndarray) -> np.ndarray:
        field = self.field
        if field.scale is not None:
            return (values.astype(np.float64) + float(field.least)) * field.scale + field.offset
        return (values + np.int64(field.least)).astype(field.value_type)


def unpacked(data: bytes, first: int, bits: int, count: int) -> np.ndarray:
    """Returns `count` integers (N,) int64 of so many bits each, the lowest first, from bit `first` of the data on."""
    padded = np.frombuffer(data + bytes(8), np.uint8)
    places = first + bits * np.arange(count, dtype=np.int64)
    words = np.lib.stride_tricks.as_strided(padded[:8].view("<u8"), (len(padded) - 7,), (1,))
    byte, shift = places >> 3, (places & 7).astype(np.uint64)
    values = words[byte] >> shift
    if bits > MOST_GATHERED:
        above = padded[np.minimum(byte + 8, len(padded) - 1)].astype(np.uint64)
        values |= np.where(shift > 0, above << (np.uint64(64) - shift) % np.uint64(64), np.uint64(0))
    mask = np.uint64((1 << bits) - 1)
    return (values & mask).view(np.int64)


def records(
    pages: Pages, path: Path, place: int, count: int, fields: list[Field], size: int
) -> Iterator[dict[str, np.ndarray]]:
    """Yields the records of a compressed vector, at most `size` at a time: values (N,) by field.

    `place`: of its section, among the bytes without checksums. Raises PointFileError where the file is damaged.
    """
    if count == 0:
        return
    head = pages.read(place, SECTION_HEADER)
    length, data = (int(n) for n in np.frombuffer(head, "<u8")[1:3])
    if head[0] != DATA or length > pages.size - place:
        raise PointFileError(path, f"has no points at byte {place:,}, where its text says that they are")
    at, end, found = pages.logical(data), place + length, 0
    streams = [Stream(field) for field in fields]
    while found < count:
        available = min((s.available for s in streams if s.available is not None), default=count - found)
        wanted = min(size, count - found)
        if available >= wanted:
            yield {stream.field.name: stream.take(wanted) for stream in streams}
            found += wanted
            continue
        if at + PACKET_HEADER > end:
            if available:
                yield {stream.field.name: stream.take(available) for stream in streams}
            raise PointFileError(path, f"promises {count:,} points and ends after {found + available:,}")
        kind, _, low, high = pages.read(at, PACKET_HEADER)
        packet = low + 256 * high + 1
        if kind == DATA:
            _add_packet(pages.read(at, packet), streams, path, at)
        at += packet


def _add_packet(packet: bytes, streams: list[Stream], path: Path, place: int) -> None:
    count = int.from_bytes(packet[4:6], "little")
    start = 6 + 2 * count
    if count != len(streams) or start > len(packet):
        raise PointFileError(path, f"has a packet of {count} fields at byte {place:,}, expected {len(streams)}")
    lengths = np.frombuffer(packet, "<u2", count, 6).tolist()
    if start + sum(lengths) > len(packet):
        raise PointFileError(path, f"has a packet at byte {place:,} that is shorter than its fields")
    for stream, length in zip(streams, lengths, strict=True):
        stream.add(packet[start : start + length])
        start += length
