"""Translucent shadow tables: how much of a lamp's light reaches any point (Gunjee et al. 2007, section 4.1).

A table holds, for each cell of directions around the lamp (rows of latitude, columns of longitude; for suns a plane
grid), a list of (distance, cumulated optical depth) in order of distance. Cells have about equal area and are as wide
as high: every row has as many columns as its circumference asks for, and the poles are cells of their own. A splat
gives its optical mass to the cells that its projection touches, each its share, over the cell's area at the splat's
distance: a cell then holds the mean optical depth over its directions. Levels of cells that double in size let each
splat touch four cells at most; a look-up sums the levels and interpolates between four cells of each.

Three kinds of matter are kept apart. VOLUME and SHELL sum optical depth, T = exp(-sum tau) (Beer's law). OPAQUE sums
the fraction of the cell that is covered (a ray that hits has optical depth 100, others none), T = max(0, 1 - sum f):
the samples of one surface tile it, and shadows have smooth edges. SHELL and OPAQUE entries lie where the splat's
*plane* meets the middle of the cell, and a look-up with a normal compares them with its own plane there, so that
a surface does not shade itself, however it is inclined.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from .cloud import PointCloud
from .scene import Light

OPAQUE_DEPTH = 100.0  # optical depth that stands for no light at all
KINDS = ("OPAQUE", "SHELL", "VOLUME")
BIAS = 1.0  # cells: how far along its normal a receiver is lifted
UNORIENTED_BIAS = 1.5  # cells, towards the lamp: receivers without a normal
STEEPEST = 0.1  # cosine: surfaces closer to edge-on are treated as this one
SHARP = 0.5  # cells: a lamp whose penumbrae are at most so wide is a point
TAPS = 64  # points of a wide lamp; the device takes some in each sample of the picture
SEGMENTS = 4  # of each ray to a point of a wide lamp
# Additive recurrence in five dimensions (Roberts 2018): two on the lamp, two in the cell, one along the ray.
SEQUENCE = 1.1347241384015194 ** -np.arange(1, 6)
SHAPES = ("POINT", "DISK", "RECTANGLE", "ELLIPSE")
NARROW = 0.8  # radians: casters within this angle about one direction get a grid about it, without poles
FINEST = 1e-6  # radians: a cell that float32 still resolves
COARSEST = 0.5  # radians: the widest cell of a grid without poles
WIDEST = 10.0  # radians: standard deviation of a splat that surrounds the lamp
SPAN = 2.0  # ratio of distances that share a level
WHOLE = 4.0  # ratio of all distances of a batch up to which they share one
WHOLE_SURFACE = 64.0  # and of samples of a surface, which would let light through where levels meet
TYPICAL = 0.9  # quantile of the radii of a surface's samples
OVERLAP = 0.15  # of a segment: how far it reaches into the next, lest light slips between the cells of both
OVERLAP_CELLS = 1.0  # and as many cells
RIM = {"VOLUME": np.sqrt(11) / 2, "SHELL": 1.0, "OPAQUE": 1.0}  # half extent in a cell, in half-axes: see _split
SMOKE = 1.005 * 2 * RIM["VOLUME"]  # cells of smoke per radius of its splats: just wide enough for them
LEAST_SHARE = 1 / 256  # of a row or column: below it, the nearer one takes all
WORD = 24  # cells to a mask: as many bits as a float32 holds as an integer
TEXEL = 3 * WORD  # cells to a texel: where its entries start, then three masks
CHUNK = 1 << 14  # splats that are projected together, so that scratch arrays stay in the cache
RUN = 1 << 14  # entries that are sorted together, for the same reason


@dataclass(frozen=True, eq=False)
class Casters:
    """Splats of one kind in world space: balls (`radius`), ellipses or ellipsoids (`axes`)."""

    kind: str  # one of KINDS
    origin: np.ndarray  # (3,) float64
    position: np.ndarray  # (N, 3) float32, relative to origin
    radius: np.ndarray | None = None  # (N,) float32
    axes: np.ndarray | None = None  # (N, K, 3) float32, half-axes: K = 2 flat, 3 solid
    # VOLUME: (N,) or (N, 3) float32, optical mass in units^2: the integral of extinction over the splat.
    # SHELL: (N,) or (N, 3) float32, optical depth -ln(1 - opacity) face on. OPAQUE: None.
    mass: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.position)

    @property
    def colored(self) -> bool:
        return self.mass is not None and self.mass.ndim == 2

    def take(self, index: np.ndarray | slice) -> Casters:
        arrays = (self.position, self.radius, self.axes, self.mass)
        position, radius, axes, mass = (None if a is None else a[index] for a in arrays)
        assert position is not None
        return Casters(self.kind, self.origin, position, radius, axes, mass)

    def reach(self) -> np.ndarray:
        """(N,) float32: the longest half-axis."""
        if self.axes is None:
            assert self.radius is not None
            return self.radius
        return np.sqrt(np.einsum("nkc,nkc->nk", self.axes, self.axes).max(axis=1))


def casters(cloud: PointCloud, world_from_object: np.ndarray) -> Casters:
    """The splats of `cloud` as casters: VOLUME where it has `extinction`, SHELL where it has `opacity`, else OPAQUE.

    world_from_object: (4, 4) float64. Extinction is per object unit, so scaling an object keeps its optical depths.
    Splats with a NaN or infinity, or without size or mass, are left out.
    """
    linear = np.asarray(world_from_object[:3, :3], float)
    origin = linear @ cloud.origin + world_from_object[:3, 3]
    position = cloud.position @ linear.T.astype(np.float32)
    kind = "VOLUME" if cloud.extinction is not None else "SHELL" if cloud.opacity is not None else "OPAQUE"
    radii = np.zeros((len(cloud), 1), np.float32) if cloud.radii is None else cloud.radii
    radius, axes, size = None, None, radii[:, 0]
    solid = kind == "VOLUME" and radii.shape[1] == 3
    with np.errstate(over="ignore", invalid="ignore"):
        if cloud.normal is None or (kind == "VOLUME" and not solid):
            scale = np.linalg.norm(linear, axis=0)
            if np.allclose(linear.T @ linear, np.eye(3) * scale[0] ** 2, atol=1e-4 * scale.max() ** 2):
                radius = radii[:, 0] * np.float32(scale[0])
            else:
                axes = radii[:, :1, None] * linear.T.astype(np.float32)
        else:
            axes = _half_axes(cloud, radii, solid) @ linear.T.astype(np.float32)
        mass = None
        if cloud.extinction is not None:
            volume = 4 / 3 * np.pi * (radii[:, :3].prod(axis=1) if solid else radii[:, 0] ** 3)
            volume *= abs(np.linalg.det(linear)) ** (2 / 3)
            extinction = cloud.extinction[:, 0] if cloud.extinction.shape[1:] == (1,) else cloud.extinction
            mass = np.maximum(extinction, 0) * (volume if extinction.ndim == 1 else volume[:, None])
            size = mass if mass.ndim == 1 else mass.sum(axis=1)
        elif cloud.opacity is not None:
            least = np.float32(np.exp(-OPAQUE_DEPTH / 2))  # float32 holds it
            mass = -np.log(np.maximum(1 - np.clip(cloud.opacity, 0, 1), least))
            mass[cloud.opacity >= 1] = OPAQUE_DEPTH
            size = size * mass
        good = np.isfinite(position).all(axis=1) & np.isfinite(size) & (size > 0)
        good &= np.isfinite(axes).all(axis=(1, 2)) if axes is not None else np.isfinite(radii[:, 0])
    if mass is not None:
        mass = mass.astype(np.float32, copy=False)
    result = Casters(kind, origin, position, radius, axes, mass)
    return result if good.all() else result.take(good)


def _half_axes(cloud: PointCloud, radii: np.ndarray, solid: bool) -> np.ndarray:
    """(N, 2 or 3, 3) float32 in object space."""
    normal = cloud.normal
    assert normal is not None
    first = cloud.axis
    if first is None:
        # Any direction in the plane of a disk: the cross product with the axis that is farthest from the normal.
        least = np.eye(3, dtype=np.float32)[np.abs(normal).argmin(axis=1)]
        first = np.cross(normal, least)
        first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), np.float32(1e-20))
    second = np.cross(normal, first)
    frame = [first, second, normal] if solid else [first, second]
    columns = [min(k, radii.shape[1] - 1) for k in range(len(frame))]
    return np.stack([a * radii[:, k, None] for a, k in zip(frame, columns, strict=True)], axis=1)


# The grid of cells


@dataclass(frozen=True, eq=False)
class Frame:
    """Where a lamp's cells lie. Local coordinates: for suns (x, y, distance), else a polar axis z.

    Angles are radians for lamps and lengths for suns: `latitude` is y, `longitude` is x.
    """

    parallel: bool
    light_from_world: np.ndarray  # (3, 3) float64, a rotation
    origin: np.ndarray  # (3,) float64, world: the lamp, or a point of the plane from which a sun's distances count
    full: bool  # all directions, with poles and without a seam
    low: np.ndarray  # (2,) least latitude and longitude where not full
    high: np.ndarray  # (2,)
    rows: int  # of the finest level

    def spherical(self, local: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Latitude, longitude and distance (N,) of local coordinates (N, 3), in their dtype."""
        x, y, z = local.T
        if self.parallel:
            return y, x, z
        squared = x * x + y * y
        return np.arctan2(z, np.sqrt(squared)), np.arctan2(y, x), np.sqrt(squared + z * z)

    @property
    def step(self) -> float:
        """Side of the finest cells."""
        return np.pi / self.rows if self.full else float((self.high - self.low).max() / self.rows)


