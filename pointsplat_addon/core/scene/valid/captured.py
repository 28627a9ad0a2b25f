"""Removes captured splats that cannot be drawn (the rules stand in validation.py)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...numeric.vectors import each_block
from ..captured import CapturedSplats
from ..cloud import FARTHEST

ARRAYS = ("position", "scale", "rotation", "base", "opacity", "sh")
LENGTHS = ("position", "scale")
SHORTEST = 1e-6  # a quaternion: what is shorter names no rotation
UNIT = 1e-3  # how far from 1 the square of a quaternion may be; coordinates of files are rounded


def valid_captured(splats: CapturedSplats) -> tuple[CapturedSplats, int]:
    """Removes splats with a NaN or an infinity in any attribute, a length beyond FARTHEST, or a rotation of 0, and
    returns how many.

    Opacities are clipped to 0 to 1, quaternions brought to unit length, and scales made positive. Splats without
    anything to change are returned themselves. Where the origin is no position, all go.
    """
    good = np.ones(len(splats), bool)
    if not (np.abs(splats.origin) <= FARTHEST).all():
        good[:] = False
        splats = replace(splats, origin=np.zeros(3))
    for name in ARRAYS:
        array = getattr(splats, name)
        if array is None or array.size == 0:
            continue
        most = FARTHEST if name in LENGTHS else np.finfo(np.float32).max
        # Row by row only where there is something to find. NaN compares as false.
        if not (array.min() >= -most and array.max() <= most):
            good &= (np.abs(array) <= most).all(axis=tuple(range(1, array.ndim)))
    squared = _squared_lengths(splats.rotation)
    good &= squared > SHORTEST**2
    if dropped := len(splats) - int(np.count_nonzero(good)):
        arrays = {name: array[good] for name in ARRAYS if (array := getattr(splats, name)) is not None}
        splats, squared = replace(splats, **arrays), squared[good]
    changed: dict[str, np.ndarray] = {}
    if len(splats):
        if np.abs(squared - 1).max() > UNIT:
            changed["rotation"] = (splats.rotation / np.sqrt(squared)[:, None]).astype(np.float32)
        if splats.opacity.min() < 0 or splats.opacity.max() > 1:
            changed["opacity"] = np.clip(splats.opacity, 0, 1)
        if splats.scale.min() < 0:
            changed["scale"] = np.abs(splats.scale)
    return (replace(splats, **changed) if changed else splats), dropped


def _squared_lengths(rotation: np.ndarray) -> np.ndarray:
    """(N,) float64: the squares of quaternions' lengths."""
    found = np.empty(len(rotation))

    def measure(block: slice) -> None:
        with np.errstate(invalid="ignore"):
            w, x, y, z = rotation[block].T.astype(np.float64)
            found[block] = w * w + x * x + y * y + z * z

    each_block(len(rotation), measure)
    return found
