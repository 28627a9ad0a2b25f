"""Light that an atmosphere scatters more than once, as Hillaire 2020, "A scalable and production ready sky and
atmosphere rendering technique", section 5.5: it is the same in all directions, and each further scattering is a share
of the one before."""

from __future__ import annotations

import numpy as np

from .medium import Medium
from .scattering import depth_to_end, hits_ground, path_length

HEIGHTS, COSINES = 12, 20  # of the table; heights are closer near the ground, cosines near the horizon
DIRECTIONS, STEPS = 32, 20
GROUND_ALBEDO = 0.3
SHARE = 0.8  # of the light by equation 10: measured on skies of Cycles at elevations from 5 to 90 degrees
LOWEST = 50.0  # metres: the least height, and the least depth below the end


class OftenScattered:
    """A table of that light, by the height and by the cosine of the sun's angle to the zenith."""

    def __init__(self, medium: Medium) -> None:
        self._ground, self._span = medium.ground, medium.top - medium.ground - 2 * LOWEST
        heights = np.linspace(0, 1, HEIGHTS) ** 2 * self._span + LOWEST
        t = np.linspace(-1, 1, COSINES)
        cosines = np.sign(t) * t**2
        height, cosine = (grid.ravel() for grid in np.meshgrid(heights, cosines, indexing="ij"))
        self._table = _table(height, cosine, medium).reshape(HEIGHTS, COSINES, -1).astype(np.float32)

    def __call__(self, at: np.ndarray, sun: np.ndarray) -> np.ndarray:
        """Radiance (N, K) at points (N, 3) from the Earth's centre."""
        radius = np.linalg.norm(at, axis=1)
        up = (at @ sun) / radius
        row = np.sqrt(np.clip((radius - self._ground - LOWEST) / self._span, 0, 1)) * (HEIGHTS - 1)
        column = (np.sign(up) * np.sqrt(np.abs(up)) + 1) / 2 * (COSINES - 1)
        i, j = (np.minimum(x.astype(int), n - 2) for x, n in ((row, HEIGHTS), (column, COSINES)))
        a, b = ((x - k)[:, None].astype(np.float32) for x, k in ((row, i), (column, j)))
        low, high = (self._table[i + k, j] * (1 - b) + self._table[i + k, j + 1] * b for k in (0, 1))
        return low * (1 - a) + high * a


def _table(height: np.ndarray, cosine: np.ndarray, medium: Medium) -> np.ndarray:
    """The radiance (M, K) for heights and cosines (M,): equations 5 to 9."""
    suns = np.stack([np.sqrt(1 - cosine**2), np.zeros_like(cosine), cosine], axis=1)
    start = np.stack([np.zeros_like(height), np.zeros_like(height), medium.ground + height], axis=1)
    once, again = np.zeros((2, len(height), len(medium.irradiance)))
    number = np.arange(DIRECTIONS) + 0.5
    z, turn = 1 - 2 * number / DIRECTIONS, np.pi * (1 + np.sqrt(5)) * number
    for direction in np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1):
        ends = hits_ground(medium, start, direction)
        step = path_length(medium, start, np.broadcast_to(direction, start.shape)) / STEPS
        before = np.zeros_like(once)  # optical depth
        for k in range(STEPS):
            at = start + ((k + 0.5) * step)[:, None] * direction
            here = medium.densities(np.linalg.norm(at, axis=1) - medium.ground) * step[:, None]
            depth = here @ medium.extinction
            within = np.divide(-np.expm1(-depth), depth, np.ones_like(depth), where=depth > 0)
            share = np.exp(-before) * within * (here[:, :2] @ medium.scattering) / DIRECTIONS
            before += depth
            again += share
            once += share * _sunlight(medium, at, suns) / (4 * np.pi)
        ground = start + (STEPS * step)[:, None] * direction
        ground *= (medium.ground + 1.0) / np.linalg.norm(ground, axis=1, keepdims=True)
        slope = np.maximum((ground * suns).sum(axis=1) / medium.ground, 0)[:, None]
        passed = np.exp(-before) * (ends[:, None] * GROUND_ALBEDO / np.pi / DIRECTIONS)
        once += passed * slope * _sunlight(medium, ground, suns)
    return SHARE * once / (1 - again)


def _sunlight(medium: Medium, at: np.ndarray, suns: np.ndarray) -> np.ndarray:
    """The sun's irradiance (M, K) at points (M, 3), each with the sun in a direction of its own (M, 3)."""
    reached = np.exp(-depth_to_end(medium, at, suns)) * medium.irradiance
    return np.where(hits_ground(medium, at, suns)[:, None], 0.0, reached)
