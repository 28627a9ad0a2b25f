"""What is out of focus, and what is translucent before and behind it: each pixel goes through the splats of its tile
from the front (core/lens/defocus.py), once for all samples of the picture.

The pass `light` (passes/translucent.py) leaves of each splat, one texel each:
  place   centre in pixels from the principal point, depth, kernel's middle: share of the lens; optical depth
  shape   inverse of the covariance (xx, xy, yy); exponent of the kernel, plus what kind it is (lib/splat/defocus.glsl)
  source  radiance, reach in depth
  tint    as in passes/translucent.py
Tiles hold the column and the row at which their entries begin in the list, and their number.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.lens.defocus import FAINT, RIM
from ...core.numeric.segments import owners, ranges, starts
from ...shading.interface import Interface
from ..device.packing import PAGE_WIDTH, paged
from ..device.protocol import Device, Target, Texture, whole
from .common import FRAME
from .shade import lighting_defines, lighting_samplers
from .tiles import TILE_DEFINE

TILE = 4  # pixels on a side of tiles
MOST_ENTRIES = 1 << 24  # of all tiles: beyond it they are made larger


def defocus_program(
    lighting: tuple[str, ...], transparent: bool, tint: bool, holdout: bool, adaptive: bool, tile: int
) -> Interface:
    """`lighting`: of which what the world is is used. `adaptive`: pixels differ in how many samples they have."""
    world = tuple(name for name in lighting if name in ("PS_HAS_WORLD", "PS_HAS_ENVIRONMENT", "PS_BACKDROP"))
    named = {
        "PS_BACKGROUND": not transparent and "PS_BACKDROP" not in world,
        "PS_TINT": tint,
        "PS_HOLDOUT": holdout,
        "PS_ADAPTIVE": adaptive,
    }
    read = ["splat_place", "shape", "source", "list", "tiles", "focused", "focus"]
    read += ["tint"] * tint + ["counts"] * adaptive
    return Interface(
        "defocus", fragment="defocus/gather.frag", block=FRAME, outputs=(("vec4", "out_combined"),),
        samplers=(*(("FLOAT_2D", f"ps_{name}") for name in read), *lighting_samplers(world)),
        defines=(*lighting_defines(world), ("PS_TILE_SIZE", str(tile)), *((TILE_DEFINE,) if adaptive else ()),
                 *((name, "1") for name, on in named.items() if on)),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class TileLists:
    """Which splats each tile of a picture shows, the nearest first."""

    tile: int  # pixels on a side
    tiles: np.ndarray  # (rows, columns, 2) int64: first entry and number of entries
    entries: np.ndarray  # (E,) int64, rows of the splats


def tile_lists(place: np.ndarray, shape: np.ndarray, focal: np.ndarray, size: tuple[int, int]) -> TileLists:
    """Of splats (N, 4) each, as the pass `light` left them; focal: fx, fy, cx, cy; size: of the picture in pixels."""
    # Columns one by one: reducing rows of four takes several times as long.
    x, y, depth, peak = np.ascontiguousarray(place.T)
    xx, xy, yy, code = np.ascontiguousarray(shape.T)
    with np.errstate(all="ignore"):
        seen = np.flatnonzero((peak > 0) & np.isfinite(x + y + depth + peak) & np.isfinite(xx + xy + yy + code))
    cx, cy = (values[seen] + middle for values, middle in zip((x, y), focal[2:].astype(np.float32), strict=True))
    k = code[seen] % 8
    # Where splats end. The rims of disks are as soft as a pixel is wide.
    faint = FAINT / np.maximum(peak[seen], 1)
    support = 2 * (k + 2) * (1 - faint ** (1 / np.maximum(k, 1e-3)))
    rim = np.where(RIM**k > faint, np.float32(0.5), np.float32(0))
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
        """The first tile, and the number of tiles, of which the middle of a pixel lies between two places."""
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
    order = np.argsort(where.astype(np.uint16) if columns * rows <= 1 << 16 else where, kind="stable")
    amount = np.bincount(where, minlength=columns * rows)
    tiles = np.stack([starts(amount), amount], axis=1).reshape(rows, columns, 2)
    return TileLists(tile, tiles, seen[np.repeat(owner, width)[order]])


class Defocus:
    """The tiles of one view on the device."""

    @whole
    def __init__(self, device: Device, lists: TileLists) -> None:
        self.device, self.tile = device, lists.tile
        size, data = paged(lists.entries[:, None].astype(np.float32), 1)
        self.list = device.texture(size, "R32F", data)
        rows, columns, _ = lists.tiles.shape
        texels = np.zeros((rows, columns, 4), np.float32)
        texels[..., 0] = lists.tiles[..., 0] % PAGE_WIDTH
        texels[..., 1] = lists.tiles[..., 0] // PAGE_WIDTH
        texels[..., 2] = lists.tiles[..., 1]
        self.tiles = device.texture((columns, rows), "RGBA32F", texels.reshape(-1))

    def draw(
        self,
        program: Interface,
        target: Target,
        record: np.ndarray,
        lit: dict[str, Texture],
        textures: dict[str, Texture],
    ) -> None:
        """`lit`: what `light` left; `textures`: the picture of what is in focus, and the world's."""
        read = {"ps_splat_place": lit["ps_place"], **{k: v for k, v in lit.items() if k != "ps_place"}, **textures}
        read |= {"ps_list": self.list, "ps_tiles": self.tiles}
        self.device.draw(program, target, uniforms=record, textures=read)

    def release(self) -> None:
        self.list.release()
        self.tiles.release()
