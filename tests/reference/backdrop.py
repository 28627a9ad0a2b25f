"""The world seen out of focus, in float64: what shaders/shading/backdrop.frag and backdrop_blur.frag compute."""

from __future__ import annotations

import numpy as np

from pointsplat_addon.core.lens.backdrop import BackdropGrid
from pointsplat_addon.core.light import environment
from pointsplat_addon.core.scene.camera import Camera

TAPS = (-0.25, 0.25)  # positions within a texel along each axis, in texels, where the world is looked up
# Widths of a texel of the pyramid over the distance of TAPS: twice, so that a bright texel is met by about as much of
# them wherever it lies.
WIDE = 2.0
# Near the poles of the world's picture texels become narrow: what is looked up there is blurred along meridians by at
# most so many times the distance of TAPS, and noisier the nearer.
NARROWEST = 1 / 16


def disk_weights(grid: BackdropGrid) -> np.ndarray:
    """(2 M + 1, 2 M + 1) float64, M the margin: the share of the disk in each texel around its centre, up to a
    factor."""
    y, x = np.mgrid[-grid.margin : grid.margin + 1, -grid.margin : grid.margin + 1].astype(float)
    away = np.maximum(np.hypot(x / grid.radius[0], y / grid.radius[1]), 1e-6)
    rim = np.hypot(x, y) * (1 / away - 1)
    rim[grid.margin, grid.margin] = min(grid.radius)
    return np.clip(rim + 0.5, 0, 1)


def sharp_backdrop(atlas: np.ndarray, grid: BackdropGrid, camera: Camera, image_from_world: np.ndarray) -> np.ndarray:
    """(H, W, 3) float64: the grid's larger picture, sharp, of the world with this atlas (core/light/environment.py)."""
    fx, fy, cx, cy = camera.pixel_from_view()
    image_from_view = image_from_world @ np.linalg.inv(camera.view_from_world)[:3, :3]
    pyramid = environment.pyramid(atlas)
    columns, rows = grid.larger
    found = np.zeros((rows, columns, 3))
    for dy in TAPS:
        for dx in TAPS:
            x = (np.arange(columns) - grid.margin - 0.5 + dx) * grid.step[0]
            y = (np.arange(rows) - grid.margin - 0.5 + dy) * grid.step[1]
            ray = np.stack(np.broadcast_arrays(((x - cx) / fx)[None], ((y - cy) / fy)[:, None], -1.0), axis=-1)
            cosine = 1 / np.linalg.norm(ray, axis=-1, keepdims=True)
            direction = (ray * cosine) @ image_from_view.T
            lod = pyramid_level(cosine[..., 0], direction, grid, (fx, fy), 2 * len(pyramid[1]), len(pyramid))
            uv = environment.uv_from_direction(direction)
            for i, picture in enumerate(pyramid):
                part = np.maximum(1 - np.abs(lod - i), 0)[..., None]
                found += part * environment.bilinear(picture.astype(float), uv) / len(TAPS) ** 2
    return found


def pyramid_level(
    cosine: np.ndarray, direction: np.ndarray, grid: BackdropGrid, focal: tuple[float, float], height: int, levels: int
) -> np.ndarray:
    """(...) float64: the level of a pyramid of so many, the first of which has this height, whose texels are WIDE as
    TAPS are apart, in direction (..., 3) of the world's picture, at an angle of this cosine (...) from the view's."""
    apart = WIDE * (TAPS[1] - TAPS[0]) * max(grid.step[0] / abs(focal[0]), grid.step[1] / abs(focal[1]))
    narrow = np.maximum(np.hypot(direction[..., 0], direction[..., 1]), NARROWEST)
    return np.clip(np.log2(apart * cosine * height / (np.pi * narrow)), 0, levels - 1)


def blur_backdrop(picture: np.ndarray, grid: BackdropGrid) -> np.ndarray:
    """(H, W, 3) float64: the grid's picture, from the sharp larger one."""
    disk, (columns, rows) = disk_weights(grid), grid.size
    found = np.zeros((rows, columns, 3))
    for y, x in np.argwhere(disk > 0):
        found += disk[y, x] * picture[y : y + rows, x : x + columns]
    return found / disk.sum()
