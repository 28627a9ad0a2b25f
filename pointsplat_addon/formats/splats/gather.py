"""All splats of a file as arrays."""

from __future__ import annotations

import numpy as np

from ...core.scene.captured import CapturedSplats
from .reader import SplatReader


def read_all(reader: SplatReader) -> CapturedSplats:
    """Returns all splats of an open file that can be drawn, in its axes. Raises PointFileError and OSError."""
    parts = list(reader.chunks())
    header = reader.header
    shapes = {"position": (3,), "scale": (3,), "rotation": (4,), "base": (3,), "opacity": ()}
    if header.coefficients:
        shapes["sh"] = (header.coefficients, 3)
    found = {}
    for name, shape in shapes.items():
        arrays = [getattr(part, name) for part in parts]
        found[name] = np.concatenate([np.zeros((0, *shape), np.float32), *arrays])
    return CapturedSplats(**found, origin=np.array(header.origin, np.float64), antialiased=header.antialiased)
