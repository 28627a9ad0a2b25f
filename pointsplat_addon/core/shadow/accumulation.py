"""Entries of a shadow table sorted by cell and distance, and summed to cumulated optical depths."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ..numeric import segments
from .casters import KINDS, OPAQUE_DEPTH
from .entries import EntryBlock, concatenate_columns
from .level import MASK_CELLS, TEXEL_CELLS, TableLevel
from .rows import GridRows, ramp_of

SLAB_WIDTH, NARROW_GAP, WIDE_GAP = 1.0, 0.05, 2.0  # cells: distances that tell surfaces from each other, see _hidden
COVERED_DEPTH = 40.0  # optical depth of a cell that a surface covers: 1 - exp(-40) is 1
GROUPS = 18  # bits: cells are counted by groups, at most so many
RUN_ENTRIES = 1 << 14  # entries that are sorted together: their scratch arrays stay in the cache


def accumulate_levels(rows: GridRows, blocks: Sequence[EntryBlock], wide: bool) -> Iterator[TableLevel]:
    """Yields the levels of a table: entries sorted by cell and distance, and summed within cells. `wide`: the light has
    a size.

    Arrays of all entries are made for the levels alone: large ones take the system longer than small ones.
    """
    runs = [_sum_run(rows, key, part, wide) for key, part in _sorted_runs(blocks)]
    if not runs:
        return
    occupied, counts = concatenate_columns([run[:2] for run in runs])
    starts = segments.offsets(counts)
    run_starts = segments.offsets([len(run[2]) for run in runs])
    for k, (grid, base) in enumerate(zip(rows.grids, rows.cell_base, strict=True)):
        low, high = np.searchsorted(occupied, [base, base + grid.cells])
        if low == high:
            continue
        first, end = int(starts[low]), int(starts[high])
        rank, mask = _masks(occupied[low:high] - base, grid.cells)
        links = (starts[low : high + 1] - first).astype(np.int32)
        some = range(np.searchsorted(run_starts, first, "right") - 1, np.searchsorted(run_starts, end))
        parts = [slice(max(first - int(run_starts[i]), 0), end - int(run_starts[i])) for i in some]
        distance, total = concatenate_columns(
            [[a[part] for a in runs[i][2:]] for i, part in zip(some, parts, strict=True)]
        )
        kind = KINDS[k // rows.levels]
        yield TableLevel(kind, grid, rank, mask, links, distance, total, ramp_of(rows, kind))


def _sorted_runs(blocks: Sequence[EntryBlock]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Runs of whole cells in order: keys (E,) uint64 of cell and distance, and depths; those of one key as given.

    Entries are first dealt out to runs that fit the processor's caches: the cost then grows with their number. So that
    the dealing does too, it is done within blocks. What was in them is lost.
    """
    entries = sum(len(cell) for cell, _, _ in blocks)
    if entries == 0:
        return
    last = max(int(cell.max()) for cell, _, _ in blocks)
    shift = max(last.bit_length() - GROUPS, 0)
    size = (last >> shift) + 1
    count = sum((np.bincount(cell >> shift, minlength=size) for cell, _, _ in blocks), np.zeros(size, np.int64))
    run_of_group = (segments.starts(count) // max(RUN_ENTRIES, entries >> 15)).astype(np.uint16)
    runs = int(run_of_group[-1]) + 1
    ends = np.empty((len(blocks), runs), np.int64)
    for block, end in zip(blocks, ends, strict=True):
        run = run_of_group[block[0] >> shift]
        order = np.argsort(run, kind="stable")  # of 16 bits: a radix sort
        for values in block:
            values[:] = values.take(order, axis=0)
        end[:] = np.cumsum(np.bincount(run, minlength=runs))
    start = np.zeros(len(blocks), np.int64)
    for end in ends.T:
        parts = [
            [values[low:high] for values in block]
            for block, low, high in zip(blocks, start.tolist(), end.tolist(), strict=True)
            if low < high
        ]
        start = end
        if not parts:
            continue
        cell, at, depth = concatenate_columns(parts)
        # Positive float32 are in the order of their bits; adding 0 makes -0 one of them.
        key = cell.astype(np.uint64) << np.uint64(32) | (at + np.float32(0)).view(np.uint32)
        first = key.min() >> np.uint64(32) << np.uint64(32)
        bits = len(key).bit_length()
        if int(key.max() - first).bit_length() + bits <= 64:
            # Sorting numbers is several times as fast as finding their order: each carries its index.
            carried = (key - first) << np.uint64(bits) | np.arange(len(key), dtype=np.uint64)
            carried.sort()
            index = (carried & np.uint64((1 << bits) - 1)).astype(np.int64)
            carried >>= np.uint64(bits)
            carried += first
            yield carried, depth.take(index, axis=0)
        else:
            index = np.argsort(key, kind="stable")
            yield key[index], depth[index]


def _sum_run(rows: GridRows, key: np.ndarray, depth: np.ndarray, wide: bool) -> tuple[np.ndarray, ...]:
    """Returns, for sorted entries, the occupied cells (O,) int32 and how many entries each holds (O,),
    distances (E,) float32 and optical depths of each cell up to there (E, C) float32.
    Opaque entries come as covered fractions."""
    depth = depth.astype(np.float64)
    cell = (key >> np.uint64(32)).astype(np.int32)
    opaque = int(np.searchsorted(cell, rows.cell_base[rows.levels]))
    parts = [_opaque_depths(rows, key[:opaque], cell[:opaque], depth[:opaque])] if opaque else []
    parts += [_sums_within(cell[opaque:], depth[opaque:])] if opaque < len(cell) else []
    total = parts[0] if len(parts) == 1 else np.concatenate(parts)
    # What lies behind no light at all is not needed, but where light comes from the side.
    least = total if total.ndim == 1 else total.min(axis=1)
    lit = np.append(True, (least[:-1] < OPAQUE_DEPTH) | (cell[1:] != cell[:-1]))
    lit[:opaque] = True
    if not wide:
        lit[1:opaque] = (
            (least[: opaque - 1] < COVERED_DEPTH) | (cell[1:opaque] != cell[: opaque - 1]) if opaque else True
        )
    # Of one distance, the last holds the sum.
    if not lit.all():
        index = np.flatnonzero(lit)
        key, total = key.take(index), total.take(index, axis=0)
    index = np.flatnonzero(np.append(key[1:] != key[:-1], True))
    key, total = key.take(index), total.take(index, axis=0).astype(np.float32)
    distance = (key & np.uint64(0xFFFFFFFF)).astype(np.uint32).view(np.float32)
    cell = (key >> np.uint64(32)).astype(np.int32)
    starts = np.flatnonzero(np.append(True, cell[1:] != cell[:-1]))
    return cell[starts], np.diff(np.append(starts, len(cell))), distance, total.reshape(len(key), -1)


def _opaque_depths(rows: GridRows, key: np.ndarray, cell: np.ndarray, share: np.ndarray) -> np.ndarray:
    """(E, ...) -ln of what surfaces leave of their cells' light, up to and with each entry that covers a `share`.

    A surface ends at a gap, a wide one, or a narrow one where the next slab of distances begins: leaves fill all
    distances, while samples of one surface have nearly the same in a cell, as the distance is their plane's.
    """
    at = (key & np.uint64(0xFFFFFFFF)).astype(np.uint32).view(np.float32)
    bases = rows.cell_base[: rows.levels]
    ends = np.searchsorted(bases, cell[[0, -1]], side="right")
    # Most runs hold cells of one level.
    level = ends[:1] if ends[0] == ends[1] else np.searchsorted(bases, cell, side="right")
    width = rows.step[level - 1]
    width = np.maximum(width if rows.frame.parallel else width * at, np.float32(1e-30))
    slab, gap, between = np.floor(at / (SLAB_WIDTH * width)), np.diff(at), width if len(width) == 1 else width[1:]
    apart = (gap > WIDE_GAP * between) | (gap > NARROW_GAP * between) & (slab[1:] != slab[:-1])
    begins = np.append(True, (cell[1:] != cell[:-1]) | apart)
    starts = np.flatnonzero(begins)
    count = np.diff(np.append(starts, len(cell)))
    own = -np.log(np.maximum(1 - _sums_from(starts, count, share), np.exp(-COVERED_DEPTH)))
    last = starts + count - 1
    before = _sums_within(cell[last], own[last]) - own[last]
    own += np.repeat(before, count, axis=0)
    return own


def _sums_within(group: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Running sums (E, ...) of `values` that start anew where `group` (E,) changes."""
    starts = np.flatnonzero(np.append(True, group[1:] != group[:-1]))
    return _sums_from(starts, np.diff(np.append(starts, len(group))), values)


def _sums_from(starts: np.ndarray, count: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Running sums (E, ...) of `values` that start anew at each of `starts` (S,), `count` (S,) values each."""
    total = np.cumsum(values, axis=0)
    before = np.concatenate([np.zeros_like(total[:1]), total[starts[1:] - 1]])
    total -= np.repeat(before, count, axis=0)
    return total


def _masks(occupied: np.ndarray, cells: int) -> tuple[np.ndarray, np.ndarray]:
    """Occupancy of cells: the number (W,) int32 of occupied cells before each group of TEXEL_CELLS, and bits (W, 3)
    int32."""
    words = -(-cells // TEXEL_CELLS)
    mask = np.bincount(occupied // MASK_CELLS, weights=2.0 ** (occupied % MASK_CELLS), minlength=3 * words).astype(
        np.int32
    )
    count = np.bincount(occupied // TEXEL_CELLS, minlength=words)
    return segments.starts(count).astype(np.int32), mask.reshape(words, 3)
