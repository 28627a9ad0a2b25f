"""Depth of field by samples that are drawn through points on the lens (Cook et al. 1984; Haeberli and Akeley 1990).

The cut, the pages and the lists of what is drawn are made once, for a picture that is wide enough for all points; per
sample only the tables that hold the view are made anew. The first sample is drawn through the middle of the lens, so
that what moves in a viewport is steady, and passes that are not averaged are those of a camera without a lens.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...core.lens.thin_lens import camera_through, lens_points
from ...core.scene.camera import Camera
from ..device.protocol import Device, Texture
from ..passes.output.adaptive import KEEP
from .uploads.uploads import Uploads


class LensSamples:
    """The points on the lens through which one picture is drawn."""

    def __init__(self, device: Device, camera: Camera, samples: int) -> None:
        """`camera`: with an aperture; what it shows is what is drawn."""
        assert camera.aperture is not None
        self.device, self.camera = device, camera
        self.points = lens_points(samples, camera.aperture)
        self.centre: Texture | None = None

    def view(self, sample: int, uploads: Uploads) -> Camera:
        """The camera of a sample, for which `uploads` are moved."""
        seen = camera_through(self.camera, self.points[sample])
        if sample:
            still = replace(self.camera, view_from_world=np.eye(4))
            uploads.move(camera_through(still, self.points[sample]).view_from_world, seen)
        return seen

    def keep(self, centre: Texture) -> None:
        """Remember the depths that the middle of the lens sees: what else is drawn in a viewport is hidden by them."""
        self.centre = self.device.texture(centre.size, "RGBA32F")
        self._target = self.device.target([self.centre])
        self.device.draw(KEEP, self._target, textures={"ps_combined": centre})

    def release(self) -> None:
        if self.centre is not None:
            self._target.release()
            self.centre.release()
        self.centre = None
