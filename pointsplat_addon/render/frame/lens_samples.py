"""Draws depth of field by samples through points on the lens (Cook et al. 1984; Haeberli and Akeley 1990).

The cut, the pages and the draw lists are made once, for a picture that is wide enough for all points; only the tables
that hold the view are updated for each sample. The first sample is drawn through the centre of the lens, so that moving
things in a viewport are steady, and passes that are not averaged are those of a camera without a lens.
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
        """Chooses a point on the lens for each of `samples` samples; `camera` must have an aperture."""
        assert camera.aperture is not None
        self.device, self.camera = device, camera
        self.points = lens_points(samples, camera.aperture)
        self.centre: Texture | None = None

    def view(self, sample: int, uploads: Uploads) -> Camera:
        """Returns the camera of a sample, and moves `uploads` to its view."""
        seen = camera_through(self.camera, self.points[sample])
        if sample:
            still = replace(self.camera, view_from_world=np.eye(4))
            uploads.move(camera_through(still, self.points[sample]).view_from_world, seen)
        return seen

    def keep(self, centre: Texture) -> None:
        """Copies the depths seen through the centre of the lens, which occlude Blender's drawing in a viewport."""
        self.centre = self.device.texture(centre.size, "RGBA32F")
        self._target = self.device.target([self.centre])
        self.device.draw(KEEP, self._target, textures={"ps_combined": centre})

    def release(self) -> None:
        if self.centre is not None:
            self._target.release()
            self.centre.release()
        self.centre = None
