"""Surfels of tests: from arrays, and of a ball."""

from __future__ import annotations

import numpy as np

from pointsplat_addon.core.indirect.surfels import Surfels

UP = np.array([0.0, 0.0, 1.0])


def surfels_of(
    position: np.ndarray, normal: np.ndarray, area: np.ndarray, scattered: bool = False, closed: bool = True
) -> Surfels:
    count, f = len(position), np.float32
    none = np.zeros((count, 3), f)
    return Surfels(
        np.zeros(3), position.astype(f), normal.astype(f), np.broadcast_to(area, count).astype(f),
        np.full(count, closed), np.full(count, scattered), none, none, none, np.zeros(count, bool),
    )  # fmt: skip


def ball(count: int, radius: float, height: float) -> Surfels:
    z = 1 - 2 * (np.arange(count) + 0.5) / count
    turn = np.pi * (1 + 5**0.5) * (np.arange(count) + 0.5)
    normal = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1)
    return surfels_of(radius * normal + height * UP, normal, np.array(4 * np.pi * radius**2 / count))
