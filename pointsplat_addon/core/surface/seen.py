"""Where the surfaces lie that a camera sees, roughly: one place for each cell of a coarse grid over its picture.

Small triangles and points count where their middles are, large triangles where rays through the middles of cells meet
them. It takes milliseconds and no device. What lies between sparse samples may be missed, so that whoever asks has to
do well without.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..numeric.linear import largest_singular_value
from ..scene.camera import Camera

CELLS = 40  # along the longer side of the picture
MOST_SAMPLES = 1 << 15  # of a geometry
MOST_SAMPLES_OF_NEAR = 1 << 17  # of all instances of a geometry that are wide in the picture
FEW_SAMPLES = 32  # of each other instance
WIDE = 4.0  # cells: instances wider than this are sampled densely
MOST_LARGE = 64  # triangles of a geometry
LARGE_SHARE = 1 / 1024  # of a geometry's area: triangles that are larger are met by rays
MOST_MET = 512  # triangles by rays


@dataclass(frozen=True, eq=False)
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
    largest = np.argsort(area)[-MOST_LARGE:]
    large = corners[largest[area[largest] > LARGE_SHARE * area.sum()]]
    return _sketch(corners.mean(axis=1), large, corners.reshape(-1, 3))


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
    points, large = [np.zeros((0, 3))], [np.zeros((0, 3, 3))]
    for sketch, matrices in things:
        view = camera.view_from_world @ matrices
        middle = view[:, :3, :3] @ sketch.middle + view[:, :3, 3]
        radius = sketch.radius * largest_singular_value(view[:, :3, :3])
        ahead = np.maximum(-middle[:, 2], radius) if camera.perspective else np.ones(len(view))
        reach = radius * max(abs(fx), abs(fy)) / np.maximum(ahead, 1e-30)
        away = np.abs(middle[:, :2] * [fx, fy] / ahead[:, None] + [cx - width / 2, cy - height / 2])
        seen = (away < np.array([width, height]) / 2 + 2 * reach[:, None]).all(axis=1)
        seen &= (-middle[:, 2] + radius > camera.nearest) & (-middle[:, 2] - radius < camera.far)
        wide = seen & (2 * reach > WIDE * cell)
        for which, most in ((wide, MOST_SAMPLES_OF_NEAR // max(int(wide.sum()), 1)), (seen & ~wide, FEW_SAMPLES)):
            some = sketch.points[:: max(1, -(-len(sketch.points) // max(most, 1)))]
            points.append(_moved(view[which], some).reshape(-1, 3))
        large.append(_moved(view[wide], sketch.large.reshape(-1, 3)).reshape(-1, 3, 3))
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
    met = _met(slope, np.concatenate(large), camera)
    nearer = met < nearest
    ray = np.column_stack([slope * (met[:, None] if camera.perspective else 1.0), -met])
    where[nearer], nearest[nearer] = ray[nearer], met[nearer]
    hit = np.isfinite(nearest)
    back = np.linalg.inv(camera.view_from_world)
    pixel = (nearest[hit] if camera.perspective else np.ones(int(hit.sum()))) / max(abs(fx), abs(fy))
    return where[hit] @ back[:3, :3].T + back[:3, 3], pixel, cell


def _moved(matrices: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Returns (I, N, 3): points (N, 3) by matrices (I, 4, 4)."""
    return np.einsum("iab,nb->ina", matrices[:, :3, :3], points) + matrices[:, None, :3, 3]


def _met(slope: np.ndarray, corners: np.ndarray, camera: Camera) -> np.ndarray:
    """Returns (R,) float64: the least depth at which a camera's rays meet triangles (K, 3, 3) of view space; infinite
    where none is met. slope: (R, 2), of rays, or where they start in a parallel view (Möller and Trumbore 1997)."""
    if len(corners) > MOST_MET:
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        away = np.linalg.norm(corners, axis=2).min(axis=1) if camera.perspective else np.ones(len(corners))
        corners = corners[np.argsort(area / np.maximum(away, 1e-30) ** 2)[-MOST_MET:]]
    if len(corners) == 0:
        return np.full(len(slope), np.inf)
    start, ahead = np.zeros((len(slope), 3)), np.column_stack([slope, -np.ones(len(slope))])
    if not camera.perspective:
        start[:, :2], ahead[:, :2] = slope, 0.0
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(ahead[:, None], second)
    with np.errstate(all="ignore"):
        scale = 1 / (across * first).sum(axis=2)
        offset = start[:, None] - corners[:, 0]
        u = (offset * across).sum(axis=2) * scale
        turned = np.cross(offset, first)
        v = (turned @ ahead[:, :, None])[..., 0] * scale
        depth = (turned * second).sum(axis=2) * scale
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (depth > camera.nearest) & (depth < camera.far)
    return np.where(hit, depth, np.inf).min(axis=1)
