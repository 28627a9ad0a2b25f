"""Shadow tables: what they hold. shaders/lib/shadow/shadow.glsl looks up how much light reaches a point."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ..numeric.record import record
from ..scene.lights import Light
from .grid import Frame
from .level import TableLevel
from .nearest import NearestEntries, nearest_entries

SHAPES = ("POINT", "DISK", "RECTANGLE", "ELLIPSE")


@record
class Emitter:
    """The shape of a light, which shadows are soft by."""

    shape: str  # one of SHAPES; DISK: faces the receiver
    size: np.ndarray  # (2, 3) float64, local half-sides; DISK: both as long as the radius, for suns per unit of length

    @property
    def radius(self) -> float:
        return float(np.linalg.norm(self.size, axis=1).max())


def emitter_of(light: Light, frame: Frame) -> Emitter:
    """The shape of a light in the local coordinates of a frame."""
    if light.kind == "AREA" and light.axis_u is not None and light.axis_v is not None:
        size = np.stack([light.axis_u, light.axis_v]) @ frame.light_from_world.T
        return Emitter("ELLIPSE" if light.ellipse else "RECTANGLE", size)
    radius = np.tan(min(light.radius, 1.5)) if light.kind == "SUN" else light.radius
    return Emitter("DISK" if radius > 0 else "POINT", np.eye(3)[:2] * radius)


@record
class ShadowTable:
    """Cumulated optical depths around a light, for each direction; renderers look up transmittances in it."""

    frame: Frame
    emitter: Emitter
    levels: tuple[TableLevel, ...]
    colored: bool  # optical depths have three channels

    @property
    def entries(self) -> int:
        return sum(len(level.distance) for level in self.levels)

    @property
    def nbytes(self) -> int:
        return sum(level.nbytes for level in self.levels)

    @cached_property
    def nearest(self) -> NearestEntries:
        return nearest_entries(self.frame, self.levels, self.emitter.shape != "POINT")
