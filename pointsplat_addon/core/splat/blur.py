"""Defocus blur: circles of confusion of a thin lens, and how large splats may be where they are out of focus.

Křivánek 2003, sections 3.4 and 3.5: what is out of focus is drawn from coarser nodes.
"""

from __future__ import annotations

import numpy as np

from ..numeric.record import value_record
from ..scene.camera import Camera

# Radii of circles of confusion in pixels. Up to IN_FOCUS a circle adds less than a fifth to the variance of a pixel's
# own filter, and a splat is drawn as if it were sharp; from OUT_OF_FOCUS on it adds half and more.
IN_FOCUS, OUT_OF_FOCUS = 0.3, 0.45
# The largest node that is drawn, in diameters over the radius of its circle of confusion together with TOLERANCE_WEIGHT
# times the tolerance (`Blur.largest_splat`). docs/notes/depth_of_field.md has the errors of other values.
NODE_SIZE = 1.0
TOLERANCE_WEIGHT = 1.5
# Pixels: the coarsest tolerance of what is out of focus, however coarse a cut is asked for. Only their kernels close
# the gaps between its splats, and wider kernels add up to less than what it takes to be opaque.
COARSEST_TOLERANCE = 2.0
NEAREST = 1e-9  # depth over the focus distance; nearer circles of confusion do not grow any more


@value_record
class Blur:
    """The circles of confusion of one camera (thin lens), in pixels."""

    scale: (
        float  # pixels: focal length x aperture radius / focus; the circle's radius at infinity (parallel: at 2 focus)
    )
    focus: float  # depth of the plane of focus, world units
    perspective: bool
    node: float = NODE_SIZE  # as NODE_SIZE

    def defocus(self, depth: np.ndarray) -> np.ndarray:
        """Signed radii of circles of confusion at these depths, in units of `scale`, float64.

        Negative before the plane of focus; rises with depth. Depths behind the eye count as the nearest.
        """
        with np.errstate(all="ignore"):
            relative = np.asarray(depth, np.float64) / self.focus
            return 1 - 1 / np.maximum(relative, NEAREST) if self.perspective else relative - 1

    def radius(self, depth: np.ndarray) -> np.ndarray:
        """Radii in pixels of the circles of confusion at these depths (world units), float64."""
        return self.scale * np.abs(self.defocus(depth))

    def depth_range(self, radius: float) -> tuple[float, float]:
        """The nearest and the farthest depth (world units) whose circle of confusion is at most `radius` pixels."""
        away = radius / self.scale
        if not self.perspective:
            return self.focus * (1 - away), self.focus * (1 + away)
        return self.focus / (1 + away), self.focus / (1 - away) if away < 1 else np.inf

    def radius_range(self, near: np.ndarray, far: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The least and the greatest radius in pixels between two depths, near <= far."""
        low, high = self.defocus(near), self.defocus(far)
        return self.scale * np.maximum(np.maximum(low, -high), 0), self.scale * np.maximum(-low, high)

    def largest_splat(self, radius: np.ndarray, tolerance: float) -> np.ndarray:
        """The largest diameter in pixels that a node or patch drawn as one splat may have.

        `radius`: pixels, of the smallest circle of confusion within it. `tolerance`: pixels, allowed where nothing is
        blurred. A circle of a pixel hides as much as a tolerance of a pixel does.
        """
        return np.maximum(self.node * np.hypot(radius, TOLERANCE_WEIGHT * tolerance), tolerance)


def defocus_blur(camera: Camera, node: float = NODE_SIZE) -> Blur | None:
    """The blur of a camera's lens; returns None if everything is in focus. `node`: see NODE_SIZE."""
    aperture = camera.aperture
    if aperture is None or not aperture.radius > 0 or not aperture.focus > 0:
        return None
    focal = max(abs(f) for f in camera.pixel_from_view()[:2])
    scale = focal * aperture.radius / (aperture.focus if camera.perspective else 1.0)
    return Blur(scale, aperture.focus, camera.perspective, node) if 0 < scale < np.inf else None
