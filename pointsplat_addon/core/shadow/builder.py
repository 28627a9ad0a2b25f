"""Translucent shadow tables: how much of a lamp's light reaches any point (Gunjee et al. 2007, section 4.1).

A table holds, for each cell of directions around the lamp (rows of latitude, columns of longitude; for suns a plane
grid), a list of (distance, cumulated optical depth) in order of distance. Cells have about equal area and are as wide
as high: every row has as many columns as its circumference asks for, and the poles are cells of their own. A splat
gives its optical mass to the cells that its projection touches, each its share, over the cell's area at the splat's
distance: a cell then holds the mean optical depth over its directions. Levels of cells that double in size let each
splat touch four cells at most; a look-up sums the levels and interpolates between four cells of each.

Three kinds of matter are kept apart. VOLUME and SHELL sum optical depth, T = exp(-sum tau) (Beer's law). OPAQUE sums
the fraction f of the cell that is covered while entries follow one another closely: the samples of one surface tile it,
and shadows have smooth edges. Surfaces that lie apart hide each other by chance, T = product of max(0, 1 - sum f), as
leaves do; the table keeps -ln T. SHELL and OPAQUE entries lie where the splat's
*plane* meets the middle of the cell, and a look-up with a normal compares them with its own plane there, so that
a surface does not shade itself, however it is inclined.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..numeric import segments
from ..numeric.vectors import cross
from ..scene.lights import Light
from ..splat.kernel import SUPPORT
from .casters import CHUNK, KINDS, OPAQUE_DEPTH, Casters, casters, turned, typical
from .grid import FINER, FINEST, Frame, Grid, cell_grids, directions, fit_frame, lit_part, plane_distance, slopes
from .table import TEXEL, WORD, Emitter, Level, ShadowTable, emitter_of, isosurface

__all__ = ["Casters", "ShadowTable", "build", "casters", "isosurface"]

WIDEST = 10.0  # radians: standard deviation of a splat that surrounds the lamp
SPAN = 2.0  # ratio of distances that share a level
WIDER = 1.001  # cells of surfaces: rounding moves no sample into wider ones
WHOLE = 4.0  # ratio of all distances of a batch up to which they share one
WHOLE_SURFACE = 64.0  # and of samples of a surface, which would let light through where levels meet
RIM = {"VOLUME": np.sqrt(SUPPORT) / 2, "SHELL": 1.0, "OPAQUE": 1.0}  # half extent in a cell, in half-axes: see _split
SMOKE = 1.005 * 2 * RIM["VOLUME"]  # cells of smoke per radius of its splats: just wide enough for them
FITTED = 1.25  # typical radii: a surface's cells are as wide as its widest sample, up to this one
MOST_ROWS = 8192  # of cells that are finer than the frame's
SLAB, CLOSE, APART = 1.0, 0.05, 2.0  # cells: distances that tell surfaces from each other, see _hidden
HIDDEN = 40.0  # optical depth of a cell that a surface covers: 1 - exp(-40) is 1
LEAST_SHARE = 1 / 256  # of a row or column: below it, the nearer one takes all
GROUPS = 18  # bits: cells are counted by groups, at most so many
DEALT = 1 << 17  # entries that are dealt out to runs together, and
RUN = 1 << 14  # entries that are sorted together: their scratch arrays stay in the cache


def build(light: Light, batches: Sequence[Casters], resolution: int, around: Sequence[Casters] = ()) -> ShadowTable:
    """The table of `light`, `resolution` cells high: over half a turn, or over the casters where they fill less.

    `around`: what the cells are to reach over besides, and casts nothing.
    ValueError: a lamp or direction that is not finite, or more entries than 32-bit links reach.
    """
    if not (np.isfinite(light.position).all() and np.isfinite(light.direction).all()):
        raise ValueError(f"light {light.name!r}: position or direction is not finite")
    batches = [b for b in (lit_part(light, b) for b in batches) if len(b)]
    colored = any(b.colored for b in batches)
    if not batches:
        nothing = Frame(True, np.eye(3), np.zeros(3), False, -np.ones(2), np.ones(2), 1)
        return ShadowTable(nothing, Emitter("POINT", np.zeros((2, 3))), (), colored)
    frame = fit_frame(light, [*batches, *around], resolution)
    rows = _Rows(frame, [cell_grids(frame, _coarser(frame, kind, batches)) for kind in KINDS])
    blocks = [*_blocks(rows, batches, colored)]
    emitter = emitter_of(light, frame)
    return ShadowTable(frame, emitter, tuple(_levels(rows, blocks, emitter.shape != "POINT")), colored)


class _Rows:
    """The rows of all kinds' grids, one after another."""

    def __init__(self, frame: Frame, kinds: list[list[Grid]]) -> None:
        self.frame, self.levels = frame, len(kinds[0])
        self.grids = grids = [grid for kind in kinds for grid in kind]
        self.low = np.array([g.low for g in grids], np.float32)
        self.step = np.array([g.step for g in grids], np.float32)
        self.height = np.array([len(g.count) for g in grids])
        self.base = segments.starts(self.height).astype(np.int32)  # (G,) first row of each grid
        cells = np.array([g.cells for g in grids])
        self.cell_base = segments.starts(cells)  # (G,) first cell of each grid
        if cells.sum() >= 2**31:
            raise ValueError(f"a shadow table of {frame.rows} rows has too many cells for 32-bit links")
        self.first = np.concatenate([g.first + b for g, b in zip(grids, self.cell_base, strict=True)]).astype(np.int32)
        self.column0 = np.concatenate([g.column0 for g in grids]).astype(np.int32)
        self.count = np.concatenate([g.count for g in grids]).astype(np.int32)
        self.density = np.concatenate([g.density for g in grids])
        self.inverse_area = (1 / np.concatenate([g.area(frame.parallel) for g in grids])).astype(np.float32)
        self.latitude = np.concatenate([g.latitude for g in grids]).astype(np.float32)


