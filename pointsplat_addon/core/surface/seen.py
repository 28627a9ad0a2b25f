"""Where the surfaces lie that a camera sees, roughly: one place for each cell of a coarse grid over its picture.

Small triangles and points count where their middles are, large triangles where rays through the middles of cells meet
them. It takes milliseconds and no device. What lies between sparse samples may be missed, so that whoever asks has to
do well without.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ..numeric.linear import largest_singular_value
from ..numeric.record import record
from ..numeric.segments import owners, ranks
from ..numeric.vectors import cross, dot, lengths
from ..scene.camera import Camera
from ..scene.mesh import Mesh, joined

CELLS = 40  # along the longer side of the picture
MOST_SAMPLES = 1 << 15  # of a geometry
MOST_SAMPLES_OF_NEAR = 1 << 17  # of all instances of a geometry that are wide in the picture
FEW_SAMPLES = 32  # of each other instance
WIDE = 4.0  # cells: instances wider than this are sampled densely
MOST_LARGE = 64  # triangles of a geometry
LARGE_SHARE = 1 / 1024  # of a geometry's area: triangles that are larger are met by rays
MOST_MET = 512  # triangles by rays


@record
class Sketch:
    """Samples of a geometry, in object space."""

    points: np.ndarray  # (N, 3) float64
    large: np.ndarray  # (K, 3, 3) float64, corners of triangles
    middle: np.ndarray  # (3,) float64, of a ball around all, and
    radius: float  # its radius


def sketch_of_triangles(position: np.ndarray, triangles: np.ndarray) -> Sketch:
    """Returns the sketch of a mesh: positions (V, 3), triangles (T, 3)."""
    corners = position[triangles[:: max(1, -(-len(triangles) // MOST_SAMPLES))]].astype(np.float64)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    large = _largest(corners, area, area > LARGE_SHARE * area.sum())
    return _sketch(corners.mean(axis=1), large, corners.reshape(-1, 3))


def sketches_of_meshes(meshes: Sequence[Mesh]) -> list[Sketch]:
    """Returns the sketch of each mesh."""
    found: dict[int, Sketch] = {}
    for some in joined(meshes):
        corners = some.corners.reshape(-1, 3, 3).astype(np.float64)
        if not np.isfinite(corners).all():
            continue
        first = some.first[:-1]
        area = lengths(cross((corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T))
        large = area > LARGE_SHARE * np.repeat(np.add.reduceat(area, first), np.diff(some.first))
        low, high = corners.min(axis=1), corners.max(axis=1)
        low, high = np.minimum.reduceat(low, first, axis=0), np.maximum.reduceat(high, first, axis=0)
        middle, radius = (low + high) / 2, np.linalg.norm(high - low, axis=1) / 2
        points = corners.mean(axis=1)
        for number, (row, ends) in enumerate(zip(some.rows, pairwise(some.first.tolist()), strict=True)):
            own = slice(*ends)
            of_mesh = _largest(corners[own], area[own], large[own])
            found[row] = Sketch(points[own].copy(), of_mesh, middle[number], float(radius[number]))
    return [found.get(row) or sketch_of_triangles(mesh.position, mesh.triangles) for row, mesh in enumerate(meshes)]


def _largest(corners: np.ndarray, area: np.ndarray, large: np.ndarray) -> np.ndarray:
    """Returns those of triangles (T, 3, 3) that are `large` (T,) bool, MOST_LARGE of them at most."""
    rows = np.flatnonzero(large)
    return corners[rows if len(rows) <= MOST_LARGE else rows[np.argsort(area[rows])[-MOST_LARGE:]]]


def sketch_of_points(position: np.ndarray) -> Sketch:
    """Returns the sketch of points (N, 3)."""
    points = position[:: max(1, -(-len(position) // MOST_SAMPLES))].astype(np.float64)
    return _sketch(points, np.zeros((0, 3, 3)), points)


def _sketch(points: np.ndarray, large: np.ndarray, bounded: np.ndarray) -> Sketch:
    points, bounded = (one[np.isfinite(one).all(axis=1)] for one in (points, bounded))
    if len(points) == 0:
        return Sketch(points, large, np.zeros(3), 0.0)
    low, high = bounded.min(axis=0), bounded.max(axis=0)
    return Sketch(points, large, (low + high) / 2, float(np.linalg.norm(high - low) / 2))


@np.errstate(all="ignore")
def narrowest_pixel(camera: Camera, things: Sequence[tuple[Sketch, np.ndarray]]) -> float:
    """Returns how far a pixel reaches at least, in world units, at any place that seen_places may find."""
    _, middle, radius = _balls(camera, things)
    reached = -middle[:, 2] - radius
    nearest = np.where(np.isfinite(reached), reached, -np.inf).min(initial=np.inf)
    return float(_pixels(camera, np.maximum(nearest, camera.nearest)))


@np.errstate(all="ignore")  # what is too far away for float64 is not seen
def seen_places(camera: Camera, things: Sequence[tuple[Sketch, np.ndarray]]) -> tuple[np.ndarray, np.ndarray, float]:
    """Returns world-space places (N, 3) float64 that a camera sees, how far a pixel reaches there, (N,), and how many
    pixels wide a cell is.

    things: sketches with the matrices (I, 4, 4) of their instances, world from object.
    """
    fx, fy, cx, cy = camera.pixel_from_view()
    width, height = camera.window[2:]
    cell = max(width, height) / CELLS
    columns, rows = (max(1, int(np.ceil(side / cell))) for side in (width, height))
    view, middle, radius = _balls(camera, things)
    ahead = np.maximum(-middle[:, 2], radius) if camera.perspective else np.ones(len(view))
    reach = radius * max(abs(fx), abs(fy)) / np.maximum(ahead, 1e-30)
    away = np.abs(middle[:, :2] * [fx, fy] / ahead[:, None] + [cx - width / 2, cy - height / 2])
    seen = (away < np.array([width, height]) / 2 + 2 * reach[:, None]).all(axis=1)
    seen &= (-middle[:, 2] + radius > camera.nearest) & (-middle[:, 2] - radius < camera.far)
    wide = seen & (2 * reach > WIDE * cell)
    counts = np.array([len(matrices) for _, matrices in things], int)
    ends = np.cumsum(counts)
    points, large = [np.zeros((0, 3))], [np.zeros((0, 3, 3))]
    for row in np.unique(owners(counts)[seen]).tolist():
        sketch, own = things[row][0], slice(ends[row] - counts[row], ends[row])
        near, far = view[own][wide[own]], view[own][seen[own] & ~wide[own]]
        for views, most in ((near, MOST_SAMPLES_OF_NEAR // max(len(near), 1)), (far, FEW_SAMPLES)):
            if len(views):
                some = sketch.points[:: max(1, -(-len(sketch.points) // max(most, 1)))]
                points.append(_moved(views, some).reshape(-1, 3))
        if len(near):
            large.append(_moved(near, sketch.large.reshape(-1, 3)).reshape(-1, 3, 3))
    place = np.concatenate(points)
    depth = -place[:, 2]
    kept = (depth > camera.nearest) & (depth < camera.far)
    place, depth = place[kept], depth[kept]
    at = place[:, :2] * [fx, fy] / (depth[:, None] if camera.perspective else 1.0) + [cx, cy]
    index = np.floor(at / cell).astype(int)
    inside = ((index >= 0) & (index < [columns, rows])).all(axis=1)
    number = index[inside, 0] + columns * index[inside, 1]
    place, depth = place[inside], depth[inside]
    order = np.argsort(-depth)  # the nearest of each cell is written last
    nearest, where = np.full(columns * rows, np.inf), np.zeros((columns * rows, 3))
    nearest[number[order]], where[number[order]] = depth[order], place[order]

    row, column = np.divmod(np.arange(columns * rows), columns)
    slope = (np.stack([column + 0.5, row + 0.5], axis=1) * cell - [cx, cy]) / [fx, fy]
    met = _met(slope, columns, np.concatenate(large), camera)
    nearer = met < nearest
    ray = np.column_stack([slope * (met[:, None] if camera.perspective else 1.0), -met])
    where[nearer], nearest[nearer] = ray[nearer], met[nearer]
    hit = np.isfinite(nearest)
    back = np.linalg.inv(camera.view_from_world)
    return where[hit] @ back[:3, :3].T + back[:3, 3], _pixels(camera, nearest[hit]), cell


def _pixels(camera: Camera, depth: np.ndarray) -> np.ndarray:
    """Returns how far a pixel reaches at depths, in world units."""
    fx, fy = camera.pixel_from_view()[:2]
    return (depth if camera.perspective else np.ones_like(depth)) / max(abs(fx), abs(fy))


def _balls(camera: Camera, things: Sequence[tuple[Sketch, np.ndarray]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns the matrices (I, 4, 4), view from object, of all instances, and middles (I, 3) and radii (I,) of balls
    around them. All at once: a scene may have thousands of sketches of one instance each."""
    counts = np.array([len(matrices) for _, matrices in things], int)
    view = camera.view_from_world @ np.concatenate([np.zeros((0, 4, 4)), *(matrices for _, matrices in things)])
    middle = np.repeat(np.array([sketch.middle for sketch, _ in things]).reshape(-1, 3), counts, axis=0)
    radius = np.repeat(np.array([sketch.radius for sketch, _ in things]), counts)
    linear = view[:, :3, :3]
    moved = np.einsum("iab,ib->ia", linear, middle) + view[:, :3, 3]
    return view, moved, radius * largest_singular_value(linear)


