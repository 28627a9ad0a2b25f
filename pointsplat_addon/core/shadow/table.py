"""Shadow tables: what they hold, and how much light reaches a point. shaders/lib/shadow/shadow.glsl looks up the same."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from ..numeric.segments import starts
from ..scene.lights import Light
from .casters import CHUNK, OPAQUE_DEPTH
from .grid import STEEPEST, Frame, Grid, directions, plane_distance

BIAS = 1.0  # cells: how far along its normal a receiver is lifted
UNORIENTED_BIAS = 1.5  # cells, towards the lamp: receivers without a normal
SHARP = 0.5  # cells: a lamp whose penumbrae are at most so wide is a point
TAPS = 64  # points of a wide lamp; the device takes some in each sample of the picture
SEGMENTS, FEW_SEGMENTS = 4, 2  # of each ray to a point of a wide lamp; where it crosses few cells
NARROW = 2.0  # cells: so many are few
# Additive recurrence in five dimensions (Roberts 2018): two on the lamp, two in the cell, one along the ray.
SEQUENCE = 1.1347241384015194 ** -np.arange(1, 6)
SHAPES = ("POINT", "DISK", "RECTANGLE", "ELLIPSE")
CORNER = 1.42  # of a rectangle, over its half-side
NARROWINGS = 2  # times that the nearest entry is asked for, within what the one before leaves
SQUARE = 4  # cells of a level: sides of the squares that know its nearest entry
LOOSE = 0.65  # of a square's side: so far from it, and a cell more, nothing is that its neighbours do not know
OVERLAP = 0.3  # of a segment: how far it reaches into the next, lest light slips between the cells of both
OVERLAP_CELLS = 1.0  # and as many cells
WORD = 24  # cells to a mask: as many bits as a float32 holds as an integer
TEXEL = 3 * WORD  # cells to a texel: where its entries start, then three masks


@dataclass(frozen=True, eq=False)
class Level:
    """Cells of one size and kind. Cell c holds entries links[k] .. links[k + 1], k its rank among occupied cells."""

    kind: str
    grid: Grid
    rank: np.ndarray  # (W,) int32: occupied cells before cell W * TEXEL
    mask: np.ndarray  # (W, 3) int32: WORD cells each, lowest bit first
    links: np.ndarray  # (O + 1,) int32
    distance: np.ndarray  # (E,) float32, ascending within a cell
    total: np.ndarray  # (E, 1 or 3) float32: optical depth up to and with the entry

    @property
    def nbytes(self) -> int:
        rows = 16 * len(self.grid.count)
        return sum(a.nbytes for a in (self.rank, self.mask, self.links, self.distance, self.total)) + rows

    def range(self, cell: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """First entry (P,) and one past the last of cells (P,); the same where a cell holds none or is negative."""
        inside = cell >= 0
        cell = np.where(inside, cell, 0)
        texel, bit = cell // TEXEL, cell % TEXEL
        words = self.mask[texel]
        word = bit // WORD
        below = np.where(np.arange(3) < word[:, None], 0xFFFFFF, 0)
        below[np.arange(len(cell)), word] = (1 << (bit % WORD)) - 1
        rank = self.rank[texel] + _bit_count(words & below).sum(axis=1)
        held = inside & ((words[np.arange(len(cell)), word] >> (bit % WORD)) & 1 == 1)
        rank = np.where(held, rank, 0)
        return self.links[rank], np.where(held, self.links[np.minimum(rank + 1, len(self.links) - 1)], self.links[rank])

    def occupied(self) -> np.ndarray:
        """(O,) int64: cells that hold entries."""
        bits = np.unpackbits(self.mask.astype("<u4")[..., None].view(np.uint8), axis=-1, bitorder="little")
        return np.flatnonzero(bits.reshape(-1, 32)[:, :WORD])


def _bit_count(words: np.ndarray) -> np.ndarray:
    return np.unpackbits(words.astype("<u4")[..., None].view(np.uint8), axis=-1).sum(axis=-1, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Emitter:
    """What shines, for the softness of shadows."""

    shape: str  # one of SHAPES; DISK: faces the receiver
    size: np.ndarray  # (2, 3) float64, local half-sides; DISK: both as long as the radius, for suns per unit of length

    @property
    def radius(self) -> float:
        return float(np.linalg.norm(self.size, axis=1).max())


def emitter_of(light: Light, frame: Frame) -> Emitter:
    if light.kind == "AREA" and light.axis_u is not None and light.axis_v is not None:
        size = np.stack([light.axis_u, light.axis_v]) @ frame.light_from_world.T
        return Emitter("ELLIPSE" if light.ellipse else "RECTANGLE", size)
    radius = np.tan(min(light.radius, 1.5)) if light.kind == "SUN" else light.radius
    return Emitter("DISK" if radius > 0 else "POINT", np.eye(3)[:2] * radius)


@dataclass(frozen=True, eq=False)
class Nearest:
    """How near to the lamp the first entry is that rays towards it could meet, by squares of directions.

    From finest to coarsest, squares double in size and halve in number; the last holds all directions. A square knows
    the cells that a look-up reads up to LOOSE of its side away from it: what surrounds a receiver takes one of them.
    """

    low: np.ndarray  # (2,) float64, least latitude and longitude
    side: float  # of the finest squares
    wraps: bool  # the last column borders on the first
    distance: tuple[np.ndarray, ...]  # (P, P) float32 each, rows of latitude; inf: nothing

    @property
    def least(self) -> float:
        """No entry is nearer to the lamp; 0 where there is none."""
        return float(np.nan_to_num(self.distance[-1][0, 0], posinf=0.0))

    def around(self, latitude: np.ndarray, longitude: np.ndarray, reach: np.ndarray) -> np.ndarray:
        """(P,) distances, of directions (P,) and what lies within `reach` (P,) of them: radians, for suns units."""
        size = np.ceil(np.log2(np.maximum(reach / self.side, 1)))
        size = np.minimum(size, len(self.distance) - 1).astype(np.int64)
        count = len(self.distance[0]) >> size
        place = [
            np.floor((v - low) / (self.side * 2.0**size))
            for v, low in zip((latitude, longitude), self.low, strict=True)
        ]
        row, column = (np.clip(v, 0, count - 1).astype(np.int64) for v in place)
        first = starts([d.size for d in self.distance])
        return self.flat[first[size] + row * count + column].astype(float)

    @cached_property
    def flat(self) -> np.ndarray:
        """(S,) float32: all squares, row by row, finest first."""
        return np.concatenate([d.reshape(-1) for d in self.distance])


def nearest(frame: Frame, levels: tuple[Level, ...], wide: bool) -> Nearest:
    """Of a table's levels. Lamps without a size need but the coarsest square."""
    if not levels or not wide:
        least = min((float(level.distance.min()) for level in levels), default=np.inf)
        return Nearest(frame.low, 1.0, frame.full, (np.full((1, 1), least, np.float32),))
    finest = SQUARE * min(level.grid.step for level in levels)
    if frame.full:
        count = 1 << max(int(np.floor(np.log2(2 * np.pi / finest))), 0)
        low, side = np.array([-np.pi / 2, -np.pi]), 2 * np.pi / count
    else:
        low, side = frame.low - finest, finest
        count = 1 << int(np.ceil(np.log2(float((frame.high - frame.low).max()) / side + 2)))
    sizes = count.bit_length()
    # What each level adds to the squares of each size: where squares are SQUARE of its cells wide, and coarser ones.
    own = [[np.full((count >> k, count >> k), np.inf, np.float32)] * 2 for k in range(sizes)]
    for level in levels:
        start = int(np.clip(np.ceil(np.log2(SQUARE * level.grid.step / side * (1 - 1e-6))), 0, sizes - 1))
        cell, grid, n = level.occupied(), level.grid, count >> start
        row = np.searchsorted(grid.first, cell, side="right") - 1
        place = grid.latitude[row], (cell - grid.first[row] + grid.column0[row]) / grid.density[row]
        if frame.full:
            place = place[0], (place[1] + np.pi) % (2 * np.pi) - np.pi
        at = [np.clip((v - o) / (side * 2**start), 0, n - 1).astype(np.int64) for v, o in zip(place, low, strict=True)]
        found = np.full(n * n, np.inf, np.float32)
        np.minimum.at(found, at[0] * n + at[1], level.distance[level.links[:-1]])
        found = found.reshape(n, n)
        own[start] = [np.minimum(own[start][0], found), own[start][1]]
        for k in range(start, sizes):
            own[k] = [own[k][0], np.minimum(own[k][1], found)]
            found = np.minimum(found[::2], found[1::2]) if k + 1 < sizes else found
            found = np.minimum(found[:, ::2], found[:, 1::2]) if k + 1 < sizes else found
    distance: list[np.ndarray] = []
    coarser = np.full((1, 1), np.inf, np.float32)  # what levels add that begin with larger squares
    for here, all_ in reversed(own):
        distance.insert(0, np.minimum(_spread(all_, frame.full), coarser))
        coarser = np.minimum(_spread(here, frame.full), coarser).repeat(2, axis=0).repeat(2, axis=1)
    return Nearest(low, side, frame.full, tuple(distance))


