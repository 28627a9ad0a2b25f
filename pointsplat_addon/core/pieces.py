"""Triangles cut into pieces that are as small as a blurred picture needs, and no smaller: one splat each.

Samples of a whole mesh are as dense everywhere as its nearest part needs. Of what is out of focus that would be many
times too many, and a floor of two triangles that comes near the eye has parts of every blur.
"""

from __future__ import annotations

import numpy as np

from .defocus import BLURRED, IN_FOCUS, NODE, Blur
from .sampling import _STEINER, Samples
from .scene import Camera, Mesh

MOST = 1 << 21  # pieces of one mesh: beyond it they stay as large as they are
# Of the ellipse with a triangle's own moments the triangle covers so much: sqrt(108) / 4 pi.
SHARE = np.sqrt(108) / (4 * np.pi)


def cut(
    mesh: Mesh, rows: np.ndarray, view_from_object: np.ndarray, camera: Camera, tolerance: float, blur: Blur
) -> Samples:
    """One sample, with the moments of its piece, for each piece of the triangles `rows` that may be out of focus and in
    the picture, of an instance with the transform (4, 4).

    Pieces are cut across their longest edge in the picture until that spans at most `tolerance` pixels, or NODE times
    the radius of the smallest disk of confusion within them.
    """
    matrix = np.asarray(view_from_object, np.float64)
    corners = mesh.position.astype(np.float64)[mesh.triangles[rows]] @ matrix[:3, :3].T + matrix[:3, 3]
    weights = np.broadcast_to(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), (len(rows), 3, 2))
    owner, done = np.asarray(rows, np.int64), []
    focal = np.abs(camera.pixel_from_view()[:2])
    near = max(camera.near, 0.0)
    total = 0
    while len(owner):
        depth = -corners[:, :, 2]
        least, most = blur.bounds(np.maximum(depth.min(axis=1), near), np.maximum(depth.max(axis=1), near))
        keep = _seen(corners, camera, blur) & (most > IN_FOCUS) & np.isfinite(corners).all(axis=(1, 2))
        corners, weights, owner, depth, least = (a[keep] for a in (corners, weights, owner, depth, least))
        scale = 1 / np.maximum(depth, 1e-300) if camera.perspective else np.ones_like(depth)
        pixel = corners[:, :, :2] * (scale[:, :, None] * focal)
        edges = np.linalg.norm(pixel[:, [1, 2, 0]] - pixel[:, [2, 0, 1]], axis=2)
        # What reaches before the near plane has no size in the picture: it is cut by its size in space.
        before = depth.min(axis=1) <= near
        space = np.linalg.norm(corners[:, [1, 2, 0]] - corners[:, [2, 0, 1]], axis=2)
        edges[before] = space[before] * (focal.max() / max(near, 1e-9))
        fine = edges.max(axis=1) <= np.maximum(NODE * least, tolerance)
        total += len(owner)
        fine |= total > MOST
        done.append((owner[fine], weights[fine]))
        corners, weights, owner = _halved(corners[~fine], weights[~fine], owner[~fine], edges[~fine].argmax(axis=1))
    owner = np.concatenate([np.empty(0, np.int64), *(o for o, _ in done)])
    weights = np.concatenate([np.empty((0, 3, 2)), *(w for _, w in done)])
    order = np.argsort(owner, kind="stable")
    weights = weights[order]
    edges = weights[:, 1:] - weights[:, :1]
    ellipse = np.einsum("ij,njk->nik", _STEINER / np.sqrt(2), edges)
    return Samples("GRID", owner[order].astype(np.int32), weights.mean(axis=1).astype(np.float32), ellipse.astype("f4"))


def _seen(corners: np.ndarray, camera: Camera, blur: Blur) -> np.ndarray:
    """(n,) bool: triangles (n, 3, 3) in view space of which a corner, blurred, may lie on each side of the window."""
    depth = -corners[:, :, 2]
    fx, fy, cx, cy = camera.pixel_from_view()
    _, _, width, height = camera.window
    w = np.maximum(depth, 0.0) if camera.perspective else np.ones_like(depth)
    # Of depths at and behind the eye the disk's radius times the depth is what counts: it stays finite.
    reach = (
        blur.radius(np.maximum(depth, max(camera.near, 1e-9)))
        * (np.maximum(depth, max(camera.near, 1e-9)) if camera.perspective else 1.0)
        + BLURRED * w
    )
    x, y = fx * corners[:, :, 0] + cx * w, fy * corners[:, :, 1] + cy * w
    inside = (x + reach > 0).any(axis=1) & (x - reach < width * w).any(axis=1)
    inside &= (y + reach > 0).any(axis=1) & (y - reach < height * w).any(axis=1)
    return inside & (depth > max(camera.near, 0.0)).any(axis=1) & (depth < camera.far).any(axis=1)


def _halved(
    corners: np.ndarray, weights: np.ndarray, owner: np.ndarray, opposite: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Both halves of each triangle, cut from corner `opposite` (n,) to the middle of the edge that lies opposite."""
    n = np.arange(len(owner))
    a, b, c = opposite, (opposite + 1) % 3, (opposite + 2) % 3

    def cut_at(values: np.ndarray) -> np.ndarray:
        middle = (values[n, b] + values[n, c]) / 2
        return np.concatenate([
            np.stack([values[n, a], values[n, b], middle], axis=1),
            np.stack([values[n, a], middle, values[n, c]], axis=1),
        ])  # fmt: skip

    return cut_at(corners), cut_at(weights), np.tile(owner, 2)
