"""Reads PLY as PlayCanvas packs it: four words a splat, whose bits are shares of a range of each 256 splats.

Positions and logarithms of scales have 11, 10 and 11 bits, from the highest down; colours and opacity 8 each; rotations
two bits for the largest component, and 10 for each of the others.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..points.ply import PACKED_PROPERTIES, PlyHeader
from ..points.reader import PointFileError
from .ply import mapped, record_of
from .quaternions import smallest_three
from .reader import BlockReader, Decoded, SplatHeader, checked_coefficients, coefficients_of, exponential

SPLATS = 256  # of a chunk
RANGES = {"position": "{}_{}", "scale": "{}_scale_{}"}
AXES, CHANNELS = "xyz", "rgb"
SH_RANGE = 8.0  # from the least to the most coefficient


class PackedSplats(BlockReader):
    """The splats of a packed PLY file."""

    def __init__(self, path: Path, ply: PlyHeader) -> None:
        super().__init__()
        if ply.order == "ascii":
            raise PointFileError(path, "has packed splats as text, which are binary")
        arrays: dict[str, np.ndarray] = {}
        start = ply.size
        for element in ply.elements:
            if any(not dtype for _, dtype in element.properties):
                break
            if element.name in ("chunk", "vertex", "sh"):
                arrays[element.name] = mapped(path, element, ply.order, start)
            start += element.count * record_of(element, ply.order).itemsize
        self._vertex, chunks = self._found(path, arrays)
        self._ranges = self._read_ranges(path, chunks)
        sh = arrays.get("sh")
        names = () if sh is None else sh.dtype.names or ()
        coefficients = checked_coefficients(path, len(names) // 3 if len(names) % 3 == 0 else len(names))
        if sh is not None and (len(sh) != len(self._vertex) or any(sh.dtype[name] != np.uint8 for name in names)):
            raise PointFileError(path, f"has {len(sh):,} rows of spherical harmonics for {len(self._vertex):,} splats")
        expected = [f"f_rest_{coefficients * c + k}" for k in range(coefficients) for c in range(3)]
        if set(names) != set(expected):
            raise PointFileError(path, "has spherical harmonics that are not named f_rest_0 and on")
        self._sh, self._sh_names = sh, expected
        self.header = SplatHeader(path, "PLY, packed", len(self._vertex), coefficients)

    def _found(self, path: Path, arrays: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """The records of splats and of chunks."""
        vertex, chunks = arrays.get("vertex"), arrays.get("chunk")
        if vertex is None or chunks is None:
            raise PointFileError(path, "has packed splats without the element chunk that tells their ranges")
        if any(vertex.dtype[name].newbyteorder("=") != np.uint32 for name in PACKED_PROPERTIES):
            raise PointFileError(path, "has packed splats that are no 32-bit words")
        if len(chunks) != -(-len(vertex) // SPLATS):
            raise PointFileError(path, f"has {len(chunks):,} chunks for {len(vertex):,} splats, expected one for 256")
        return vertex, chunks

    def _read_ranges(self, path: Path, chunks: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Lows and extents (C, 3) float32 of positions and scales, and of colours where the file has them."""
        names = chunks.dtype.names or ()
        found = {}
        for what, pattern in RANGES.items():
            ends = [[pattern.format(end, axis) for axis in AXES] for end in ("min", "max")]
            if missing := [name for name in (*ends[0], *ends[1]) if name not in names]:
                raise PointFileError(path, f"has chunks without {', '.join(missing)}")
            found[what] = _range(chunks, ends)
        ends = [[f"{end}_{channel}" for channel in CHANNELS] for end in ("min", "max")]
        if all(name in names for end in ends for name in end):
            found["color"] = _range(chunks, ends)
        return found

    def decode(self, first: int, out: Decoded) -> None:
        rows = slice(first, first + len(out.opacity))
        chunk = np.arange(rows.start, rows.stop) // SPLATS
        words = {name: self._vertex[name][rows].astype(np.uint32) for name in PACKED_PROPERTIES}
        self._spread("position", chunk, _shares(words["packed_position"]), out.position)
        scale = np.empty_like(out.scale)
        self._spread("scale", chunk, _shares(words["packed_scale"]), scale)
        exponential(scale, out.scale)
        self._rotations(words["packed_rotation"], out.rotation)
        color = words["packed_color"].astype(">u4").view(np.uint8).reshape(-1, 4)
        share = color[:, :3] * np.float32(1 / 255)
        if "color" in self._ranges:
            self._spread("color", chunk, share, share)
        coefficients_of(share, out.base)
        np.multiply(color[:, 3], np.float32(1 / 255), out=out.opacity)
        if self._sh is not None:
            self._coefficients(rows, out.sh)

    def _spread(self, what: str, chunk: np.ndarray, share: np.ndarray, out: np.ndarray) -> None:
        """Values (n, 3) of shares of the ranges of chunks (n,)."""
        low, extent = self._ranges[what]
        np.multiply(share, extent[chunk], out=out)
        out += low[chunk]

    def _rotations(self, words: np.ndarray, out: np.ndarray) -> None:
        """Quaternions w, x, y, z; the two highest bits number the largest component, in that order."""
        kept = np.stack([words >> shift & 1023 for shift in (20, 10, 0)], axis=1)
        smallest_three((words >> 30).astype(np.intp), (kept / np.float32(1023) - 0.5) * np.float32(2**0.5), out)

    def _coefficients(self, rows: slice, out: np.ndarray) -> None:
        """Coefficients of bytes: the middles of 256 steps, but the ends of the first and the last."""
        assert self._sh is not None
        steps = (np.arange(256) + 0.5) / 256
        steps[[0, 255]] = 0, 1
        table = ((steps - 0.5) * SH_RANGE).astype(np.float32)
        part = self._sh[rows]
        flat = out.reshape(len(out), -1)
        for column, name in enumerate(self._sh_names):
            flat[:, column] = table[part[name]]

    def close(self) -> None:
        self._vertex, self._sh = self._vertex[:0].copy(), None


def _range(chunks: np.ndarray, ends: list[list[str]]) -> tuple[np.ndarray, np.ndarray]:
    low, high = (np.stack([chunks[name] for name in end], axis=1).astype(np.float32) for end in ends)
    with np.errstate(all="ignore"):
        return low, high - low


def _shares(words: np.ndarray) -> np.ndarray:
    """Shares (n, 3) float32 of 0 to 1 of words of 11, 10 and 11 bits."""
    return np.stack([(words >> 21) / np.float32(2047), (words >> 11 & 1023) / np.float32(1023),
                     (words & 2047) / np.float32(2047)], axis=1, dtype=np.float32, casting="same_kind")  # fmt: skip