def _coarser(frame: Frame, kind: str, batches: Sequence[Casters]) -> float:
    """By how much the finest cells of a kind are wider than the frame's, up to 2.

    A level of smoke's cells is then SMOKE radii of most of its splats wide, and one of surfaces as wide as nearly all
    samples: wider cells would blur them more. Where samples of a surface are smaller than the frame's cells, as leaves
    are, finer cells cost nothing but their masks. Shells would show their samples.
    """
    found = [batch for batch in batches if batch.kind == kind]
    if kind == "SHELL" or not found:
        return 1.0
    widths = []
    for batch in found:
        spans, reach = _spans(frame, batch), batch.reach
        width = (
            SMOKE * float(np.median(reach))
            if kind == "VOLUME"
            else WIDER * 2 * RIM[kind] * min(float(reach.max()), FITTED * spans.least)
        )
        widths.append(max(width / spans.farthest / frame.step, 1e-30))
    octaves = np.log2(widths)
    most = octaves[max(range(len(found)), key=lambda k: len(found[k]))]
    finer = np.clip(np.floor(octaves.min()), -_finer(frame), 0) if kind == "OPAQUE" else 0.0
    part = most % 1 if kind == "OPAQUE" or most > 0 else 0.0
    return float(2 ** (part + finer))


def _finer(frame: Frame) -> int:
    """Octaves by which cells may be finer than the frame's."""
    room = np.log2(MOST_ROWS / frame.rows)
    return int(np.clip(room if frame.parallel else min(room, np.log2(frame.step / FINEST)), 0, FINER))


@dataclass(frozen=True)
class _Spans:
    """How the splats of a batch are given their levels; see _level."""

    farthest: float  # where the farthest span of distances begins
    nearest: float  # and the nearest
    least: float  # radius: smaller splats count as this one


def _spans(frame: Frame, batch: Casters) -> _Spans:
    surface = batch.kind != "VOLUME"
    least = typical(batch.reach) if surface else 0.0
    if frame.parallel:
        return _Spans(1.0, 1.0, least)
    near, far = np.inf, 0.0
    for start in range(0, len(batch), CHUNK):
        seen = batch.position[start : start + CHUNK] + (batch.origin - frame.origin).astype(np.float32)
        squared = np.einsum("nc,nc->n", seen, seen)
        near, far = min(near, float(squared.min())), max(far, float(squared.max()))
    near, far = max(np.sqrt(near), 1e-30), max(np.sqrt(far), 1e-30)
    if far <= (WHOLE_SURFACE if surface else WHOLE) * near:
        return _Spans(near, near, least)
    return _Spans(far / SPAN, far / SPAN ** np.ceil(np.log(far / near) / np.log(SPAN)), least)


_Block = tuple[np.ndarray, np.ndarray, np.ndarray]  # what _entries returns


