"""A sky in all directions, with or without the sun's disc, and the light that the disc sends."""

from __future__ import annotations

from functools import cached_property, lru_cache

import numpy as np

from ..numeric.record import value_record
from .medium import Atmosphere, Medium, scattering_often, scattering_once
from .often import OftenScattered
from .preetham import preetham
from .scattering import scattered, sun_through

ROWS, COLUMNS = 128, 64  # of a table: elevations of one sign, and angles to the sun's azimuth from 0 to pi
FADE = 0.4  # sine of the angle below the horizon at which a sky that is scattered once ends
LIMB = 0.6  # how much darker the sun's edge is than its middle
HOSEK = 0.14  # of Preetham's sky: Hosek and Wilkie's is about as bright


@value_record
class Sky:
    """The parameters of a sky.

    model: PREETHAM; SINGLE_SCATTERING or MULTIPLE_SCATTERING, which `atmosphere` is of; HOSEK_WILKIE, which is
    Preetham's, as bright.
    """

    model: str
    sun: tuple[float, float, float]  # unit, towards it
    turbidity: float = 2.2
    atmosphere: Atmosphere = Atmosphere()

    @cached_property
    def medium(self) -> Medium:
        """What scatters, of a sky that scatters."""
        make = scattering_often if self.model == "MULTIPLE_SCATTERING" else scattering_once
        return make(self.atmosphere)

    def radiance(self, direction: np.ndarray) -> np.ndarray:
        """Colours (N, 3) of the sky, without the sun, in unit directions (N, 3)."""
        sun = np.array(self.sun)
        if self.model not in ("SINGLE_SCATTERING", "MULTIPLE_SCATTERING"):
            return preetham(direction, sun, self.turbidity) * (HOSEK if self.model == "HOSEK_WILKIE" else 1.0)
        return _tables(self).look_up(direction)


@value_record
class Disc:
    """The sun's disc in a sky that is scattered."""

    sky: Sky
    angle: float  # radians: of its radius
    intensity: float = 1.0

    def radiance(self, direction: np.ndarray) -> np.ndarray:
        """Colours (N, 3) that it adds to the sky in unit directions (N, 3): 0 below the horizon."""
        found = np.zeros((len(direction), 3))
        chord = np.linalg.norm(direction - self.sky.sun, axis=1)
        apart = 2 * np.arcsin(np.clip(chord / 2, 0, 1))  # exact near 0, as the arc cosine is not
        inside = np.flatnonzero((apart < self.angle) & (direction[:, 2] >= 0))
        if len(inside):
            limb = 1 - LIMB * (1 - np.sqrt(np.maximum(1 - (apart[inside] / self.angle) ** 2, 0)))
            heights, colors = self._profile
            height = np.arcsin(np.clip(direction[inside, 2], -1, 1))
            color = np.stack([np.interp(height, heights, column) for column in colors.T], axis=1)
            found[inside] = limb[:, None] * color
        return found

    @cached_property
    def _profile(self) -> tuple[np.ndarray, np.ndarray]:
        """Elevations (K,), and the colours (K, 3) of the middle of a sun there."""
        middle = np.arcsin(np.clip(self.sky.sun[2], -1, 1))
        heights = np.linspace(max(middle - self.angle, 0.0), min(max(middle + self.angle, 1e-6), np.pi / 2), 17)
        direction = np.stack([np.cos(heights), 0 * heights, np.sin(heights)], axis=1)
        solid_angle = 2 * np.pi * (1 - np.cos(self.angle))
        medium = self.sky.medium
        return heights, sun_through(direction, medium) @ medium.rgb / solid_angle * self.intensity

    def directions(self, count: int = 1024) -> tuple[np.ndarray, float]:
        """Unit directions (count, 3) evenly over the disc, and the solid angle in steradian that each stands for."""
        number = np.arange(count) + 0.5
        cosine = 1 - (1 - np.cos(self.angle)) * number / count
        turn, sine = np.pi * (1 + np.sqrt(5)) * number, np.sqrt(np.maximum(1 - cosine**2, 0))
        sun = np.array(self.sky.sun)
        across = np.cross(sun, [0.0, 0, 1] if abs(sun[2]) < 0.9 else [1.0, 0, 0])
        across /= np.linalg.norm(across)
        around = np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * np.cross(sun, across)
        return cosine[:, None] * sun + sine[:, None] * around, 2 * np.pi * (1 - np.cos(self.angle)) / count


class Tables:
    """Colours of a sky that is scattered, by elevation and by the angle to the sun's azimuth."""

    def __init__(self, sky: Sky) -> None:
        self._sun = np.array(sky.sun)
        elevation = np.linspace(0, 1, ROWS) ** 2 * (np.pi / 2)  # closer near the horizon, and
        azimuth = np.arctan2(self._sun[1], self._sun[0]) + np.linspace(0, 1, COLUMNS) ** 2 * np.pi  # near the sun
        medium = sky.medium
        often = OftenScattered(medium) if sky.model == "MULTIPLE_SCATTERING" else None
        self._tables = []  # of the sky above the horizon and, where it does not just fade, below it
        for sign in (1, -1) if often is not None else (1,):
            v, u = (grid.ravel() for grid in np.meshgrid(sign * elevation, azimuth, indexing="ij"))
            direction = np.stack([np.cos(v) * np.cos(u), np.cos(v) * np.sin(u), np.sin(v)], axis=1)
            color = scattered(direction, self._sun, medium, often) @ medium.rgb
            self._tables.append(color.reshape(ROWS, COLUMNS, 3))

    def look_up(self, direction: np.ndarray) -> np.ndarray:
        """Colours (N, 3) in unit directions (N, 3)."""
        x, y, z = direction.T
        apart = np.abs(np.arctan2(y, x) - np.arctan2(self._sun[1], self._sun[0]))
        apart = np.minimum(apart, 2 * np.pi - apart)
        if len(self._tables) == 1:
            above = _bilinear(self._tables[0], np.maximum(z, 0), apart)
            return above * (np.maximum(1 + np.minimum(z, 0) / FADE, 0) ** 3)[:, None]
        return np.where((z >= 0)[:, None], *(_bilinear(table, np.abs(z), apart) for table in self._tables))


@lru_cache(8)
def _tables(sky: Sky) -> Tables:
    return Tables(sky)


def _bilinear(table: np.ndarray, z: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    row = np.sqrt(np.arcsin(np.clip(z, 0, 1)) / (np.pi / 2)) * (ROWS - 1)
    column = np.sqrt(azimuth / np.pi) * (COLUMNS - 1)
    i, j = (np.clip(at.astype(int), 0, count - 2) for at, count in ((row, ROWS), (column, COLUMNS)))
    a, b = (row - i)[:, None], (column - j)[:, None]
    low, high = (table[i + k, j] * (1 - b) + table[i + k, j + 1] * b for k in (0, 1))
    return low * (1 - a) + high * a
