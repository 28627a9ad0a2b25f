"""The sky as sunlight that the air, its aerosols and ozone scatter once and absorb (Nishita, Sirai, Tadamura &
Nakamae 1993, "Display of the Earth taking into account atmospheric scattering"), at 21 wavelengths."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ..numeric.record import value_record
from .spectrum import WAVELENGTHS, sun_irradiance

GROUND, TOP = 6360e3, 6420e3  # metres: radii of the Earth and of its atmosphere
AIR_HEIGHT, AEROSOL_HEIGHT = 8000.0, 1200.0  # metres: heights over which densities fall to 1/e (Nishita 1993, 3.1)
OZONE_MIDDLE, OZONE_HALF = 25e3, 15e3  # metres: the layer, whose density falls to both sides (Bruneton 2017)
REFRACTION, MOLECULES = 1.0002926, 2.504e25  # of air: index of refraction, molecules per m3 (Penndorf 1957, 20 C)
AEROSOL = 2e-5  # 1/m: scattering by aerosols at the ground, the same at all wavelengths
ASYMMETRY, ALBEDO = 0.76, 0.9  # of aerosols: of their phase function, and the share of extinction that scatters
OZONE = 5.4e18  # molecules per m3 in the middle of the layer, about 300 Dobson units in all
# Absorption cross-sections of ozone at WAVELENGTHS, in 1e-25 m2 (the Chappuis band; Serdyuchenko et al. 2014)
OZONE_SECTIONS = np.array([
    0.006, 0.011, 0.037, 0.135, 0.372, 0.748, 1.18, 1.79, 2.87, 3.87, 4.56, 5.07, 3.98, 2.95, 2.08, 1.36, 0.86, 0.613,
    0.417, 0.276, 0.312,
])  # fmt: skip
STEPS, STEPS_TO_SUN = 32, 16
HIGHEST = TOP - GROUND - 1  # metres
CHUNK = 2048  # directions at a time


@value_record
class Atmosphere:
    """The densities of an atmosphere relative to the Earth's, and where the eye is in it."""

    altitude: float = 0.0  # metres
    air: float = 1.0
    aerosol: float = 1.0
    ozone: float = 1.0

    @property
    def height(self) -> float:
        """Metres above the ground, within the atmosphere."""
        return float(np.clip(self.altitude, 1.0, HIGHEST))


class Often(Protocol):
    """Light that has been scattered more than once: radiance (N, 21), the same in all directions, at points (N, 3)."""

    def __call__(self, at: np.ndarray, sun: np.ndarray) -> np.ndarray: ...


def air_scattering() -> np.ndarray:
    """Rayleigh's scattering by air at the ground, (21,) 1/m: 8 pi^3 (n^2 - 1)^2 / (3 N wavelength^4)."""
    return 8 * np.pi**3 * (REFRACTION**2 - 1) ** 2 / (3 * MOLECULES * (WAVELENGTHS * 1e-9) ** 4)


def scattered(direction: np.ndarray, sun: np.ndarray, of: Atmosphere, often: Often | None = None) -> np.ndarray:
    """Radiance (N, 21) W/m2/sr per nanometre that the sky has in unit directions (N, 3); rays end at the ground.

    sun: (3,) unit, towards it. often: the light that is scattered more than once; None: it is left out.
    """
    parts = [_scattered(direction[i : i + CHUNK], sun, of, often) for i in range(0, len(direction), CHUNK)]
    return np.concatenate(parts) if parts else np.zeros((0, len(WAVELENGTHS)), np.float32)


def _scattered(direction: np.ndarray, sun: np.ndarray, of: Atmosphere, often: Often | None) -> np.ndarray:
    eye = np.array([0.0, 0.0, GROUND + of.height])
    step = path_length(eye, direction) / STEPS
    phases = _phases(direction @ sun) * [1.0, ALBEDO]
    before = np.zeros((len(direction), 3))  # densities along the ray so far
    found = np.zeros((len(direction), len(WAVELENGTHS)), np.float32)
    coefficients = coefficients_of(of).astype(np.float32)
    irradiance = sun_irradiance().astype(np.float32)
    for k in range(STEPS):
        at = eye + ((k + 0.5) * step)[:, None] * direction
        here = densities(np.linalg.norm(at, axis=1) - GROUND) * step[:, None]
        before += here
        lit = np.flatnonzero(~hits_ground(at, sun))
        depth = (before[lit] + densities_along(at[lit], sun)).astype(np.float32) @ coefficients
        share = (here[lit, :2] * phases[lit]).astype(np.float32) @ coefficients[:2]
        found[lit] += np.exp(-depth) * share * irradiance
        if often is not None:
            scattering = (here[:, :2] * [1.0, ALBEDO]).astype(np.float32) @ coefficients[:2]
            found += np.exp(-before.astype(np.float32) @ coefficients) * scattering * often(at, sun)
    return found


