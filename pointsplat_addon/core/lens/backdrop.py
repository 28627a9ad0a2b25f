"""The world seen out of focus: when it is blurred, and on which grid of texels.

What is infinitely far has the same disk of confusion everywhere in a picture (Křivánek 2003, equation 8): its radius is
C = F r / D, in pixels (core/lens/kernel.py). Parallel rays all see one direction, and nothing is blurred.
Seen through the lens the world is therefore the sharp picture of it convolved with that disk. Both are drawn on a grid
whose texels are C / DISK_TEXELS pixels wide, but not finer than FINEST: however wide the disk is, it holds as many
texels, and the picture at most four a pixel. Texels of the sharp picture are means of the world over their area,
from a pyramid (core/light/environment.py), so that small bright things keep their light."""

from __future__ import annotations

import numpy as np

from ..numeric.record import value_record
from ..scene.camera import Camera
from ..scene.scene import Scene
from ..splat.blur import IN_FOCUS, defocus_blur

DISK_TEXELS = 8.0  # texels, the largest radius of the disk
FINEST = 0.5  # pixels: texels of a pixel would blur by more than disks of less than a pixel do
RIM_SQUARE = 0.25  # texels^2, subtracted from the squared radius because the rim and the pixels are a texel wide
LEAST_RADIUS = 0.05  # texels, the least radius


@value_record
class BackdropGrid:
    """The texels of the world behind one picture. Texel (i, j) of the blurred picture is centred on the position
    ((i - 0.5) step x, (j - 0.5) step y), in pixels from the corner of what is drawn."""

    step: tuple[float, float]  # pixels that a texel spans
    radius: tuple[float, float]  # radius of the disk in texels
    margin: int  # texels of the sharp picture on each side of the blurred one
    size: tuple[int, int]  # texels of the blurred picture

    @property
    def larger(self) -> tuple[int, int]:
        """The size of the sharp picture, in texels."""
        return self.size[0] + 2 * self.margin, self.size[1] + 2 * self.margin


def why_not_blurred(scene: Scene, camera: Camera) -> str:
    """The reason why the world behind a picture is not blurred; empty if it is blurred."""
    blur = defocus_blur(camera)
    if blur is None:
        return "the camera has no depth of field"
    if scene.transparent:
        return "the film is transparent"
    if scene.world.behind.image is None:
        return "the world is of one colour"
    if not blur.perspective:
        return "parallel rays see one direction of the world"
    return "" if max(_radii(camera)) > IN_FOCUS else "the world is in focus"


def backdrop_grid(camera: Camera, most: int) -> BackdropGrid:
    """The grid for the picture of a perspective camera with a lens; `most`: the largest side of a texture, in
    texels."""
    margin = int(DISK_TEXELS) + 2
    step, radius, size = [], [], []
    for disk, pixels in zip(_radii(camera), camera.window[2:], strict=True):
        step.append(max(disk / DISK_TEXELS, FINEST, pixels / (most - 2 * margin - 3)))
        radius.append(max(np.sqrt(max((disk / step[-1]) ** 2 - RIM_SQUARE, 0.0)), LEAST_RADIUS))
        size.append(int(np.ceil(pixels / step[-1])) + 2)
    return BackdropGrid((step[0], step[1]), (radius[0], radius[1]), int(max(radius)) + 2, (size[0], size[1]))


def _radii(camera: Camera) -> tuple[float, float]:
    """Pixels, along x and y, of the disk of confusion of what is infinitely far, of a perspective camera."""
    aperture = camera.aperture
    assert aperture is not None
    fx, fy = (abs(f) for f in camera.pixel_from_view()[:2])
    away = aperture.radius / aperture.focus
    return fx * away / aperture.ratio, fy * away
