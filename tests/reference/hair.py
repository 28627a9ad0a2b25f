"""Hair of Chiang et al. 2016 as Cycles evaluates it: at each offset across a strand, in float64.

shaders/lib/strands/hair.glsl draws the mean over the width of a strand, with the centre of each lobe at one angle
(twin: hair_lighting.py). Here each offset has its own path; their mean is what a strand scatters that is seen as a
whole.
"""

from __future__ import annotations

import numpy as np

from pointsplat_addon.core.material.hair_color import absorption_from_color
from tests.reference.hair_lighting import Fibre, logistic, logistic_scale, longitudinal, longitudinal_variance
from tests.reference.reflectance import fresnel_dielectric


def scattered(theta: float, eye: float, phi: float, fibre: Fibre, offsets: int) -> np.ndarray:
    """(3,) radiance towards the eye of one strand in light of unit irradiance, the mean of so many offsets across it.

    `theta` and `eye` are the angles of the light and of the eye to the plane across the strand, `phi` the one between
    their azimuths, in radians. The fibre is one. Chiang et al. 2016, equations 3 to 8.
    """
    h = (np.arange(offsets) + 0.5) / offsets * 2 - 1
    eta, tilt = (float(np.ravel(a)[0]) for a in (fibre.eta, fibre.tilt))
    sigma = absorption_from_color(np.asarray(fibre.color, float), np.asarray(fibre.radial)[..., None])[0]
    sine, cosine = np.sin(eye), np.cos(eye)
    inside = np.sqrt(1 - (sine / eta) ** 2)
    bent = np.sqrt(eta**2 - sine**2) / cosine
    outer, inner = np.arcsin(h), np.arcsin(h / bent)
    passed = np.exp(-sigma * (2 * np.cos(inner) / inside)[:, None])  # (H, 3)
    reflected = fresnel_dielectric(cosine * np.cos(outer), np.full(offsets, eta))[:, None]
    through = (1 - reflected) ** 2 * passed
    again = through * passed * reflected
    energies = [np.broadcast_to(reflected, passed.shape), through, again]
    rest = again * passed * reflected / (1 - passed * reflected)
    wide, width = longitudinal_variance(fibre.roughness), logistic_scale(fibre.radial)
    total = np.zeros((offsets, 3))
    lobes = ((wide, 2 * tilt), (wide / 4, -tilt), (wide * 4, -4 * tilt))
    for p, (energy, (v, lean)) in enumerate(zip(energies, lobes, strict=True)):
        along = longitudinal(np.array([theta]), np.array([eye + lean]), v)
        off = phi - (2 * p * inner - 2 * outer + p * np.pi)
        around = logistic((off + np.pi) % (2 * np.pi) - np.pi, width)
        total += along * around[:, None] * energy
    along = longitudinal(np.array([theta]), np.array([eye]), wide * 4)
    total += along / (2 * np.pi) * rest
    return total.mean(axis=0)
