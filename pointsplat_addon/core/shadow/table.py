"""Shadow tables: what they hold, and how much light reaches a point. shaders/lib/shadow/shadow.glsl looks up the same."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..scene.lights import Light
from .grid import Frame, Grid
from .nearest import NearestEntries, nearest_entries

SHAPES = ("POINT", "DISK", "RECTANGLE", "ELLIPSE")
WORD = 24  # cells to a mask: as many bits as a float32 holds as an integer
TEXEL = 3 * WORD  # cells to a texel: where its entries start, then three masks


@dataclass(frozen=True, eq=False)
class Level:
    """Cells of one size and kind. Cell c holds entries links[k] .. links[k + 1], k its rank among occupied cells."""

    kind: str
    grid: Grid
    rank: np.ndarray  # (W,) int32: occupied cells before cell W * TEXEL
    mask: np.ndarray  # (W, 3) int32: WORD cells each, lowest bit first
    links: np.ndarray  # (O + 1,) int32
    distance: np.ndarray  # (E,) float32, ascending within a cell
    total: np.ndarray  # (E, 1 or 3) float32: optical depth up to and with the entry

    @property
    def nbytes(self) -> int:
        rows = 16 * len(self.grid.count)
        return sum(a.nbytes for a in (self.rank, self.mask, self.links, self.distance, self.total)) + rows

    def occupied(self) -> np.ndarray:
        """(O,) int64: cells that hold entries."""
        bits = np.unpackbits(self.mask.astype("<u4")[..., None].view(np.uint8), axis=-1, bitorder="little")
        return np.flatnonzero(bits.reshape(-1, 32)[:, :WORD])


@dataclass(frozen=True, eq=False)
class Emitter:
    """What shines, for the softness of shadows."""

    shape: str  # one of SHAPES; DISK: faces the receiver
    size: np.ndarray  # (2, 3) float64, local half-sides; DISK: both as long as the radius, for suns per unit of length

    @property
    def radius(self) -> float:
        return float(np.linalg.norm(self.size, axis=1).max())


def emitter_of(light: Light, frame: Frame) -> Emitter:
    if light.kind == "AREA" and light.axis_u is not None and light.axis_v is not None:
        size = np.stack([light.axis_u, light.axis_v]) @ frame.light_from_world.T
        return Emitter("ELLIPSE" if light.ellipse else "RECTANGLE", size)
    radius = np.tan(min(light.radius, 1.5)) if light.kind == "SUN" else light.radius
    return Emitter("DISK" if radius > 0 else "POINT", np.eye(3)[:2] * radius)


@dataclass(frozen=True, eq=False)
class ShadowTable:
    """What stands between a lamp and the points that it could light."""

    frame: Frame
    emitter: Emitter
    levels: tuple[Level, ...]
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
