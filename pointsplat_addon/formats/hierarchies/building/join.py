"""Puts the chunks of a build together: pages above them, and all pages in one file."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ..pages import Layout
from ..psh import HEAD, PAGE, pack_directory, pack_head
from .files import COPIED, Arrays, written
from .nodes import Elements, joined, merged, pack_nodes
from .octree import Cell, Cube, cube_of_cell
from .subtree import page_entry


@dataclass
class _Root:
    """The first page of a chunk's pages."""

    cell: Cell
    file: int
    part: int


class _Upper:
    """Makes the pages above the chunks, children before parents, and spools their bytes."""

    def __init__(self, layout: Layout, cube: Cube, files: Sequence[Path], spool: BinaryIO) -> None:
        self.layout, self.cube, self.files, self.spool = layout, cube, files, spool
        self.pages: list[Any] = []
        self.parent_of: dict[tuple[int, int], int] = {}  # upper page of each chunk's first page, -1: it is the root
        self.saturation = 0.0

    def page(self, roots: list[_Root], level: int, parent: int) -> tuple[Elements, np.ndarray]:
        """Elements and bounds (2, 3) of the page over some chunks, of which more than one lie in no smaller cell of
        `level`; adds the pages above them."""
        if len(roots) == 1:
            self.parent_of[roots[0].file, roots[0].part] = parent
            return self._top(roots[0])
        children: list[list[_Root]] = []
        while True:
            # The cell of the next level of each chunk; chunks follow in Morton order.
            octant = [r.cell.code >> 3 * (r.cell.level - level - 1) for r in roots]
            children = [[r for r, o in zip(roots, octant, strict=True) if o == one] for one in sorted(set(octant))]
            if len(children) > 1:
                break
            level += 1
        number = len(self.pages)
        self.pages.append(None)
        parts = [self.page(child, level + 1, number) for child in children]
        cell = Cell(level, roots[0].cell.code >> 3 * (roots[0].cell.level - level), 0)
        low, edge = cube_of_cell(self.cube, cell)
        elements, spacing = merged(joined([p[0] for p in parts]), low, edge)
        bounds = np.stack([np.min([p[1][0] for p in parts], axis=0), np.max([p[1][1] for p in parts], axis=0)])
        blob, corner, step, longest = pack_nodes(self.layout, elements, self.saturation)
        self.pages[number] = page_entry(
            self.spool.tell(), bounds, corner, step, np.append(low, edge), parent, elements.rows.shape[1], blob, 0,
            spacing, longest,
        )  # fmt: skip
        self.spool.write(blob)
        return elements, bounds

    def _top(self, root: _Root) -> tuple[Elements, np.ndarray]:
        """Elements and bounds of a chunk's first page."""
        with Arrays(self.files[root.file]) as chunk:
            first, stop = chunk.rows("element", root.part, root.part + 2).tolist()
            rows = np.ascontiguousarray(chunk.rows("rows", first, stop).T)
            names = [name for name in chunk.facts["arrays"] if name.startswith("class ")]
            classes = {name[6:]: chunk.rows(name, first, stop) for name in names}
            [page] = chunk.rows("first", root.part, root.part + 1).tolist()
            bounds = chunk.rows("pages", page, page + 1)["bounds"][0]
        return Elements(rows, classes), bounds


def join(
    output: Path, folder: Path, layout: Layout, cube: Cube, groups: Sequence[Sequence[Cell]], facts: dict[str, Any],
    progress: Callable[[float], None],
) -> None:  # fmt: skip
    """Writes the file of all chunks, under its name when it is whole. `facts`: what the directory says beside the
    layout. Raises OSError."""
    files = [folder / f"chunk-{i}.pages" for i in range(len(groups))]
    roots = [_Root(cell, i, j) for i, group in enumerate(groups) for j, cell in enumerate(group)]
    roots.sort(key=lambda r: r.cell.range(cube.depth))
    with (folder / "upper.part").open("w+b") as spool, written(output) as out:
        upper = _Upper(layout, cube, files, spool)
        upper.saturation = _mean_saturation(files, groups)
        upper.page(roots, 0, -1)
        out.write(bytes(HEAD.size))
        spool.flush()
        spool.seek(0)
        shutil.copyfileobj(spool, out, COPIED)
        pages = [np.array(upper.pages, PAGE)]
        pages[0]["offset"] += np.uint64(HEAD.size)
        before = len(upper.pages)
        for i, path in enumerate(files):
            with Arrays(path) as chunk:
                found, first = chunk.rows("pages"), chunk.rows("first")
                found["offset"] += np.uint64(out.tell())
                local = np.repeat(first[:-1], np.diff(first))
                above = np.repeat([upper.parent_of[i, j] for j in range(len(first) - 1)], np.diff(first))
                found["parent"] = np.where(found["parent"] < 0, above, found["parent"] + local + before)
                chunk.copy("blobs", out)
            pages.append(found)
            before += len(found)
            progress((i + 1) / len(files))
        ordered = breadth_first(np.concatenate(pages))
        directory = pack_directory({**facts, "color": layout.color, "normal": layout.normal,
                                    "attributes": [list(a) for a in layout.attributes]}, ordered)  # fmt: skip
        end = out.tell()
        out.write(directory)
        out.seek(0)
        out.write(pack_head(directory, end))
        out.flush()
        os.fsync(out.fileno())
    (folder / "upper.part").unlink(missing_ok=True)


def _mean_saturation(files: Sequence[Path], groups: Sequence[Sequence[Cell]]) -> float:
    total = weight = 0.0
    for path, group in zip(files, groups, strict=True):
        with Arrays(path) as chunk:
            for cell, value in zip(group, chunk.facts["saturation"], strict=True):
                total, weight = total + cell.points * value, weight + cell.points
    return total / weight


def breadth_first(pages: np.ndarray) -> np.ndarray:
    """The pages (P,) PAGE breadth first, with their levels; parents come before children in the given order."""
    parent = pages["parent"].astype(np.int64)
    by_parent = np.argsort(parent, kind="stable")
    first = np.searchsorted(parent[by_parent], np.arange(len(pages) + 1))
    order, level, front = [], [], by_parent[: first[0]]
    while len(front):
        level.append(np.full(len(front), len(order)))
        order.append(front)
        count = first[front + 1] - first[front]
        at = np.repeat(first[front] - (np.cumsum(count) - count), count) + np.arange(count.sum())
        front = by_parent[at]
    together = np.concatenate(order)
    place = np.empty(len(pages), np.int64)
    place[together] = np.arange(len(pages))
    found = pages[together]
    found["level"] = np.concatenate(level)
    found["parent"][1:] = place[found["parent"][1:]]
    return found
