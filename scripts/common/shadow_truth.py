"""How much light reaches a point through a shadow table, in float64: what shaders/lib/shadow/shadow.glsl computes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from pointsplat_addon.core.numeric.segments import starts
from pointsplat_addon.core.shadow.casters import CHUNK, OPAQUE_DEPTH
from pointsplat_addon.core.shadow.grid import LEAST_COSINE, Frame, directions, plane_distance
from pointsplat_addon.core.shadow.level import MASK_CELLS, TEXEL_CELLS, TableLevel
from pointsplat_addon.core.shadow.nearest import NearestEntries
from pointsplat_addon.core.shadow.table import Emitter, ShadowTable

BIAS = 1.0  # cells: how far along its normal a receiver is lifted
UNORIENTED_BIAS = 1.5  # cells, towards the light: receivers without a normal
SHARP = 0.5  # cells: a light whose penumbrae are at most so wide counts as a point
TAPS = 64  # points of a light with a size; the device takes some in each sample of the picture
SEGMENTS, FEW_SEGMENTS = 4, 2  # of each ray to a point of a light with a size; where it crosses few cells
NARROW = 2.0  # cells: so many are few
# Additive recurrence in five dimensions (Roberts 2018): two on the light, two in the cell, one along the ray.
SEQUENCE = 1.1347241384015194 ** -np.arange(1, 6)
CORNER = 1.42  # of a rectangle, over its half-side
NARROWINGS = 2  # times that the nearest entry is asked for, within what the one before leaves
LOOSE = 0.65  # of a square's side: so far from it, and a cell more, nothing is that its neighbours do not know
OVERLAP = 0.3  # of a segment: how far it reaches into the next, lest light slips between the cells of both
OVERLAP_CELLS = 1.0  # and as many cells


def _bit_count(words: np.ndarray) -> np.ndarray:
    return np.unpackbits(words.astype("<u4")[..., None].view(np.uint8), axis=-1).sum(axis=-1, dtype=np.int64)


def nearest_around(
    nearest: NearestEntries, latitude: np.ndarray, longitude: np.ndarray, reach: np.ndarray
) -> np.ndarray:
    """(P,) distances that no entry within `reach` (P,) of directions (P,) falls below. Reach: radians, for suns
    units."""
    size = np.ceil(np.log2(np.maximum(reach / nearest.side, 1)))
    size = np.minimum(size, len(nearest.distance) - 1).astype(np.int64)
    count = len(nearest.distance[0]) >> size
    place = [
        np.floor((v - low) / (nearest.side * 2.0**size))
        for v, low in zip((latitude, longitude), nearest.low, strict=True)
    ]
    row, column = (np.clip(v, 0, count - 1).astype(np.int64) for v in place)
    first = starts([d.size for d in nearest.distance])
    return nearest.flat[first[size] + row * count + column].astype(float)


class Receiver:
    """Points that receive light, in the light's coordinates; normals are zero where there is none."""

    def __init__(self, frame: Frame, local: np.ndarray, normals: np.ndarray) -> None:
        self.frame, self.local, self.normals = frame, local, normals
        self.latitude, self.longitude, self.distance = frame.spherical(local)
        self.ray, self.north, self.east = directions(frame, self.latitude, self.longitude)
        self.oriented = normals.any(axis=1)
        self.facing = np.maximum(np.abs((normals * self.ray).sum(axis=1)), LEAST_COSINE)

    def __len__(self) -> int:
        return len(self.local)

    def take(self, index: np.ndarray) -> Receiver:
        return Receiver(self.frame, self.local[index], self.normals[index])

    def spread_at_nearest(self, table: ShadowTable) -> np.ndarray:
        """(P,) how far the ray from the light's rim departs from the ray from its middle, per size of the light, where
        the first thing lies that the ray may meet."""
        if table.emitter.shape == "POINT":
            return np.zeros(len(self))
        narrowed = 1.0 if self.frame.parallel else np.maximum(np.cos(self.latitude) - 1 + LOOSE, 1e-3) / LOOSE
        spread = self._spread(table, np.full(len(self), table.nearest.least))
        # What is known of the nearest narrows the directions in which there may be a nearer one.
        for _ in range(NARROWINGS):
            reach = spread * table.emitter.radius * CORNER / (LOOSE * narrowed)
            spread = self._spread(table, nearest_around(table.nearest, self.latitude, self.longitude, reach))
        return spread

    def _spread(self, table: ShadowTable, nearest: np.ndarray) -> np.ndarray:
        if self.frame.parallel:
            return np.maximum(self.distance - nearest, 0)
        nearest = np.maximum(nearest, max(table.emitter.radius, 1e-30))
        return np.maximum(1 / nearest - 1 / np.maximum(self.distance, 1e-30), 0)

    def along(self, spread: np.ndarray) -> np.ndarray:
        """(P,) distance from the light at which rays have departed so far."""
        return self.distance - spread if self.frame.parallel else self.distance / (1 + self.distance * spread)

    def offset(self, emitter: Emitter, at: np.ndarray) -> np.ndarray:
        """(P, 3) from the light's middle to a point (2,) of it, across the ray."""
        if emitter.shape in ("POINT", "DISK") and not self.frame.parallel:
            return emitter.radius * (at[0] * self.east + at[1] * self.north)
        point = at @ emitter.size
        return point - (self.ray @ point)[:, None] * self.ray

    def direction(self, offset: np.ndarray, spread: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Latitude and longitude (P,) of rays that have departed so far towards `offset` (P, 3)."""
        if self.frame.parallel:
            return self.latitude + offset[:, 1] * spread, self.longitude + offset[:, 0] * spread
        return self.frame.spherical(self.ray + offset * spread[:, None])[:2]


def transmittance(
    table: ShadowTable, points: np.ndarray, normals: np.ndarray | None = None, taps: int = TAPS
) -> np.ndarray:
    """(P,) float64, or (P, 3) where the table is coloured: the share of the light that reaches world points (P, 3).

    normals: (P, 3) unit normals of the surface that receives the light, zero where there is none. Where shadows are
    soft, `taps` points of the light are averaged.
    """
    normals = np.zeros_like(points, dtype=float) if normals is None else normals
    parts = [slice(i, i + CHUNK) for i in range(0, max(len(points), 1), CHUNK)]
    result = np.concatenate([_transmittance(table, points[part], normals[part], taps) for part in parts])
    return result if table.colored else result[:, 0]


def optical_depth(
    table: ShadowTable, points: np.ndarray, normals: np.ndarray | None = None, taps: int = TAPS
) -> np.ndarray:
    """-ln of `transmittance` (P,) or (P, 3), at most OPAQUE_DEPTH."""
    return -np.log(np.maximum(transmittance(table, points, normals, taps), np.exp(-OPAQUE_DEPTH)))


def receiver_of(table: ShadowTable, points: np.ndarray, normals: np.ndarray) -> Receiver:
    """World points (P, 3) and their normals (P, 3) in the coordinates of the table's light."""
    turn = table.frame.light_from_world.T
    return Receiver(table.frame, (np.asarray(points, float) - table.frame.origin) @ turn, normals @ turn)


def _transmittance(table: ShadowTable, points: np.ndarray, normals: np.ndarray, taps: int) -> np.ndarray:
    receiver = receiver_of(table, points, normals)
    spread = receiver.spread_at_nearest(table)
    cells = spread * table.emitter.radius / table.frame.step
    result = np.empty((len(points), 3 if table.colored else 1))
    hard, far = cells <= SHARP, cells > NARROW
    result[hard] = _from_one_point(table, receiver.take(hard), spread[hard], [(0.0, 1.0)], np.zeros(2), None)
    for some, segments in ((~hard & ~far, FEW_SEGMENTS), (far, SEGMENTS)):
        if some.any():
            result[some] = _from_many_points(table, receiver.take(some), spread[some], segments, taps)
    return result


def _from_many_points(
    table: ShadowTable, receiver: Receiver, spread: np.ndarray, segments: int, taps: int
) -> np.ndarray:
    """(P, C): the mean transmittance from `taps` points of a light with a size, along rays that are cut into
    segments."""
    sum_ = 0.0
    for k in range(taps):
        x, y, row, column, cut = (0.5 + k * SEQUENCE) % 1
        point = np.array([x, y]) * 2 - 1
        if table.emitter.shape != "RECTANGLE":
            point = np.sqrt(x) * np.array([np.cos(2 * np.pi * y), np.sin(2 * np.pi * y)])
        edges = (np.arange(segments + 1) + cut - 1) / (segments - 1)
        jitter = np.array([row, column]) - 0.5
        sum_ = sum_ + _from_one_point(table, receiver, spread, list(pairwise(edges)), point, jitter)
    return np.asarray(sum_ / taps)


def _from_one_point(
    table: ShadowTable,
    receiver: Receiver,
    spread: np.ndarray,
    segments: list[tuple[float, float]],
    point: np.ndarray,
    jitter: np.ndarray | None,
) -> np.ndarray:
    """(P, C): the transmittance from one point (2,) of the light. Its ray crosses cells where the light has a size.

    Segments of the ray are looked up in the cells of their middles. They are given by the square roots of parts of the
    spread, so that shadows sharpen towards what casts them.
    """
    open_, depth = np.ones((len(receiver), 1)), np.zeros((len(receiver), 3 if table.colored else 1))
    offset = receiver.offset(table.emitter, point)
    for start, end in segments:
        far = receiver.along(max(start, 0.0) ** 2 * spread)
        near, behind = (receiver.along(e**2 * spread) for e in (end, end + OVERLAP * (end - start)))
        if end >= 1:
            near = behind = np.full(len(receiver), -np.inf)
        middle = max((start + end) / 2, 0.0) ** 2 if jitter is not None else 0.0
        latitude, longitude = receiver.direction(offset, middle * spread)
        # Samples of one surface may lie in several levels, but not side by side along the ray.
        covered = np.zeros_like(open_)
        for level in table.levels:
            until = behind if level.kind == "OPAQUE" else near
            found = _look_up(level, receiver, latitude, longitude, until, far, jitter)
            if level.kind == "OPAQUE":
                covered += found[:, :1]
            else:
                depth += found
        open_ *= np.maximum(1 - covered, 0)
    return open_ * np.exp(-depth)


def _entry_range(level: TableLevel, cell: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First entry (P,) and one past the last of cells (P,); the same where a cell holds none or is negative."""
    inside = cell >= 0
    cell = np.where(inside, cell, 0)
    texel, bit = cell // TEXEL_CELLS, cell % TEXEL_CELLS
    words = level.mask[texel]
    word = bit // MASK_CELLS
    below = np.where(np.arange(3) < word[:, None], 0xFFFFFF, 0)
    below[np.arange(len(cell)), word] = (1 << (bit % MASK_CELLS)) - 1
    rank = level.rank[texel] + _bit_count(words & below).sum(axis=1)
    held = inside & ((words[np.arange(len(cell)), word] >> (bit % MASK_CELLS)) & 1 == 1)
    rank = np.where(held, rank, 0)
    return level.links[rank], np.where(held, level.links[np.minimum(rank + 1, len(level.links) - 1)], level.links[rank])


def _look_up(
    level: TableLevel,
    receiver: Receiver,
    latitude: np.ndarray,
    longitude: np.ndarray,
    near: np.ndarray,
    far: np.ndarray,
    jitter: np.ndarray | None,
) -> np.ndarray:
    """(P, 1 or 3) float64: what a level holds in a direction between two distances (P,), by the four cells around it.

    With a `jitter` (2,) in cells, by the one cell there: many of them average to the same.
    """
    frame, grid = receiver.frame, level.grid
    width = grid.step * (np.ones(len(receiver)) if frame.parallel else receiver.distance)
    place = (latitude - grid.low) / grid.step
    result = np.zeros((len(receiver), level.total.shape[1]))
    for next_row, next_column in np.ndindex(2, 2) if jitter is None else [(0, 0)]:
        row = np.floor(place) + next_row if jitter is None else np.rint(place + jitter[0])
        inside = (row >= 0) & (row < len(grid.count))
        row = np.where(inside, row, 0).astype(np.int64)
        across = longitude * grid.density[row]
        column = np.floor(across) + next_column if jitter is None else np.rint(across + jitter[1])
        share = (1 - np.abs(place - row)) * (1 - np.abs(across - column)) if jitter is None else np.ones_like(place)
        limit = np.full(len(receiver), np.inf)
        if level.kind in ("OPAQUE", "SHELL"):
            there = column / grid.density[row]
            to_cell = there - receiver.longitude, grid.latitude[row] - receiver.latitude
            middle = directions(frame, grid.latitude[row], there)[0]
            plane = plane_distance(frame, receiver.normals, receiver.distance, receiver.ray, middle, to_cell)
            unoriented = receiver.distance - UNORIENTED_BIAS * width if level.kind == "OPAQUE" else np.inf
            limit = np.where(receiver.oriented, plane - BIAS * width / receiver.facing, unoriented)
        column = column.astype(np.int64) - grid.column0[row]
        if grid.wraps:
            column %= grid.count[row]
        inside &= (column >= 0) & (column < grid.count[row])
        first, end = _entry_range(level, np.where(inside, grid.first[row] + column, -1))
        ramp = width * level.ramp
        found = _depth_before(level, first, end, np.minimum(far, limit), ramp)
        if jitter is not None:
            until = near - OVERLAP_CELLS * width if level.kind == "OPAQUE" else near
            found -= _depth_before(level, first, end, np.minimum(until, limit), ramp)
        result += share[:, None] * (-np.expm1(-found) if level.kind == "OPAQUE" else found)
    return result


def _depth_before(
    level: TableLevel, first: np.ndarray, end: np.ndarray, limit: np.ndarray, ramp: np.ndarray
) -> np.ndarray:
    """(P, C) float64: what the entries first .. end (P,) hold in front of distances (P,).

    Opaque entries count in full. Others set in along the ray from `ramp` (P,) before to as much after their distance,
    or half the way to their neighbours where these are nearer: a splat counts half for itself.
    """
    low, high = first.copy(), end.copy()
    while (low < high).any():
        middle = (low + high) // 2
        before = (low < high) & (level.distance[np.minimum(middle, len(level.distance) - 1)] < limit)
        low, high = np.where(before, middle + 1, low), np.where(before | (low >= high), high, middle)

    def total(entry: np.ndarray) -> np.ndarray:
        return np.where((entry >= first)[:, None], level.total[np.clip(entry, 0, len(level.total) - 1)], 0).astype(
            float
        )

    if level.kind == "OPAQUE":
        return total(low - 1)
    has_last, has_next = low > first, low < end
    last, following = np.maximum(low - 1, 0), np.minimum(low, len(level.distance) - 1)
    before, after = limit - level.distance[last], level.distance[following] - limit
    gap = level.distance[following].astype(float) - level.distance[last]
    reach = np.where(has_last & has_next, np.minimum(ramp, gap / 2), ramp)
    reach = np.maximum(reach, 1e-30)
    result = total(low - 1)
    missing = has_last * np.clip(1 - before / reach, 0, 1) / 2
    added = has_next * np.clip(1 - after / reach, 0, 1) / 2
    return (
        result
        - missing[:, None] * (result - total(low - 2))
        + added[:, None] * (np.where(has_next[:, None], total(low), result) - result)
    )
