"""Sums and products of octaves of noise: fractal Brownian motion and Musgrave's multifractals.

Ebert, Musgrave et al., Texturing and Modeling: A Procedural Approach, chapter 16. A fraction of an octave is one that
is blended in. Points are (1..4, n) float32, parameters (n,) or (1,) float32: `detail` is the number of octaves beyond
the first, `roughness` the ratio of the amplitudes of one octave and the one before, `lacunarity` that of frequencies.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from ....numeric.record import record
from .perlin import signed_noise

MOST_DETAIL = 15.0
LEAST_WEIGHT = 0.001  # of an octave of the hybrid multifractal, below which no other follows


@record
class Octaves:
    """Parameters of a fractal, (n,) or (1,) float32 each."""

    detail: np.ndarray
    roughness: np.ndarray
    lacunarity: np.ndarray
    offset: np.ndarray
    gain: np.ndarray
    normalize: bool = True  # of FBM alone: values in [0, 1]

    def shares(self) -> Iterator[np.ndarray]:
        """Yields how much of each octave there is: 1 for whole ones, then a fraction; all zero ends it."""
        octave = 0
        while octave == 0 or (share := np.clip(self.detail - (octave - 1), 0, 1)).any():
            yield share if octave else np.ones(1, np.float32)
            octave += 1


def _fbm(p: np.ndarray, octaves: Octaves) -> np.ndarray:
    """Fractal Brownian motion: a sum of octaves; with `normalize` divided by the largest sum and mapped to [0, 1]."""
    frequency = amplitude = np.ones(1, np.float32)
    total = largest = np.zeros(1, np.float32)
    value = total
    for share in octaves.shares():
        total = total + signed_noise(frequency * p) * amplitude
        largest = largest + amplitude
        value = _blend(value, _to_unit(total, largest) if octaves.normalize else total, share)
        amplitude = amplitude * octaves.roughness
        frequency = frequency * octaves.lacunarity
    return value


def _to_unit(total: np.ndarray, largest: np.ndarray) -> np.ndarray:
    half = np.float32(0.5)
    return half * total / largest + half


def _blend(a: np.ndarray, b: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Interpolates from a (share = 0) to b, which a share of 1 leaves as it is."""
    if len(share) == 1:
        return b if share[0] == 1 else a + share * (b - a)
    return a + share * (b - a)


def _multifractal(p: np.ndarray, octaves: Octaves) -> np.ndarray:
    """A product of octaves."""
    value = power = np.ones(1, np.float32)
    for share in octaves.shares():
        value = value * (share * power * signed_noise(p) + 1)
        power = power * octaves.roughness
        p = p * octaves.lacunarity
    return value


def _hetero_terrain(p: np.ndarray, octaves: Octaves) -> np.ndarray:
    """Octaves in proportion to the height that there is already."""
    value, power = None, octaves.roughness
    for share in octaves.shares():
        raised = signed_noise(p) + octaves.offset
        if value is None:
            value = raised
        else:
            value = value + share * (raised * power * value)
            power = power * octaves.roughness
        p = p * octaves.lacunarity
    assert value is not None
    return value


def _hybrid_multifractal(p: np.ndarray, octaves: Octaves) -> np.ndarray:
    """Octaves weighted by those before, until the weight is next to nothing."""
    power = weight = np.ones(1, np.float32)
    value = np.zeros(1, np.float32)
    for share in octaves.shares():
        share = share * (weight > LEAST_WEIGHT)
        weight = np.minimum(weight, 1)
        signal = (signed_noise(p) + octaves.offset) * power
        value = value + share * weight * signal
        weight = np.where(share > 0, weight * (octaves.gain * signal), 0)
        power = power * octaves.roughness
        p = p * octaves.lacunarity
    return value


def _ridged_multifractal(p: np.ndarray, octaves: Octaves) -> np.ndarray:
    """Octaves with ridges where noise is zero, weighted by those before. Fractions of octaves are left out."""
    value, power, signal = np.zeros(1, np.float32), np.ones(1, np.float32), None
    for share in octaves.shares():
        weight = 1 if signal is None else np.clip(signal * octaves.gain, 0, 1)
        signal = np.square(octaves.offset - np.abs(signed_noise(p))) * weight
        value = value + np.floor(share) * (signal * power)
        power = power * octaves.roughness
        p = p * octaves.lacunarity
    return value


FRACTALS: dict[str, Callable[[np.ndarray, Octaves], np.ndarray]] = {
    "FBM": _fbm,
    "MULTIFRACTAL": _multifractal,
    "HYBRID_MULTIFRACTAL": _hybrid_multifractal,
    "RIDGED_MULTIFRACTAL": _ridged_multifractal,
    "HETERO_TERRAIN": _hetero_terrain,
}
