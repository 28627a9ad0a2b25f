"""How much optical depth captured splats add to the cells of a shadow table.

A splat of opacity o leaves 1 - o exp(-q / 2) of the light of a ray, with q the squared Mahalanobis distance at which it
passes the splat's centre: an optical depth of

    -ln(1 - o exp(-q / 2)),    and none where o exp(-q / 2) is below LEAST_ALPHA,

as in pictures (core/splat/captured.py). Other splats touch four cells at most, of a level in which they are no wider
than a cell; captured ones are large and small side by side and mostly opaque, and would darken all around them. They
are drawn into cells that are no wider than half their standard deviation, in the cells' middles; where they are many,
into wider ones. Looking up interpolates
between cells, which adds a variance of a sixth of their area along each axis. Splats are narrowed by half of that
before, which is too much in cells' middles and too little between them; those that are too narrow for their cells are
widened. Either keeps the optical mass.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...numeric.segments import owners, ranges
from ...numeric.vectors import cross
from ...splat.captured import LEAST_ALPHA
from ..casters import KINDS, Casters, rotate_vectors
from ..grid import directions
from ..rows import GridRows

CELL = 0.5  # standard deviations along the shorter axis, at most,
ASPECT = 4.0  # and of needles so much less than along the longer one
NARROWED = 1 / 12  # cells^2: variance that splats are narrowed by
LEAST_VARIANCE = 1 / 4  # of what is drawn, in cells^2: sums over cells are then even within 1.5 %
MOST_ENTRIES = 1 << 21  # of all captured splats of a table, about: more splats are drawn into wider cells
ENTRIES_OF_POINT = 12.0  # of a splat that is smaller than its cell
WIDEST = 2.0  # radians: standard deviation of a splat that surrounds the light
INSIDE = 1.0  # standard deviations: the light is in the splat, which then does not cast
SIDEWAYS = 0.1  # cosine: a splat is not drawn farther from its centre, as seen from the light
BATCH = 1 << 12  # splats that are drawn together, so that what is in between stays in the cache

_Block = tuple[np.ndarray, np.ndarray, np.ndarray]


def captured_entries(rows: GridRows, batch: Casters, share: float = 1.0) -> Iterator[_Block]:
    """Yields, for splats with an opacity, cells (E,) int32, distances (E,) float32 and optical depths (E,) float32.

    share: of the most entries of a table, for this batch.
    """
    parts = [_Seen(rows, batch.take(slice(start, start + BATCH))) for start in range(0, len(batch), BATCH)]
    count = sum(seen.count for seen in parts)
    wider = np.sqrt(max(count / (share * MOST_ENTRIES), 1.0))
    for seen in parts:
        yield _drawn(rows, seen, wider)


class _Seen:
    """N splats as a light sees them: centres in its coordinates, and covariances in the plane across the ray to each,
    in radians or, of parallel rays, in the unit: a power of two near the finest step, so that fourth powers of lengths
    are numbers of float32 in worlds of any size."""

    def __init__(self, rows: GridRows, batch: Casters) -> None:
        frame = rows.frame
        turn = frame.light_from_world.T.astype(np.float32)
        assert batch.axes is not None
        assert batch.opacity is not None
        local = (batch.position + (batch.origin - frame.origin).astype(np.float32)) @ turn
        axes = rotate_vectors(batch.axes, turn) / 2
        self.latitude, self.longitude, self.distance = frame.spherical(local)
        self.ray, self.north, self.east = directions(frame, self.latitude, self.longitude)
        u, v, w = (np.einsum("nkc,nc->kn", axes, d) for d in (self.east, self.north, self.ray))
        self.rim = 2 * np.log(np.maximum(batch.opacity / LEAST_ALPHA, 1))  # q where alpha is LEAST_ALPHA
        self.opacity = batch.opacity
        self.unit = np.float32(1)
        if frame.parallel:
            self.unit = np.exp2(np.round(np.log2(rows.step[KINDS.index("CAPTURED") * rows.levels]))).astype(np.float32)
            u, v, w = u / self.unit, v / self.unit, w / self.unit
        else:
            floor = np.maximum(self.distance, np.float32(1e-30))
            self.opacity = np.where(_holds_light(axes, local), np.float32(0), self.opacity)
            u, v = u / floor, v / floor
            shrink = np.minimum(WIDEST / np.maximum(np.sqrt((u * u + v * v).sum(axis=0)), np.float32(1e-30)), 1)
            u, v = u * shrink, v * shrink
        self.uu, self.uv, self.vv = ((a * b).sum(axis=0) for a, b in ((u, u), (u, v), (v, v)))
        self.deep_u, self.deep_v = (w * u).sum(axis=0), (w * v).sum(axis=0)
        self.det = (cross(u, v) ** 2).sum(axis=0)  # a sum of squares: without cancellation
        middle = (self.uu + self.vv) / 2
        self.major = middle + np.sqrt(((self.uu - self.vv) / 2) ** 2 + self.uv**2)
        self.minor = self.det / np.maximum(self.major, np.float32(1e-30))
        self.width = np.float32(CELL) * np.sqrt(np.maximum(self.minor, self.major / np.float32(ASPECT**2)))

    @property
    def count(self) -> float:
        """About how many cells all are drawn into, where cells are as wide as they."""
        covered = np.pi * self.rim * np.sqrt(self.det) / np.maximum(self.width**2, np.float32(1e-30))
        return float((ENTRIES_OF_POINT + covered).sum())


def _holds_light(axes: np.ndarray, local: np.ndarray) -> np.ndarray:
    """(N,) bool: whether the light, at the origin, lies in boxes of splats with axes (N, 3, 3) at `local` (N, 3)."""
    columns = [axes[:, k].T for k in range(3)]
    sides = [cross(columns[(k + 1) % 3], columns[(k + 2) % 3]).T for k in range(3)]
    volume = np.maximum(np.abs(np.einsum("nc,nc->n", axes[:, 0], sides[0])), np.float32(1e-38))
    along = [np.abs(np.einsum("nc,nc->n", side, local)) for side in sides]
    return np.all([a < INSIDE * volume for a in along], axis=0)


def _drawn(rows: GridRows, seen: _Seen, wider: float) -> _Block:
    """The entries of splats, in cells `wider` times as wide as these ask for."""
    frame, first = rows.frame, KINDS.index("CAPTURED") * rows.levels
    finest = rows.step[first] / seen.unit
    level = np.floor(np.log2(np.maximum(seen.width * np.float32(wider) / finest, np.float32(1e-30))))
    level = np.clip(level, 0, rows.levels - 1).astype(np.int32) + first
    step = rows.step[level]
    area = (step / seen.unit) ** 2
    more = np.maximum(-NARROWED * area, LEAST_VARIANCE * area - seen.minor)
    uu, vv = seen.uu + more, seen.vv + more
    det = (seen.minor + more) * (seen.major + more)
    kept = np.sqrt(seen.det / det)
    rim = np.where(seen.opacity > 0, seen.rim, np.float32(0))

    # Cells in a box around each.
    up, across = np.sqrt(rim * vv) * seen.unit, np.sqrt(rim * uu) * seen.unit
    if not frame.parallel:
        # A circle of latitude curves towards the pole.
        up = up + np.minimum(across**2 * np.abs(np.tan(seen.latitude)) / 2, across)
    low = np.ceil((seen.latitude - up - rows.low[level]) / step).astype(np.int64)
    high = np.floor((seen.latitude + up - rows.low[level]) / step).astype(np.int64)
    low, high = np.maximum(low, 0), np.minimum(high, rows.height[level] - 1)
    height = np.maximum(np.where(rim > 0, high - low + 1, 0), 0)
    which = owners(height)
    row = ranges(low, height) + rows.base[level][which]
    density = rows.density[row]
    half = across[which]
    if not frame.parallel:
        half = half / np.maximum(np.cos(rows.latitude[row]), np.float32(1e-6))
    middle = seen.longitude[which] * density
    reach = np.minimum(half * density, rows.count[row].astype(np.float32))
    left, right = np.ceil(middle - reach).astype(np.int64), np.floor(middle + reach).astype(np.int64)
    start, count = rows.column0[row], rows.count[row]
    if frame.full:
        right = np.minimum(right, left + count - 1)
    else:
        left, right = np.maximum(left, start), np.minimum(right, start + count - 1)
    width = np.maximum(right - left + 1, 0)
    again = owners(width)
    column = ranges(left, width)
    which, row = which[again], row[again]

    # Where in the plane across its ray each is met by the ray through the cell's middle.
    place = column.astype(np.float32) / rows.density[row]
    if frame.parallel:
        u, v = place - seen.longitude[which], rows.latitude[row] - seen.latitude[which]
        meets = np.ones(len(u), bool)
    else:
        ray = directions(frame, rows.latitude[row], place)[0]
        ahead, u, v = (np.einsum("nc,nc->n", ray, d[which]) for d in (seen.ray, seen.east, seen.north))
        meets = ahead > SIDEWAYS
        ahead = np.maximum(ahead, np.float32(SIDEWAYS))
        u, v = u / ahead, v / ahead
    conic = [(array / det)[which] for array in (vv, -seen.uv, uu)]
    x, y = u / seen.unit, v / seen.unit
    q = conic[0] * x * x + 2 * conic[1] * x * y + conic[2] * y * y
    inside = np.flatnonzero(meets & (q < rim[which]))
    which, row, column, u, v, q = (array[inside] for array in (which, row, column, u, v, q))
    depth = -np.log1p(-seen.opacity[which] * np.exp(-0.5 * q)) * kept[which]
    slope_u = (vv * seen.deep_u - seen.uv * seen.deep_v) / det
    slope_v = (uu * seen.deep_v - seen.uv * seen.deep_u) / det
    at = np.maximum(seen.distance[which] + slope_u[which] * u + slope_v[which] * v, 0)
    column = column - rows.column0[row]
    if frame.full:
        column %= rows.count[row]
    return rows.first[row] + column.astype(np.int32), at.astype(np.float32), depth.astype(np.float32)
