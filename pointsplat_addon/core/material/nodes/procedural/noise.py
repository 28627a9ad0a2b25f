"""The noise texture: fractals of Perlin noise; and white noise."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ....numeric.record import record
from ...expression import Expression, SampleInputs
from .blocks import by_columns
from .fractals import FRACTALS, MOST_DETAIL, Octaves
from .hashes import hash_floats
from .perlin import signed_noise


def texture_points(vector: np.ndarray, w: np.ndarray, dimensions: int) -> np.ndarray:
    """Points (dimensions, n) of a texture: W alone, some of the vector (3, n), or the vector and W, (1, n)."""
    if dimensions == 1:
        return w
    if dimensions < 4:
        return vector[:dimensions]
    points = np.empty((4, max(vector.shape[1], w.shape[1])), np.float32)
    points[:3], points[3] = vector, w
    return points


@lru_cache(64)
def _shift(seed: float, dimensions: int) -> np.ndarray:
    """(dimensions, 1) float32 in [100, 200]: where noise of another seed is read."""
    values = [seed] if dimensions == 1 else range(dimensions)
    hashes = [hash_floats(v) if dimensions == 1 else hash_floats(seed, v) for v in values]
    # Rounded once, as by fused multiplication and addition
    return np.array([100 + 100 * float(h.item()) for h in map(np.asarray, hashes)], np.float32).reshape(-1, 1)


@record
class Noise(Expression):
    """Colour of the noise texture, (N, 3), whose red is the value, or (N, 1) the value alone.

    `kind` is one of FRACTALS. Vector and W are scaled, then distorted by noise of other seeds.
    """

    vector: Expression
    w: Expression
    scale: Expression
    detail: Expression
    roughness: Expression
    lacunarity: Expression
    offset: Expression
    gain: Expression
    distortion: Expression
    dimensions: int = 3
    kind: str = "FBM"
    normalize: bool = True
    colored: bool = True  # whether green and blue are read

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        return by_columns(self._columns, 3 if self.colored else 1, *values)

    def _columns(
        self, vector: np.ndarray, w: np.ndarray, scale: np.ndarray, *rest: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        detail, roughness, lacunarity, offset, gain, distortion = (a[0] for a in rest)
        d = self.dimensions
        p = texture_points(vector, w, d) * scale
        octaves = Octaves(
            np.clip(detail, 0, np.float32(MOST_DETAIL)),
            np.maximum(roughness, 0),
            lacunarity,
            offset,
            gain,
            self.normalize,
        )
        if distortion.any():
            p = p + np.stack([signed_noise(p + _shift(k, d)) for k in range(d)]) * distortion
        fractal = FRACTALS[self.kind]
        value = fractal(p, octaves)
        if not self.colored:
            return (value,)
        return value, *(fractal(p + _shift(d + k, d), octaves) for k in range(2))


@record
class WhiteNoise(Expression):
    """Colour (N, 3) that a hash of the coordinates' bits gives; its red is the value."""

    vector: Expression
    w: Expression
    dimensions: int = 3

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        return by_columns(self._columns, 3, *values)

    def _columns(self, vector: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, ...]:
        p = tuple(texture_points(vector, w, self.dimensions))
        if self.dimensions == 4:
            x, y, z, w = p
            return hash_floats(*p), hash_floats(z, x, w, y), hash_floats(w, z, y, x)
        return hash_floats(*p), hash_floats(*p, 1.0), hash_floats(*p, 2.0)