def _spread(distance: np.ndarray, wraps: bool) -> np.ndarray:
    """(P, P) the least of each square and its eight neighbours."""
    padded = np.pad(distance, ((1, 1), (0, 0)), constant_values=np.inf)
    across = (0, 0), (1, 1)
    padded = np.pad(padded, across, "wrap") if wraps else np.pad(padded, across, constant_values=np.inf)
    rows = np.minimum(np.minimum(padded[:-2], padded[1:-1]), padded[2:])
    return np.minimum(np.minimum(rows[:, :-2], rows[:, 1:-1]), rows[:, 2:])


@dataclass(frozen=True, eq=False)
class ShadowTable:
    """What stands between a lamp and the points that it could light."""

    frame: Frame
    emitter: Emitter
    levels: tuple[Level, ...]
    colored: bool  # optical depths have three channels

    @property
    def entries(self) -> int:
        return sum(len(level.distance) for level in self.levels)

    @property
    def nbytes(self) -> int:
        return sum(level.nbytes for level in self.levels)

    @cached_property
    def nearest(self) -> Nearest:
        return nearest(self.frame, self.levels, self.emitter.shape != "POINT")

    def transmittance(self, points: np.ndarray, normals: np.ndarray | None = None, taps: int = TAPS) -> np.ndarray:
        """(P,) float64, or (P, 3) where colored: the share of the light that reaches world points (P, 3).

        normals: (P, 3) unit, or zero where there is none: of the surface that receives the light. Where shadows are
        soft, `taps` points of the lamp are averaged.
        """
        normals = np.zeros_like(points, dtype=float) if normals is None else normals
        parts = [slice(i, i + CHUNK) for i in range(0, max(len(points), 1), CHUNK)]
        result = np.concatenate([self._transmittance(points[part], normals[part], taps) for part in parts])
        return result if self.colored else result[:, 0]

    def optical_depth(self, points: np.ndarray, normals: np.ndarray | None = None, taps: int = TAPS) -> np.ndarray:
        """-ln of `transmittance`, at most OPAQUE_DEPTH."""
        return -np.log(np.maximum(self.transmittance(points, normals, taps), np.exp(-OPAQUE_DEPTH)))

    def receiver(self, points: np.ndarray, normals: np.ndarray) -> Receiver:
        """World points (P, 3) and their normals, as `transmittance` has them."""
        turn = self.frame.light_from_world.T
        return Receiver(self.frame, (np.asarray(points, float) - self.frame.origin) @ turn, normals @ turn)

    def _transmittance(self, points: np.ndarray, normals: np.ndarray, taps: int) -> np.ndarray:
        receiver = self.receiver(points, normals)
        spread = receiver.reach(self)
        cells = spread * self.emitter.radius / self.frame.step
        result = np.empty((len(points), 3 if self.colored else 1))
        hard, far = cells <= SHARP, cells > NARROW
        result[hard] = self._light(receiver.take(hard), spread[hard], [(0.0, 1.0)], np.zeros(2), None)
        for some, segments in ((~hard & ~far, FEW_SEGMENTS), (far, SEGMENTS)):
            if some.any():
                result[some] = self._soft(receiver.take(some), spread[some], segments, taps)
        return result

    def _soft(self, receiver: Receiver, spread: np.ndarray, segments: int, taps: int) -> np.ndarray:
        """(P, C): the mean of what comes from points of a lamp that is wide, its rays cut into segments."""
        sum_ = 0.0
        for k in range(taps):
            x, y, row, column, cut = (0.5 + k * SEQUENCE) % 1
            lamp = np.array([x, y]) * 2 - 1
            if self.emitter.shape != "RECTANGLE":
                lamp = np.sqrt(x) * np.array([np.cos(2 * np.pi * y), np.sin(2 * np.pi * y)])
            edges = (np.arange(segments + 1) + cut - 1) / (segments - 1)
            sum_ = sum_ + self._light(receiver, spread, list(pairwise(edges)), lamp, np.array([row, column]) - 0.5)
        return np.asarray(sum_ / taps)

    def _light(
        self,
        receiver: Receiver,
        spread: np.ndarray,
        segments: list[tuple[float, float]],
        lamp: np.ndarray,
        jitter: np.ndarray | None,
    ) -> np.ndarray:
        """(P, C): what comes from one point of the lamp. Its ray crosses cells where the lamp is wide.

        Segments of the ray are looked up in the cells of their middles. They are given by the square roots of parts of
        the spread, so that shadows sharpen towards what casts them.
        """
        left, depth = np.ones((len(receiver), 1)), np.zeros((len(receiver), 3 if self.colored else 1))
        offset = receiver.offset(self.emitter, lamp)
        for start, end in segments:
            far = receiver.along(max(start, 0.0) ** 2 * spread)
            near, behind = (receiver.along(e**2 * spread) for e in (end, end + OVERLAP * (end - start)))
            if end >= 1:
                near = behind = np.full(len(receiver), -np.inf)
            middle = max((start + end) / 2, 0.0) ** 2 if jitter is not None else 0.0
            latitude, longitude = receiver.tap(offset, middle * spread)
            # Samples of one surface may lie in several levels, but not side by side along the ray.
            covered = np.zeros_like(left)
            for level in self.levels:
                until = behind if level.kind == "OPAQUE" else near
                found = _look_up(level, receiver, latitude, longitude, until, far, jitter)
                if level.kind == "OPAQUE":
                    covered += found[:, :1]
                else:
                    depth += found
            left *= np.maximum(1 - covered, 0)
        return left * np.exp(-depth)