def path_length(at: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Metres (N,) along rays from points (N | 1, 3) to the ground or, where they miss it, the end of the atmosphere."""
    b = (at * direction).sum(axis=-1)
    under = b * b - (at * at).sum(axis=-1) + GROUND**2
    ground = -b - np.sqrt(np.maximum(under, 0.0))
    return np.where((b < 0) & (under >= 0), ground, _distance_to(TOP, at, direction))


def transmittance(direction: np.ndarray, of: Atmosphere) -> np.ndarray:
    """What reaches the eye of light from outside in directions (N, 3), (N, 21)."""
    eye = np.broadcast_to([0.0, 0.0, GROUND + of.height], direction.shape)
    depth = _along(eye, direction, STEPS_TO_SUN * 4) @ coefficients_of(of)
    return np.where(hits_ground(eye, direction)[:, None], 0.0, np.exp(-depth))


def coefficients_of(of: Atmosphere) -> np.ndarray:
    """Extinction by air, aerosols and ozone where their density is 1, (3, 21) 1/m."""
    aerosol = np.full(len(WAVELENGTHS), AEROSOL / ALBEDO * of.aerosol)
    return np.stack([air_scattering() * of.air, aerosol, OZONE * of.ozone * OZONE_SECTIONS * 1e-25])


def densities(height: np.ndarray) -> np.ndarray:
    """Relative densities of air, aerosols and ozone, (N, 3), at heights in metres (N,)."""
    height = np.maximum(height, 0.0)
    return np.stack(
        [
            np.exp(-height / AIR_HEIGHT),
            np.exp(-height / AEROSOL_HEIGHT),
            np.maximum(1 - np.abs(height - OZONE_MIDDLE) / OZONE_HALF, 0),
        ],
        axis=1,
    )


def densities_along(at: np.ndarray, sun: np.ndarray) -> np.ndarray:
    """Densities (N, 3) summed, in metres, from points (N, 3) to the end of the atmosphere towards the sun."""
    return _along(at, np.broadcast_to(sun, at.shape), STEPS_TO_SUN)


def _along(at: np.ndarray, direction: np.ndarray, steps: int) -> np.ndarray:
    step = _distance_to(TOP, at, direction) / steps
    total = np.zeros((len(at), 3))
    for k in range(steps):
        point = at + ((k + 0.5) * step)[:, None] * direction
        total += densities(np.linalg.norm(point, axis=1) - GROUND)
    return total * step[:, None]


def _distance_to(radius: float, at: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Distance (N,) from within a sphere about the Earth's centre to it."""
    b = (at * direction).sum(axis=-1)
    return np.sqrt(b * b - (at * at).sum(axis=-1) + radius**2) - b


def hits_ground(at: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Whether rays from points (N, 3) meet the ground, (N,)."""
    b = (at * direction).sum(axis=-1)
    return (b < 0) & (b * b - (at * at).sum(axis=-1) + GROUND**2 >= 0)


def _phases(cosine: np.ndarray) -> np.ndarray:
    """Phase functions of air (Rayleigh) and aerosols (Cornette & Shanks 1992), (N, 2) 1/sr."""
    g2 = ASYMMETRY**2
    rayleigh = 3 / (16 * np.pi) * (1 + cosine**2)
    narrow = (1 + g2 - 2 * ASYMMETRY * cosine) ** 1.5
    aerosol = 3 / (8 * np.pi) * (1 - g2) * (1 + cosine**2) / ((2 + g2) * narrow)
    return np.stack([rayleigh, aerosol], axis=1)
