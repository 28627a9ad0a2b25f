"""What a laser scanner would bring home from 100 m of hills with boxes on them: points, NumPy only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

WIDE = 100.0  # metres that the landscape measures, in x and in y, about the origin
BOXES = 60
GRASS, EARTH = np.array([0.10, 0.22, 0.05]), np.array([0.30, 0.20, 0.11])


@dataclass(frozen=True)
class Boxes:
    """Middles (B, 2), half widths (B, 2), heights above the ground in the middle (B,), colours (B, 3)."""

    middle: np.ndarray
    half: np.ndarray
    height: np.ndarray
    color: np.ndarray


def ground(x: np.ndarray | float, y: np.ndarray | float) -> np.ndarray:
    """Height of the hills in metres."""
    return 3.0 * np.sin(0.11 * x + 0.5) * np.cos(0.09 * y) + 1.2 * np.sin(0.23 * x + 0.17 * y)


def boxes(rng: np.random.Generator) -> Boxes:
    half = rng.uniform(0.8, 3.5, (BOXES, 2))
    middle = rng.uniform(-WIDE / 2 + 5, WIDE / 2 - 5, (BOXES, 2))
    return Boxes(middle, half, rng.uniform(2.0, 9.0, BOXES), rng.uniform(0.15, 0.8, (BOXES, 3)))


def rectangle(wide: float, high: float, spacing: float, rng: np.random.Generator) -> np.ndarray:
    """(N, 2) one point at random within the middle half of each cell of a grid over [0, wide] x [0, high]."""
    across, up = max(round(wide / spacing), 1), max(round(high / spacing), 1)
    cell = np.stack(np.meshgrid(np.arange(across), np.arange(up)), axis=-1).reshape(-1, 2).astype(np.float32)
    cell += 0.25 + 0.5 * rng.random(cell.shape, dtype=np.float32)
    return cell * np.array([wide / across, high / up], np.float32)


def walls_and_roof(which: Boxes, i: int, spacing: float, rng: np.random.Generator) -> np.ndarray:
    """(N, 3) points on the five sides of a box that stand out of the ground."""
    (x, y), (a, b) = which.middle[i], which.half[i]
    top = float(ground(float(x), float(y))) + which.height[i]
    roof = rectangle(2 * a, 2 * b, spacing, rng) - which.half[i]
    sides = [np.column_stack([roof, np.full(len(roof), top)])]
    for wide, distance, along in ((a, b, 0), (b, a, 1)):
        for sign in (-1, 1):
            wall = rectangle(2 * wide, which.height[i] + 3.0, spacing, rng)
            side = np.empty((len(wall), 3))
            side[:, along], side[:, 1 - along], side[:, 2] = wall[:, 0] - wide, sign * distance, top - wall[:, 1]
            sides.append(side)
    points = np.concatenate(sides) + np.array([x, y, 0])
    return points[points[:, 2] > ground(points[:, 0], points[:, 1])]


def landscape(count: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Positions (count, 3) float32 in random order, colours (count, 3) float32, and the points' spacing in metres."""
    rng = np.random.default_rng(0)
    which = boxes(rng)
    area = WIDE**2 + float((8 * which.half.prod(axis=1) / 2 + 4 * which.half.sum(axis=1) * which.height).sum())
    spacing = (area / (1.02 * count)) ** 0.5  # a few too many: those are left out again
    points, colors = [], []
    while sum(map(len, points)) < count:
        floor = rectangle(WIDE, WIDE, spacing, rng) - np.float32(WIDE / 2)
        inside = np.zeros(len(floor), bool)
        for middle, half in zip(which.middle, which.half, strict=True):
            inside |= (np.abs(floor - np.float32(middle)) < np.float32(half)).all(axis=1)
        floor = floor[~inside]
        height = ground(floor[:, 0], floor[:, 1])
        bare = np.clip(0.5 + 0.15 * height + 0.2 * np.sin(0.7 * floor[:, 0]) * np.sin(0.9 * floor[:, 1]), 0, 1)
        points = [np.column_stack([floor, height])]
        colors = [GRASS + bare[:, None] * (EARTH - GRASS)]
        for i in range(BOXES):
            points.append(walls_and_roof(which, i, spacing, rng))
            colors.append(np.broadcast_to(which.color[i], points[-1].shape))
        spacing *= 0.98
    position, color = np.concatenate(points).astype(np.float32), np.concatenate(colors).astype(np.float32)
    order = rng.permutation(len(position))[:count]  # so that nothing profits from the order of a grid
    color = color[order] * rng.uniform(0.8, 1.2, (count, 1)).astype(np.float32)
    return position[order], np.clip(color, 0, 1), spacing / 0.98
