"""Perlin's gradient noise in one to four dimensions (Perlin 2002), with lattice gradients chosen by Jenkins' hash."""

from __future__ import annotations

import numpy as np

from .hashes import lookup3

SCALE = (0.2500, 0.6616, 0.9820, 0.8344)  # by dimensions: makes values fill [-1, 1]
PERIOD = 100_000.0  # of the noise along each axis, beyond which float32 has too few fractions
FAR = 1_000_000.0  # from here on points lie on lattice points, where noise is zero, but for a shift


def _gradients(count: int, dimensions: int) -> np.ndarray:
    """The gradients (dimensions, count) float32 among which the last bits of a hash choose."""
    h = np.arange(count)
    if dimensions == 1:
        return (((h & 7) + 1) * np.where(h < 8, 1, -1)).astype(np.float32)[None]
    # The axes of the components that are not 0, and their lengths; bits of the hash are their signs
    components = {
        2: [(np.where(h < 4, 0, 1), 1), (np.where(h < 4, 1, 0), 2)],
        3: [(np.where(h < 8, 0, 1), 1), (np.where(h < 4, 1, np.where((h == 12) | (h == 14), 0, 2)), 1)],
        4: [(np.where(h < 24, 0, 1), 1), (np.where(h < 16, 1, 2), 1), (np.where(h < 8, 2, 3), 1)],
    }[dimensions]
    table = np.zeros((dimensions, count), np.float32)
    for bit, (axis, length) in enumerate(components):
        table[axis, h] = length * np.where(h >> bit & 1, -1, 1)
    return table


GRADIENTS = {k: _gradients(count, k) for k, count in ((1, 16), (2, 8), (3, 16), (4, 32))}  # by dimensions


def signed_noise(p: np.ndarray) -> np.ndarray:
    """Perlin noise (n,) float32 in about [-1, 1] at points (1..4, n) float32; 0 at lattice points and where p is not
    finite."""
    dimensions = len(p)
    size = np.abs(p).max(initial=0)
    if not size < PERIOD:
        p = np.fmod(p, np.float32(PERIOD)) + np.where(np.abs(p) >= FAR, np.float32(0.5), np.float32(0))
        p = np.where(np.isfinite(p).all(axis=0), p, np.float32(0))
    cell = np.floor(p)
    t = p - cell
    near = np.empty((dimensions, 2, p.shape[1]), np.uint32)
    near[:, 0] = cell.astype(np.int32).view(np.uint32)
    np.add(near[:, 0], np.uint32(1), out=near[:, 1])
    # Corners lie along the leading axes, those of x along the last of these: (2,) * dimensions + (n,)
    shapes = [(*(1,) * (dimensions - 1 - k), 2, *(1,) * k, p.shape[1]) for k in range(dimensions)]
    chosen = lookup3([words.reshape(shape) for words, shape in zip(near, shapes, strict=True)])
    table = GRADIENTS[dimensions]
    chosen &= np.uint32(table.shape[1] - 1)
    index = chosen.astype(np.intp)
    value = None
    for k in range(dimensions):
        offset = np.stack([t[k], t[k] - np.float32(1)]).reshape(shapes[k])
        part = table[k].take(index)
        part *= offset
        value = part if value is None else np.add(value, part, out=value)
    assert value is not None
    fade = t * t * t * (t * (t * np.float32(6) - np.float32(15)) + np.float32(10))
    for k in range(dimensions):  # along x first: the last of the leading axes
        low, high = value[..., 0, :], value[..., 1, :]
        value = low * (1 - fade[k]) + high * fade[k]
    value *= np.float32(SCALE[dimensions - 1])
    return value
