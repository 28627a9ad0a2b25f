"""The cells of a shadow table: directions around a light, or positions across a sun's rays."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from ..numeric.record import record
from ..numeric.segments import starts
from ..numeric.vectors import unit_rows
from ..scene.lights import Light
from .casters import CHUNK, Casters

LEAST_COSINE = 0.1  # cosine: surfaces closer to edge-on are treated as this one
NARROW_ANGLE = 0.8  # radians: casters within this angle about one direction get a grid about it, without poles
FINEST_STEP = 1e-6  # radians: a cell that float32 still resolves
FINER_OCTAVES = 2  # octaves by which the finest cells may be narrower than the frame's
# The grid of a sun is turned about its direction where volumes cast: cells that run along a lattice of voxels, under a
# sun along one of its axes, would all hold the same share of them. By so many radians, no multiple of which is a right
# angle or a simple slope.
TILT = 0.3
COARSEST_STEP = 0.5  # radians: the widest cell of a grid without poles
GRAZING = 1e-3  # sine of the angle to an area light's plane below which casters count as lying in it


@record
class Frame:
    """The coordinate system of a light's cells, whose rows lie along latitudes and columns along longitudes.

    Local coordinates of suns are (x, y, distance); then latitude is y and longitude x, in world units. Those of other
    lights have their origin at the light and a polar axis z; then both are angles in radians.
    """

    parallel: bool
    light_from_world: np.ndarray  # (3, 3) float64, a rotation
    origin: np.ndarray  # (3,) float64, world: the light, or a point of the plane from which a sun's distances count
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


@record
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


def cell_grids(frame: Frame, coarser: float) -> list[Grid]:
    """Returns the grids of a frame, finest first, each with about twice the step of the one before.

    The finest has `coarser` times the frame's step. The number of grids does not depend on `coarser`, which must be
    in [2^-FINER_OCTAVES, 2].
    """
    grids = []
    for level in range(frame.rows.bit_length() + FINER_OCTAVES):
        if frame.full:
            rows = max(1, int(frame.rows / coarser) >> level)
            step, low, count = np.pi / rows, -np.pi / 2, rows + 1
            latitude = low + step * np.arange(count)
            columns = np.maximum(np.rint(2 * np.pi * np.cos(latitude) / step), 1).astype(np.int64)
            density, column0 = columns / (2 * np.pi), np.zeros(count, np.int64)
        else:
            step = frame.step * coarser * 2**level
            if level and not frame.parallel and frame.step * 2.0 ** (level - FINER_OCTAVES) > COARSEST_STEP:
                break
            low = frame.low[0] - step
            latitude = low + step * np.arange(int(np.ceil((frame.high[0] - frame.low[0]) / step)) + 3)
            shrink = np.ones(len(latitude)) if frame.parallel else np.maximum(np.cos(latitude), LEAST_COSINE)
            density = shrink / step
            column0 = np.floor(frame.low[1] * density).astype(np.int64) - 1
            columns = np.ceil(frame.high[1] * density).astype(np.int64) + 2 - column0
        first = starts(columns)
        grids.append(Grid(low, step, column0, columns, density.astype(np.float32), first, frame.full))
    return grids


def fit_frame(light: Light, batches: Sequence[Casters], resolution: int) -> Frame:
    """The frame of a light whose grids hold all casters that it shines on, `resolution` cells high."""
    rows = max(int(resolution), 1)
    low, high = np.min([b.box[0] for b in batches], axis=0), np.max([b.box[1] for b in batches], axis=0)
    corners = np.stack(np.meshgrid(*np.stack([low, high], axis=1), indexing="ij"), axis=-1).reshape(-1, 3)
    if light.kind == "SUN":
        turn = rotation_to(light.direction)[[1, 2, 0]]
        if any(batch.kind == "VOLUME" for batch in batches):
            cosine, sine = np.cos(TILT), np.sin(TILT)
            turn = np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]]) @ turn
        local = (corners - corners.mean(axis=0)) @ turn.T
        ends = _across(batches, corners.mean(axis=0), turn[:2])
        side = ends[1] - ends[0]
        # The distance of what lies flat across the light is resolved too.
        least = max(side.max() * 1e-6, np.abs(corners).max() * 1e-12, 1e-30)
        half = np.maximum(side / 2, least)
        origin = corners.mean(axis=0) + np.append(ends.mean(axis=0), local[:, 2].min()) @ turn
        return Frame(True, turn, origin, False, -half[::-1], half[::-1], rows)
    direction, angle = _cone(light, corners.mean(axis=0), batches)
    if angle > NARROW_ANGLE:
        # The poles lie across the light's own direction: a spot or area light has nothing there but at its rim.
        return Frame(False, rotation_to(light.direction), light.position, True, np.zeros(2), np.zeros(2), rows)
    angle = max(angle, FINEST_STEP * rows / 2)
    return Frame(False, rotation_to(direction), light.position, False, np.full(2, -angle), np.full(2, angle), rows)


def _across(batches: Sequence[Casters], middle: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """(2, K) float64: the least and greatest extent of the splats along unit vectors (K, 3), relative to `middle`."""
    ends = np.array([np.full(len(axes), np.inf), np.full(len(axes), -np.inf)])
    for batch in batches:
        offset = axes @ (batch.origin - middle)
        for start in range(0, len(batch), CHUNK):
            along = axes.astype(np.float32) @ batch.position[start : start + CHUNK].T
            reach = float(batch.reach[start : start + CHUNK].max())
            ends[0] = np.minimum(ends[0], along.min(axis=1) + offset - reach)
            ends[1] = np.maximum(ends[1], along.max(axis=1) + offset + reach)
    return ends


def _cone(light: Light, middle: np.ndarray, batches: Sequence[Casters]) -> tuple[np.ndarray, float]:
    """A direction, and the angle about it that holds all splats that are lit; pi if the light is among them."""
    direction, angle = unit_rows(middle - light.position), 0.0
    for batch in batches:
        for start in range(0, len(batch), CHUNK):
            part = batch.take(slice(start, start + CHUNK))
            seen = part.position + (batch.origin - light.position).astype(np.float32)
            distance = np.maximum(np.sqrt(np.einsum("nc,nc->n", seen, seen)), np.float32(1e-30))
            cosine = seen @ direction.astype(np.float32) / distance
            angle = max(angle, float((np.arccos(np.clip(cosine, -1, 1)) + part.reach / distance).max()))
            if angle > NARROW_ANGLE:
                break
    if light.kind == "SPOT" and light.axis_u is None:
        lit = float(np.arccos(np.clip(light.spot_cos, -1, 1)))
        if lit < angle:
            return light.direction, lit
    return direction, angle


def rotation_to(direction: np.ndarray) -> np.ndarray:
    """(3, 3) float64 rotation whose first row is `direction`."""
    first = unit_rows(np.asarray(direction, float))
    if not first.any():
        first = np.array([1.0, 0, 0])
    second = unit_rows(np.cross(first, np.eye(3)[np.abs(first).argmin()]))
    return np.stack([first, second, np.cross(first, second)])


def lit_casters(light: Light, batch: Casters) -> Casters:
    """The casters of a batch that a spot or area light may shine on (conservative); all of them for other lights."""
    if light.kind not in ("SPOT", "AREA"):
        return batch
    seen = batch.position + (batch.origin - light.position).astype(np.float32)
    depth = seen @ light.direction.astype(np.float32)
    reach = batch.reach + np.float32(light.radius)
    if light.kind == "AREA":
        # What does not rise before the light's plane is between no point of it and what it shines on.
        risen = depth + batch.extent_along(light.direction)
        keep = risen > GRAZING * np.sqrt(np.einsum("nc,nc->n", seen, seen))
    elif light.axis_u is not None or light.spot_cos <= 0:
        return batch
    else:
        # The distance to the cone's side, in the plane of its axis.
        across = np.sqrt(np.maximum(np.einsum("nc,nc->n", seen, seen) - depth**2, 0))
        sine = np.sqrt(max(1 - light.spot_cos**2, 0))
        keep = across * light.spot_cos - depth * sine < reach
    return batch if keep.all() else batch.take(keep)


def directions(frame: Frame, latitude: np.ndarray, longitude: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit vectors (N, 3) away from the light, along growing latitude and along growing longitude; local."""
    if frame.parallel:
        shape = (len(latitude), 3)
        return tuple(np.broadcast_to(np.eye(3, dtype=latitude.dtype)[k], shape) for k in (2, 1, 0))  # type: ignore[return-value]
    c, s, x, y = np.cos(latitude), np.sin(latitude), np.cos(longitude), np.sin(longitude)
    ray, north = np.stack([c * x, c * y, s], axis=1), np.stack([-s * x, -s * y, c], axis=1)
    return ray, north, np.stack([-y, x, np.zeros_like(x)], axis=1)


