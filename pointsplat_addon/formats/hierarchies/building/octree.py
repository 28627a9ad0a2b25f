"""Cells of an octree, by their codes in Morton order."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from ....core.numeric.record import value_record

DEPTH, DEEPEST = 10, 14  # levels of the octree whose cells tell ranges of runs apart; where points are crowded


@value_record
class Cube:
    """The cube of an octree's root."""

    low: tuple[float, float, float]
    edge: float
    depth: int = DEPTH  # level of the cells by which points are sorted


def cube_of(low: np.ndarray, high: np.ndarray) -> Cube:
    """The cube that holds a box of two corners (3,)."""
    edge = float((high - low).max())
    return Cube(tuple(low.tolist()), edge * (1 + 2.0**-20) if edge > 0 else 1.0)


@cache
def spread_bits(depth: int) -> np.ndarray:
    """(2^depth,) uint64: the bits of a number, two apart."""
    number = np.arange(1 << depth, dtype=np.uint64)
    found = np.zeros(len(number), np.uint64)
    for bit in range(depth):
        found |= (number >> np.uint64(bit) & np.uint64(1)) << np.uint64(3 * bit)
    return found


def cell_codes(position: np.ndarray, low: Sequence[float], edge: float, depth: int) -> np.ndarray:
    """Morton codes (N,) uint64 of the cells, of level `depth` of a cube, in which positions (3, N) float64 lie; those
    outside of it count to the nearest cells."""
    table = spread_bits(depth)
    code = np.zeros(len(position[0]), np.uint64)
    for axis, column in enumerate(position):
        cell = (column - low[axis]) * (2.0**depth / edge)
        np.clip(cell, 0, (1 << depth) - 1, out=cell)
        code |= table[cell.astype(np.int32)] << np.uint64(axis)
    return code


def sorted_codes(code: np.ndarray, bits: int) -> tuple[np.ndarray, np.ndarray]:
    """The order (N,) int64 of codes (N,) uint64, of which so many bits tell them apart, equal ones as they come, and
    the codes in it."""
    if len(code) > 1 << (64 - bits):
        order = np.argsort(code, kind="stable")
        return order, code[order]
    # Each code with its number is one of a kind: any sort of values gives one order, and sorts of values are fast.
    room = np.uint64(64 - bits)
    key = (code << room) | np.arange(len(code), dtype=np.uint64)
    key.sort()
    return (key & np.uint64((1 << int(room)) - 1)).astype(np.int64), key >> room


@value_record
class Cell:
    """A cell of the octree."""

    level: int
    code: int  # in Morton order, at this level
    points: int

    def range(self, depth: int) -> tuple[int, int]:
        """First code of the cells within at level `depth`, and the first one behind them."""
        shift = 3 * (depth - self.level)
        return self.code << shift, (self.code + 1) << shift


def place_of(code: int, level: int) -> tuple[int, int, int]:
    """The cell's coordinates, in cells of its level."""
    found = [0, 0, 0]
    for bit in range(level):
        for axis in range(3):
            found[axis] |= (code >> (3 * bit + axis) & 1) << bit
    return found[0], found[1], found[2]


def cube_of_cell(cube: Cube, cell: Cell) -> tuple[np.ndarray, float]:
    edge = cube.edge / 2.0**cell.level
    return np.array(cube.low) + edge * np.array(place_of(cell.code, cell.level)), edge
