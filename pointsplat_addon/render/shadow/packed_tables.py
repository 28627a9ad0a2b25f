"""Shadow tables as the shaders read them: a float texture, and a record of each light for each view."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...core.numeric.record import record
from ...core.numeric.segments import starts
from ...core.shadow.casters import KINDS
from ...core.shadow.level import TableLevel
from ...core.shadow.table import SHAPES, ShadowTable
from ..device.packing import PAGE_WIDTH

HEADER_TEXELS = 8  # texels of a light's record before its levels
NO_ENTRY_DISTANCE = np.float32(1e30)  # distance of the nearest entry where there is none
LEVEL_TEXELS = 3  # texels of a level's record


@record
class PackedTables:
    """The tables of all lights as one texture that no view changes, and what each view needs to read it.

    `data` holds, for each level: rows (first cell, column0, count, density), masks (rank, three masks), links, and
    entries (distance, total): two to a texel, or one where `colored`; and the nearest entry by squares, for lights
    with a size. Integers that may be large are `coded`.
    """

    data: np.ndarray  # (H, PAGE_WIDTH, 4) float32
    colored: bool
    tables: tuple[ShadowTable | None, ...]  # of each light; None: it casts no shadow
    levels: np.ndarray  # (lights, most levels, LEVEL_TEXELS, 4) float32
    squares: np.ndarray  # (lights,) int64: which number of `data` is the first square's, core/shadow/table.py

    @property
    def only_opaque(self) -> bool:
        """Whether all casters are opaque."""
        return all(level.kind == "OPAQUE" for table in self._made for level in table.levels)

    @property
    def only_suns(self) -> bool:
        """Whether only suns cast shadows."""
        return all(table.frame.parallel for table in self._made)

    @property
    def no_light_has_size(self) -> bool:
        """Whether no light has a size: shadows have no penumbrae."""
        return all(table.emitter.shape == "POINT" for table in self._made)

    @property
    def _made(self) -> list[ShadowTable]:
        return [table for table in self.tables if table is not None]

    def records(self, view_from_world: np.ndarray) -> np.ndarray:
        """Returns ps_shadow_lights, (lights, HEADER_TEXELS + LEVEL_TEXELS * levels, 4) float32.

        `view_from_world`: (4, 4) float64, rigid.

        Texels 0 to 2 are the rows of light_from_view, 3 is (1 for suns, number of levels, index of the shape, nearest
        entry), 4 and 5 are the size, local, with the radius and the finest step behind. Texels 6 and 7 tell of the
        squares that know the nearest entry: least latitude and longitude, side of the finest, and the coarsest size;
        how many along a side, and where they begin.
        """
        world_from_view = np.linalg.inv(view_from_world)
        head = np.zeros((len(self.tables), HEADER_TEXELS, 4))
        for row, table in zip(head, self.tables, strict=True):
            if table is not None and table.levels:
                frame, emitter = table.frame, table.emitter
                row[:3, :3] = frame.light_from_world @ world_from_view[:3, :3]
                row[:3, 3] = frame.light_from_world @ (world_from_view[:3, 3] - frame.origin)
                row[3] = frame.parallel, len(table.levels), SHAPES.index(emitter.shape), table.nearest.least
                row[4:6, :3], row[4:6, 3] = emitter.size, (emitter.radius, frame.step)
                squares = table.nearest
                row[6] = *squares.low, squares.side, len(squares.distance) - 1
                row[7, 0] = len(squares.distance[0])
        result = np.concatenate([head.astype(np.float32), self.levels.reshape(len(head), -1, 4)], axis=1)
        result[:, 7, 1] = coded(self.squares)
        return result


def pack(tables: Sequence[ShadowTable | None], texture_size: int = 16384) -> PackedTables:
    """Packs the tables of lights, in the order of the light table's rows; None: the light casts no shadow.

    Raises ValueError if they need more than `texture_size` rows of PAGE_WIDTH texels.
    """
    colored = any(t is not None and t.colored for t in tables)
    most = max([len(t.levels) for t in tables if t is not None], default=0)
    records = np.zeros((len(tables), most, LEVEL_TEXELS, 4), np.float32)
    squares = np.zeros(len(tables), np.int64)
    parts, texels = [], 0
    for light, (table, row) in enumerate(zip(tables, records, strict=True)):
        for level, texel in zip(() if table is None else table.levels, row, strict=False):
            blocks = _level_blocks(level, colored)
            sizes = np.array([len(b) for b in blocks])
            base = texels + starts(sizes)
            texel[0] = level.grid.low, level.grid.step, len(level.grid.count), KINDS.index(level.kind)
            texel[1] = coded(base * (1, 1, 4, 1 if colored else 2))
            texel[2, 0] = level.grid.wraps
            texel[2, 1:] = level.distance.min(initial=np.inf), level.distance.max(initial=0), level.ramp
            parts += blocks
            texels += int(sizes.sum())
        if table is not None and table.emitter.shape != "POINT":
            squares[light] = 4 * texels
            parts.append(_as_texels(np.minimum(table.nearest.flat, NO_ENTRY_DISTANCE)))
            texels += len(parts[-1])
    height = max(1, -(-texels // PAGE_WIDTH))
    if height > texture_size:
        raise ValueError(f"shadow tables need {height} rows of a texture, this device has {texture_size}")
    data = np.zeros((height * PAGE_WIDTH, 4), np.float32)
    if parts:
        np.concatenate(parts, out=data[:texels])
    return PackedTables(data.reshape(height, PAGE_WIDTH, 4), colored, tuple(tables), records, squares)


def coded(integers: np.ndarray) -> np.ndarray:
    """Returns integers below 2^31 - 2^24 encoded in the bits of float32 numbers.

    The numbers are positive and normal, so that no device alters them.
    """
    return (np.asarray(integers, np.int64) + 0x00800000).astype(np.int32).view(np.float32)


def _level_blocks(level: TableLevel, colored: bool) -> list[np.ndarray]:
    """Returns the rows, masks, links and entries of a level as texels (n, 4) float32."""
    grid = level.grid
    rows = np.stack([coded(grid.first), grid.column0, grid.count, grid.density], axis=1).astype(np.float32)
    masks = np.concatenate([coded(level.rank)[:, None], level.mask.astype(np.float32)], axis=1)
    total = np.broadcast_to(level.total, (len(level.total), 3)) if colored else level.total
    entries = np.concatenate([level.distance[:, None], total], axis=1)
    return [rows, masks, *(_as_texels(a.reshape(-1)) for a in (coded(level.links), entries))]


def _as_texels(values: np.ndarray) -> np.ndarray:
    """Returns `values` (N,) as texels (ceil(N / 4), 4) float32, padded with zeros."""
    texels = np.zeros((-(-len(values) // 4), 4), np.float32)
    texels.reshape(-1)[: len(values)] = values
    return texels
