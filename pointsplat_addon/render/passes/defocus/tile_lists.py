"""Lists which out-of-focus splats each tile of a picture shows, the nearest first."""

from __future__ import annotations

import numpy as np

from ....core.lens.kernel import NEGLIGIBLE, SOFT_RIM
from ....core.numeric.record import record
from ....core.numeric.segments import owners, ranges, starts

TILE = 4  # pixels on a side of tiles
TRANSLUCENT = 16  # in the kinds of splats: shaders/lib/splat/defocus.glsl
MOST_AWAY = (0.25, 4.0)  # of depth, over that of a splat in its plane elsewhere
MOST_ENTRIES = 1 << 24  # of all tiles: beyond it they are made larger


@record
class TileLists:
    """Which splats each tile of a picture shows, the nearest first."""

    tile: int  # pixels on a side
    tiles: np.ndarray  # (rows, columns, 2) int64: first entry and number of entries
    entries: np.ndarray  # (E,) int64, rows of the splats


@record
class Planes:
    """Planes in which splats lie, by which they are ordered: two panes one close behind the other have splats whose
    middles mix."""

    slope: np.ndarray  # (N, 4) as the pass `light` left it
    perspective: bool

    def depth(self, which: np.ndarray, depth: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Depths of planes, (E,) float, x and y pixels beside the middles of splats `which` (E,) at `depth` (E,)."""
        dx, dy, beside_x, beside_y = self.slope[which].T
        with np.errstate(all="ignore"):
            away = np.nan_to_num(dx * (x + beside_x) + dy * (y + beside_y)) / np.maximum(depth, 1e-30)
            # Along planes, the inverse of depth in perspective changes evenly.
            return depth * (1 / np.clip(1 - away, *MOST_AWAY) if self.perspective else 1 + away)


def tile_lists(
    centre: np.ndarray, shape: np.ndarray, focal: np.ndarray, size: tuple[int, int], planes: Planes | None = None
) -> TileLists:
    """Returns which splats each tile shows, the nearest first.

    centre, shape: (N, 4) each, as the pass `light` left them. focal: fx, fy, cx, cy. size: of the picture in pixels.
    `planes`: those that light passes are ordered by their depths in the middle of each tile, not in their own.
    """
    # Columns one by one: reducing rows of four takes several times as long.
    x, y, depth, peak = np.ascontiguousarray(centre.T)
    xx, xy, yy, code = np.ascontiguousarray(shape.T)
    with np.errstate(all="ignore"):
        seen = np.flatnonzero((peak > 0) & np.isfinite(x + y + depth + peak) & np.isfinite(xx + xy + yy + code))
    cx, cy = (values[seen] + middle for values, middle in zip((x, y), focal[2:].astype(np.float32), strict=True))
    k = code[seen] % 8
    # Where splats end. The rims of disks are as soft as a pixel is wide.
    faint = NEGLIGIBLE / np.maximum(peak[seen], 1)
    support = 2 * (k + 2) * (1 - faint ** (1 / np.maximum(k, 1e-3)))
    rim = np.where(SOFT_RIM**k > faint, np.float32(0.5), np.float32(0))
    # Halves of the box around xx dx^2 + 2 xy dx dy + yy dy^2 = support.
    xx, xy, yy = (values[seen] for values in (xx, xy, yy))
    determinant = np.maximum(xx * yy - xy * xy, np.finfo(np.float32).tiny)
    wide, tall = np.sqrt(support * yy / determinant), np.sqrt(support * xx / determinant)
    ends = np.array(size, np.float32) - 0.5
    inside = (cx + wide + rim >= 0.5) & (cx - wide - rim <= ends[0])
    inside = np.flatnonzero(inside & (cy + tall + rim >= 0.5) & (cy - tall - rim <= ends[1]))
    inside = inside[np.argsort(depth[seen[inside]], kind="stable")]
    names = (seen, cx, cy, xx, xy, yy, determinant, support, rim, wide, tall)
    seen, cx, cy, xx, xy, yy, determinant, support, rim, wide, tall = (values[inside] for values in names)

    def tiles_between(low: np.ndarray, high: np.ndarray, last: float) -> tuple[np.ndarray, np.ndarray]:
        """The first tile, and the number of tiles, of which the middle of a pixel lies between two coordinates."""
        first = np.ceil((np.maximum(low, 0.5) + 0.5) / tile).astype(np.int32) - 1
        end = np.floor((np.minimum(high, last) - 0.5) / tile).astype(np.int32) + 1
        return first, np.maximum(end - first, 0)

    tile = TILE
    while True:
        first, count = tiles_between(cy - tall - rim, cy + tall + rim, ends[1])
        _, across = tiles_between(cx - wide - rim, cx + wide + rim, ends[0])
        if (count * across.astype(np.int64)).sum() <= MOST_ENTRIES or tile >= max(size):
            break
        tile *= 2
    columns, rows = (-(-side // tile) for side in size)
    # Rows of tiles, and in each those between the ellipse's ends within the row.
    owner = owners(count, np.int32)
    row = ranges(first, count, np.int32)
    below = row * np.float32(tile) + 0.5 - cy[owner] - rim[owner]
    above = below + np.float32(tile - 1) + 2 * rim[owner]
    lean, half = (xy / xx)[owner], tall[owner]
    touches = (xy / yy * wide)[owner]  # how far below its middle the ellipse's right end lies
    narrow = (determinant / xx**2)[owner]
    reach = []
    for side in (-1, 1):
        dy = np.clip(np.clip(-side * touches, below, above), -half, half)
        reach.append(side * np.sqrt(np.maximum((half * half - dy * dy) * narrow, 0)) - lean * dy)
    left, width = tiles_between(cx[owner] + reach[0] - rim[owner], cx[owner] + reach[1] + rim[owner], ends[0])
    where = ranges(row * columns + left, width, np.int32)
    if planes is None:
        order = np.argsort(where.astype(np.uint16) if columns * rows <= 1 << 16 else where, kind="stable")
    else:
        of = np.repeat(owner, width)
        x, y = (at * tile + np.float32(0.5 * tile) for at in (where % columns, where // columns))
        found = depth[seen[of]]
        # Opaque ones are taken together by what their middles reach: a side of a body, seen at a slant, would be far
        # before the others in its plane.
        through = np.flatnonzero(code[seen[of]].astype(np.int32) & TRANSLUCENT)
        of, x, y = of[through], x[through], y[through]
        found[through] = planes.depth(seen[of], found[through], x - cx[of], y - cy[of])
        # Depths are positive, so that their bits are in their order.
        bits = found.view(np.int32)
        order = np.argsort(where.astype(np.int64) << 32 | bits, kind="stable")
    amount = np.bincount(where, minlength=columns * rows)
    tiles = np.stack([starts(amount), amount], axis=1).reshape(rows, columns, 2)
    return TileLists(tile, tiles, seen[np.repeat(owner, width)[order]])
