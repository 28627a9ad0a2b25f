"""Reads SPZ, Niantic's format of bytes, versions 1 to 4 (github.com/nianticlabs/spz).

Attributes follow one another: positions, opacities, colours, scales, rotations, spherical harmonics. Up to version 3
all are one gzip stream behind a header of 16 bytes; since version 4 each is a zstd stream of its own, whose sizes stand
in a table. Axes are right, up, back, unless an extension names others.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...core.scene.captured import COEFFICIENTS
from ..points.reader import PointFileError
from .axes import Y_UP
from .inflate import DEFLATE_RATIO, gunzip, unzstd
from .quaternions import smallest_three
from .reader import BlockReader, Decoded, SplatHeader

MAGIC = b"NGSP"
HEADER = struct.Struct("<4sIIBBBB")  # magic, version, splats, degree, bits of fractions, flags, streams
LONG_HEADER = 32  # bytes since version 4
GZIP = b"\x1f\x8b"
ANTIALIASED, EXTENDED = 1, 2  # flags
COORDINATES = 0xADBE0003  # an extension's type
SYSTEMS = ("", "LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF",
           "LFD", "RFD", "LFU", "RFU", "LBD", "RBD", "LBU", "RBU")  # fmt: skip
COLOR_SCALE = 0.15  # display values of a coefficient of degree 0: bytes hold more than black to white
LARGEST_TAIL = 1 << 16  # bytes of extensions behind the splats


class Packed(NamedTuple):
    """A file's bytes, and what it says of them."""

    version: int
    count: int
    degree: int
    fraction: int  # bits
    flags: int
    streams: dict[str, np.ndarray]  # (N, bytes of a splat) uint8
    extensions: bytes


class SpzSplats(BlockReader):
    """The splats of an SPZ file."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        data = np.memmap(path, np.uint8, "r").data if path.stat().st_size else memoryview(b"")
        self._packed = packed = _unpacked(path, data)
        axes = Y_UP
        for kind, content in _extensions(packed.extensions):
            if kind == COORDINATES and len(content) == 4 and 0 < int.from_bytes(content, "little") < len(SYSTEMS):
                axes = SYSTEMS[int.from_bytes(content, "little")]
        coefficients = (0, *COEFFICIENTS)[packed.degree]
        antialiased = bool(packed.flags & ANTIALIASED)
        self.header = SplatHeader(path, f"SPZ {packed.version}", packed.count, coefficients, antialiased, axes)

    def decode(self, first: int, out: Decoded) -> None:
        packed = self._packed
        part = {name: stream[first : first + len(out.opacity)] for name, stream in packed.streams.items()}
        if packed.version == 1:
            out.position[:] = part["position"].view("<f2")
        else:
            _fixed_point(part["position"], packed.fraction, out.position)
        np.multiply(part["opacity"][:, 0], np.float32(1 / 255), out=out.opacity)
        np.multiply(part["base"], np.float32(1 / 255 / COLOR_SCALE), out=out.base)
        np.subtract(out.base, np.float32(0.5 / COLOR_SCALE), out=out.base)
        np.multiply(part["scale"], np.float32(1 / 16), out=out.scale)
        np.subtract(out.scale, np.float32(10), out=out.scale)
        np.exp(out.scale, out=out.scale)
        if packed.version < 3:
            _first_three(part["rotation"], out.rotation)
        else:
            _smallest_three(part["rotation"], out.rotation)
        if "sh" in part:
            flat = out.sh.reshape(len(out.sh), -1)
            np.subtract(part["sh"], np.float32(128), out=flat)
            flat *= np.float32(1 / 128)

    def close(self) -> None:
        self._packed = self._packed._replace(streams={})


def _fixed_point(data: np.ndarray, fraction: int, out: np.ndarray) -> None:
    """Positions (n, 3) of three signed numbers of 24 bits each, the lowest byte first."""
    wide = np.empty((len(data), 3, 4), np.uint8)
    wide[..., 0] = 0
    wide[..., 1:] = data.reshape(-1, 3, 3)
    np.multiply(wide.view("<i4")[..., 0] >> 8, np.float32(2.0**-fraction), out=out, casting="same_kind")


def _first_three(data: np.ndarray, out: np.ndarray) -> None:
    """Quaternions of the bytes of x, y and z; w is not negative."""
    xyz = data * np.float32(1 / 127.5) - np.float32(1)
    out[:, 1:] = xyz
    out[:, 0] = np.sqrt(np.maximum(1 - np.einsum("ij,ij->i", xyz, xyz), 0))


def _smallest_three(data: np.ndarray, out: np.ndarray) -> None:
    """Quaternions of words: two bits number the largest of x, y, z, w; the others have a sign and 9 bits of size."""
    words = np.ascontiguousarray(data).view("<u4")[:, 0]
    kept = np.stack([words >> shift & 1023 for shift in (20, 10, 0)], axis=1).astype(np.int32)
    size = (kept & 511) * np.float32(0.5**0.5 / 511)
    xyzw = np.empty_like(out)
    smallest_three((words >> 30).astype(np.intp), np.where(kept & 512, -size, size), xyzw)
    out[:, 1:], out[:, 0] = xyzw[:, :3], xyzw[:, 3]


def _unpacked(path: Path, data: memoryview) -> Packed:
    """The bytes of a file's attributes. Raises PointFileError where it is none, or damaged."""
    head = gunzip(path, data, HEADER.size) if data[:2] == GZIP else data[: HEADER.size]
    if len(head) < HEADER.size or bytes(head[:4]) != MAGIC:
        raise PointFileError(path, "is no SPZ file, for it does not begin with NGSP, packed or not")
    _, version, count, degree, fraction, flags, streams = HEADER.unpack(head)
    if not 1 <= version <= 4:
        raise PointFileError(path, f"has version {version} of SPZ; versions 1 to 4 can be read")
    if degree > len(COEFFICIENTS):
        raise PointFileError(path, f"has spherical harmonics of degree {degree}, expected at most {len(COEFFICIENTS)}")
    if fraction > 24:
        raise PointFileError(path, f"has positions with {fraction} bits behind the point, expected at most 24")
    widths = {"position": 6 if version == 1 else 9, "opacity": 1, "base": 3, "scale": 3,
              "rotation": 3 if version < 3 else 4, "sh": 3 * (0, *COEFFICIENTS)[degree]}  # fmt: skip
    widths = {name: width for name, width in widths.items() if width}
    if version == 4:
        parts, extensions = _streams(path, data, streams, widths, count)
    else:
        parts, extensions = _single_stream(path, data, widths, count)
    found = {
        name: np.frombuffer(part, np.uint8).reshape(count, width)
        for (name, width), part in zip(widths.items(), parts, strict=True)
    }
    return Packed(version, count, degree, fraction, flags, found, extensions if flags & EXTENDED else b"")


