"""Writes SPZ, version 3 (gzip) or 4 (zstd): see ..spz."""

from __future__ import annotations

import os
import zlib
from pathlib import Path

import numpy as np

from ....core.numeric.vectors import each_block
from ....core.scene.captured import CapturedSplats
from ...points.reader import PointFileError
from ..quaternions import pack_smallest_three
from ..reader import BLOCK, DEGREES
from ..spz import ANTIALIASED, COLOR_SCALE, HEADER, LONG_HEADER, MAGIC

MOST_FRACTION = 16  # bits of positions behind the point: 15 micrometres
HALF = 1 << 23  # positions are from -HALF to HALF - 1 steps


def write_spz(path: Path, splats: CapturedSplats, version: int = 3) -> list[str]:
    """Writes splats in the file's axes; returns what they lost beyond rounding, for a person.

    Raises PointFileError where positions are too far away, and OSError; then there is no file.
    """
    position = splats.position + splats.origin
    farthest = float(np.abs(position).max(initial=0.0))
    fraction = next((bits for bits in range(MOST_FRACTION, -1, -1) if farthest * 2**bits < HALF - 1), None)
    if fraction is None:
        raise PointFileError(path, f"cannot hold positions up to {farthest:,.0f}: SPZ reaches {HALF:,}")
    coefficients = 0 if splats.sh is None else splats.sh.shape[1]
    widths = {"position": 9, "opacity": 1, "base": 3, "scale": 3, "rotation": 4, "sh": 3 * coefficients}
    parts = {name: np.empty((len(splats), width), np.uint8) for name, width in widths.items() if width}
    clipped = np.zeros(len(splats), bool)

    def work(rows: slice) -> None:
        steps = np.rint(position[rows] * 2.0**fraction).astype("<i4")
        parts["position"][rows] = steps.view(np.uint8).reshape(-1, 3, 4)[:, :, :3].reshape(-1, 9)
        with np.errstate(divide="ignore"):
            log = np.log(splats.scale[rows])
        values = {
            "opacity": splats.opacity[rows, None] * 255,
            "base": (splats.base[rows] * COLOR_SCALE + 0.5) * 255,
            "scale": (np.maximum(log, -10) + 10) * 16,  # smaller ones are less than a pixel from anywhere
        }
        if splats.sh is not None:
            values["sh"] = splats.sh[rows].reshape(len(steps), -1) * 128 + 128
        for name, value in values.items():
            rounded = np.rint(value)
            clipped[rows] |= ((rounded < -0.5) | (rounded > 255.5)).any(axis=1)
            parts[name][rows] = np.clip(rounded, 0, 255)
        parts["rotation"][rows] = _words(splats.rotation[rows]).view(np.uint8).reshape(-1, 4)

    each_block(len(splats), work, BLOCK)
    flags = ANTIALIASED if splats.antialiased else 0
    streams = len(parts) if version == 4 else 0
    head = HEADER.pack(MAGIC, version, len(splats), DEGREES[coefficients], fraction, flags, streams)
    content = _single_stream(head, list(parts.values())) if version < 4 else _streams(head, list(parts.values()))
    unfinished = path.with_name(path.name + ".part")
    try:
        unfinished.write_bytes(content)
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)
    lost = int(np.count_nonzero(clipped))
    return [f"{lost:,} splats have colours or scales beyond what SPZ holds, which are cut off"] if lost else []


def _words(rotation: np.ndarray) -> np.ndarray:
    """Quaternions w, x, y, z (n, 4) as words (n,): two bits for the largest of x, y, z, w; signs and 9 bits of size."""
    largest, kept = pack_smallest_three(rotation[:, [1, 2, 3, 0]])
    size = np.minimum(np.rint(np.abs(kept) * (511 * 2**0.5)), 511).astype(np.uint32)
    parts = size | (kept < 0).astype(np.uint32) << 9
    return (largest.astype(np.uint32) << 30 | parts[:, 0] << 20 | parts[:, 1] << 10 | parts[:, 2]).astype("<u4")


def _single_stream(head: bytes, parts: list[np.ndarray]) -> bytes:
    pack = zlib.compressobj(wbits=31)
    packed = [pack.compress(head)]
    packed += [pack.compress(part.data) for part in parts if part.size]
    return b"".join([*packed, pack.flush()])


def _streams(head: bytes, parts: list[np.ndarray]) -> bytes:
    import zstandard

    table = LONG_HEADER
    packed = [zstandard.ZstdCompressor(level=6).compress(part.tobytes()) for part in parts]
    sizes = np.array([[len(one), part.size] for one, part in zip(packed, parts, strict=True)], "<u8")
    start = (head + table.to_bytes(4, "little")).ljust(LONG_HEADER, b"\0")
    return b"".join([start, sizes.tobytes(), *packed])
