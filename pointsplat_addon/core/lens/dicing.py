"""Dicing of triangles and balls into patches just small enough for their blur: each patch is one splat out of focus.

Samples of a whole mesh are as dense everywhere as its nearest part needs. Out of focus that would be many times too
many, and a floor of two triangles that comes near the eye has parts of every blur.
"""

from __future__ import annotations

import numpy as np

from ..numeric.linear import largest_singular_value
from ..numeric.segments import ranks
from ..numeric.vectors import basis
from ..scene.camera import Camera
from ..scene.cloud import PointCloud
from ..scene.mesh import Mesh
from ..splat.blur import IN_FOCUS, OUT_OF_FOCUS, Blur
from ..surface.area_sampling import STEINER
from ..surface.samples import Samples

MOST_PATCHES = 1 << 21  # patches of one mesh: beyond it they are not cut any more
BALL_FACET_SIZE = 0.7  # sides of facets of balls over those of patches of triangles
LEAST_FACETS = 4  # of a ball
MOST_FACET_OFFSET = 0.97  # of a ball's squared radius: facets nearer to its rim would be seen edge-on
GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))
DISK_SHARE = 3 / np.pi  # of the disk that stands for a cell with the same moments, that the cell covers
# Of the ellipse with a triangle's own moments the triangle covers so much: sqrt(108) / 4 pi.
TRIANGLE_SHARE = np.sqrt(108) / (4 * np.pi)


def dice_triangles(
    mesh: Mesh,
    rows: np.ndarray,
    view_from_object: np.ndarray,
    camera: Camera,
    tolerance: float,
    blur: Blur,
    in_focus: bool = False,
) -> Samples:
    """One sample, with the second moments of its patch, for each patch of triangles that may be out of focus and in the
    picture. rows: triangles of the mesh; view_from_object: (4, 4); tolerance: pixels; in_focus: of those in focus, too.

    Patches are cut across their longest edge in the picture until that spans as many pixels as disks of confusion of
    their size allow (`Blur.widest`).
    """
    matrix = np.asarray(view_from_object, np.float64)
    corners = mesh.position.astype(np.float64)[mesh.triangles[rows]] @ matrix[:3, :3].T + matrix[:3, 3]
    weights = np.broadcast_to(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), (len(rows), 3, 2))
    owner, done = np.asarray(rows, np.int64), []
    focal = np.abs(camera.pixel_from_view()[:2])
    near = camera.nearest
    total = 0
    while len(owner):
        depth = -corners[:, :, 2]
        least, most = blur.radius_range(np.maximum(depth.min(axis=1), near), np.maximum(depth.max(axis=1), near))
        keep = (
            _may_be_seen(corners, camera, blur) & (in_focus | (most > IN_FOCUS)) & np.isfinite(corners).all(axis=(1, 2))
        )
        corners, weights, owner, depth, least = (a[keep] for a in (corners, weights, owner, depth, least))
        scale = 1 / np.maximum(depth, near) if camera.perspective else np.ones_like(depth)  # behind it: see below
        pixel = corners[:, :, :2] * (scale[:, :, None] * focal)
        edges = np.linalg.norm(pixel[:, [1, 2, 0]] - pixel[:, [2, 0, 1]], axis=2)
        # What reaches before the near plane has no size in the picture: it is cut by its size in space.
        before = depth.min(axis=1) <= near
        space = np.linalg.norm(corners[:, [1, 2, 0]] - corners[:, [2, 0, 1]], axis=2)
        edges[before] = space[before] * (focal.max() / (near if camera.perspective else 1.0))
        fine = edges.max(axis=1) <= blur.largest_splat(least, tolerance)
        total += len(owner)
        fine |= total > MOST_PATCHES
        done.append((owner[fine], weights[fine]))
        corners, weights, owner = _halved(corners[~fine], weights[~fine], owner[~fine], edges[~fine].argmax(axis=1))
    owner = np.concatenate([np.empty(0, np.int64), *(o for o, _ in done)])
    weights = np.concatenate([np.empty((0, 3, 2)), *(w for _, w in done)])
    order = np.argsort(owner, kind="stable")
    weights = weights[order]
    edges = weights[:, 1:] - weights[:, :1]
    ellipse = np.einsum("ij,njk->nik", STEINER / np.sqrt(2), edges)
    return Samples(
        "PATCHES", owner[order].astype(np.int32), weights.mean(axis=1).astype(np.float32), ellipse.astype("f4")
    )


