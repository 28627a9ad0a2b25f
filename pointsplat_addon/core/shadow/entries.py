"""How much optical depth, or covered fraction, each splat adds to which cells of a shadow table."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ..numeric.vectors import cross
from .captured.entries import captured_entries
from .casters import CHUNK, OPAQUE_DEPTH, Casters, rotate_vectors
from .fine_smoke import FINE_CHUNK, fine_entries, merged_entries
from .grid import directions, plane_distance, slopes
from .rows import HALF_EXTENT, WIDEST_DEVIATION, DistanceSpans, GridRows, distance_spans, level_of_splats

LEAST_SHARE = 1 / 256  # of a row or column: below it, the nearer one takes all
BLOCK_ENTRIES = 1 << 17  # entries that are dealt out to runs together
MERGED_ENTRIES = 1 << 20  # entries of smoke among which those next to each other become one
EntryBlock = tuple[np.ndarray, np.ndarray, np.ndarray]  # what _splat_entries returns


def entry_blocks(rows: GridRows, batches: Sequence[Casters], colored: bool) -> Iterator[EntryBlock]:
    """The entries of all splats, in blocks of about BLOCK_ENTRIES."""
    parts, held = [], 0
    captured = sum(batch.opacity is not None for batch in batches)
    for batch in batches:
        for cell, at, depth in _batch_entries(rows, batch, 1 / max(captured, 1)):
            if colored and depth.ndim == 1:
                depth = np.broadcast_to(depth[:, None], (len(depth), 3))
            parts.append((cell, at, depth))
            held += len(cell)
            if held >= BLOCK_ENTRIES:
                yield concatenate_columns(parts)
                parts, held = [], 0
    if held:
        yield concatenate_columns(parts)


def _batch_entries(rows: GridRows, batch: Casters, share: float) -> Iterator[EntryBlock]:
    """The entries of a batch. share: of it among batches of captured splats."""
    if batch.opacity is not None:
        yield from captured_entries(rows, batch, share)
        return
    spans = distance_spans(rows.frame, batch)
    fine = rows.fine and batch.kind == "VOLUME"
    starts = range(0, len(batch), FINE_CHUNK if fine else CHUNK)
    found = (_splat_entries(rows, batch.take(slice(start, start + starts.step)), spans) for start in starts)
    yield from _merged(rows, found) if fine else found


def _merged(rows: GridRows, blocks: Iterator[EntryBlock]) -> Iterator[EntryBlock]:
    """Entries of smoke in which what is next to each other in a cell is one entry, many of them at a time."""
    parts, held = [], 0
    for block in blocks:
        parts.append(block)
        held += len(block[0])
        if held >= MERGED_ENTRIES:
            yield from _blocks(merged_entries(rows, *concatenate_columns(parts)))
            parts, held = [], 0
    if held:
        yield from _blocks(merged_entries(rows, *concatenate_columns(parts)))


def _blocks(entries: EntryBlock) -> Iterator[EntryBlock]:
    """Entries in pieces of BLOCK_ENTRIES."""
    for start in range(0, len(entries[0]), BLOCK_ENTRIES):
        cell, at, depth = (values[start : start + BLOCK_ENTRIES] for values in entries)
        yield cell, at, depth


def concatenate_columns(parts: Sequence[Sequence[np.ndarray]]) -> tuple:
    """Concatenates the first arrays of all tuples, the second ones, and so on."""
    return tuple(np.concatenate(arrays) for arrays in zip(*parts, strict=True))


def _splat_entries(rows: GridRows, batch: Casters, spans: DistanceSpans) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Entries of splats: cells (E,) int32, distances (E,) float32, and amounts (E,) or (E, 3) float32, which are
    optical depths, or the covered fractions of opaque splats."""
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
        axes = rotate_vectors(batch.axes, turn)
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
        spread = _mean_inverse_square(distance, np.maximum(up, across))
        strength = strength * (spread if strength.ndim == 1 else spread[:, None])
        floor = np.maximum(distance, np.float32(1e-30))
        up, across = np.minimum(up / floor, WIDEST_DEVIATION), np.minimum(across / floor, WIDEST_DEVIATION)
    if frame.full:
        # Around a pole a spread along rows also moves away from the pole: the mean of the Rice distribution.
        cosine = np.cos(latitude)
        latitude = latitude - (np.hypot(cosine, np.minimum(np.maximum(up, across), 1)) - cosine) * np.sin(latitude)
    level = level_of_splats(rows, batch, distance, spans)
    if rows.fine and batch.kind == "VOLUME":
        return fine_entries(rows, level, latitude, longitude, distance, strength)
    if (level == level[0]).all():
        level = level[:1]  # what follows from it is the same for all splats then, and not gathered for each
    one = len(level) == 1

    # The nearer row and, where the splat reaches into it, the next; in each of them the same with columns.
    step, smoke, rim = rows.step[level], batch.kind == "VOLUME", np.float32(2 * HALF_EXTENT[batch.kind])
    which, row, share = _split_between_cells((latitude - rows.low[level]) / step, rim * up / step, smoke)
    level = level if one else level[which]
    inside = _inside(row, rows.height[level])
    row = (row if inside is None else np.where(inside, row, 0)) + rows.base[level]
    # Across a sun's rays all rows of a level are alike.
    alike = rows.base[level] if one and frame.parallel else row
    density = rows.density[alike]
    if not frame.parallel:
        across = across / np.maximum(np.cos(latitude), np.float32(1e-6))
    again, column, part = _split_between_cells(longitude[which] * density, rim * across[which] * density, smoke)
    which, row, share = which[again], row[again], share[again] * part
    inside = None if inside is None else inside[again]
    alike = alike if len(alike) == 1 else row
    place = column
    column = column - rows.column0[alike]
    if frame.full:
        column %= rows.count[alike]
    beside = _inside(column, rows.count[alike])
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


def _inside(index: np.ndarray, count: np.ndarray) -> np.ndarray | None:
    """(E,) bool where 0 <= index < count (E,) or (1,); None if that holds everywhere."""
    if len(index) == 0 or (index.min() >= 0 and index.max() < count.min()):
        return None
    inside = (index >= 0) & (index < count)
    return None if inside.all() else inside


def _split_between_cells(place: np.ndarray, half: np.ndarray, smoke: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Divides splats on a line of cells, centred on integers, between the cells that they touch: splat (E,), cell (E,)
    int32, and share of the splat (E,).

    `half` is a splat's half extent in cells; it is at most half a cell, so the nearest border divides it. Along the
    line a disk counts as a parabola that ends at its rim, and smoke as (1 - x^2)^4, near to the projection of
    core/splat/kernel.py, with the variance of a splat where it ends at sqrt(11) standard deviations. Both have an end,
    so that no cell but two gets a share."""
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


def _mean_inverse_square(distance: np.ndarray, deviation: np.ndarray) -> np.ndarray:
    """(N,) float32: mean of 1 / r^2 over Gaussians, which for smoke around a light is far from the value at their
    centres.

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
    """(N,) or (N, 3) float32: optical mass towards the light, units^2; of opaque splats the area that is seen.

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