def isosurface(table: ShadowTable, depth: float) -> np.ndarray:
    """(K, 3) float64 world points where the optical depth from the lamp reaches `depth`: one in the middle of each cell
    of the fullest level where it does. (Gunjee et al. 2007, figure 15.) The lamp counts as a point.

    ValueError: a depth that is not positive and below OPAQUE_DEPTH.
    """
    if not 0 < depth < OPAQUE_DEPTH:
        raise ValueError(f"an isosurface of optical depth {depth}: expected above 0 and below {OPAQUE_DEPTH:g}")
    if not table.levels:
        return np.zeros((0, 3))
    table = replace(table, emitter=Emitter("POINT", np.zeros((2, 3))))
    level = max(table.levels, key=lambda level: len(level.distance))
    cell, grid, frame = level.occupied(), level.grid, table.frame
    row = np.searchsorted(grid.first, cell, side="right") - 1
    latitude, longitude = grid.latitude[row], (cell - grid.first[row] + grid.column0[row]) / grid.density[row]
    ray = directions(frame, latitude, longitude)[0]
    start = np.stack([longitude, latitude, np.zeros(len(cell))], axis=1) if frame.parallel else np.zeros((len(cell), 3))

    def at(distance: np.ndarray) -> np.ndarray:
        return (start + distance[:, None] * ray) @ frame.light_from_world + frame.origin

    def reached(distance: np.ndarray) -> np.ndarray:
        return table.optical_depth(at(distance)).reshape(len(cell), -1).max(axis=1) >= depth

    low = np.zeros(len(cell))
    high = np.full(len(cell), max(float(v.distance.max()) * (1 + v.grid.step) + v.grid.step for v in table.levels))
    found = reached(high)
    for _ in range(40):
        middle = (low + high) / 2
        behind = reached(middle)
        low, high = np.where(behind, low, middle), np.where(behind, middle, high)
    return at(high)[found]