def dice_balls(
    cloud: PointCloud, view_from_object: np.ndarray, camera: Camera, tolerance: float, blur: Blur
) -> PointCloud:
    """The sides of balls that face the eye, as disks of equal areas in the picture, of which each covers DISK_SHARE:
    balls of an instance with the transform (4, 4) that may be out of focus, in as many as their sizes in the picture
    ask for, at least LEAST_FACETS."""
    matrix = np.asarray(view_from_object, np.float64)
    assert cloud.radii is not None
    radius = cloud.radii[:, 0].astype(np.float64)
    position = cloud.position.astype(np.float64) + cloud.origin
    depth = -(position @ matrix[2, :3] + matrix[2, 3])
    scale = float(largest_singular_value(matrix[None, :3, :3])[0])
    low, high = (np.maximum(depth + side * radius * scale, camera.nearest) for side in (-1, 1))
    least, most = blur.radius_range(low, high)
    rows = np.flatnonzero((most > IN_FOCUS) & (high > camera.nearest))
    pixels = radius * scale * max(abs(f) for f in camera.pixel_from_view()[:2]) / (low if camera.perspective else 1.0)
    pixels = np.minimum(pixels, max(camera.resolution))  # of what is wider, a part is seen
    count = np.pi * (pixels / (BALL_FACET_SIZE * blur.largest_splat(least, tolerance)))[rows] ** 2
    count = np.clip(np.ceil(np.minimum(count, MOST_PATCHES / max(len(rows), 1))), LEAST_FACETS, None).astype(np.int64)
    of = np.repeat(rows, count)
    number = ranks(count)
    # Spirals fill a disk evenly; the points are raised from the disk onto the ball.
    share = np.minimum((number + 0.5) / np.repeat(count, count), MOST_FACET_OFFSET)
    angle = number * GOLDEN_ANGLE
    inverse = np.linalg.inv(matrix[:3, :3])
    toward = -(inverse @ matrix[:3, 3]) - position[of] if camera.perspective else np.tile(inverse[:, 2], (len(of), 1))
    toward = (toward / np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-300)).T
    first, second = basis(toward)
    out = np.cos(angle) * first + np.sin(angle) * second
    rising, flat = np.sqrt(1 - share), np.sqrt(share)
    normal = flat * out + rising * toward
    half = radius[of] / np.sqrt(np.repeat(count, count) * DISK_SHARE)
    given = {name: array[of] for name, array in cloud.arrays().items() if name not in ("position", "radii")}
    return PointCloud(
        (position[of] - cloud.origin + radius[of, None] * normal.T).astype(np.float32),
        cloud.origin,
        **given | {
            "normal": np.ascontiguousarray(normal.T, np.float32),
            "axis": np.ascontiguousarray((rising * out - flat * toward).T, np.float32),
            "radii": np.stack([half / rising, half], axis=1).astype(np.float32),
        },
    )  # fmt: skip


def _may_be_seen(corners: np.ndarray, camera: Camera, blur: Blur) -> np.ndarray:
    """(n,) bool: triangles (n, 3, 3) in view space of which a corner, blurred, may lie on each side of the window."""
    depth = -corners[:, :, 2]
    fx, fy, cx, cy = camera.pixel_from_view()
    _, _, width, height = camera.window
    w = np.maximum(depth, 0.0) if camera.perspective else np.ones_like(depth)
    # Of depths at and behind the eye the disk's radius times the depth is what counts: it stays finite.
    seen = np.maximum(depth, camera.nearest)
    reach = blur.radius(seen) * (seen if camera.perspective else 1.0) + OUT_OF_FOCUS * w
    x, y = fx * corners[:, :, 0] + cx * w, fy * corners[:, :, 1] + cy * w
    inside = (x + reach > 0).any(axis=1) & (x - reach < width * w).any(axis=1)
    inside &= (y + reach > 0).any(axis=1) & (y - reach < height * w).any(axis=1)
    return inside & (depth > camera.nearest).any(axis=1) & (depth < camera.far).any(axis=1)


def _halved(
    corners: np.ndarray, weights: np.ndarray, owner: np.ndarray, opposite: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Both halves of each triangle (n, 3, ...), cut from corner `opposite` (n,) to the middle of the edge that lies
    opposite."""
    n = np.arange(len(owner))
    a, b, c = opposite, (opposite + 1) % 3, (opposite + 2) % 3

    def cut_at(values: np.ndarray) -> np.ndarray:
        middle = (values[n, b] + values[n, c]) / 2
        return np.concatenate([
            np.stack([values[n, a], values[n, b], middle], axis=1),
            np.stack([values[n, a], middle, values[n, c]], axis=1),
        ])  # fmt: skip

    return cut_at(corners), cut_at(weights), np.tile(owner, 2)
