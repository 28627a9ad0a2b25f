"""Reads SOG, PlayCanvas's format of pictures whose pixels are splats, version 2, as a folder or as one ZIP file.

A pixel's bytes are numbers: of positions (two pictures, symmetric logarithms), of entries in code books (scales,
colours), of the smallest three components of quaternions, and of entries in a palette of spherical harmonics
(developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog). Axes are those of PLY files.
"""

from __future__ import annotations

import json
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from ...core.scene.captured import COEFFICIENTS
from ..points.reader import PointFileError
from .inflate import DEFLATE_RATIO
from .quaternions import smallest_three
from .reader import BlockReader, Decoded, SplatHeader, exponential

ImageDecoder = Callable[[bytes, str], np.ndarray]  # of a picture's bytes and name: (H, W, 4) uint8, the top row first
Files = Callable[[str], bytes]  # the content of the file of a name
CODES = 256
ACROSS = 64  # entries of the palette in a row of its picture
FIRST_LARGEST = 252  # the last byte of quaternions whose largest component is w
SPARE = 1 << 16  # pixels that a picture may have beyond a few for each splat
MOST_META = 1 << 24  # bytes
DAMAGES = zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, ValueError, struct.error, zlib.error


class SogSplats(BlockReader):
    """The splats of one SOG set."""

    def __init__(self, path: Path, meta: dict, files: Files, decode: ImageDecoder) -> None:
        super().__init__()
        self._path, self._files, self._decode = path, files, decode
        if (version := meta.get("version")) != 2:
            raise PointFileError(path, f"has version {version} of SOG; version 2 can be read")
        count = meta.get("count")
        if not isinstance(count, int) or isinstance(count, bool) or not 0 <= count < 1 << 31:
            raise PointFileError(path, f"has a count of {count!r:.40} splats")
        self._count = count
        low, high = (self._numbers(meta, "means", key, 3) for key in ("mins", "maxs"))
        self._low, self._extent = low, high - low
        self._means = [self._image(name)[:, :3] for name in self._names(meta, "means", 2)]
        self._scales, self._scale_codes = (
            self._image(*self._names(meta, "scales", 1))[:, :3],
            self._codes(meta, "scales"),
        )
        self._quats = self._image(*self._names(meta, "quats", 1))
        self._sh0, self._sh0_codes = self._image(*self._names(meta, "sh0", 1)), self._codes(meta, "sh0")
        self._labels = self._palette = None
        coefficients = self._open_palette(meta) if meta.get("shN") else 0
        antialiased = meta.get("antialias") is True or meta.get("model") == "antialiased"
        self.header = SplatHeader(path, "SOG 2", count, coefficients, antialiased)

    def _open_palette(self, meta: dict) -> int:
        """Reads the palette of spherical harmonics; returns the number of their coefficients."""
        bands = self._part(meta, "shN").get("bands")
        if bands not in (1, 2, 3):
            raise PointFileError(self._path, f"has spherical harmonics of {bands!r:.40} bands, expected 1 to 3")
        coefficients = COEFFICIENTS[bands - 1]
        centroids, labels = self._names(meta, "shN", 2)
        self._labels = self._image(labels)[:, :2]
        entries = int(self._label(slice(None)).max(initial=0)) + 1
        picture = self._picture(centroids, ACROSS * coefficients * -(-entries // ACROSS))
        if picture.shape[1] != ACROSS * coefficients:
            what = f"{picture.shape[1]:,} pixels wide, expected {ACROSS * coefficients:,}"
            raise PointFileError(self._path, f"has a palette {centroids} of spherical harmonics that is {what}")
        codes = picture[..., :3].reshape(-1, coefficients, 3)[:entries]
        self._palette = self._codes(meta, "shN")[codes]
        return coefficients

    def decode(self, first: int, out: Decoded) -> None:
        rows = slice(first, first + len(out.opacity))
        low, high = (picture[rows] for picture in self._means)
        share = (low + high * np.float64(256)) / 65535
        logarithm = self._low + self._extent * share
        out.position[:] = np.sign(logarithm) * np.expm1(np.abs(logarithm))
        exponential(self._scale_codes[self._scales[rows]], out.scale)
        quats = self._quats[rows]
        largest = quats[:, 3].astype(np.intp) - FIRST_LARGEST
        stored = (quats[:, :3] * np.float32(1 / 255) - np.float32(0.5)) * np.float32(2**0.5)
        smallest_three(np.maximum(largest, 0), stored, out.rotation)
        out.rotation[largest < 0] = 0  # reserved: not turned
        sh0 = self._sh0[rows]
        out.base[:] = self._sh0_codes[sh0[:, :3]]
        np.multiply(sh0[:, 3], np.float32(1 / 255), out=out.opacity)
        if self._palette is not None:
            np.take(self._palette, self._label(rows), axis=0, out=out.sh)

    def _label(self, rows: slice) -> np.ndarray:
        """Entries of the palette, (n,) int."""
        assert self._labels is not None
        return self._labels[rows, 0] + self._labels[rows, 1].astype(np.intp) * 256

    # What the description names

    def _part(self, meta: dict, name: str) -> dict:
        part = meta.get(name)
        if not isinstance(part, dict):
            raise PointFileError(self._path, f"does not describe its {name}")
        return part

    def _names(self, meta: dict, name: str, count: int) -> list[str]:
        """Names of pictures."""
        names = self._part(meta, name).get("files")
        if not isinstance(names, list) or len(names) < count or not all(isinstance(item, str) for item in names):
            raise PointFileError(self._path, f"does not name the {count} pictures of its {name}")
        return names[:count]

    def _numbers(self, meta: dict, name: str, key: str, count: int) -> np.ndarray:
        """A list of so many numbers, float64."""
        found = self._part(meta, name).get(key)
        try:
            array = np.array(found, np.float64)
        except (TypeError, ValueError, OverflowError):
            array = np.empty(0)
        if array.shape != (count,):
            raise PointFileError(self._path, f"has {key} of {name} that are no {count} numbers")
        return array

    def _codes(self, meta: dict, name: str) -> np.ndarray:
        """A code book, (256,) float32. A first entry that was written as null follows from the others' range."""
        codes = self._numbers(meta, name, "codebook", CODES)
        if np.isnan(codes[0]):
            codes[0] = codes[1] + (codes[1] - codes[-1]) / (CODES - 1)
        with np.errstate(over="ignore"):
            return codes.astype(np.float32)

    def _image(self, name: str) -> np.ndarray:
        """The pixels of a picture that are splats, (N, 4) uint8."""
        return self._picture(name, self._count).reshape(-1, 4)[: self._count]

    def _picture(self, name: str, pixels: int) -> np.ndarray:
        """A picture (H, W, 4) uint8, of at least so many pixels and not very many more."""
        data = self._files(name)
        width, height = _size_of(data)
        if not width:
            raise PointFileError(self._path, f"has a file {name} that is no whole WebP or PNG picture")
        if not pixels <= width * height <= 8 * pixels + SPARE:
            what = f"of {width} x {height} pixels for {self._count:,} splats"
            raise PointFileError(self._path, f"has a picture {name} {what}")
        found = self._decode(data, name)
        if found.shape != (height, width, 4) or found.dtype != np.uint8:
            raise PointFileError(self._path, f"has a picture {name} that cannot be read")
        return found

    def close(self) -> None:
        self._means, self._labels, self._palette = [], None, None


def open_sog(path: Path, decode: ImageDecoder) -> SogSplats:
    """Opens a ZIP file, or a folder by its meta.json. Raises PointFileError and OSError."""
    if path.suffix.lower() == ".json":
        return SogSplats(path, read_json(path), lambda name: read_beside(path, name), decode)
    with path.open("rb") as file:
        try:
            archive = zipfile.ZipFile(file)
        except (*DAMAGES, OSError) as error:
            raise PointFileError(path, f"is no ZIP file: {error}") from None

        def member(name: str) -> bytes:
            try:
                info = archive.getinfo(name)
                if info.file_size > DEFLATE_RATIO * (info.compress_size + 1):
                    raise PointFileError(path, f"promises {info.file_size:,} bytes of {name}")
                with archive.open(info) as content:
                    return content.read(info.file_size)
            except KeyError:
                raise PointFileError(path, f"has no file {name}") from None
            except PointFileError:
                raise
            except (*DAMAGES, OSError) as error:  # seeking before the file's beginning is an OSError, too
                raise PointFileError(path, f"is damaged in {name}: {error}") from None

        return SogSplats(path, parsed(path, member("meta.json")), member, decode)


def read_json(path: Path) -> dict:
    """Returns a description. Raises PointFileError where it is missing or none."""
    try:
        with path.open("rb") as file:
            return parsed(path, file.read(MOST_META))
    except (FileNotFoundError, NotADirectoryError):
        raise PointFileError(path, f"is missing from {path.parent}") from None


def parsed(path: Path, text: bytes) -> dict:
    """Returns an object of JSON. Raises PointFileError where it is none."""
    try:
        found: Any = json.loads(text.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise PointFileError(path, f"is no JSON: {error}") from None
    if not isinstance(found, dict):
        raise PointFileError(path, "describes no set of splats")
    return found


def read_beside(path: Path, name: str) -> bytes:
    """Returns the content of a file that a description names, in its folder or below."""
    try:
        return beside(path, name).read_bytes()
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
        raise PointFileError(path, f"names the file {name}, which is missing") from None


def beside(path: Path, name: str) -> Path:
    """Returns the path of a file that a description names. Raises PointFileError where it lies outside its folder."""
    parts = PurePosixPath(name.replace("\\", "/"))
    if not name or "\0" in name or parts.is_absolute() or ".." in parts.parts or ":" in name:
        raise PointFileError(path, f'names the file "{name:.60}", which is outside its folder')
    return path.parent.joinpath(*parts.parts)


def _size_of(data: bytes) -> tuple[int, int]:
    """Width and height of a WebP or PNG picture; zeros where it is none, or cut off."""
    if data[:8] == b"\x89PNG\r\n\x1a\n" and len(data) >= 24:
        return struct.unpack_from(">II", data, 16)
    if (
        data[:4] != b"RIFF"
        or data[8:12] != b"WEBP"
        or len(data) < 30
        or struct.unpack_from("<I", data, 4)[0] + 8 > len(data)
    ):
        return 0, 0
    kind = data[12:16]
    if kind == b"VP8L":
        bits = struct.unpack_from("<I", data, 21)[0]
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    if kind == b"VP8X":
        return int.from_bytes(data[24:27], "little") + 1, int.from_bytes(data[27:30], "little") + 1
    if kind == b"VP8 ":
        width, height = struct.unpack_from("<HH", data, 26)
        return width & 0x3FFF, height & 0x3FFF
    return 0, 0
