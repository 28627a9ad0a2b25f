"""Chooses the groups at which indirect light is gathered: in each tile of pixels one for each surface."""

from __future__ import annotations

import numpy as np

from ....core.numeric.record import record
from ...passes.uniforms import SampleView

DEPTHS = 4.0  # tiles' sides along a line of sight that one receiver stands for
TURNS = 2  # steps of normals along each axis, either way


@record
class Receivers:
    """R groups of a list, sorted by tile."""

    rows: np.ndarray  # (R,) int64, of the list
    pixels: np.ndarray  # (R, 2) float32: where in the picture they are
    tiles: np.ndarray  # (rows, columns, 2) float32: the first receiver of each tile, and how many it has


def choose_receivers(
    place: np.ndarray, up: np.ndarray, pixel: np.ndarray, view: SampleView, side: int, fewest: int, every: bool
) -> Receivers:
    """Chooses receivers among N groups.

    place, up: (N, 4) as of shaders/indirect/group_points.frag. pixel: (N,), row by row. `side`: of a tile, in pixels.
    `fewest`: groups that a receiver stands for; `every`: tiles without so many of a kind have one of their largest.
    """
    width, height = view.size
    number = pixel.astype(np.int64)
    x, y = number % width, number // width
    columns, rows = -(-width // side), -(-height // side)
    tile = (y // side) * columns + x // side
    focal = view.camera.pixel_from_view()[0]
    depth, there = place[:, 3].astype(np.float64), place[:, 3] != 0
    if view.camera.perspective:
        nearest = depth[there].min(initial=np.inf)
        far = np.floor(np.log(np.where(there, depth / nearest, 1.0)) * (focal / (DEPTHS * side)))
    else:
        far = np.floor(depth * (focal / (DEPTHS * side)))
    far = (far - far.min()).astype(np.int64) & 0xFFFF
    turn = np.clip(np.floor((up[:, :3] * 0.999 + 1) * TURNS).astype(np.int64), 0, 2 * TURNS - 1)
    turned = (turn[:, 0] * 2 * TURNS + turn[:, 1]) * 2 * TURNS + turn[:, 2]
    key = (tile << 23) | (far << 7) | turned
    middle = 0.5 * (side - 1)
    away = ((x % side - middle) ** 2 + (y % side - middle) ** 2).astype(np.int64)
    order = np.argsort((key << 12 | np.minimum(away * 4, 4095))[there], kind="stable")
    kept = np.flatnonzero(there)[order]
    new = np.append(True, key[kept][1:] != key[kept][:-1]) if len(kept) else np.zeros(0, bool)
    first = np.flatnonzero(new)
    number = np.diff(np.append(first, len(kept)))
    large = number >= fewest
    if every and len(first):
        tiles_of = tile[kept[first]]
        begin = np.flatnonzero(np.append(True, tiles_of[1:] != tiles_of[:-1]))
        largest = np.repeat(np.maximum.reduceat(number, begin), np.diff(np.append(begin, len(first))))
        large |= number == largest
    chosen = kept[first[large]]
    counts = np.bincount(tile[chosen], minlength=rows * columns)
    starts = np.cumsum(counts) - counts
    tiles = np.stack([starts, counts], axis=1).astype(np.float32).reshape(rows, columns, 2)
    return Receivers(chosen, np.stack([x[chosen], y[chosen]], axis=1).astype(np.float32) + np.float32(0.5), tiles)
