"""Atmospheres: what scatters and absorbs in them, at which wavelengths, and how these make a colour."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..numeric.record import record, value_record
from .spectrum import OBSERVER, RGB_FROM_XYZ, STEP, WAVELENGTHS, sun_irradiance

# Of skies that scatter once
AIR_HEIGHT, AEROSOL_HEIGHT = 8000.0, 1200.0  # metres: heights over which densities fall to 1/e (Nishita 1993, 3.1)
OZONE_MIDDLE, OZONE_HALF = 25e3, 15e3  # metres: the layer, whose density falls to both sides (Bruneton 2017)
REFRACTION, MOLECULES = 1.0002926, 2.504e25  # of air: index of refraction, molecules per m3 (Penndorf 1957, 20 C)
AEROSOL = 2e-5  # 1/m: scattering by aerosols at the ground, the same at all wavelengths
ALBEDO = 0.9  # the share of what aerosols take out that they scatter
CORNETTE, HENYEY = 0.76, 0.8  # asymmetry of their phase functions
OZONE = 5.4e18  # molecules per m3 in the middle of the layer, about 300 Dobson units in all
# Absorption cross-sections of ozone at WAVELENGTHS, in 1e-25 m2 (the Chappuis band; Serdyuchenko et al. 2014)
OZONE_SECTIONS = np.array([
    0.006, 0.011, 0.037, 0.135, 0.372, 0.748, 1.18, 1.79, 2.87, 3.87, 4.56, 5.07, 3.98, 2.95, 2.08, 1.36, 0.86, 0.613,
    0.417, 0.276, 0.312,
])  # fmt: skip

# Of skies that scatter often, at 630, 560, 490 and 430 nm; per metre, or m2 per particle
MOLECULES_SCATTER = np.array([6.605e-6, 1.067e-5, 1.842e-5, 3.156e-5])  # Bucholtz 1995
OZONE_ABSORBS = np.array([3.472e-25, 3.914e-25, 1.349e-25, 0.1103e-25])  # Gorshelev et al. 2014
DOBSON = 334.5  # the year's mean
# Urban aerosols, Guimera, Gutierrez & Jarabo 2018, "A physically-based spatio-temporal sky model": of their table the
# cross-sections in km2 are in m2 with densities per km3, so that products are per metre
AEROSOL_ABSORBS = np.array([2.8722e-24, 4.6168e-24, 7.9706e-24, 1.3578e-23])
AEROSOL_SCATTERS = np.array([1.5908e-22, 1.7711e-22, 2.0942e-22, 2.4033e-22])
AEROSOLS, BACKGROUND = 1.3681e20, 2e6  # per volume at the ground, and everywhere
FOUR_IRRADIANCES = np.array([1.679, 1.828, 1.986, 1.307])  # of the sun, W/m2 per nanometre
FOUR_OBSERVER = np.array([  # nanometres: the CIE 1931 standard observer for these four, (4, 3)
    [53.387, 22.981, 0.0], [43.905, 71.348, 0.1025], [1.6137, 18.423, 31.743], [20.763, 2.3614, 110.48],
])  # fmt: skip


@value_record
class Atmosphere:
    """The densities of an atmosphere relative to the Earth's, and where the eye is in it."""

    altitude: float = 0.0  # metres
    air: float = 1.0
    aerosol: float = 1.0
    ozone: float = 1.0


@record
class Medium:
    """An atmosphere of air, aerosols and ozone about a round Earth, at K wavelengths; lengths in metres."""

    ground: float  # radius of the Earth
    top: float  # radius of the atmosphere
    altitude: float  # of the eye
    extinction: np.ndarray  # (3, K) 1/m by air, aerosols and ozone where their density is 1
    scattering: np.ndarray  # (2, K) 1/m by air and aerosols
    of_disc: np.ndarray  # (3, K) extinction of what is seen of the sun's disc
    densities: Callable[[np.ndarray], np.ndarray]  # (N, 3) at heights (N,)
    phase: Callable[[np.ndarray], np.ndarray]  # of aerosols, 1/sr, for cosines
    irradiance: np.ndarray  # (K,) of the sun outside, W/m2 per nanometre
    rgb: np.ndarray  # (K, 3) linear Rec. 709 of a unit at each wavelength
    steps: int  # along rays
    steps_to_sun: int
    exact_steps: bool  # light of a step is dimmed within it as it is in a homogeneous one; else by all of it

    @property
    def eye(self) -> np.ndarray:
        """(3,) where the eye is from the Earth's centre, within the atmosphere."""
        return np.array([0.0, 0.0, self.ground + np.clip(self.altitude, 1.0, self.top - self.ground - 1.0)])


