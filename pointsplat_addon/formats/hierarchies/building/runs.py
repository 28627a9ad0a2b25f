"""Sorts points by cells of an octree in runs that fit memory, each a file: an external merge sort, whose merging is left
to those who read ranges of all runs.

Cells are those of level DEPTH of a cube; within a run, points follow in Morton order of their cells. A run's index
tells where each cell begins.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ....core.numeric.record import record, value_record
from .inputs import BATCH

DEPTH = 10  # levels of the octree whose cells tell runs' ranges apart
COPIED = 1 << 24  # bytes at once
COARSEST = 2.0**-16  # units: steps of positions in runs, as integers of 32 bits; runs that are wider have float64
STRAY = 1e-3  # share of colours whose low bytes may differ where 16 bits hold 8


@value_record
class Cube:
    """The cube of an octree's root."""

    low: tuple[float, float, float]
    edge: float


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


def cell_codes(position: Sequence[np.ndarray], low: Sequence[float], edge: float, depth: int) -> np.ndarray:
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
    the codes in it. N < 2^(64 - bits)."""
    # Each code with its number is one of a kind: any sort of values gives one order, and sorts of values are fast.
    room = np.uint64(64 - bits)
    key = (code << room) | np.arange(len(code), dtype=np.uint64)
    key.sort()
    return (key & np.uint64((1 << int(room)) - 1)).astype(np.int64), key >> room


# ---------------------------------------------------------------------------- files


@contextlib.contextmanager
def written(path: Path) -> Iterator[Any]:
    """A file that is there as a whole or not at all. Raises OSError."""
    unfinished = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        with unfinished.open("wb") as file:
            yield file
        os.replace(unfinished, path)
    except BaseException:
        with contextlib.suppress(OSError):
            unfinished.unlink()
        raise


def write_json(path: Path, facts: Any) -> None:
    with written(path) as file:
        file.write(json.dumps(facts).encode())


def write_arrays(path: Path, arrays: dict[str, np.ndarray], facts: dict[str, Any]) -> None:
    """Writes arrays, one after the other, behind what is said of them. Raises OSError."""
    table, at = {}, 0
    for name, array in arrays.items():
        table[name] = [array.dtype.descr if array.dtype.names else array.dtype.str, list(array.shape), at]
        at += array.nbytes
    head = json.dumps({**facts, "arrays": table}).encode()
    with written(path) as file:
        file.write(len(head).to_bytes(8, "little") + head)
        for array in arrays.values():
            file.write(np.ascontiguousarray(array).data.cast("B") if array.size else b"")


class Arrays:
    """A file of `write_arrays`, of which ranges of rows are read."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb")
        length = int.from_bytes(self._file.read(8), "little")
        self.facts = json.loads(self._file.read(length))
        self._start = 8 + length

    def _dtype(self, kind: Any) -> np.dtype:
        return np.dtype(
            kind if isinstance(kind, str) else [tuple(tuple(p) if isinstance(p, list) else p for p in f) for f in kind]
        )

    def copy(self, name: str, out: Any) -> None:
        """Writes an array's bytes to a file."""
        kind, shape, at = self.facts["arrays"][name]
        left = self._dtype(kind).itemsize * int(np.prod(shape))
        self._file.seek(self._start + at)
        while left and (part := self._file.read(min(left, COPIED))):
            out.write(part)
            left -= len(part)

    def rows(self, name: str, first: int = 0, stop: int | None = None) -> np.ndarray:
        kind, shape, at = self.facts["arrays"][name]
        dtype, stop = self._dtype(kind), shape[0] if stop is None else stop
        row = dtype.itemsize * int(np.prod(shape[1:]))
        found = np.empty((stop - first, *shape[1:]), dtype)
        self._file.seek(self._start + at + first * row)
        if found.size and self._file.readinto(found.data.cast("B")) != found.nbytes:
            raise OSError(f"{self._file.name} is shorter than it was")
        return found

    def __enter__(self) -> Arrays:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()


# ---------------------------------------------------------------------------- runs


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
    order, code = sorted_codes(cell_codes(columns, cube.low, cube.edge, DEPTH), 3 * DEPTH)
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
    arrays = {"cell": code[first].astype(np.uint32), "first": first.astype(np.uint32)}
    arrays["position"] = np.take(position, order, axis=0)
    arrays |= {name: np.take(column, order, axis=0) for name, column in batch.columns.items()}
    return arrays, {"points": len(order), "low": corner.tolist(), "step": step, "dark": batch.dark}


@value_record
class Index:
    """Where the cells of some level of a cube's octree begin in a run."""

    path: str
    cell: np.ndarray  # (C,) uint32, rising
    first: np.ndarray  # (C + 1,) int64

    def ranges(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """First and last row but one of the cells from `low` (R,) to `high`, which is not included."""
        return self.first[np.searchsorted(self.cell, low)], self.first[np.searchsorted(self.cell, high)]


def read_index(path: Path) -> Index:
    with Arrays(path) as run:
        first = np.append(run.rows("first").astype(np.int64), run.facts["points"])
        return Index(str(path), run.rows("cell"), first)


def merged_cells(indices: Iterable[Index]) -> tuple[np.ndarray, np.ndarray]:
    """Cells (C,) uint32 of all runs, rising, and points in each (C,) int64."""
    cell, count = np.empty(0, np.uint32), np.empty(0, np.int64)
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


# ---------------------------------------------------------------------------- columns of files


def color_bytes(values: np.ndarray) -> tuple[np.ndarray, bool]:
    """Colours (N, C) of a file as (N, 3) uint8, and whether wider fields hold no more than 8 bits.

    Fields of 16 bits often hold 8: as they are, times 256, or times 257.
    """
    values = values[:, :3]
    if values.dtype == np.uint8:
        return np.ascontiguousarray(values), False
    if values.dtype.kind == "f":
        scale = 1.0 if float(np.nanmax(values, initial=0.0)) > 1.0 else 255.0
        return np.clip(np.nan_to_num(values * scale) + 0.5, 0, 255).astype(np.uint8), False
    most = int(values.max(initial=0))
    if most <= 255:
        return np.clip(values, 0, 255).astype(np.uint8), True
    if most > 65535:
        return (values / (np.iinfo(values.dtype).max / 255.0) + 0.5).astype(np.uint8), False
    low, high = values & 255, values >> 8
    if np.count_nonzero((low != 0) & (low != high)) <= STRAY * low.size:
        return high.astype(np.uint8), False
    return (values.astype(np.uint32) * np.uint32(255) + np.uint32(32768) >> np.uint32(16)).astype(np.uint8), False


def attribute_codes(values: np.ndarray, kind: str) -> np.ndarray:
    """A column of a file in the type that the hierarchy keeps; floats from 0 to 1 fill it, what is beyond is clipped."""
    dtype = np.dtype(kind)
    if dtype.kind == "f":
        return values.astype(dtype)
    most = np.iinfo(dtype).max
    if values.dtype.kind == "f":
        values = np.nan_to_num(values)
        values = values * most if len(values) and values.min() >= 0 and values.max() <= 1 else values
        values = np.round(values)
    return np.clip(values, 0, most).astype(dtype)
