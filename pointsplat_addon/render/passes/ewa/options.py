"""Options of EWA splatting that follow from the camera and from how wide splats are on the screen."""

from __future__ import annotations

import math

from ....core.numeric.record import value_record
from ....core.scene.camera import Camera
from ....core.splat.ewa import centres_decide, low_pass

WIDEST_POINT = 32.0  # pixels of radius up to which shaders/ewa/project.frag calls splats small
AFFINE_ERROR = 0.1  # pixels, as there
NODE_RIM = 6.0  # squared Mahalanobis distance, beyond CUTOFF: shaders/lib/splat/ewa.glsl


@value_record
class EwaOptions:
    """What a view's splats need beyond PointOptions."""

    low_pass: float  # pixels^2: core.ewa.low_pass
    shift: float  # pixels that samples shift the picture by at most
    hard: bool  # core.ewa.centres_decide
    balls: bool = False  # some have no normal
    large: bool = False  # some may be wide, or near

    def reach(self, largest: float) -> float:
        """Pixels from the centre to the end of the kernel of splats that are drawn as points, of at most the radius
        `largest`; wider ones are drawn wherever their centres are."""
        return math.sqrt(NODE_RIM * (min(largest, WIDEST_POINT) ** 2 / 4 + self.low_pass))


def options(camera: Camera, largest: float, balls: bool, samples: int, filter_size: float) -> EwaOptions:
    """Returns the options of a view. `largest`: bound of the splats' radii in pixels. A rim's projection errs by its
    radius times the share of the depth that it extends over, at most the radius squared over the focal length in
    pixels."""
    focal = min(abs(f) for f in camera.pixel_from_view()[:2])
    affine = math.sqrt(AFFINE_ERROR * focal) if camera.perspective else math.inf
    wide = not largest <= min(WIDEST_POINT, affine)
    return EwaOptions(low_pass(samples), filter_size, centres_decide(samples), balls, wide)
