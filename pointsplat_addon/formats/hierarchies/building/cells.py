"""Which cells of the octree are built together as one chunk."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .octree import Cell, place_of, spread_bits

CHUNK = 1 << 20  # points of a chunk at most, but where a cell of the finest level holds more
MOST_CELLS = 64  # that one task builds
NEAR = 4  # levels below a chunk: cells of which a layer around it is read for the neighbours of its points


def chunks_of(cell: np.ndarray, count: np.ndarray, depth: int) -> list[Cell]:
    """The largest cells of at most CHUNK points, in Morton order, of points (C,) in cells of level `depth`, rising."""
    total = np.concatenate([[0], np.cumsum(count)])
    found: list[Cell] = []
    codes = np.zeros(1, np.int64)
    for level in range(depth + 1):
        shift = 3 * (depth - level)
        low = np.searchsorted(cell, codes << shift)
        high = np.searchsorted(cell, (codes + 1) << shift)
        points = total[high] - total[low]
        done = (points <= CHUNK) | (level == depth)
        found += [
            Cell(level, code, n) for code, n in zip(codes[done].tolist(), points[done].tolist(), strict=True) if n > 0
        ]
        codes = (8 * codes[~done][:, None] + np.arange(8)).ravel()
    return sorted(found, key=lambda c: c.range(depth))


def groups_of(chunks: Sequence[Cell]) -> list[list[Cell]]:
    """Chunks that one task builds: neighbours of at most CHUNK points together, or one."""
    found: list[list[Cell]] = []
    together = 0
    for chunk in chunks:
        if not found or together + chunk.points > CHUNK or len(found[-1]) == MOST_CELLS:
            found.append([])
            together = 0
        found[-1].append(chunk)
        together += chunk.points
    return found


def layer_around(chunk: Cell, finest: int) -> tuple[np.ndarray, np.ndarray]:
    """Ranges of codes (R,), of level `finest`, of the cells around a chunk: a layer as wide as its edge over 2^NEAR,
    or as a cell of that level."""
    depth = min(chunk.level + NEAR, finest)
    inside = 1 << (depth - chunk.level)
    place = np.array(place_of(chunk.code, chunk.level)) * inside
    side = np.arange(-1, inside + 1)
    x, y, z = (g.ravel() for g in np.meshgrid(side, side, side, indexing="ij"))
    outer = (x < 0) | (y < 0) | (z < 0) | (x == inside) | (y == inside) | (z == inside)
    around = np.stack([x, y, z])[:, outer] + place[:, None]
    around = around[:, ((around >= 0) & (around < 1 << depth)).all(axis=0)]
    table = spread_bits(depth) if depth else np.zeros(1, np.uint64)
    code = np.zeros(around.shape[1], np.uint64)
    for axis in range(3):
        code |= table[around[axis]] << np.uint64(axis)
    code = np.sort(code).astype(np.int64)
    shift = 3 * (finest - depth)
    return code << shift, (code + 1) << shift
