"""Which reader opens which file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..points.reader import PointFileError
from .reader import SplatReader

ImageDecoder = Callable[[bytes, str], np.ndarray]  # of a picture's bytes and name: (H, W, 4) uint8, the top row first


def _ply(path: Path) -> SplatReader:
    from .ply import open_ply

    return open_ply(path)


def _splat(path: Path) -> SplatReader:
    from .splat import SplatFile

    return SplatFile(path)


def _spz(path: Path) -> SplatReader:
    from .spz import SpzSplats

    return SpzSplats(path)


FORMATS: dict[str, Callable[[Path], SplatReader]] = {".ply": _ply, ".splat": _splat, ".spz": _spz}


def open_splats(path: Path, decode: ImageDecoder | None = None, level: int = 0) -> SplatReader:
    """Opens a file of captured splats, or the folder of a set of them.

    decode: makes arrays of the pictures of SOG files. level: which level of detail of those that have several, 0 being
    the finest. Raises PointFileError where the file is damaged or none, OSError where it cannot be read.
    """
    for end, reader in FORMATS.items():
        if path.name.lower().endswith(end):
            return reader(path)
    raise PointFileError(path, f"is none of {', '.join(FORMATS)}")