@dataclass(frozen=True, eq=False)
class Grid:
    """Cells of one size. Row i lies about latitude low + i step, its cells about longitudes (column0 + j) / density."""

    low: float
    step: float
    column0: np.ndarray  # (R,) int64
    count: np.ndarray  # (R,) int64: cells in each row
    density: np.ndarray  # (R,) float32: columns per unit of longitude
    first: np.ndarray  # (R,) int64: index of each row's first cell
    wraps: bool  # the last column borders on the first

    @property
    def cells(self) -> int:
        return int(self.first[-1] + self.count[-1])

    @cached_property
    def latitude(self) -> np.ndarray:
        return self.low + self.step * np.arange(len(self.count))

    def area(self, parallel: bool) -> np.ndarray:
        """(R,) float64: of a cell of each row, in steradians (for suns, in units^2)."""
        if parallel:
            return np.full(len(self.count), self.step**2)
        edges = np.clip([self.latitude - self.step / 2, self.latitude + self.step / 2], -np.pi / 2, np.pi / 2)
        return np.maximum(np.sin(edges[1]) - np.sin(edges[0]), 1e-12) / self.density


def _grids(frame: Frame, coarser: float) -> list[Grid]:
    """Finest first, of `coarser` times the frame's step, each of twice the step of the one before."""
    grids = []
    for level in range(frame.rows.bit_length()):
        if frame.full:
            rows = max(1, int(frame.rows / coarser) >> level)
            step, low, count = np.pi / rows, -np.pi / 2, rows + 1
            latitude = low + step * np.arange(count)
            columns = np.maximum(np.rint(2 * np.pi * np.cos(latitude) / step), 1).astype(np.int64)
            density, column0 = columns / (2 * np.pi), np.zeros(count, np.int64)
        else:
            step = frame.step * coarser * 2**level
            if level and not frame.parallel and frame.step * 2**level > COARSEST:
                break
            low = frame.low[0] - step
            latitude = low + step * np.arange(int(np.ceil((frame.high[0] - frame.low[0]) / step)) + 3)
            shrink = np.ones(len(latitude)) if frame.parallel else np.maximum(np.cos(latitude), STEEPEST)
            density = shrink / step
            column0 = np.floor(frame.low[1] * density).astype(np.int64) - 1
            columns = np.ceil(frame.high[1] * density).astype(np.int64) + 2 - column0
        first = np.cumsum(columns) - columns
        grids.append(Grid(low, step, column0, columns, density.astype(np.float32), first, frame.full))
    return grids