def scattering_once(of: Atmosphere) -> Medium:
    """The atmosphere of Nishita et al. 1993, at 21 wavelengths. As in Cycles, ozone does not dim the sun's disc."""
    air = 8 * np.pi**3 * (REFRACTION**2 - 1) ** 2 / (3 * MOLECULES * (WAVELENGTHS * 1e-9) ** 4) * of.air
    aerosol = np.full(len(WAVELENGTHS), AEROSOL * of.aerosol)
    ozone = OZONE * of.ozone * OZONE_SECTIONS * 1e-25
    return Medium(
        6360e3, 6420e3, of.altitude,
        extinction=np.stack([air, aerosol / ALBEDO, ozone]),
        scattering=np.stack([air, aerosol]),
        of_disc=np.stack([air, aerosol / ALBEDO, 0 * ozone]),
        densities=_densities_once,
        phase=lambda cosine: 1.5 * (1 + cosine**2) / (2 + CORNETTE**2) * _henyey(cosine, CORNETTE),
        irradiance=sun_irradiance(),
        rgb=OBSERVER * STEP @ RGB_FROM_XYZ.T,
        steps=32, steps_to_sun=16, exact_steps=False,
    )  # fmt: skip


def scattering_often(of: Atmosphere) -> Medium:
    """The atmosphere of Guimera, Gutierrez & Jarabo 2018 with urban aerosols, at four wavelengths."""
    air, ozone = MOLECULES_SCATTER * of.air, OZONE_ABSORBS * DOBSON * of.ozone
    aerosol, absorbed = AEROSOL_SCATTERS * AEROSOLS * 1e-3 * of.aerosol, AEROSOL_ABSORBS * AEROSOLS * 1e-3 * of.aerosol
    extinction = np.stack([air, aerosol + absorbed, ozone])
    return Medium(
        6371e3, 6471e3, of.altitude, extinction, np.stack([air, aerosol]), extinction, _densities_often,
        phase=lambda cosine: _henyey(cosine, HENYEY), irradiance=FOUR_IRRADIANCES,
        rgb=FOUR_OBSERVER @ RGB_FROM_XYZ.T, steps=64, steps_to_sun=32, exact_steps=True,
    )  # fmt: skip


def _densities_once(height: np.ndarray) -> np.ndarray:
    height = np.maximum(height, 0.0)
    ozone = np.maximum(1 - np.abs(height - OZONE_MIDDLE) / OZONE_HALF, 0)
    return np.stack([np.exp(-height / AIR_HEIGHT), np.exp(-height / AEROSOL_HEIGHT), ozone], axis=1)


def _densities_often(height: np.ndarray) -> np.ndarray:
    """Fits of Guimera et al. 2018: of molecules, aerosols, and ozone in molecules per m3 and Dobson unit."""
    height = np.maximum(height, 0.0) / 1000
    air = np.exp(-0.07771971 * height**1.16364243)
    aerosol = np.exp(-height / 0.73) + BACKGROUND / AEROSOLS
    ozone = 3.78547397e17 / (height + 1e-4) * np.exp(-((np.log(height + 1e-4) - 3.22261) ** 2) * 5.55555555)
    return np.stack([air, aerosol, ozone], axis=1)


def _henyey(cosine: np.ndarray, g: float) -> np.ndarray:
    """Henyey and Greenstein's phase function, 1/sr."""
    return (1 - g * g) / (4 * np.pi * (1 + g * g - 2 * g * cosine) ** 1.5)
