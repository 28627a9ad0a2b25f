"""How many captured splats a view shows in each pixel: whether nodes would save something."""

from __future__ import annotations

import numpy as np

from ...scene.camera import Camera
from ...scene.captured import CapturedSplats

MOST = 1 << 18  # splats that are looked at
SMALL = 0.5  # of the tolerance: the standard deviation, in pixels, of splats that nodes stand for


def splats_a_pixel(
    splats: CapturedSplats, largest: np.ndarray, view_from_splats: np.ndarray, camera: Camera, tolerance: float
) -> float:
    """The number of splats that are small, for each square of `tolerance` pixels that has some; 0 without any.

    largest: (N,) as `bounds_of_scales` left it. view_from_splats: (4, 4) float64 that holds the splats' origin.
    """
    step = -(-len(splats) // MOST)
    linear = view_from_splats[:3, :3]
    fx, fy, cx, cy = camera.pixel_from_view()
    width, height = camera.window[2:]
    columns, rows = (int(side / tolerance) + 1 for side in (width, height))
    with np.errstate(all="ignore"):
        x, y, z = (splats.position[::step] @ linear.T.astype(np.float32) + view_from_splats[:3, 3].astype(np.float32)).T
        over = -1 / z if camera.perspective else np.ones_like(z)
        size = largest[::step] * (np.linalg.norm(linear, 2) * max(abs(fx), abs(fy))) * over
        small = (-z > camera.near) & (-z < camera.far) & (size <= SMALL * tolerance)
        column, row = (x * fx * over + cx) / tolerance, (y * fy * over + cy) / tolerance
        small &= (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    if not small.any():
        return 0.0
    there = np.zeros(columns * rows, bool)
    there[row[small].astype(np.int64) * columns + column[small].astype(np.int64)] = True
    return step * np.count_nonzero(small) / np.count_nonzero(there)