def _fit(light: Light, batches: Sequence[Casters], resolution: int) -> Frame:
    """A grid about the casters, as far as the lamp shines on them."""
    rows = max(int(resolution), 1)
    low = np.min([b.origin + b.position.min(axis=0) - b.reach().max() for b in batches], axis=0)
    high = np.max([b.origin + b.position.max(axis=0) + b.reach().max() for b in batches], axis=0)
    corners = np.stack(np.meshgrid(*np.stack([low, high], axis=1), indexing="ij"), axis=-1).reshape(-1, 3)
    if light.kind == "SUN":
        rotation = _rotation(light.direction)[[1, 2, 0]]
        local = (corners - corners.mean(axis=0)) @ rotation.T
        side = np.ptp(local[:, :2], axis=0)
        # The distance of what lies flat across the light is resolved too.
        least = max(side.max() * 1e-6, np.abs(corners).max() * 1e-12, 1e-30)
        half = np.maximum(side / 2, least)
        origin = corners.mean(axis=0) + rotation[2] * local[:, 2].min()
        return Frame(True, rotation, origin, False, -half[::-1], half[::-1], rows)
    direction, angle = _cone(light, corners.mean(axis=0), batches)
    if angle > NARROW:
        # The poles lie across the lamp's own direction: a spot or area light has nothing there but at its rim.
        return Frame(False, _rotation(light.direction), light.position, True, np.zeros(2), np.zeros(2), rows)
    angle = max(angle, FINEST * rows / 2)
    return Frame(False, _rotation(direction), light.position, False, np.full(2, -angle), np.full(2, angle), rows)


def _cone(light: Light, middle: np.ndarray, batches: Sequence[Casters]) -> tuple[np.ndarray, float]:
    """A direction, and the angle about it that holds all splats that are lit; pi where the lamp is among them."""
    direction, angle = _unit(middle - light.position), 0.0
    for batch in batches:
        for start in range(0, len(batch), CHUNK):
            part = batch.take(slice(start, start + CHUNK))
            seen = part.position + (batch.origin - light.position).astype(np.float32)
            distance = np.maximum(np.sqrt(np.einsum("nc,nc->n", seen, seen)), np.float32(1e-30))
            cosine = seen @ direction.astype(np.float32) / distance
            angle = max(angle, float((np.arccos(np.clip(cosine, -1, 1)) + part.reach() / distance).max()))
            if angle > NARROW:
                break
    if light.kind == "SPOT" and light.axis_u is None:
        lit = float(np.arccos(np.clip(light.spot_cos, -1, 1)))
        if lit < angle:
            return light.direction, lit
    return direction, angle


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300)


def _rotation(direction: np.ndarray) -> np.ndarray:
    """(3, 3) float64 rotation whose first row is `direction`."""
    first = _unit(np.asarray(direction, float))
    if not first.any():
        first = np.array([1.0, 0, 0])
    second = _unit(np.cross(first, np.eye(3)[np.abs(first).argmin()]))
    return np.stack([first, second, np.cross(first, second)])


def _lit(light: Light, batch: Casters) -> Casters:
    """Without the casters that a spot or area lamp does not shine at."""
    if light.kind not in ("SPOT", "AREA"):
        return batch
    seen = batch.position + (batch.origin - light.position).astype(np.float32)
    reach = batch.reach() + np.float32(light.radius)
    depth = seen @ light.direction.astype(np.float32)
    if light.kind == "AREA":
        keep = depth > -reach
    elif light.axis_u is not None or light.spot_cos <= 0:
        return batch
    else:
        # The distance to the cone's side, in the plane of its axis.
        across = np.sqrt(np.maximum(np.einsum("nc,nc->n", seen, seen) - depth**2, 0))
        sine = np.sqrt(max(1 - light.spot_cos**2, 0))
        keep = across * light.spot_cos - depth * sine < reach
    return batch if keep.all() else batch.take(keep)


