"""Light that an atmosphere scatters more than once, as Hillaire 2020, "A scalable and production ready sky and
atmosphere rendering technique", section 5.5: it is the same in all directions, and each further scattering is a share
of the one before."""

from __future__ import annotations

import numpy as np

from .scattering import (
    ALBEDO,
    GROUND,
    TOP,
    Atmosphere,
    coefficients_of,
    densities,
    densities_along,
    hits_ground,
    path_length,
)
from .spectrum import WAVELENGTHS, sun_irradiance

HEIGHTS, COSINES = 12, 20  # of the table; heights are closer near the ground, cosines near the horizon
DIRECTIONS, STEPS = 32, 20
GROUND_ALBEDO = 0.3


class OftenScattered:
    """A table of that light, by the height and by the cosine of the sun's angle to the zenith."""

    def __init__(self, of: Atmosphere) -> None:
        heights = np.linspace(0, 1, HEIGHTS) ** 2 * (TOP - GROUND - 100.0) + 50.0
        t = np.linspace(-1, 1, COSINES)
        cosines = np.sign(t) * t**2
        height, cosine = (grid.ravel() for grid in np.meshgrid(heights, cosines, indexing="ij"))
        self._table = _table(height, cosine, of).reshape(HEIGHTS, COSINES, -1).astype(np.float32)

    def __call__(self, at: np.ndarray, sun: np.ndarray) -> np.ndarray:
        """Radiance (N, 21) at points (N, 3) from the Earth's centre."""
        radius = np.linalg.norm(at, axis=1)
        up = (at @ sun) / radius
        row = np.sqrt(np.clip((radius - GROUND - 50.0) / (TOP - GROUND - 100.0), 0, 1)) * (HEIGHTS - 1)
        column = (np.sign(up) * np.sqrt(np.abs(up)) + 1) / 2 * (COSINES - 1)
        i, j = (np.minimum(x.astype(int), n - 2) for x, n in ((row, HEIGHTS), (column, COSINES)))
        a, b = ((x - k)[:, None].astype(np.float32) for x, k in ((row, i), (column, j)))
        low, high = (self._table[i + k, j] * (1 - b) + self._table[i + k, j + 1] * b for k in (0, 1))
        return low * (1 - a) + high * a


def _table(height: np.ndarray, cosine: np.ndarray, of: Atmosphere) -> np.ndarray:
    """The radiance (K, 21) for heights and cosines (K,): equations 5 to 9."""
    coefficients = coefficients_of(of)
    scattering_of = coefficients[:2] * [[1.0], [ALBEDO]]
    suns = np.stack([np.sqrt(1 - cosine**2), np.zeros_like(cosine), cosine], axis=1)
    start = np.stack([np.zeros_like(height), np.zeros_like(height), GROUND + height], axis=1)
    once, again = np.zeros((2, len(height), len(WAVELENGTHS)))
    number = np.arange(DIRECTIONS) + 0.5
    z, turn = 1 - 2 * number / DIRECTIONS, np.pi * (1 + np.sqrt(5)) * number
    for direction in np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1):
        ends = hits_ground(start, direction)
        step = path_length(start, np.broadcast_to(direction, start.shape)) / STEPS
        before = np.zeros((len(height), 3))
        for k in range(STEPS):
            at = start + ((k + 0.5) * step)[:, None] * direction
            here = densities(np.linalg.norm(at, axis=1) - GROUND) * step[:, None]
            passed = np.exp(-(before + here / 2) @ coefficients)
            before += here
            share = passed * (here[:, :2] @ scattering_of) / DIRECTIONS
            again += share
            once += share * _sunlight(at, suns, coefficients) / (4 * np.pi)
        ground = start + (STEPS * step)[:, None] * direction
        ground *= (GROUND + 1.0) / np.linalg.norm(ground, axis=1, keepdims=True)
        slope = np.maximum((ground * suns).sum(axis=1) / GROUND, 0)[:, None]
        passed = np.exp(-before @ coefficients) * (ends[:, None] * GROUND_ALBEDO / np.pi / DIRECTIONS)
        once += passed * slope * _sunlight(ground, suns, coefficients)
    return once / (1 - again)


def _sunlight(at: np.ndarray, suns: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """The sun's irradiance (K, 21) at points (K, 3), each with the sun in a direction of its own (K, 3)."""
    depth = densities_along(at, suns) @ coefficients
    return np.where(hits_ground(at, suns)[:, None], 0.0, np.exp(-depth) * sun_irradiance())
