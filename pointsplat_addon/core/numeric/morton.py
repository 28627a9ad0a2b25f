"""Points in Morton order: the order of the cells of an octree of DEPTH levels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .segments import batches, sorted_places
from .vectors import each_block, moved_rows

DEPTH = 20  # levels: bits of each coordinate
SPREAD = (
    (32, 0x1F00000000FFFF),
    (16, 0x1F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)
COARSE = 15  # leading bits of codes by which they are sorted first
FEW = 1 << 12  # codes: fewer are compared in less time than digits are counted
TOGETHER = 1 << 18  # codes that are sorted together afterwards, so that they stay in the cache


def morton_codes(position: np.ndarray) -> tuple[np.ndarray, float]:
    """Codes (N,) uint64 of the cells of positions (N, 3) float32, finite, and the side of the cube that holds them."""
    low = [float(column.min()) for column in position.T]
    side = max(float(column.max()) - least for column, least in zip(position.T, low, strict=True))
    side = max(side * (1 + 2.0**-20), 1e-30)
    return codes_in_cube(position.T, low, side), side


def codes_in_cube(columns: np.ndarray, low: Sequence[float], side: float) -> np.ndarray:
    """Codes (N,) uint64 of the cells of a cube, with the low corner `low`, in which positions (3, N) float32 lie;
    those outside of it count to the nearest cells."""
    code = np.empty(columns.shape[1], np.uint64)
    most = np.nextafter(np.float32(2.0**DEPTH), np.float32(0))

    def fill(block: slice) -> None:
        found = np.zeros(block.stop - block.start, np.uint64)
        for axis, (column, least) in enumerate(zip(columns, low, strict=True)):
            with np.errstate(over="ignore"):
                cell = (column[block] - least) * (2.0**DEPTH / side)
            cell = np.clip(cell, 0, most).astype(np.uint64)
            for shift, mask in SPREAD:
                cell |= cell << np.uint64(shift)
                cell &= np.uint64(mask)
            cell <<= np.uint64(axis)
            found |= cell
        code[block] = found

    each_block(columns.shape[1], fill)
    return code


def sorted_by_code(code: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The order (N,) integers that sorts codes (N,) uint64, equal ones as they come, and the codes in it."""
    shift = np.uint64(3 * DEPTH - COARSE)
    coarse = (code >> shift).astype(np.uint16)
    places = sorted_places(coarse)
    order, code = moved_rows(np.arange(len(code), dtype=places.dtype), places), moved_rows(code, places)
    parts = list(batches(np.bincount(coarse, minlength=1 << COARSE), TOGETHER))
    ends = np.cumsum(np.bincount(coarse, minlength=1 << COARSE))

    def sort(which: slice) -> None:
        for a, b in parts[which]:
            some = slice(int(ends[a - 1]) if a else 0, int(ends[b - 1]))
            index = _order_within(code[some])
            code[some] = code[some][index]
            order[some] = order[some][index]

    each_block(len(parts), sort, 1)
    return order, code


def _order_within(code: np.ndarray) -> np.ndarray:
    """The order (n,) that sorts codes (n,) uint64, equal ones as they come."""
    if len(code) < FEW:
        return np.argsort(code, kind="stable")
    order = None
    for shift in range(0, 3 * DEPTH, COARSE):  # the last digit first; NumPy sorts 16 bits by counting them
        digit = (code >> np.uint64(shift)).astype(np.uint16) & np.uint16((1 << COARSE) - 1)
        order = np.argsort(digit, kind="stable") if order is None else order[np.argsort(digit[order], kind="stable")]
    assert order is not None
    return order