# Building


def build(light: Light, batches: Sequence[Casters], resolution: int) -> ShadowTable:
    """The table of `light`, `resolution` cells high: over half a turn, or over the casters where they fill less.

    ValueError: a lamp or direction that is not finite, or more entries than 32-bit links reach.
    """
    if not (np.isfinite(light.position).all() and np.isfinite(light.direction).all()):
        raise ValueError(f"light {light.name!r}: position or direction is not finite")
    batches = [b for b in (_lit(light, b) for b in batches) if len(b)]
    colored = any(b.colored for b in batches)
    if not batches:
        nothing = Frame(True, np.eye(3), np.zeros(3), False, -np.ones(2), np.ones(2), 1)
        return ShadowTable(nothing, Emitter("POINT", np.zeros((2, 3))), (), colored)
    frame = _fit(light, batches, resolution)
    rows = _Rows(frame, [_grids(frame, _coarser(frame, kind, batches)) for kind in KINDS])
    found: list[tuple[np.ndarray, ...]] = []
    for batch in batches:
        spans = _spans(frame, batch)
        for start in range(0, len(batch), CHUNK):
            cell, at, depth = _entries(rows, batch.take(slice(start, start + CHUNK)), spans)
            if colored and depth.ndim == 1:
                depth = np.broadcast_to(depth[:, None], (len(depth), 3))
            found.append((cell, at, depth))
    cell, at, depth = (np.concatenate(parts) for parts in zip(*found, strict=True))
    del found
    emitter = _emitter(light, frame)
    return ShadowTable(frame, emitter, tuple(_levels(rows, cell, at, depth, emitter.shape != "POINT")), colored)


class _Rows:
    """The rows of all kinds' grids, one after another."""

    def __init__(self, frame: Frame, kinds: list[list[Grid]]) -> None:
        self.frame, self.levels = frame, len(kinds[0])
        self.grids = grids = [grid for kind in kinds for grid in kind]
        self.low = np.array([g.low for g in grids], np.float32)
        self.step = np.array([g.step for g in grids], np.float32)
        self.height = np.array([len(g.count) for g in grids])
        self.base = (np.cumsum(self.height) - self.height).astype(np.int32)  # (G,) first row of each grid
        cells = np.array([g.cells for g in grids])
        self.cell_base = np.cumsum(cells) - cells  # (G,) first cell of each grid
        if cells.sum() >= 2**31:
            raise ValueError(f"a shadow table of {frame.rows} rows has too many cells for 32-bit links")
        self.first = np.concatenate([g.first + b for g, b in zip(grids, self.cell_base, strict=True)]).astype(np.int32)
        self.column0 = np.concatenate([g.column0 for g in grids]).astype(np.int32)
        self.count = np.concatenate([g.count for g in grids]).astype(np.int32)
        self.density = np.concatenate([g.density for g in grids])
        self.inverse_area = (1 / np.concatenate([g.area(frame.parallel) for g in grids])).astype(np.float32)
        self.latitude = np.concatenate([g.latitude for g in grids]).astype(np.float32)


def _coarser(frame: Frame, kind: str, batches: Sequence[Casters]) -> float:
    """By how much the finest cells of a kind are wider than the frame's, from 1 to 2.

    A level of smoke's cells is then SMOKE radii of most of its splats wide: wider cells would blur it more.
    """
    found = [batch for batch in batches if batch.kind == kind]
    if kind != "VOLUME" or not found:
        return 1.0
    batch = max(found, key=len)
    ratio = SMOKE * float(np.median(batch.reach())) / _spans(frame, batch).farthest / frame.step
    return ratio / 2 ** np.floor(np.log2(ratio)) if ratio > 1 else 1.0


@dataclass(frozen=True)
class _Spans:
    """How the splats of a batch are given their levels; see _level."""

    farthest: float  # where the farthest span of distances begins
    nearest: float  # and the nearest
    least: float  # radius: smaller splats count as this one


def _spans(frame: Frame, batch: Casters) -> _Spans:
    surface = batch.kind != "VOLUME"
    least = float(np.quantile(batch.reach(), TYPICAL)) if surface else 0.0
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