class Receiver:
    """Points that receive light, in the lamp's coordinates; normals are zero where there is none."""

    def __init__(self, frame: Frame, local: np.ndarray, normals: np.ndarray) -> None:
        self.frame, self.local, self.normals = frame, local, normals
        self.latitude, self.longitude, self.distance = frame.spherical(local)
        self.ray, self.north, self.east = directions(frame, self.latitude, self.longitude)
        self.oriented = normals.any(axis=1)
        self.facing = np.maximum(np.abs((normals * self.ray).sum(axis=1)), STEEPEST)

    def __len__(self) -> int:
        return len(self.local)

    def take(self, index: np.ndarray) -> Receiver:
        return Receiver(self.frame, self.local[index], self.normals[index])

    def reach(self, table: ShadowTable) -> np.ndarray:
        """(P,) how far the ray from the lamp's rim departs from the ray from its middle, per size of the lamp, where
        the first thing lies that the ray may meet."""
        if table.emitter.shape == "POINT":
            return np.zeros(len(self))
        narrowed = 1.0 if self.frame.parallel else np.maximum(np.cos(self.latitude) - 1 + LOOSE, 1e-3) / LOOSE
        spread = self._reach(table, np.full(len(self), table.nearest.least))
        # What is known of the nearest narrows the directions in which there may be a nearer one.
        for _ in range(NARROWINGS):
            reach = spread * table.emitter.radius * CORNER / (LOOSE * narrowed)
            spread = self._reach(table, table.nearest.around(self.latitude, self.longitude, reach))
        return spread

    def _reach(self, table: ShadowTable, nearest: np.ndarray) -> np.ndarray:
        if self.frame.parallel:
            return np.maximum(self.distance - nearest, 0)
        nearest = np.maximum(nearest, max(table.emitter.radius, 1e-30))
        return np.maximum(1 / nearest - 1 / np.maximum(self.distance, 1e-30), 0)

    def along(self, spread: np.ndarray) -> np.ndarray:
        """(P,) distance from the lamp at which rays have departed so far."""
        return self.distance - spread if self.frame.parallel else self.distance / (1 + self.distance * spread)

    def offset(self, emitter: Emitter, lamp: np.ndarray) -> np.ndarray:
        """(P, 3) from the lamp's middle to a point (2,) of it, across the ray."""
        if emitter.shape in ("POINT", "DISK") and not self.frame.parallel:
            return emitter.radius * (lamp[0] * self.east + lamp[1] * self.north)
        point = lamp @ emitter.size
        return point - (self.ray @ point)[:, None] * self.ray

    def tap(self, offset: np.ndarray, spread: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Latitude and longitude (P,) of rays that have departed so far towards `offset` (P, 3)."""
        if self.frame.parallel:
            return self.latitude + offset[:, 1] * spread, self.longitude + offset[:, 0] * spread
        return self.frame.spherical(self.ray + offset * spread[:, None])[:2]


def _look_up(
    level: Level,
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
        if level.kind != "VOLUME":
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
        first, end = level.range(np.where(inside, grid.first[row] + column, -1))
        found = _up_to(level, first, end, np.minimum(far, limit), width / 2)
        if jitter is not None:
            until = near - OVERLAP_CELLS * width if level.kind == "OPAQUE" else near
            found -= _up_to(level, first, end, np.minimum(until, limit), width / 2)
        result += share[:, None] * (-np.expm1(-found) if level.kind == "OPAQUE" else found)
    return result


def _up_to(level: Level, first: np.ndarray, end: np.ndarray, limit: np.ndarray, ramp: np.ndarray) -> np.ndarray:
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
