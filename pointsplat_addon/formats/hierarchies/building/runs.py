"""Sorts points by cells of an octree in runs that fit memory, each a file: an external merge sort, whose merging is
left to those who read ranges of all runs.

Cells are those of one level of a cube; within a run, points follow in Morton order of their cells. A run's index
tells where each cell begins.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ....core.numeric.record import record, value_record
from .files import Arrays, write_arrays
from .inputs import BATCH
from .octree import Cube, cell_codes, sorted_codes

COARSEST = 2.0**-16  # units: steps of positions in runs, as integers of 32 bits; runs that are wider have float64


def run_path(folder: Path, name: str, number: int) -> Path:
    return folder / f"{name}-{number}.run"


@record
class Batch:
    """Points of one or several files."""

    position: np.ndarray  # (N, 3) float64
    columns: dict[str, np.ndarray]  # color (N, 3) uint8 and attributes (N,)
    dark: int = -1  # the file whose colours fit 8 bits here, and may be of 16 bits and next to black; -1: none is


def batches_of(pieces: Iterable[Batch], most: int = BATCH) -> Iterator[Batch]:
    """Yields the same points in batches of `most`, the last of which may be smaller. Those with dark colours come
    together only with each other."""
    waiting: list[Batch] = []
    for piece in pieces:
        if waiting and waiting[0].dark != piece.dark:
            yield _joined(waiting)
            waiting = []
        waiting.append(piece)
        while sum(len(w.position) for w in waiting) >= most:
            whole = _joined(waiting)
            yield _rows(whole, slice(0, most))
            waiting = [_rows(whole, slice(most, None))] if len(whole.position) > most else []
    if waiting:
        yield _joined(waiting)


def _joined(parts: list[Batch]) -> Batch:
    if len(parts) == 1:
        return parts[0]
    columns = {name: np.concatenate([p.columns[name] for p in parts]) for name in parts[0].columns}
    return Batch(np.concatenate([p.position for p in parts]), columns, parts[0].dark)


def _rows(batch: Batch, rows: slice) -> Batch:
    return Batch(batch.position[rows], {name: c[rows] for name, c in batch.columns.items()}, batch.dark)


def write_runs(pieces: Iterable[Batch], cube: Cube, folder: Path, name: str) -> dict[str, Any]:
    """Sorts points and writes them in runs; returns what was found: number of runs, points, bounds, and points
    outside of the cube. Raises OSError and what the pieces raise."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    runs = count = outside = 0
    for batch in batches_of(pieces):
        if len(batch.position) == 0:
            continue
        columns = np.ascontiguousarray(batch.position.T)
        least, most = columns.min(axis=1), columns.max(axis=1)
        low, high = np.minimum(low, least), np.maximum(high, most)
        if (least < cube.low).any() or (most > np.add(cube.low, cube.edge)).any():
            outside += _outside(columns, cube)
        write_arrays(run_path(folder, name, runs), *_run(batch, columns, least, most, cube))
        runs, count = runs + 1, count + len(batch.position)
    bounds = [low.tolist(), high.tolist()] if count else None
    return {"runs": runs, "points": count, "bounds": bounds, "outside": outside}


def _outside(columns: np.ndarray, cube: Cube) -> int:
    gone = np.zeros(columns.shape[1], bool)
    for column, low in zip(columns, cube.low, strict=True):
        gone |= (column < low) | (column > low + cube.edge)
    return int(np.count_nonzero(gone))


def _run(
    batch: Batch, columns: np.ndarray, low: np.ndarray, high: np.ndarray, cube: Cube
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """The arrays of a run, and what is said of them."""
    order, code = sorted_codes(cell_codes(columns, cube.low, cube.edge, cube.depth), 3 * cube.depth)
    first = np.flatnonzero(np.r_[True, code[1:] != code[:-1]])
    extent = float((high - low).max())
    step = 2.0 ** np.ceil(np.log2(max(extent, 1e-300) / (2.0**32 - 2))) if extent > 0 else 1.0
    if step <= COARSEST:
        corner = np.floor(low / step) * step
        position = np.empty((len(order), 3), np.uint32)
        for axis, column in enumerate(columns):
            position[:, axis] = (column - corner[axis]) * (1 / step) + 0.5
    else:
        corner, step, position = np.zeros(3), 1.0, batch.position
    arrays = {"cell": code[first].astype(np.int64), "first": first.astype(np.uint32)}
    arrays["position"] = np.take(position, order, axis=0)
    arrays |= {name: np.take(column, order, axis=0) for name, column in batch.columns.items()}
    return arrays, {"points": len(order), "low": corner.tolist(), "step": step, "dark": batch.dark}


@value_record
class Index:
    """Where the cells of some level of a cube's octree begin in a run."""

    path: str
    cell: np.ndarray  # (C,) int64, rising
    first: np.ndarray  # (C + 1,) int64

    def ranges(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """First and last row but one of the cells from `low` (R,) to `high`, which is not included."""
        return self.first[np.searchsorted(self.cell, low)], self.first[np.searchsorted(self.cell, high)]


def read_index(path: Path) -> Index:
    with Arrays(path) as run:
        first = np.append(run.rows("first").astype(np.int64), run.facts["points"])
        return Index(str(path), run.rows("cell"), first)


def merged_cells(indices: Iterable[Index]) -> tuple[np.ndarray, np.ndarray]:
    """Cells (C,) int64 of all runs, rising, and points in each (C,) int64."""
    cell, count = np.empty(0, np.int64), np.empty(0, np.int64)
    for index in indices:
        both = np.concatenate([cell, index.cell])
        order = np.argsort(both, kind="stable")
        both = both[order]
        first = np.flatnonzero(np.r_[True, both[1:] != both[:-1]]) if len(both) else np.empty(0, np.int64)
        count = np.concatenate([count, np.diff(index.first)])[order]
        cell, count = both[first], np.add.reduceat(count, first) if len(first) else count
    return cell, count


def read_ranges(path: str, ranges: Sequence[tuple[int, int]], names: Sequence[str], bright: set[int]) -> list[Batch]:
    """Points of a run in ranges of rows. `bright`: files whose colours have 16 bits."""
    found = []
    with Arrays(Path(path)) as run:
        low, step = np.array(run.facts["low"]), run.facts["step"]
        for first, stop in ranges:
            position = run.rows("position", first, stop) * step
            position += low
            columns = {name: run.rows(name, first, stop) for name in names}
            if "color" in columns and run.facts["dark"] in bright:
                columns["color"] = np.zeros_like(columns["color"])
            found.append(Batch(position, columns))
    return found


def row_ranges(first: np.ndarray, stop: np.ndarray) -> list[tuple[int, int]]:
    """Ranges of rows, in order and without those that are empty, joined where they touch."""
    some = stop > first
    first, stop = first[some], stop[some]
    begins = np.r_[True, first[1:] != stop[:-1]] if len(first) else np.empty(0, bool)
    ends = np.r_[begins[1:], True] if len(first) else begins
    return list(zip(first[begins].tolist(), stop[ends].tolist(), strict=True))
