"""The sky by Preetham, Shirley & Smits 1999, "A practical analytic model for daylight", appendix A.2."""

from __future__ import annotations

import numpy as np

from .spectrum import RGB_FROM_XYZ

# The coefficients A .. E of Perez' function of luminance Y and of the chromaticities x and y: factor of turbidity, rest
PEREZ = np.array([
    [[0.1787, -1.4630], [-0.3554, 0.4275], [-0.0227, 5.3251], [0.1206, -2.5771], [-0.0670, 0.3703]],
    [[-0.0193, -0.2592], [-0.0665, 0.0008], [-0.0004, 0.2125], [-0.0641, -0.8989], [-0.0033, 0.0452]],
    [[-0.0167, -0.2608], [-0.0950, 0.0092], [-0.0079, 0.2102], [-0.0441, -1.6537], [-0.0109, 0.0529]],
])  # fmt: skip
# Chromaticity of the zenith: rows are powers 2, 1, 0 of turbidity, columns powers 3 .. 0 of the sun's angle to it
ZENITH = np.array([
    [[0.00166, -0.00375, 0.00209, 0.0], [-0.02903, 0.06377, -0.03202, 0.00394], [0.11693, -0.21196, 0.06052, 0.25886]],
    [[0.00275, -0.00610, 0.00317, 0.0], [-0.04214, 0.08970, -0.04153, 0.00516], [0.15346, -0.26756, 0.06670, 0.26688]],
])  # fmt: skip
LOWEST = np.pi / 2 - 1e-3  # the largest angle to the zenith: below the horizon the sky is that at it
LUMINANCE = 0.06  # of a radiance, for a luminance of 1 kcd/m2: Cycles' scale


def preetham(direction: np.ndarray, sun: np.ndarray, turbidity: float) -> np.ndarray:
    """Colours (N, 3) of the sky in unit directions (N, 3). `sun`: (3,) unit, towards it. 1.7 < turbidity < 10."""
    to_sun = float(np.arccos(np.clip(sun[2], -1, 1)))
    coefficients = PEREZ @ [turbidity, 1.0]  # (3, 5)
    angle = np.minimum(np.arccos(np.clip(direction[:, 2], -1, 1)), LOWEST)
    gamma = np.arccos(np.clip(direction @ sun, -1, 1))
    zenith = zenith_of(to_sun, turbidity)
    luminance, x, y = (
        zenith[i] * _perez(coefficients[i], angle, gamma) / _perez(coefficients[i], np.zeros(1), np.full(1, to_sun))
        for i in range(3)
    )
    scale = np.divide(LUMINANCE * luminance, y, np.zeros_like(y), where=y != 0)
    return np.stack([scale * x, scale * y, scale * (1 - x - y)], axis=1) @ RGB_FROM_XYZ.T


def zenith_of(to_sun: float, turbidity: float) -> np.ndarray:
    """Luminance in kcd/m2 and chromaticities x, y, (3,), of the zenith for the sun's angle to it in radians."""
    chi = (4 / 9 - turbidity / 120) * (np.pi - 2 * to_sun)
    luminance = (4.0453 * turbidity - 4.9710) * np.tan(chi) - 0.2155 * turbidity + 2.4192
    powers = to_sun ** np.arange(3, -1, -1)
    return np.array([luminance, *(turbidity ** np.arange(2, -1, -1) @ ZENITH @ powers)])


def _perez(coefficients: np.ndarray, angle: np.ndarray, gamma: np.ndarray) -> np.ndarray:
    """Perez' function of angles to the zenith and to the sun, (N,)."""
    a, b, c, d, e = coefficients
    return (1 + a * np.exp(b / np.cos(angle))) * (1 + c * np.exp(d * gamma) + e * np.cos(gamma) ** 2)
