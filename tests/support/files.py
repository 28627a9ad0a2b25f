"""Reads uncompressed 32-bit float scan-line OpenEXR files as Blender writes them, of one part or several.

Layout: OpenEXR's technical introduction, "File layout". Blender 5 writes one part for each pass.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

MULTIPART = 0x1000
FLOAT = 2
LETTERS = "RGBA", "XYZW", "V"


def read_exr(path: Path) -> dict[str, np.ndarray]:
    """Pass name (with its view layer: Layer.Pass) to (H, W, C) float32, bottom row first."""
    raw = path.read_bytes()
    multipart = bool(struct.unpack_from("<I", raw, 4)[0] & MULTIPART)
    headers, at = [], 8
    while not headers or (multipart and raw[at]):
        header, at = _header(raw, at)
        headers.append(header)
    at += multipart
    planes: dict[str, dict[str, np.ndarray]] = {}
    for header in headers:
        x0, y0, x1, y1 = struct.unpack("<4i", header["dataWindow"])
        width, height = x1 - x0 + 1, y1 - y0 + 1
        channels = _channels(header["channels"])
        offsets = np.frombuffer(raw, "<u8", height, at)
        at += 8 * height
        # Each line: its part's number where there are several, y, size, then channel after channel.
        start = 12 if multipart else 8
        lines = np.stack([np.frombuffer(raw, "<f4", width * len(channels), int(o) + start) for o in offsets])
        part = lines.reshape(height, len(channels), width)[::-1]
        for index, channel in enumerate(channels):
            stem, _, letter = channel.rpartition(".")
            planes.setdefault(stem or header.get("name", b"").decode(), {})[letter] = part[:, index]
    return {stem: np.stack([found[k] for k in sorted(found, key=_place)], axis=-1) for stem, found in planes.items()}


def _header(raw: bytes, at: int) -> tuple[dict[str, bytes], int]:
    """Attributes by name, and the place after the header."""
    header = {}
    while raw[at]:
        name_end = raw.index(0, at)
        kind_end = raw.index(0, name_end + 1)
        (size,) = struct.unpack_from("<I", raw, kind_end + 1)
        header[raw[at:name_end].decode()] = raw[kind_end + 5 : kind_end + 5 + size]
        at = kind_end + 5 + size
    assert header["compression"] == b"\0", "the file is compressed"
    return header, at + 1


def _channels(data: bytes) -> list[str]:
    names, at = [], 0
    while data[at]:
        end = data.index(0, at)
        assert struct.unpack_from("<I", data, end + 1)[0] == FLOAT, "a channel is not 32-bit float"
        names.append(data[at:end].decode())
        at = end + 17
    return names


def _place(letter: str) -> int:
    return next(letters.index(letter) for letters in LETTERS if letter in letters)


def nifti(array, order="<", code=4, *, slope=0.0, inter=0.0, sform=None, qform=None, pixdim=(1, 1, 1), units=2, qfac=1):
    """A file in NIfTI-1's layout, written field by field."""
    header = bytearray(352)
    struct.pack_into(order + "i", header, 0, 348)
    struct.pack_into(order + "8h", header, 40, array.ndim, *array.shape, *[1] * (7 - array.ndim))
    struct.pack_into(order + "2h", header, 70, code, 8 * array.itemsize)
    struct.pack_into(order + "8f", header, 76, qfac, *pixdim, 1, 1, 1, 1)
    struct.pack_into(order + "3f", header, 108, 352, slope, inter)
    header[123] = units
    if qform is not None:
        struct.pack_into(order + "h", header, 252, 1)
        struct.pack_into(order + "6f", header, 256, *qform)
    if sform is not None:
        struct.pack_into(order + "h", header, 254, 1)
        struct.pack_into(order + "12f", header, 280, *np.ravel(sform))
    header[344:348] = b"n+1\0"
    return bytes(header) + array.astype(array.dtype.newbyteorder(order)).tobytes(order="F")
