"""Which reader opens which file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ..points.reader import PointFileError
from .reader import SplatReader
from .sog import ImageDecoder, open_sog, read_json
from .streamed import StreamedSplats


def _ply(path: Path) -> SplatReader:
    from ..points.ply import PACKED_PROPERTIES, read_header
    from .packed_ply import PackedSplats
    from .ply import PlySplats

    ply = read_header(path)
    vertex = ply.element("vertex")
    packed = vertex is not None and {name for name, _ in vertex.properties} >= PACKED_PROPERTIES
    return PackedSplats(path, ply) if packed else PlySplats(path, ply)


def _splat(path: Path) -> SplatReader:
    from .splat import SplatFile

    return SplatFile(path)


def _ksplat(path: Path) -> SplatReader:
    from .ksplat import KsplatFile

    return KsplatFile(path)


def _spz(path: Path) -> SplatReader:
    from .spz import SpzSplats

    return SpzSplats(path)


FORMATS: dict[str, Callable[[Path], SplatReader]] = {".ply": _ply, ".splat": _splat, ".ksplat": _ksplat, ".spz": _spz}
SETS = "lod-meta.json", "meta.json"  # files that stand for the folder they lie in
ENDS = *FORMATS, ".sog"


def open_splats(path: Path, decode: ImageDecoder | None = None, level: int = 0) -> SplatReader:
    """Opens a file of captured splats, or the folder of a set of them.

    decode: makes arrays of the pictures of SOG files. level: which level of detail of those that have several, 0 being
    the finest. Raises PointFileError where the file is damaged or none, OSError where it cannot be read.
    """
    if path.is_dir():
        path = next((path / name for name in SETS if (path / name).exists()), path)
    name = path.name.lower()
    if name.endswith((".json", ".sog")):
        if decode is None:
            raise PointFileError(path, "is made of pictures, which cannot be read here")
        streamed = name.endswith(".json") and "lodLevels" in read_json(path)
        return StreamedSplats(path, decode, level) if streamed else open_sog(path, decode)
    for end, reader in FORMATS.items():
        if name.endswith(end):
            return reader(path)
    raise PointFileError(path, f"is none of {', '.join((*ENDS, *SETS))}")