def _blocks(rows: _Rows, batches: Sequence[Casters], colored: bool) -> Iterator[_Block]:
    """The entries of all splats, in blocks of about DEALT."""
    parts, held = [], 0
    for batch in batches:
        spans = _spans(rows.frame, batch)
        for start in range(0, len(batch), CHUNK):
            cell, at, depth = _entries(rows, batch.take(slice(start, start + CHUNK)), spans)
            if colored and depth.ndim == 1:
                depth = np.broadcast_to(depth[:, None], (len(depth), 3))
            parts.append((cell, at, depth))
            held += len(cell)
            if held >= DEALT:
                yield _joined(parts)
                parts, held = [], 0
    if held:
        yield _joined(parts)


def _joined(parts: Sequence[Sequence[np.ndarray]]) -> tuple:
    """Tuples of arrays, each end to end."""
    return tuple(np.concatenate(arrays) for arrays in zip(*parts, strict=True))


def _entries(rows: _Rows, batch: Casters, spans: _Spans) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What splats give to the cells: which (E,) int32, at what distance (E,) float32, how much (E,) or (E, 3) float32:
    optical depth, of opaque splats the covered fraction."""
    frame = rows.frame
    turn = frame.light_from_world.T.astype(np.float32)
    local = (batch.position + (batch.origin - frame.origin).astype(np.float32)) @ turn
    latitude, longitude, distance = frame.spherical(local)

    # Standard deviations along rows and columns; as angles, seen from within a splat, they are as wide as need be.
    normal, ray = None, np.zeros(0)
    if batch.axes is None:
        assert batch.radius is not None
        up = across = batch.radius / 2
    else:
        axes = turned(batch.axes, turn)
        ray, north, east = directions(frame, latitude, longitude)
        along = (
            (axes[..., 1], axes[..., 0])
            if frame.parallel
            else (np.einsum("nkc,nc->nk", axes, d) for d in (north, east))
        )
        up, across = (np.sqrt(np.einsum("nk,nk->n", a, a)) / 2 for a in along)
        normal = cross(axes[:, 0].T, axes[:, 1].T).T if batch.kind != "VOLUME" else None
    strength = _strength(batch, normal, ray)
    if not frame.parallel:
        spread = _inverse_square(distance, np.maximum(up, across))
        strength = strength * (spread if strength.ndim == 1 else spread[:, None])
        floor = np.maximum(distance, np.float32(1e-30))
        up, across = np.minimum(up / floor, WIDEST), np.minimum(across / floor, WIDEST)
    if frame.full:
        # Around a pole a spread along rows also moves away from the pole: the mean of the Rice distribution.
        cosine = np.cos(latitude)
        latitude = latitude - (np.hypot(cosine, np.minimum(np.maximum(up, across), 1)) - cosine) * np.sin(latitude)
    level = _level(rows, batch, distance, spans)
    if (level == level[0]).all():
        level = level[:1]  # what follows from it is the same for all splats then, and not gathered for each
    one = len(level) == 1

    # The nearer row and, where the splat reaches into it, the next; in each of them the same with columns.
    step, smoke, rim = rows.step[level], batch.kind == "VOLUME", np.float32(2 * RIM[batch.kind])
    which, row, share = _split((latitude - rows.low[level]) / step, rim * up / step, smoke)
    level = level if one else level[which]
    inside = _within(row, rows.height[level])
    row = (row if inside is None else np.where(inside, row, 0)) + rows.base[level]
    # Across a sun's rays all rows of a level are alike.
    alike = rows.base[level] if one and frame.parallel else row
    density = rows.density[alike]
    if not frame.parallel:
        across = across / np.maximum(np.cos(latitude), np.float32(1e-6))
    again, column, part = _split(longitude[which] * density, rim * across[which] * density, smoke)
    which, row, share = which[again], row[again], share[again] * part
    inside = None if inside is None else inside[again]
    alike = alike if len(alike) == 1 else row
    place = column
    column = column - rows.column0[alike]
    if frame.full:
        column %= rows.count[alike]
    beside = _within(column, rows.count[alike])
    inside = inside if beside is None else beside if inside is None else inside & beside

    at = distance[which]
    if normal is not None:
        place = place.astype(np.float32) / rows.density[alike]
        to_cell = place - longitude[which], rows.latitude[row] - latitude[which]
        if frame.parallel:
            slope = slopes(normal)
            at = at - slope[0][which] * to_cell[0] - slope[1][which] * to_cell[1]
        else:
            middle = directions(frame, rows.latitude[row], place)[0]
            at = plane_distance(frame, normal[which], at, ray[which], middle, to_cell)
    weight = share * rows.inverse_area[alike]
    depth = np.minimum(strength[which] * (weight if strength.ndim == 1 else weight[:, None]), np.float32(OPAQUE_DEPTH))
    cell, at = rows.first[row] + column, np.maximum(at, 0)
    return (cell, at, depth) if inside is None else (cell[inside], at[inside], depth[inside])


def _within(index: np.ndarray, count: np.ndarray) -> np.ndarray | None:
    """(E,) bool: 0 <= index < count, of which there may be one for all; None: everywhere."""
    if len(index) == 0 or (index.min() >= 0 and index.max() < count.min()):
        return None
    inside = (index >= 0) & (index < count)
    return None if inside.all() else inside


def _level(rows: _Rows, batch: Casters, distance: np.ndarray, spans: _Spans) -> np.ndarray:
    """(N,) int32: the finest grid of the batch's kind in which no splat is wider than a cell.

    Where levels meet, their different widths show. So splats of one size whose distances are in a ratio of up to SPAN
    share a level, that of the nearest (in a batch whose distances are all alike, all do), and the samples of surfaces
    share that of a wide one among them.
    """
    angle = np.float32(2 * RIM[batch.kind]) * np.maximum(batch.reach, np.float32(spans.least))
    if not rows.frame.parallel:
        base = np.full_like(distance, spans.nearest)
        if spans.farthest > spans.nearest:
            base *= SPAN ** np.floor(np.log(np.maximum(distance / base, 1)) / np.float32(np.log(SPAN)))
        angle = np.minimum(angle / base, 4 * WIDEST)
    first = KINDS.index(batch.kind) * rows.levels
    level = np.ceil(np.log2(np.maximum(angle / rows.step[first], np.float32(1e-30))))
    return np.clip(level, 0, rows.levels - 1).astype(np.int32) + first


def _split(place: np.ndarray, half: np.ndarray, smoke: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which splat (E,), which cell (E,) int32, what share of it (E,): of splats on a line of cells about integers.

    `half` is a splat's half extent in cells; it is at most half a cell, so the nearest border divides it. Along the
    line a disk counts as a parabola that ends at its rim, and smoke as (1 - x^2)^4, near to the projection of
    core/splat/kernel.py, with the variance of a splat where it ends at sqrt(11) standard deviations. Both have an end, so
    that no cell but two gets a share.
    """
    cell = np.rint(place)
    off = place - cell
    t = (np.abs(off) - np.float32(0.5)) / np.maximum(half, np.float32(1e-20))
    t = np.minimum(np.maximum(t, np.float32(-1), out=t), np.float32(1), out=t)
    t2 = t * t
    if smoke:
        t *= np.float32(315 / 128) * (1 + t2 * (-4 / 3 + t2 * (6 / 5 + t2 * (-4 / 7 + t2 / 9))))
    else:
        t *= np.float32(1.5) - np.float32(0.5) * t2
    beyond = np.float32(0.5) + np.float32(0.5) * t
    reaches = beyond >= np.float32(LEAST_SHARE)
    beyond *= reaches
    far = np.flatnonzero(reaches)
    next_cell = cell[far] + np.copysign(np.float32(1), off[far])
    which = np.concatenate([np.arange(len(place)), far])
    return which, np.concatenate([cell, next_cell]).astype(np.int32), np.concatenate([1 - beyond, beyond[far]])


