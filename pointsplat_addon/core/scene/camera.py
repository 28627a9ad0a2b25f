"""Camera and aperture: where a picture is seen from, and the thin lens that it is seen through."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..numeric.record import record, value_record


@value_record
class Aperture:
    """The opening of a thin lens, in the plane through the eye that the camera looks along the normal of."""

    radius: float  # world units, along the picture's y
    focus: float  # world units > 0, along the direction of view: what lies there is sharp
    blades: int = 0  # sides of a regular polygon; below three: a disk
    rotation: float = 0.0  # radians, of the polygon
    ratio: float = 1.0  # height over width


@record
class Camera:
    """A pinhole or parallel camera. View space looks along -Z, +Y up. Pixels count from the bottom left."""

    view_from_world: np.ndarray  # (4, 4) float64, rigid
    clip_from_view: np.ndarray  # (4, 4) float64, OpenGL's (z from -1 to 1); no skew; shift included
    resolution: tuple[int, int]  # width, height of the full frame in pixels
    region: tuple[int, int, int, int] | None = None  # x0, y0, width, height of the part to draw; None: all
    near: float = 0.1  # clip start; may be negative in a parallel viewport
    far: float = 1000.0
    previous_view_from_world: np.ndarray | None = None  # a frame before; only for the Vector pass
    previous_clip_from_view: np.ndarray | None = None
    aperture: Aperture | None = None  # None: everything is sharp
    coarseness: float = 1.0  # side of a pixel over that of those for which it stands while a view is in a hurry

    @property
    def perspective(self) -> bool:
        return bool(self.clip_from_view[3, 2] != 0.0)

    @property
    def nearest(self) -> float:
        """The least depth that is seen: in a parallel view it may lie behind the camera."""
        return max(self.near, 1e-9) if self.perspective else self.near

    @property
    def window(self) -> tuple[int, int, int, int]:
        return self.region or (0, 0, *self.resolution)

    def with_coarser_pixels(self, times: int) -> Camera:
        """Returns the camera whose picture shows this one's window, in pixels that are about `times` as wide and high:
        whole ones fill the window."""
        if times <= 1:
            return self
        (w, h), (x0, y0, *size) = self.resolution, self.window
        width, height = (max(1, round(side / times)) for side in size)
        # Clip space of the window, whose low corner lies at x0, y0 of the full frame.
        clip_of_window = np.diag([w / size[0], h / size[1], 1.0, 1.0])
        clip_of_window[:2, 3] = (w - 2 * x0) / size[0] - 1, (h - 2 * y0) / size[1] - 1
        return replace(
            self,
            clip_from_view=clip_of_window @ self.clip_from_view,
            previous_clip_from_view=None,
            previous_view_from_world=None,
            resolution=(width, height),
            region=None,
            coarseness=self.coarseness * times,
        )

    def pixel_from_view(self) -> tuple[float, float, float, float]:
        """(fx, fy, cx, cy): pixel = c + f * xy / d, with d = -z for perspective and d = 1 for parallel cameras."""
        m, (w, h), (x0, y0, _, _) = self.clip_from_view, self.resolution, self.window
        shift = -m[:2, 2] if self.perspective else m[:2, 3]
        fx, fy = m[0, 0] * w / 2, m[1, 1] * h / 2
        return fx, fy, (1 + shift[0]) * w / 2 - x0, (1 + shift[1]) * h / 2 - y0
