"""TODO: say what this module is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..scene.camera import Camera

# Pixels of radius: a disk that adds a fifth of the variance that a pixel's own filter has; one that adds half of it.
IN_FOCUS, OUT_OF_FOCUS = 0.3, 0.45
# Diameter of the largest node that is drawn, over the radius of its disk of confusion together with SHARPER times the
# tolerance (`Blur.widest`). docs/notes/depth_of_field.md has the errors of others.
NODE_SIZE = 1.0
TOLERANCE_WEIGHT = 1.5
# Pixels: the coarsest tolerance of what is blurred, however coarse a cut is asked for. Nothing closes the gaps between
# its splats but their kernels, which sum to less than what lets nothing through if they are wider.
COARSEST_TOLERANCE = 2.0
NEAREST = 1e-9  # depth, over the distance of focus, nearer than which the disk does not grow any more


@dataclass(frozen=True)
class Blur:
    """How a camera's lens blurs."""

    scale: float  # pixels: f r / D, the radius of the disk of what is infinitely far (parallel: at twice D)
    focus: float  # D, world units
    perspective: bool
    node: float = NODE_SIZE  # as that

    def position(self, depth: np.ndarray) -> np.ndarray:
        """Signed: how far beyond the plane of focus depths are, in units in which the disk's radius is `scale` times
        that. Rises with depth; depths behind the eye are taken for the nearest."""
        with np.errstate(all="ignore"):
            relative = np.asarray(depth, np.float64) / self.focus
            return 1 - 1 / np.maximum(relative, NEAREST) if self.perspective else relative - 1

    def radius(self, depth: np.ndarray) -> np.ndarray:
        """Pixels, of the disks of confusion at these depths."""
        return self.scale * np.abs(self.position(depth))

    def depths(self, radius: float) -> tuple[float, float]:
        """The nearest and the farthest depth at which disks of confusion have no more than this radius in pixels."""
        away = radius / self.scale
        if not self.perspective:
            return self.focus * (1 - away), self.focus * (1 + away)
        return self.focus / (1 + away), self.focus / (1 - away) if away < 1 else np.inf

    def bounds(self, near: np.ndarray, far: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The least and the greatest radius in pixels between two depths, near <= far."""
        low, high = self.position(near), self.position(far)
        return self.scale * np.maximum(np.maximum(low, -high), 0), self.scale * np.maximum(-low, high)

    def widest(self, radius: np.ndarray, tolerance: float) -> np.ndarray:
        """Pixels: the diameter of the largest piece or node that is drawn as one splat, for the radius in pixels of the
        smallest disk of confusion within it. A disk of a pixel hides as much as a tolerance of one does."""
        return np.maximum(self.node * np.hypot(radius, TOLERANCE_WEIGHT * tolerance), tolerance)


def defocus_blur(camera: Camera, node: float = NODE_SIZE) -> Blur | None:
    """None: nothing is blurred. `node`: how large those are that are drawn, as NODE."""
    aperture = camera.aperture
    if aperture is None or not aperture.radius > 0 or not aperture.focus > 0:
        return None
    focal = max(abs(f) for f in camera.pixel_from_view()[:2])
    scale = focal * aperture.radius / (aperture.focus if camera.perspective else 1.0)
    return Blur(scale, aperture.focus, camera.perspective, node) if 0 < scale < np.inf else None