def _inverse_square(distance: np.ndarray, deviation: np.ndarray) -> np.ndarray:
    """(N,) float32: mean of 1 / r^2 over Gaussians, which smoke around a lamp is far from the value at their centres.

    With t = distance / deviation it is Dawson's integral, over deviation^2: the integral of exp(-t^2 (1 - s^2) / 2) for
    s from 0 to 1, or 1 / t^2 (1 + 1 / t^2 (1 + 3 / t^2 (1 + 5 / t^2))) for large t.
    """
    distance = np.maximum(distance, np.float32(1e-18))
    ratio = np.minimum(deviation / distance, 1) ** 2
    result = (1 + ratio * (1 + 3 * ratio * (1 + 5 * ratio))) / distance**2
    near = np.flatnonzero(ratio > 1 / 25)
    if len(near):
        place, weight = np.polynomial.legendre.leggauss(12)
        width = np.maximum(deviation[near], np.float32(1e-18))
        exact = np.exp(-((distance[near] / width) ** 2)[:, None] * (1 - (0.5 + place / 2) ** 2) / 2) @ (weight / 2)
        result[near] = exact / width**2
    return result.astype(np.float32)


def _strength(batch: Casters, normal: np.ndarray | None, ray: np.ndarray) -> np.ndarray:
    """(N,) or (N, 3) float32: optical mass towards the lamp, units^2; of opaque splats the area that is seen.

    normal: (N, 3), of surfaces, as long as the product of the half-axes.
    """
    if batch.kind == "VOLUME":
        assert batch.mass is not None
        return batch.mass
    if normal is None:
        assert batch.radius is not None
        area = np.pi * batch.radius**2
    else:
        area = np.float32(np.pi) * np.abs(np.einsum("nc,nc->n", normal, ray))
    if batch.mass is None:
        return area
    return batch.mass * (area if batch.mass.ndim == 1 else area[:, None])


