"""Reads .splat, the format of antimatter15's viewer: 32 bytes a splat and no header.

Position and scales are float32; then come red, green, blue and opacity as bytes, and a quaternion w, x, y, z as bytes
that are (1 + component) * 128.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..points.reader import PointFileError
from .reader import BlockReader, Decoded, SplatHeader, coefficients_of

RECORD = np.dtype([("position", "<f4", 3), ("scale", "<f4", 3), ("color", "u1", 4), ("rotation", "u1", 4)])


class SplatFile(BlockReader):
    """The splats of a .splat file."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        size = path.stat().st_size
        if size % RECORD.itemsize:
            raise PointFileError(
                path, f"has {size:,} bytes, which are no whole number of splats of {RECORD.itemsize} bytes"
            )
        count = size // RECORD.itemsize
        self._records = np.memmap(path, RECORD, "r", shape=(count,)) if count else np.empty(0, RECORD)
        self.header = SplatHeader(path, "splat", count)

    def decode(self, first: int, out: Decoded) -> None:
        part = self._records[first : first + len(out.opacity)]
        out.position[:] = part["position"]
        out.scale[:] = np.where(part["scale"] >= 0, part["scale"], np.nan)
        coefficients_of(part["color"][:, :3] * np.float32(1 / 255), out.base)
        np.multiply(part["color"][:, 3], np.float32(1 / 255), out=out.opacity)
        np.subtract(part["rotation"], np.float32(128), out=out.rotation)

    def close(self) -> None:
        self._records = np.empty(0, RECORD)
