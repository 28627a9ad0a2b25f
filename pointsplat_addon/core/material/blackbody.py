"""Colours of black bodies from Planck's law and the CIE 1931 observer."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

# Planck's law times the observer, relative to its luminance; Cycles holds the colour constant outside this range, too.
BLACKBODY_KELVIN = np.geomspace(800.0, 12000.0, 256)


def blackbody(kelvin: np.ndarray) -> np.ndarray:
    """Linear Rec. 709 colour (N, 3) float64 of luminance 1 of black bodies; below 800 K that of 800 K.

    Planck's law integrated with the CIE 1931 observer in the fit of Wyman, Sloan & Shirley 2013, equation 4. Colours
    outside the gamut are clamped.
    """
    x = np.log(np.maximum(kelvin, 1.0))
    at = np.log(BLACKBODY_KELVIN)
    return np.stack([np.interp(x, at, column) for column in _blackbody_table().T], axis=1)


@lru_cache(1)
def _blackbody_table() -> np.ndarray:
    wave = np.arange(360.0, 831.0)  # nanometres

    def lobe(middle: float, left: float, right: float) -> np.ndarray:
        return np.exp(-0.5 * ((wave - middle) * np.where(wave < middle, left, right)) ** 2)

    observer = np.stack([
        0.362 * lobe(442.0, 0.0624, 0.0374) + 1.056 * lobe(599.8, 0.0264, 0.0323) - 0.065 * lobe(501.1, 0.0490, 0.0382),
        0.821 * lobe(568.8, 0.0213, 0.0247) + 0.286 * lobe(530.9, 0.0613, 0.0322),
        1.217 * lobe(437.0, 0.0845, 0.0278) + 0.681 * lobe(459.0, 0.0385, 0.0725),
    ])  # fmt: skip
    with np.errstate(over="ignore"):
        planck = 1 / (wave**5 * np.expm1(1.438777e7 / (wave * BLACKBODY_KELVIN[:, None])))
    xyz = planck @ observer.T
    linear = (xyz / xyz[:, 1:2]) @ np.array([
        [3.2404542, -0.9692660, 0.0556434],
        [-1.5371385, 1.8760108, -0.2040259],
        [-0.4985314, 0.0415560, 1.0572252],
    ])  # fmt: skip
    return np.maximum(linear, 0)