def _levels(rows: _Rows, blocks: Sequence[_Block], wide: bool) -> Iterator[Level]:
    """Sort the entries of all cells, sum within cells, and cut into levels. `wide`: the lamp has a size.

    Arrays of all entries are made for the levels alone: large ones take the system longer than small ones.
    """
    runs = [_summed(rows, key, part, wide) for key, part in _sorted_runs(blocks)]
    if not runs:
        return
    occupied, counts = _joined([run[:2] for run in runs])
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
        distance, total = _joined([[a[part] for a in runs[i][2:]] for i, part in zip(some, parts, strict=True)])
        yield Level(KINDS[k // rows.levels], grid, rank, mask, links, distance, total)


def _sorted_runs(blocks: Sequence[_Block]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
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
    run_of_group = (segments.starts(count) // max(RUN, entries >> 15)).astype(np.uint16)
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
        cell, at, depth = _joined(parts)
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


def _summed(rows: _Rows, key: np.ndarray, depth: np.ndarray, wide: bool) -> tuple[np.ndarray, ...]:
    """Of sorted entries: occupied cells (O,) int32 and how many entries each holds (O,), distances (E,) float32 and
    optical depths of each cell up to there (E, C) float32. Opaque entries come as covered fractions."""
    depth = depth.astype(np.float64)
    cell = (key >> np.uint64(32)).astype(np.int32)
    opaque = int(np.searchsorted(cell, rows.cell_base[rows.levels]))
    parts = [_hidden(rows, key[:opaque], cell[:opaque], depth[:opaque])] if opaque else []
    parts += [_sums_within(cell[opaque:], depth[opaque:])] if opaque < len(cell) else []
    total = parts[0] if len(parts) == 1 else np.concatenate(parts)
    # What lies behind no light at all is not needed, but where light comes from the side.
    least = total if total.ndim == 1 else total.min(axis=1)
    lit = np.append(True, (least[:-1] < OPAQUE_DEPTH) | (cell[1:] != cell[:-1]))
    lit[:opaque] = True
    if not wide:
        lit[1:opaque] = (least[: opaque - 1] < HIDDEN) | (cell[1:opaque] != cell[: opaque - 1]) if opaque else True
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


def _hidden(rows: _Rows, key: np.ndarray, cell: np.ndarray, share: np.ndarray) -> np.ndarray:
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
    slab, gap, between = np.floor(at / (SLAB * width)), np.diff(at), width if len(width) == 1 else width[1:]
    apart = (gap > APART * between) | (gap > CLOSE * between) & (slab[1:] != slab[:-1])
    begins = np.append(True, (cell[1:] != cell[:-1]) | apart)
    starts = np.flatnonzero(begins)
    count = np.diff(np.append(starts, len(cell)))
    own = -np.log(np.maximum(1 - _sums_from(starts, count, share), np.exp(-HIDDEN)))
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
    """Which cells hold entries: the number (W,) int32 of occupied cells before each TEXEL, bits (W, 3) int32."""
    words = -(-cells // TEXEL)
    mask = np.bincount(occupied // WORD, weights=2.0 ** (occupied % WORD), minlength=3 * words).astype(np.int32)
    count = np.bincount(occupied // TEXEL, minlength=words)
    return segments.starts(count).astype(np.int32), mask.reshape(words, 3)