def _single_stream(path: Path, data: memoryview, widths: dict[str, int], count: int) -> tuple[list[memoryview], bytes]:
    """The bytes of each attribute, and of extensions, of versions 1 to 3."""
    size = HEADER.size + sum(widths.values()) * count
    if data[:2] == GZIP:
        if size > DEFLATE_RATIO * len(data):
            raise PointFileError(path, f"promises {count:,} splats, for which its {len(data):,} bytes are too few")
        content = memoryview(gunzip(path, data, size + LARGEST_TAIL))
    else:
        content = data
    if len(content) < size:
        raise PointFileError(path, f"promises {count:,} splats, which are {size:,} bytes, and has {len(content):,}")
    parts, at = [], HEADER.size
    for width in widths.values():
        parts.append(content[at : at + width * count])
        at += width * count
    return parts, bytes(content[at : at + LARGEST_TAIL])


def _streams(
    path: Path, data: memoryview, streams: int, widths: dict[str, int], count: int
) -> tuple[list[bytearray], bytes]:
    """The bytes of each attribute, and of extensions, of version 4."""
    if len(data) < LONG_HEADER:
        raise PointFileError(path, f"ends within its header, after {len(data)} bytes")
    table = int.from_bytes(data[16:20], "little")
    at = table + 16 * streams
    if streams != len(widths) or table < LONG_HEADER or at > len(data):
        raise PointFileError(path, f"has a table of {streams} streams at byte {table:,}, expected {len(widths)}")
    sizes = np.frombuffer(data[table:at], "<u8").reshape(-1, 2).tolist()
    found = []
    for (name, width), (packed, unpacked) in zip(widths.items(), sizes, strict=True):
        if unpacked != width * count or packed > len(data) - at:
            what = f"{packed:,} of {len(data) - at:,} bytes that hold {unpacked:,}, expected {width * count:,}"
            raise PointFileError(path, f"has a stream of {name} at byte {at:,} of {what}")
        found.append(unzstd(path, data[at : at + packed], unpacked, f"stream of {name} at byte {at:,}"))
        at += packed
    return found, bytes(data[LONG_HEADER:table][:LARGEST_TAIL])


def _extensions(data: bytes) -> list[tuple[int, bytes]]:
    """Types and contents of extensions, as far as they are whole."""
    found, at = [], 0
    while at + 8 <= len(data):
        kind, size = struct.unpack_from("<II", data, at)
        if size > len(data) - at - 8:
            break
        found.append((kind, data[at + 8 : at + 8 + size]))
        at += 8 + size
    return found
