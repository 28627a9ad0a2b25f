"""Surfels: small flat pieces of all surfaces of a scene, of which the light tree is built."""

from __future__ import annotations

import numpy as np

from ..numeric.record import record


@record
class Surfels:
    """N pieces of surface in world space, relative to `origin`."""

    origin: np.ndarray  # (3,) float64
    position: np.ndarray  # (N, 3) float32
    normal: np.ndarray  # (N, 3) float32, unit; (0, 0, 0): turned to every side, as a ball is
    area: np.ndarray  # (N,) float32: of one side; of a ball its whole surface
    closed: np.ndarray  # (N,) bool: of a closed surface, whose inside nobody sees
    scattered: np.ndarray  # (N,) bool: leaves and hairs, which do not tile a surface
    albedo: np.ndarray  # (N, 3) float32: share of the light that falls on it which it scatters
    emission: np.ndarray  # (N, 3) float32: radiance

    def __len__(self) -> int:
        return len(self.area)

    def take(self, rows: np.ndarray) -> Surfels:
        """Returns the surfels `rows`, in their order."""
        arrays = (self.position, self.normal, self.area, self.closed, self.scattered, self.albedo, self.emission)
        return Surfels(self.origin, *(array[rows] for array in arrays))
