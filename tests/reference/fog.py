"""Float64 twin of shaders/lib/fog/airlight.glsl: light that fog scatters once along rays.

Along a ray that passes a lamp at a distance h, with t from the nearest place, dt / (h^2 + t^2) = d(atan(t / h)) / h:
over that angle the integrand is smooth (Kulla and Fajardo 2012; Sun et al. 2005 tabulate the same integral).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.world import Fog

NODES, WEIGHTS = np.polynomial.legendre.leggauss(2048)
DEEPEST = 40.0  # optical depth beyond which nothing is seen


def phase(g: float, cosine: np.ndarray) -> np.ndarray:
    """Henyey and Greenstein 1941; `cosine` of the angle by which light turns."""
    return (1 - g * g) / (4 * np.pi * (1 + g * g - 2 * g * cosine) ** 1.5)


def airlight(
    fog: Fog,
    light: Light,
    origins: np.ndarray,
    directions: np.ndarray,
    far: np.ndarray | float = np.inf,
    visible: Callable[[np.ndarray], np.ndarray] | None = None,
) -> np.ndarray:
    """(R, 3) radiance of the fog between the origins of rays (R, 3) and distances `far`, lit by a lamp without size.

    `visible` tells of places (..., 3) which of them the lamp sees.
    """
    least = fog.extinction.min()
    far = np.minimum(np.broadcast_to(far, len(origins)), DEEPEST / least if least > 0 else 1e6)
    offset = origins - light.position
    middle = -(offset * directions).sum(axis=1)
    h = np.linalg.norm(offset + middle[:, None] * directions, axis=1)
    low, high = np.arctan2(-middle, h), np.arctan2(far - middle, h)
    angle = low[:, None] + 0.5 * (high - low)[:, None] * (1 + NODES)
    t = h[:, None] * np.tan(angle)
    place = origins[:, None] + (middle[:, None] + t)[..., None] * directions[:, None]
    to_light = light.position - place
    way = np.linalg.norm(to_light, axis=2)
    to_light /= way[..., None]
    shines = phase(fog.anisotropy, (to_light * directions[:, None]).sum(axis=2))
    if light.kind == "SPOT":
        cosine = -(to_light @ light.direction)
        blend = np.clip((cosine - light.spot_cos) / ((1 - light.spot_cos) * light.spot_blend), 0, 1)
        shines = shines * blend * blend * (3 - 2 * blend)
    if visible is not None:
        shines = shines * visible(place)
    left = np.exp(-(middle[:, None] + t + way)[..., None] * fog.extinction)
    sums = (WEIGHTS[:, None] * shines[..., None] * left).sum(axis=1)
    return 0.5 * ((high - low) / h)[:, None] * sums * fog.scattering * light.color


def transmittance(fog: Fog, distance: np.ndarray | float) -> np.ndarray:
    """(..., 3), by Beer's law."""
    return np.exp(-np.asarray(distance, float)[..., None] * fog.extinction)