def _entries(rows: _Rows, batch: Casters, spans: _Spans) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What splats give to the cells: which (E,) int32, at what distance (E,) float32, how much (E,) or (E, 3) float32:
    optical depth, of opaque splats the covered fraction."""
    frame = rows.frame
    turn = frame.light_from_world.T.astype(np.float32)
    local = (batch.position + (batch.origin - frame.origin).astype(np.float32)) @ turn
    latitude, longitude, distance = frame.spherical(local)

    # Standard deviations along rows and columns; as angles, seen from within a splat, they are as wide as need be.
    axes, ray = None, np.zeros(0)
    if batch.axes is None:
        assert batch.radius is not None
        up = across = batch.radius / 2
    else:
        axes = batch.axes @ turn
        ray, north, east = _directions(frame, latitude, longitude)
        up, across = (np.sqrt((np.einsum("nkc,nc->nk", axes, d) ** 2).sum(axis=1)) / 2 for d in (north, east))
    strength = _strength(batch, axes, ray)
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

    # The nearer row and, where the splat reaches into it, the next; in each of them the same with columns.
    step, smoke, rim = rows.step[level], batch.kind == "VOLUME", np.float32(2 * RIM[batch.kind])
    which, row, share = _split((latitude - rows.low[level]) / step, rim * up / step, smoke)
    level = level[which]
    inside = (row >= 0) & (row < rows.height[level])
    row = np.where(inside, row, 0) + rows.base[level]
    density = rows.density[row]
    if not frame.parallel:
        across = across / np.maximum(np.cos(latitude), np.float32(1e-6))
    again, column, part = _split(longitude[which] * density, rim * across[which] * density, smoke)
    which, row, share, inside = which[again], row[again], share[again] * part, inside[again]
    place = column
    column = column - rows.column0[row]
    if frame.full:
        column %= rows.count[row]
    inside &= (column >= 0) & (column < rows.count[row])

    at = distance[which]
    if axes is not None and batch.kind != "VOLUME":
        place = place.astype(np.float32) / rows.density[row]
        to_cell = place - longitude[which], rows.latitude[row] - latitude[which]
        middle = _directions(frame, rows.latitude[row], place)[0]
        at = _plane_distance(frame, np.cross(axes[:, 0], axes[:, 1])[which], at, ray[which], middle, to_cell)
    weight = share * rows.inverse_area[row]
    depth = np.minimum(strength[which] * (weight if strength.ndim == 1 else weight[:, None]), np.float32(OPAQUE_DEPTH))
    cell, at = rows.first[row] + column, np.maximum(at, 0)
    return (cell, at, depth) if inside.all() else (cell[inside], at[inside], depth[inside])


def _level(rows: _Rows, batch: Casters, distance: np.ndarray, spans: _Spans) -> np.ndarray:
    """(N,) int32: the finest grid of the batch's kind in which no splat is wider than a cell.

    Where levels meet, their different widths show. So splats of one size whose distances are in a ratio of up to SPAN
    share a level, that of the nearest (in a batch whose distances are all alike, all do), and the samples of surfaces
    share that of a wide one among them.
    """
    angle = np.float32(2 * RIM[batch.kind]) * np.maximum(batch.reach(), np.float32(spans.least))
    if not rows.frame.parallel:
        base = np.full_like(distance, spans.nearest)
        if spans.farthest > spans.nearest:
            base *= SPAN ** np.floor(np.log(np.maximum(distance / base, 1)) / np.float32(np.log(SPAN)))
        angle = np.minimum(angle / base, 4 * WIDEST)
    first = KINDS.index(batch.kind) * rows.levels
    level = np.ceil(np.log2(np.maximum(angle / rows.step[first], np.float32(1e-30))))
    return np.clip(level, 0, rows.levels - 1).astype(np.int32) + first


def _directions(frame: Frame, latitude: np.ndarray, longitude: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit vectors (N, 3) away from the lamp, along growing latitude and along growing longitude; local."""
    if frame.parallel:
        shape = (len(latitude), 3)
        return tuple(np.broadcast_to(np.eye(3, dtype=latitude.dtype)[k], shape) for k in (2, 1, 0))  # type: ignore[return-value]
    c, s, x, y = np.cos(latitude), np.sin(latitude), np.cos(longitude), np.sin(longitude)
    ray, north = np.stack([c * x, c * y, s], axis=1), np.stack([-s * x, -s * y, c], axis=1)
    return ray, north, np.stack([-y, x, np.zeros_like(x)], axis=1)


