"""A picture of the world that is out of focus.

What is infinitely far has the same disk of confusion everywhere in a picture (Křivánek 2003, equation 8): its radius is
C = F r / D, in pixels (core/lens/defocus.py), and of parallel rays, which all see one direction, there is nothing to blur.
Seen through the lens the world is therefore the sharp picture of it convolved with that disk. Both are drawn on a grid
whose texels are C / DISK pixels wide, but not finer than pixels: however wide the disk is, it holds as many texels, and
the picture as many texels or fewer. Texels of the sharp picture are means of the world over their area, from a pyramid
(core/light/environment.py), so that small bright things keep their light.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..light import environment
from ..scene.camera import Camera
from ..scene.scene import Scene
from ..splat.blur import IN_FOCUS, defocus_blur

DISK = 8.0  # texels of the widest disk's radius
TAPS = (-0.25, 0.25)  # places in a texel along each axis, in texels, where the world is looked up
# Widths of a texel of the pyramid over the distance of TAPS: twice, so that a bright texel is met by about as much of
# them wherever it lies.
WIDE = 2.0
# Near the poles of the world's picture texels become narrow: what is looked up there is blurred along meridians by at
# most so many times the distance of TAPS, and noisier the nearer.
NARROWEST = 1 / 16
SQUARE = 0.25  # texels^2 by which the square of a radius is less: the rim is a texel wide, and so are pixels
LEAST = 0.05  # texels: radius of what is hardly a disk


@dataclass(frozen=True)
class Grid:
    """Texels of the world behind one picture. Texel (i, j) of the blurred picture is centred on the place
    ((i - 0.5) step x, (j - 0.5) step y), in pixels from the corner of what is drawn."""

    step: tuple[float, float]  # pixels that a texel spans
    radius: tuple[float, float]  # texels, of the disk
    margin: int  # texels of the sharp picture on each side of the blurred one
    size: tuple[int, int]  # texels of the blurred picture

    @property
    def larger(self) -> tuple[int, int]:
        """Texels of the sharp picture."""
        return self.size[0] + 2 * self.margin, self.size[1] + 2 * self.margin


def why_sharp(scene: Scene, camera: Camera) -> str:
    """Why the world behind a picture is not blurred; empty where it is."""
    blur = defocus_blur(camera)
    if blur is None:
        return "the camera has no depth of field"
    if scene.transparent:
        return "the film is transparent"
    if scene.world.image is None:
        return "the world is of one colour"
    if not blur.perspective:
        return "parallel rays see one direction of the world"
    return "" if max(_radii(camera)) > IN_FOCUS else "the world is in focus"


def grid_of(camera: Camera, most: int) -> Grid:
    """The grid behind what a perspective camera with a lens draws; `most`: texels that a texture may have on a side."""
    margin = int(DISK) + 2
    step, radius, size = [], [], []
    for disk, pixels in zip(_radii(camera), camera.window[2:], strict=True):
        step.append(max(disk / DISK, 1.0, pixels / (most - 2 * margin - 3)))
        radius.append(max(np.sqrt(max((disk / step[-1]) ** 2 - SQUARE, 0.0)), LEAST))
        size.append(int(np.ceil(pixels / step[-1])) + 2)
    return Grid((step[0], step[1]), (radius[0], radius[1]), int(max(radius)) + 2, (size[0], size[1]))


def weights(grid: Grid) -> np.ndarray:
    """(2 M + 1, 2 M + 1) float64, M the margin: what of the disk each texel around its middle holds, up to a factor."""
    y, x = np.mgrid[-grid.margin : grid.margin + 1, -grid.margin : grid.margin + 1].astype(float)
    away = np.maximum(np.hypot(x / grid.radius[0], y / grid.radius[1]), 1e-6)
    rim = np.hypot(x, y) * (1 / away - 1)
    rim[grid.margin, grid.margin] = min(grid.radius)
    return np.clip(rim + 0.5, 0, 1)


def sharp(atlas: np.ndarray, grid: Grid, camera: Camera, image_from_world: np.ndarray) -> np.ndarray:
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
            lod = level(cosine[..., 0], direction, grid, (fx, fy), len(pyramid[0]), len(pyramid))
            uv = environment.uv_from_direction(direction)
            for i, picture in enumerate(pyramid):
                part = np.maximum(1 - np.abs(lod - i), 0)[..., None]
                found += part * environment.bilinear(picture.astype(float), uv) / len(TAPS) ** 2
    return found


def level(
    cosine: np.ndarray, direction: np.ndarray, grid: Grid, focal: tuple[float, float], height: int, levels: int
) -> np.ndarray:
    """(...) float64: the level of a pyramid of so many, the first of which has this height, whose texels are WIDE as
    TAPS are apart, in direction (..., 3) of the world's picture, at an angle of this cosine (...) from the view's."""
    apart = WIDE * (TAPS[1] - TAPS[0]) * max(grid.step[0] / abs(focal[0]), grid.step[1] / abs(focal[1]))
    narrow = np.maximum(np.hypot(direction[..., 0], direction[..., 1]), NARROWEST)
    return np.clip(np.log2(apart * cosine * height / (np.pi * narrow)), 0, levels - 1)


def blurred(picture: np.ndarray, grid: Grid) -> np.ndarray:
    """(H, W, 3) float64: the grid's picture, from the sharp larger one."""
    disk, (columns, rows) = weights(grid), grid.size
    found = np.zeros((rows, columns, 3))
    for y, x in np.argwhere(disk > 0):
        found += disk[y, x] * picture[y : y + rows, x : x + columns]
    return found / disk.sum()


def _radii(camera: Camera) -> tuple[float, float]:
    """Pixels, along x and y, of the disk of confusion of what is infinitely far, of a perspective camera."""
    aperture = camera.aperture
    assert aperture is not None
    fx, fy = (abs(f) for f in camera.pixel_from_view()[:2])
    away = aperture.radius / aperture.focus
    return fx * away / aperture.ratio, fy * away
