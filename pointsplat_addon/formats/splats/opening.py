"""Which reader opens which file."""

from __future__ import annotations

from pathlib import Path

from ..points.reader import PointFileError
from .reader import SplatReader

ENDS = ".ply", ".splat", ".ksplat", ".spz", ".sog"
SETS = "lod-meta.json", "meta.json"  # files that stand for the folder they lie in


def open_splats(path: Path, decode: None = None, level: int = 0) -> SplatReader:
    """Opens a file of captured splats."""
    name = path.name.lower()
    if name.endswith(".ply"):
        from .ply import open_ply

        return open_ply(path)
    if name.endswith(".splat"):
        from .splat import SplatFile

        return SplatFile(path)
    raise PointFileError(path, f"is none of {', '.join((*ENDS, *SETS))}")