def _split(place: np.ndarray, half: np.ndarray, smoke: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which splat (E,), which cell (E,) int32, what share of it (E,): of splats on a line of cells about integers.

    `half` is a splat's half extent in cells; it is at most half a cell, so the nearest border divides it. Along the
    line a disk counts as a parabola that ends at its rim, and smoke as (1 - x^2)^4, near to the projection of
    core/kernel.py, with the variance of a splat where it ends at sqrt(11) standard deviations. Both have an end, so
    that no cell but two gets a share.
    """
    cell = np.rint(place)
    off = place - cell
    t = np.clip((np.abs(off) - np.float32(0.5)) / np.maximum(half, np.float32(1e-20)), -1, 1)
    t2 = t * t
    if smoke:
        t *= np.float32(315 / 128) * (1 + t2 * (-4 / 3 + t2 * (6 / 5 + t2 * (-4 / 7 + t2 / 9))))
    else:
        t *= np.float32(1.5) - np.float32(0.5) * t2
    beyond = np.float32(0.5) + np.float32(0.5) * t
    beyond[beyond < LEAST_SHARE] = 0
    far = np.flatnonzero(beyond)
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


def _strength(batch: Casters, axes: np.ndarray | None, ray: np.ndarray) -> np.ndarray:
    """(N,) or (N, 3) float32: optical mass towards the lamp, units^2; of opaque splats the area that is seen."""
    if batch.kind == "VOLUME":
        assert batch.mass is not None
        return batch.mass
    if axes is None:
        assert batch.radius is not None
        area = np.pi * batch.radius**2
    else:
        area = np.float32(np.pi) * np.abs(np.einsum("nc,nc->n", np.cross(axes[:, 0], axes[:, 1]), ray))
    if batch.mass is None:
        return area
    return batch.mass * (area if batch.mass.ndim == 1 else area[:, None])


def _plane_distance(
    frame: Frame,
    normal: np.ndarray,  # (N, 3) local, of any length
    distance: np.ndarray,  # (N,) of a point of the plane
    ray: np.ndarray,  # (N, 3) towards it, unit
    middle: np.ndarray,  # (N, 3) towards the cell, unit
    to_cell: tuple[np.ndarray, np.ndarray],  # (N,) longitude and latitude of the cell less those of the point
) -> np.ndarray:
    """(N,) distance at which the plane meets the middle of the cell."""
    facing = (normal * ray).sum(axis=1)
    least = STEEPEST * np.sqrt((normal**2).sum(axis=1))
    if frame.parallel:
        return distance - (normal[:, 0] * to_cell[0] + normal[:, 1] * to_cell[1]) / _at_least(facing, least)
    there = (normal * middle).sum(axis=1)
    # A plane that turns its other side to the cell never meets it.
    there = np.where((there > 0) == (facing > 0), there, facing)
    return distance * (_at_least(facing, least) / _at_least(there, least))


def _at_least(value: np.ndarray, least: np.ndarray) -> np.ndarray:
    """With its sign, and not nearer to 0 than `least`; never 0."""
    return np.copysign(np.maximum(np.maximum(np.abs(value), least), np.float32(1e-30)), value)


def _levels(rows: _Rows, cell: np.ndarray, at: np.ndarray, depth: np.ndarray, wide: bool) -> Iterator[Level]:
    """Sort the entries of all cells, sum within cells, and cut into levels. `wide`: the lamp has a size."""
    opaque = 0 if wide else int(rows.cell_base[rows.levels])
    summed = [_summed(key, part, opaque) for key, part in _sorted_runs(cell, at, depth)]
    del cell, at, depth
    cell, distance, total = (np.concatenate(parts) for parts in zip(*summed, strict=True))
    del summed
    starts = np.flatnonzero(np.append(True, cell[1:] != cell[:-1]))
    occupied = cell[starts]
    starts = np.append(starts, len(cell))
    for k, (grid, base) in enumerate(zip(rows.grids, rows.cell_base, strict=True)):
        low, high = np.searchsorted(occupied, [base, base + grid.cells])
        if low == high:
            continue
        first, end = int(starts[low]), int(starts[high])
        rank, mask = _masks(occupied[low:high] - base, grid.cells)
        links = (starts[low : high + 1] - first).astype(np.int32)
        yield Level(
            KINDS[k // rows.levels], grid, rank, mask, links, distance[first:end].copy(), total[first:end].copy()
        )


def _sorted_runs(cell: np.ndarray, at: np.ndarray, depth: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Runs of whole cells in order: keys (E,) uint64 of cell and distance, and depths; those of one key as given.

    Entries are first dealt out to runs that fit the processor's caches: the cost then grows with their number.
    """
    group = cell >> max(int(cell.max(initial=0)).bit_length() - 20, 0)
    count = np.bincount(group)
    run = ((np.cumsum(count) - count) // max(RUN, len(cell) >> 15)).astype(np.uint16)[group]
    order = np.argsort(run, kind="stable")  # of 16 bits: a radix sort
    ends = np.cumsum(np.bincount(run)).tolist()
    for start, end in pairwise([0, *ends]):
        if start == end:
            continue
        where = order[start:end]
        # Positive float32 are in the order of their bits; adding 0 makes -0 one of them.
        part = cell[where].astype(np.uint64) << np.uint64(32) | (at[where] + np.float32(0)).view(np.uint32)
        first = part.min() >> np.uint64(32) << np.uint64(32)
        bits = len(part).bit_length()
        if int(part.max() - first).bit_length() + bits <= 64:
            # Sorting numbers is several times as fast as finding their order: each carries its index.
            carried = (part - first) << np.uint64(bits) | np.arange(len(part), dtype=np.uint64)
            index = (np.sort(carried) & np.uint64((1 << bits) - 1)).astype(np.int64)
        else:
            index = np.argsort(part, kind="stable")
        yield part[index], depth[where[index]]


def _summed(key: np.ndarray, depth: np.ndarray, opaque: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cells (E,) int32, distances (E,) float32 and sums over each cell up to there (E, C) float32, of sorted entries.

    Cells below `opaque` hold covered fractions, of which nothing counts behind 1.
    """
    depth = depth.astype(np.float64)
    cell = (key >> np.uint64(32)).astype(np.int32)
    total = _sums_within(cell, depth)
    # What lies behind no light at all is not needed, but where light comes from the side.
    before = total - depth if depth.ndim == 1 else (total - depth).min(axis=1)
    lit = before < np.where(cell < opaque, 1, OPAQUE_DEPTH)
    # Of one distance, the last holds the sum.
    key, total = key[lit], total[lit]
    last = np.append(key[1:] != key[:-1], True)
    key, total = key[last], total[last].astype(np.float32)
    distance = (key & np.uint64(0xFFFFFFFF)).astype(np.uint32).view(np.float32)
    return (key >> np.uint64(32)).astype(np.int32), distance, total.reshape(len(key), -1)


def _sums_within(group: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Running sums (E, ...) of `values` that start anew where `group` (E,) changes."""
    total = np.cumsum(values, axis=0)
    starts = np.flatnonzero(np.append(True, group[1:] != group[:-1]))
    before = np.concatenate([np.zeros_like(total[:1]), total[starts[1:] - 1]])
    return total - np.repeat(before, np.diff(np.append(starts, len(group))), axis=0)


def _masks(occupied: np.ndarray, cells: int) -> tuple[np.ndarray, np.ndarray]:
    """Which cells hold entries: the number (W,) int32 of occupied cells before each TEXEL, bits (W, 3) int32."""
    words = -(-cells // TEXEL)
    mask = np.bincount(occupied // WORD, weights=2.0 ** (occupied % WORD), minlength=3 * words).astype(np.int32)
    count = np.bincount(occupied // TEXEL, minlength=words)
    return (np.cumsum(count) - count).astype(np.int32), mask.reshape(words, 3)


# The table


@dataclass(frozen=True, eq=False)
class Level:
    """Cells of one size and kind. Cell c holds entries links[k] .. links[k + 1], k its rank among occupied cells."""

    kind: str
    grid: Grid
    rank: np.ndarray  # (W,) int32: occupied cells before cell W * TEXEL
    mask: np.ndarray  # (W, 3) int32: WORD cells each, lowest bit first
    links: np.ndarray  # (O + 1,) int32
    distance: np.ndarray  # (E,) float32, ascending within a cell
    total: np.ndarray  # (E, 1 or 3) float32: optical depth (OPAQUE: covered fraction) up to and with the entry

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


def _emitter(light: Light, frame: Frame) -> Emitter:
    if light.kind == "AREA" and light.axis_u is not None and light.axis_v is not None:
        size = np.stack([light.axis_u, light.axis_v]) @ frame.light_from_world.T
        return Emitter("ELLIPSE" if light.ellipse else "RECTANGLE", size)
    radius = np.tan(min(light.radius, 1.5)) if light.kind == "SUN" else light.radius
    return Emitter("DISK" if radius > 0 else "POINT", np.eye(3)[:2] * radius)


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
    def nearest(self) -> float:
        """No entry is nearer to the lamp."""
        return min((float(level.distance.min()) for level in self.levels), default=0.0)

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

    def _transmittance(self, points: np.ndarray, normals: np.ndarray, taps: int) -> np.ndarray:
        turn = self.frame.light_from_world.T
        receiver = _Receiver(self.frame, (np.asarray(points, float) - self.frame.origin) @ turn, normals @ turn)
        wide = receiver.spread(self) > SHARP
        result = np.empty((len(points), 3 if self.colored else 1))
        result[~wide] = self._light(receiver.take(~wide), [(0.0, 1.0)], np.zeros(2), None)
        soft, sum_ = receiver.take(wide), 0.0
        for k in range(taps if wide.any() else 0):
            x, y, row, column, cut = (0.5 + k * SEQUENCE) % 1
            lamp = np.array([x, y]) * 2 - 1
            if self.emitter.shape != "RECTANGLE":
                lamp = np.sqrt(x) * np.array([np.cos(2 * np.pi * y), np.sin(2 * np.pi * y)])
            edges = (np.arange(SEGMENTS + 1) + cut - 1) / (SEGMENTS - 1)
            sum_ = sum_ + self._light(soft, list(pairwise(edges)), lamp, np.array([row, column]) - 0.5)
        result[wide] = sum_ / taps
        return result

    def _light(
        self, receiver: _Receiver, segments: list[tuple[float, float]], lamp: np.ndarray, jitter: np.ndarray | None
    ) -> np.ndarray:
        """(P, C): what comes from one point of the lamp. Its ray crosses cells where the lamp is wide.

        Segments of the ray are looked up in the cells of their middles. They are given by the square roots of parts of
        the spread, so that shadows sharpen towards what casts them.
        """
        covered, depth = np.zeros((len(receiver), 1)), np.zeros((len(receiver), 3 if self.colored else 1))
        spread, offset = receiver.reach(self), receiver.offset(self.emitter, lamp)
        for start, end in segments:
            far = receiver.along(max(start, 0.0) ** 2 * spread)
            near, behind = (receiver.along(e**2 * spread) for e in (end, end + OVERLAP * (end - start)))
            if end >= 1:
                near = behind = np.full(len(receiver), -np.inf)
            middle = max((start + end) / 2, 0.0) ** 2 if jitter is not None else 0.0
            latitude, longitude = receiver.tap(offset, middle * spread)
            for level in self.levels:
                until = behind if level.kind == "OPAQUE" else near
                found = _look_up(level, receiver, latitude, longitude, until, far, jitter)
                if level.kind == "OPAQUE":
                    covered += found[:, :1]
                else:
                    depth += found
        return np.maximum(1 - covered, 0) * np.exp(-depth)


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
    ray = _directions(frame, latitude, longitude)[0]
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


class _Receiver:
    """Points that receive light, in the lamp's coordinates; normals are zero where there is none."""

    def __init__(self, frame: Frame, local: np.ndarray, normals: np.ndarray) -> None:
        self.frame, self.local, self.normals = frame, local, normals
        self.latitude, self.longitude, self.distance = frame.spherical(local)
        self.ray, self.north, self.east = _directions(frame, self.latitude, self.longitude)
        self.oriented = normals.any(axis=1)
        self.facing = np.maximum(np.abs((normals * self.ray).sum(axis=1)), STEEPEST)

    def __len__(self) -> int:
        return len(self.local)

    def take(self, index: np.ndarray) -> _Receiver:
        return _Receiver(self.frame, self.local[index], self.normals[index])

    def reach(self, table: ShadowTable) -> np.ndarray:
        """(P,) how far the ray from the lamp's rim departs there from the ray from its middle, per size of the lamp."""
        if self.frame.parallel:
            return np.maximum(self.distance - table.nearest, 0)
        nearest = max(table.nearest, table.emitter.radius, 1e-30)
        return np.maximum(1 / nearest - 1 / np.maximum(self.distance, 1e-30), 0)

    def spread(self, table: ShadowTable) -> np.ndarray:
        """(P,) the same in cells."""
        return self.reach(table) * table.emitter.radius / self.frame.step

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
    receiver: _Receiver,
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
            middle = _directions(frame, grid.latitude[row], there)[0]
            plane = _plane_distance(frame, receiver.normals, receiver.distance, receiver.ray, middle, to_cell)
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
        result += share[:, None] * (np.minimum(found, 1) if level.kind == "OPAQUE" else found)
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


# What the device reads

PAGE_WIDTH = 4096  # texels to a row of the tables' texture
HEAD = 6  # texels of a lamp's record before its levels
LEVEL = 3  # texels of a level's record


@dataclass(frozen=True, eq=False)
class PackedTables:
    """All lamps' tables as one texture that no view changes, and what each view needs to read it.

    `data` holds, for each level: rows (first cell, column0, count, density), masks (rank, three masks), links, and
    entries (distance, total): two to a texel, or one where `colored`. Integers that may be large are `coded`.
    """

    data: np.ndarray  # (H, PAGE_WIDTH, 4) float32
    colored: bool
    tables: tuple[ShadowTable | None, ...]  # of each lamp; None: it casts no shadow
    levels: np.ndarray  # (lamps, most levels, LEVEL, 4) float32

    def records(self, view_from_world: np.ndarray) -> np.ndarray:
        """(lamps, HEAD + LEVEL levels, 4) float32: ps_shadow_lights for one view, (4, 4) float64 and rigid.

        Texels 0 to 2 are the rows of light_from_view, 3 is (1 for suns, number of levels, index of the shape, nearest
        entry), 4 and 5 are the size, local, with the radius and the finest step behind.
        """
        world_from_view = np.linalg.inv(view_from_world)
        head = np.zeros((len(self.tables), HEAD, 4))
        for row, table in zip(head, self.tables, strict=True):
            if table is not None and table.levels:
                frame, emitter = table.frame, table.emitter
                row[:3, :3] = frame.light_from_world @ world_from_view[:3, :3]
                row[:3, 3] = frame.light_from_world @ (world_from_view[:3, 3] - frame.origin)
                row[3] = frame.parallel, len(table.levels), SHAPES.index(emitter.shape), table.nearest
                row[4:, :3], row[4:, 3] = emitter.size, (emitter.radius, frame.step)
        return np.concatenate([head.astype(np.float32), self.levels.reshape(len(head), -1, 4)], axis=1)


def pack(tables: Sequence[ShadowTable | None], texture_size: int = 16384) -> PackedTables:
    """The tables of lamps, in the order of their rows in the texture of lights; None where one casts no shadow.

    ValueError: they need more than `texture_size` rows of PAGE_WIDTH texels.
    """
    colored = any(t is not None and t.colored for t in tables)
    most = max([len(t.levels) for t in tables if t is not None], default=0)
    records = np.zeros((len(tables), most, LEVEL, 4), np.float32)
    parts, texels = [], 0
    for table, record in zip(tables, records, strict=True):
        for level, texel in zip(() if table is None else table.levels, record, strict=False):
            blocks = _blocks(level, colored)
            sizes = np.array([len(b) for b in blocks])
            base = texels + np.cumsum(sizes) - sizes
            texel[0] = level.grid.low, level.grid.step, len(level.grid.count), KINDS.index(level.kind)
            texel[1] = coded(base * (1, 1, 4, 1 if colored else 2))
            texel[2, 0] = level.grid.wraps
            texel[2, 1:3] = level.distance.min(initial=np.inf), level.distance.max(initial=0)
            parts += blocks
            texels += int(sizes.sum())
    height = max(1, -(-texels // PAGE_WIDTH))
    if height > texture_size:
        raise ValueError(f"shadow tables need {height} rows of a texture, this device has {texture_size}")
    data = np.zeros((height * PAGE_WIDTH, 4), np.float32)
    if parts:
        np.concatenate(parts, out=data[:texels])
    return PackedTables(data.reshape(height, PAGE_WIDTH, 4), colored, tuple(tables), records)


def coded(integers: np.ndarray) -> np.ndarray:
    """Integers below 2^31 - 2^24 as the float32 of their bits: positive, normal, so that no device alters them."""
    return (np.asarray(integers, np.int64) + 0x00800000).astype(np.int32).view(np.float32)


def _blocks(level: Level, colored: bool) -> list[np.ndarray]:
    """Rows, masks, links and entries as texels (n, 4) float32."""
    grid = level.grid
    rows = np.stack([coded(grid.first), grid.column0, grid.count, grid.density], axis=1).astype(np.float32)
    masks = np.concatenate([coded(level.rank)[:, None], level.mask.astype(np.float32)], axis=1)
    total = np.broadcast_to(level.total, (len(level.total), 3)) if colored else level.total
    entries = np.concatenate([level.distance[:, None], total], axis=1)
    return [rows, masks, *(_texels(a.reshape(-1)) for a in (coded(level.links), entries))]


def _texels(values: np.ndarray) -> np.ndarray:
    texels = np.zeros((-(-len(values) // 4), 4), np.float32)
    texels.reshape(-1)[: len(values)] = values
    return texels
