"""Smoke drawn into cells of a shadow table finer than its splats, so that shadows are as sharp as these are."""

from __future__ import annotations

from functools import cache

import numpy as np

from ..numeric.segments import offsets
from ..splat.kernel import POWER
from .casters import OPAQUE_DEPTH
from .rows import FINE_EXTENT, GridRows

ACROSS = 4  # cells that a splat touches along a row or a column, at most: FINE_EXTENT is below 1.5
STEPS = 32  # of a cell, along each axis: shares of splats are tabulated for so many places, and linear about each
NODES = 4  # of Gauss's rule, along each axis of a cell
FINE_CHUNK = 1 << 11  # splats that are drawn together, so that their shares stay in the cache
LEAST_SHARE = 1 / 4096  # of a splat: cells with less get nothing
SLAB = 0.5  # of a cell's width: of one cell, entries in so short a piece of the ray become one
MOST_SLABS = 4  # for each entry: where there were more, entries are far apart as they are
FARTHEST_SLAB = 1 << 24


def fine_entries(
    rows: GridRows,
    level: np.ndarray,
    latitude: np.ndarray,
    longitude: np.ndarray,
    distance: np.ndarray,
    strength: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns cells (E,) int32, distances (E,) float32 and optical depths (E,) or (E, 3) float32 of N splats of smoke.

    level: (N,) int32, or (1,) for all; latitude, longitude, distance: (N,) float32; strength: (N,) or (N, 3) float32,
    optical mass over the squared distance, in steradians (of suns: in units^2). All splats are as wide as the widest
    may be in their level: FINE_EXTENT cells from their middle to their rim.
    """
    cells = np.arange(-1, ACROSS - 1, dtype=np.int32)
    place = (latitude - rows.low[level]) / rows.step[level]
    first, between, up = _steps(place)
    row = first[:, None] + cells
    held = (row >= 0) & (row < rows.height[level][:, None])
    row = np.clip(row, 0, rows.height[level][:, None] - 1) + rows.base[level][:, None]
    place = longitude[:, None] * rows.density[row]
    first, again, along = _steps(place)
    share, by_row, by_column = np.moveaxis(_shares()[between[:, None], np.arange(ACROSS), again], 2, 0)
    share = share + up[:, None, None] * by_row + along[..., None] * by_column
    share[~held] = 0
    column = (first - rows.column0[row])[..., None] + cells
    index = np.flatnonzero((share > 0) & (column >= 0) & (column < rows.count[row][..., None]))
    which, row = index // ACROSS**2, row.reshape(-1)[index // ACROSS]
    weight = share.reshape(-1)[index] * rows.inverse_area[row]
    depth = strength[which] * (weight if strength.ndim == 1 else weight[:, None])
    cell = rows.first[row] + column.reshape(-1)[index]
    return cell, distance[which], np.minimum(depth, np.float32(OPAQUE_DEPTH))


def merged_entries(
    rows: GridRows, cell: np.ndarray, distance: np.ndarray, depth: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Takes together what lies next to each other in a cell, at its mean distance: a ray meets few voxels, but each
    cell has entries of all around it.

    Takes and returns what `fine_entries` does, in order of cells and distances where something was taken together.
    """
    level = np.searchsorted(rows.cell_base, [cell.min(), cell.max()], side="right") - 1
    if level[0] != level[1]:
        of_entry = np.searchsorted(rows.cell_base, cell, side="right") - 1
        found = [
            merged_entries(rows, cell[some], distance[some], depth[some])
            for some in (np.flatnonzero(of_entry == one) for one in np.unique(of_entry))
        ]
        cells, distances, depths = zip(*found, strict=True)
        return np.concatenate(cells), np.concatenate(distances), np.concatenate(depths)
    first = cell.min()
    if cell.max() - first > MOST_SLABS * len(cell):
        return cell, distance, depth
    held = np.flatnonzero(np.bincount(cell - first))
    number = np.zeros(held[-1] + 1, np.int32)
    number[held] = np.arange(len(held))
    number = number[cell - first]
    width = SLAB * rows.step[level[0]] * (1 if rows.frame.parallel else distance.min())
    slab = np.minimum((distance - distance.min()) / max(width, 1e-30), FARTHEST_SLAB).astype(np.int32)
    low, high = np.full(len(held), FARTHEST_SLAB, np.int32), np.zeros(len(held), np.int32)
    np.minimum.at(low, number, slab)
    np.maximum.at(high, number, slab)
    start = offsets(high - low + 1)
    if start[-1] > MOST_SLABS * len(cell):
        return cell, distance, depth
    slab += (start[:-1] - low).astype(np.int32)[number]
    channels = depth.reshape(len(depth), -1).T
    total = np.stack([np.bincount(slab, channel, start[-1]) for channel in channels])
    whole = total.sum(axis=0)
    along = np.bincount(slab, channels.sum(axis=0) * distance, start[-1])
    index = np.flatnonzero(whole > 0)
    at = (along[index] / whole[index]).astype(np.float32)
    sums = np.minimum(total[:, index].T, OPAQUE_DEPTH).astype(np.float32)
    cells = np.repeat(held + first, high - low + 1)[index].astype(np.int32)
    return cells, at, sums[:, 0] if depth.ndim == 1 else sums


def _steps(place: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Divides places along a row or a column, in cells: the middle of a cell below each (int32), in which step of
    1 / STEPS of a cell from there it lies (int32), and how far from the middle of that step, in cells (float32)."""
    below = np.floor(place)
    between = STEPS * (place - below)
    step = np.minimum(between.astype(np.int32), STEPS - 1)
    return below.astype(np.int32), step, (between - step - np.float32(0.5)) / np.float32(STEPS)


@cache
def _shares() -> np.ndarray:
    """(STEPS, ACROSS, STEPS, 3, ACROSS) float32: how much of a splat each of ACROSS x ACROSS cells gets, by its place
    between the second and the third along both axes, and its derivatives by the place along rows and columns: the
    kernel (core/splat/kernel.py) integrated over the cell.

    The kernel is round: by products of one along each axis, lattices of voxels that are turned in the plane of the
    cells would not be even.
    """
    place = (np.arange(STEPS) + 0.5) / STEPS
    node, weight = np.polynomial.legendre.leggauss(NODES)
    off = np.arange(-1, ACROSS - 1)[:, None] + node / 2 - place[:, None, None]
    off = off.reshape(STEPS * ACROSS, NODES) / FINE_EXTENT
    found = np.zeros((3, STEPS * ACROSS, STEPS * ACROSS))
    for i, j in np.ndindex(NODES, NODES):
        up, along = off[:, None, i], off[None, :, j]
        left = np.maximum(1 - up * up - along * along, 0)
        steep = 2 * POWER / FINE_EXTENT * left ** (POWER - 1)
        found += weight[i] * weight[j] * np.stack([left**POWER, steep * up, steep * along])
    found = found.reshape(3, STEPS, ACROSS, STEPS, ACROSS)
    found /= found[:1].sum(axis=(2, 4), keepdims=True)
    found *= found[:1] >= LEAST_SHARE
    found /= found[:1].sum(axis=(2, 4), keepdims=True)
    return np.ascontiguousarray(np.moveaxis(found, 0, 3), np.float32)
