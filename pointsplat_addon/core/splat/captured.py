"""Captured Gaussian splats in one view: which are seen, their order, and what the projection needs (Kerbl et al. 2023).

A splat with the covariance Σ = R S² Rᵀ in its object becomes J V Σ Vᵀ Jᵀ + LOW_PASS I in the picture, in pixels², with
V the linear part of view_from_object, whatever that is, and J the Jacobian of the projection at the splat's centre. A
pixel at the squared Mahalanobis distance q from the centre has

    alpha = min(MOST_ALPHA, o exp(-q / 2)),    and nothing where that is below LEAST_ALPHA.

Where training knew what the low-pass widens (`antialiased`), o is first multiplied by the root of the determinants'
ratio before and after it (Yu et al. 2024, Mip-Splatting, equation 10). shaders/captured/project.frag is the same on the
device, and tests/reference/captured.py in float64.
"""

from __future__ import annotations

import numpy as np

from ..numeric.vectors import each_block
from ..scene.camera import Camera
from ..scene.captured import CapturedSplats

LOW_PASS = 0.3  # pixels²
RIM = 1.3  # of half the field: the perspective of what lies farther out is taken as there
MOST_ALPHA = 0.99
LEAST_ALPHA = 1 / 255
WIDEST = float(np.sqrt(2 * np.log(1 / LEAST_ALPHA)))  # standard deviations at which alpha is LEAST_ALPHA, at most


def slope_limits(camera: Camera) -> np.ndarray:
    """(4,) float64: the least x / depth and y / depth, and the greatest, at which the perspective is taken.

    They lie RIM half fields from the middle of the full frame, whatever part of it is drawn.
    """
    fx, fy, cx, cy = camera.pixel_from_view()
    x0, y0, _, _ = camera.window
    half = np.abs(np.array(camera.resolution) / 2 / (fx, fy))
    middle = (np.array(camera.resolution) / 2 - (cx + x0, cy + y0)) / (fx, fy)
    return np.concatenate([middle - RIM * half, middle + RIM * half])


def eye_in_object(view_from_object: np.ndarray, perspective: bool) -> np.ndarray:
    """(3,) float64: where the eye is in object space; for a parallel camera the unit direction in which it looks.

    view_from_object: (4, 4). Of transforms without an inverse, the one of least squares.
    """
    inverse = np.linalg.pinv(view_from_object[:3, :3])
    if perspective:
        return -inverse @ view_from_object[:3, 3]
    found = inverse @ np.array([0.0, 0.0, -1.0])
    return found / (np.linalg.norm(found) or 1.0)


def bounds_of_scales(splats: CapturedSplats) -> np.ndarray:
    """(N,) float32: the greatest standard deviation of each splat; NaN of those that no view shows, of too little
    opacity."""
    found = np.empty(len(splats), np.float32)

    def measure(block: slice) -> None:
        scale = splats.scale[block]
        found[block] = np.maximum(np.maximum(scale[:, 0], scale[:, 1]), scale[:, 2])
        found[block][splats.opacity[block] < LEAST_ALPHA] = np.nan

    each_block(len(splats), measure)
    return found


def seen(
    splats: CapturedSplats,
    largest: np.ndarray,
    view_from_object: np.ndarray,
    camera: Camera,
    everywhere: bool = False,
    among: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """The rows (K,) int64, rising, of the splats that may show in a view, and their depths (K,) float32 less that of
    the origin: a sum of both may not tell splats of a small object apart.

    largest: (N,) as `bounds_of_scales` left it. view_from_object: (4, 4) float64 that holds the splats' origin.
    `everywhere`: those beside the picture count, too. among: (R,) int64, rising, of the rows that are looked at; None:
    all.
    """
    linear, offset = view_from_object[:3, :3], view_from_object[:3, 3].astype(np.float32)
    columns = np.ascontiguousarray(linear.T, np.float32)
    fx, fy, cx, cy = (np.float32(value) for value in camera.pixel_from_view())
    width, height = camera.window[2:]
    limits = slope_limits(camera).reshape(2, 2)
    # A standard deviation along any direction, in pixels times depth.
    tangents = np.sqrt(1 + np.abs(limits).max(axis=0) ** 2) if camera.perspective else np.ones(2)
    stretch = np.abs([fx, fy]) * tangents * np.linalg.norm(linear, 2) * WIDEST
    around = WIDEST * np.sqrt(LOW_PASS)
    count = len(splats) if among is None else len(among)
    keep = np.empty(count, bool)
    depth = np.empty(count, np.float32)

    def look(block: slice) -> None:
        with np.errstate(all="ignore"):
            rows: slice | np.ndarray = block if among is None else among[block]
            turned, widest = splats.position[rows] @ columns, largest[rows]
            depth[block] = -turned[:, 2]
            x, y, z = (turned + offset).T
            inside = (-z > camera.near) & (-z < camera.far) & (widest >= 0)
            if not everywhere:
                over = -1 / z if camera.perspective else np.float32(1)
                size = widest * over
                for at, f, c, side, s in ((x, fx, cx, width, stretch[0]), (y, fy, cy, height, stretch[1])):
                    half = np.float32(side / 2)
                    inside &= np.abs(f * at * over + (c - half)) < half + np.float32(around) + np.float32(s) * size
        keep[block] = inside

    each_block(count, look)
    found = np.flatnonzero(keep)
    return (found if among is None else among[found]), depth[found]
