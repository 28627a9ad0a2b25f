"""A real tile of a survey from the air, repeated on a grid: points as an import makes them, NumPy and laspy only."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

FILE = "../points/lasR_bcts/bcts_2.laz"  # 823,945 points of woodland, of the folder of data


def survey(path: Path, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions (count, 3) float32 in metres about the middle of the ground, and colours (count, 3) float32 by
    intensity.

    Every other copy is mirrored, so that neighbours fit.
    """
    import laspy

    tile = laspy.read(path)
    low, high = np.array(tile.header.mins), np.array(tile.header.maxs)
    place = (tile.xyz - low).astype(np.float32)
    size = (high - low).astype(np.float32)
    level = np.asarray(tile.intensity, np.float32)
    level = np.clip(level / np.quantile(level, 0.98), 0, 1)
    green = np.array([0.08, 0.1, 0.04], np.float32), np.array([0.5, 0.55, 0.35], np.float32)
    color = green[0] + level[:, None] * (green[1] - green[0])
    copies = math.ceil(count / len(place))
    side = math.ceil(math.sqrt(copies))
    parts = []
    for number in range(copies):
        at = np.array([number % side, number // side])
        part = place.copy()
        for axis in np.flatnonzero(at % 2):
            part[:, axis] = size[axis] - part[:, axis]
        part[:, :2] += (at - side / 2) * size[:2]
        parts.append(part)
    return np.concatenate(parts)[:count], np.tile(color, (copies, 1))[:count]
