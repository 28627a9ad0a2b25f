"""Builds the pages over the points of one cell of the octree: leaves of points, and pages of nodes above them."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field

import numpy as np

from ....core.lod.balls.tree import saturation
from ..pages import Layout, encode_normal, encode_position, grid_of, pack
from ..psh import LEAF, PAGE, WIDE
from .nodes import FINEST, MOST, Elements, elements_of_points, joined, merged, pack_nodes
from .octree import cell_codes, sorted_codes
from .runs import Batch

EVERY = 32  # of so many points one is asked for its nearest neighbour
WINDOW = 10  # points on either side in Morton order among which it is looked for
LOOKED_AT = 512  # points that tell how evenly a chunk is sampled


@dataclass
class _Cell:
    """A cell that becomes a page: rows of points from `first` to `stop`."""

    level: int
    first: int
    stop: int
    children: list[_Cell] = field(default_factory=list)


@dataclass
class Subtree:
    """Pages of a cell, parents before children, and the elements of the first."""

    pages: np.ndarray  # (P,) PAGE; `parent` counts among these, -1: the first; `offset` from the first blob
    blobs: list[bytes]
    top: Elements
    saturation: float


def build_subtree(layout: Layout, points: Batch, low: np.ndarray, edge: float) -> Subtree:
    """Returns the pages over N > 0 points in a cube: low corner (3,) and edge. Points outside of it belong to the
    nearest of its cells."""
    position = np.ascontiguousarray(points.position.T)
    order, code = sorted_codes(cell_codes(position, low.tolist(), edge, FINEST), 3 * FINEST)
    position = np.stack([column[order] for column in position])
    columns = {name: np.take(column, order, axis=0) for name, column in points.columns.items()}
    root = _split(code)
    spacing = _spacings(position, root)
    even = saturation((position - low[:, None]).T.astype(np.float32), LOOKED_AT)
    build = _Build(layout, position, columns, code, spacing, low, edge, even)
    top = build.page(root, -1)
    return Subtree(np.array(build.pages, PAGE), build.blobs, top, even)


def _split(code: np.ndarray) -> _Cell:
    """The cells that become pages: those of more than MOST points, and the parts of these. Cells that have all points
    of the one above them stand in its place."""
    root = _Cell(0, 0, len(code))
    waiting = [root]
    while waiting:
        cell = waiting.pop()
        while cell.stop - cell.first > MOST and cell.level < FINEST and len(cell.children) < 2:
            cell.level += 1
            octant = code[cell.first : cell.stop] >> np.uint64(3 * (FINEST - cell.level))
            ends = cell.first + np.r_[0, 1 + np.flatnonzero(octant[1:] != octant[:-1]), len(octant)]
            if len(ends) > 2:
                within = zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True)
                cell.children = [_Cell(cell.level, a, b) for a, b in within]
                cell.level -= 1
                waiting += cell.children
    return root


def _leaves(cell: _Cell) -> list[_Cell]:
    """Leaves, in Morton order."""
    return [leaf for child in cell.children for leaf in _leaves(child)] if cell.children else [cell]


def _spacings(position: np.ndarray, root: _Cell) -> dict[int, float]:
    """For each leaf, by its first point, the median distance to the nearest neighbour, of some of its points (3, N) in
    Morton order."""
    count = position.shape[1]
    query = np.arange(EVERY // 2 if count > EVERY else 0, count, EVERY if count > EVERY else 1)
    least = np.full(len(query), np.inf)
    for step in (*range(-WINDOW, 0), *range(1, WINDOW + 1)):
        other = np.clip(query + step, 0, count - 1)
        squared = sum(np.square(column[other] - column[query]) for column in position)
        np.minimum(least, squared, out=least, where=squared > 0)
    found = {}
    all_known = least[np.isfinite(least)]
    typical = float(np.median(all_known)) if len(all_known) else 0.0
    for leaf in _leaves(root):
        some = least[np.searchsorted(query, leaf.first) : np.searchsorted(query, leaf.stop)]
        some = some[np.isfinite(some)]
        found[leaf.first] = float(np.sqrt(np.median(some) if len(some) else typical))
    return found


@dataclass
class _Build:
    """Pages in the making."""

    layout: Layout
    position: np.ndarray  # (3, N), sorted by code
    columns: dict[str, np.ndarray]
    code: np.ndarray  # (N,) uint64
    spacing: dict[int, float]
    low: np.ndarray
    edge: float
    saturation: float
    pages: list[tuple] = field(default_factory=list)
    blobs: list[bytes] = field(default_factory=list)
    offset: int = 0

    def page(self, cell: _Cell, parent: int) -> Elements:
        """Adds the page of a cell and those below it; returns its elements."""
        number = len(self.pages)
        self.pages.append(())  # parents come first
        low, edge = self._cube(cell)
        if cell.children:
            elements, spacing = merged(joined([self.page(child, number) for child in cell.children]), low, edge)
            blob, corner, step, longest = pack_nodes(self.layout, elements, self.saturation)
            flags = 0
        else:
            spacing, longest = self.spacing[cell.first], 0.0
            blob, corner, step, flags = self._leaf(cell)
            elements = self._points(cell, spacing)
        part = self.position[:, cell.first : cell.stop]
        self.pages[number] = page_entry(
            self.offset, np.stack([part.min(axis=1), part.max(axis=1)]), corner, step, np.append(low, edge), parent,
            elements.rows.shape[1], blob, flags, spacing, longest,
        )  # fmt: skip
        self.blobs.append(blob)
        self.offset += len(blob)
        return elements

    def _cube(self, cell: _Cell) -> tuple[np.ndarray, float]:
        prefix = int(self.code[cell.first]) >> 3 * (FINEST - cell.level)
        place = [sum((prefix >> (3 * bit + axis) & 1) << bit for bit in range(cell.level)) for axis in range(3)]
        edge = self.edge / 2.0**cell.level
        return self.low + edge * np.array(place), edge

    def _leaf(self, cell: _Cell) -> tuple[bytes, np.ndarray, np.ndarray, int]:
        rows = slice(cell.first, cell.stop)
        position = self.position[:, rows]
        grid = grid_of(position.min(axis=1), position.max(axis=1), True)
        columns = encode_position(position, grid)
        columns |= {name: column[rows] for name, column in self.columns.items()}
        if self.layout.color:
            columns["color"] = columns["color"].T
        if self.layout.normal:
            columns["normal"] = encode_normal(columns["normal"].T)
        blob = pack(self.layout, True, grid.wide, columns)
        return blob, np.array(grid.low), np.array(grid.step), LEAF | (WIDE if grid.wide else 0)

    def _points(self, cell: _Cell, spacing: float) -> Elements:
        rows = slice(cell.first, cell.stop)
        columns = {name: column[rows] for name, column in self.columns.items()}
        return elements_of_points(self.layout, self.position[:, rows], columns, spacing)


def page_entry(
    offset: int, bounds: np.ndarray, low: np.ndarray, step: np.ndarray, cube: np.ndarray, parent: int, count: int,
    blob: bytes, flags: int, spacing: float, longest: float,
) -> tuple:  # fmt: skip
    """A row of PAGE; its level is not known yet."""
    return (
        offset, bounds, low, step, cube, parent, 0, count, len(blob), zlib.crc32(blob), flags, spacing, longest
    )  # fmt: skip