def _moved(matrices: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Returns (I, N, 3): points (N, 3) by matrices (I, 4, 4)."""
    return np.einsum("iab,nb->ina", matrices[:, :3, :3], points) + matrices[:, None, :3, 3]


def _met(slope: np.ndarray, columns: int, corners: np.ndarray, camera: Camera) -> np.ndarray:
    """Returns (R,) float64: the least depth at which a camera's rays meet triangles (K, 3, 3) of view space; infinite
    where none is met (Möller and Trumbore 1997).

    slope: (R, 2), of rays, or where they start in a parallel view, row by row of a grid with so many columns.
    """
    if len(corners) > MOST_MET:
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        away = np.linalg.norm(corners, axis=2).min(axis=1) if camera.perspective else np.ones(len(corners))
        corners = corners[np.argsort(area / np.maximum(away, 1e-30) ** 2)[-MOST_MET:]]
    found = np.full(len(slope), np.inf)
    triangle, ray = _pairs(slope, columns, corners, camera)
    x, y = slope[ray].T
    nothing, one = np.zeros_like(x), np.ones_like(x)
    perspective = camera.perspective
    start = np.stack([nothing, nothing, nothing] if perspective else [x, y, nothing])
    ahead = np.stack([x, y, -one] if perspective else [nothing, nothing, -one])
    base, second, third = corners[triangle].transpose(1, 2, 0)
    first, second = second - base, third - base
    across = cross(ahead, second)
    scale = 1 / dot(across, first)
    offset = start - base
    u = dot(offset, across) * scale
    turned = cross(offset, first)
    v = dot(turned, ahead) * scale
    depth = dot(turned, second) * scale
    hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (depth > camera.nearest) & (depth < camera.far)
    np.minimum.at(found, ray[hit], depth[hit])
    return found


def _pairs(slope: np.ndarray, columns: int, corners: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Returns triangles (P,) and rays (P,), all that may meet: those in the rectangle around each triangle's picture,
    and all of triangles that reach behind the nearest depth."""
    lattice = slope.reshape(-1, columns, 2)
    rows = len(lattice)
    low, high = lattice[0, 0], lattice[-1, -1]
    step = (high - low) / np.maximum([columns - 1, rows - 1], 1)
    depth = -corners[..., 2:]
    at = (corners[..., :2] / depth if camera.perspective else corners[..., :2]) - low
    at = at / np.where(step == 0, 1.0, step)
    whole = (depth[..., 0] <= camera.nearest).any(axis=1) | ~np.isfinite(at).all(axis=(1, 2))
    at[whole] = 0.0
    most = np.array([columns, rows]) - 1
    first = np.where(whole[:, None], 0, np.clip(np.floor(at.min(axis=1)), 0, most + 1)).astype(int)
    last = np.where(whole[:, None], most, np.clip(np.ceil(at.max(axis=1)), -1, most)).astype(int)
    width, height = (last - first + 1).clip(0).T
    count = width * height
    triangle, rank = owners(count), ranks(count)
    row, column = np.divmod(rank, width[triangle])
    return triangle, first[triangle, 0] + column + columns * (first[triangle, 1] + row)