def plane_distance(
    frame: Frame,
    normal: np.ndarray,  # (N, 3) local, of any length
    distance: np.ndarray,  # (N,) of a point of the plane
    ray: np.ndarray,  # (N, 3) towards it, unit
    middle: np.ndarray,  # (N, 3) towards the cell, unit
    to_cell: tuple[np.ndarray, np.ndarray],  # (N,) longitude and latitude of the cell less those of the point
) -> np.ndarray:
    """Returns the distance (N,) at which the ray through a cell's middle meets a plane, given one point of the plane.

    Both are distances along the rays from the light, in world units. The slope is limited by LEAST_COSINE.
    """
    if frame.parallel:
        slope = slopes(normal)
        return distance - slope[0] * to_cell[0] - slope[1] * to_cell[1]
    facing, there = np.einsum("nc,nc->n", normal, ray), np.einsum("nc,nc->n", normal, middle)
    least = LEAST_COSINE * np.sqrt(np.einsum("nc,nc->n", normal, normal))
    # A plane that turns its other side to the cell never meets it.
    there = np.where((there > 0) == (facing > 0), there, facing)
    return distance * (clamp_magnitude(facing, least) / clamp_magnitude(there, least))


def slopes(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Slopes of planes with local normals (N, 3) along x and y, each (N,): how much they rise towards a sun.

    They are the negative derivatives of the distance from the sun. LEAST_COSINE limits them.
    """
    facing = clamp_magnitude(normal[:, 2], LEAST_COSINE * np.sqrt(np.einsum("nc,nc->n", normal, normal)))
    return normal[:, 0] / facing, normal[:, 1] / facing


def clamp_magnitude(value: np.ndarray, least: np.ndarray) -> np.ndarray:
    """Values with their sign whose magnitude is at least `least`, and never 0."""
    return np.copysign(np.maximum(np.maximum(np.abs(value), least), np.float32(1e-30)), value)
