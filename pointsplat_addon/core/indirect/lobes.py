"""Directions in which rough mirrors reflect: GGX lobes, of which neighbouring pixels take different parts."""

from __future__ import annotations

import numpy as np

from ..numeric.vectors import unit_rows

SIDE = 8  # pixels: squares of so many take all parts of a lobe


def parts_of_lobes(column: np.ndarray, row: np.ndarray) -> np.ndarray:
    """(N, 2) float64 in [0, 1): which part of its lobe the pixel in each column and row (N,) takes.

    Numbered in Morton order, pixels take points of a (0, 2)-sequence (Sobol 1967), so that aligned squares of 2, 4
    and 8 pixels have one in each of 4, 16 and 64 parts of equal area.
    """
    number = np.zeros(len(column), np.uint32)
    for bit in range(SIDE.bit_length() - 1):
        number |= ((column.astype(np.uint32) >> bit) & 1) << (2 * bit)
        number |= ((row.astype(np.uint32) >> bit) & 1) << (2 * bit + 1)
    first, second, turn = np.zeros_like(number), np.zeros_like(number), np.uint32(1 << 31)
    for bit in range(2 * (SIDE.bit_length() - 1)):
        on = ((number >> bit) & 1).astype(bool)
        first ^= np.where(on, np.uint32(1 << (31 - bit)), np.uint32(0))
        second ^= np.where(on, turn, np.uint32(0))
        turn ^= turn >> np.uint32(1)
    return (np.stack([first, second], axis=1) / 2.0**32 + 0.5 / SIDE**2) % 1.0


def half_vectors(normal: np.ndarray, to_eye: np.ndarray, alpha: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """(N, 3): half vectors of GGX lobes that are seen from `to_eye`, one for each of parts (N, 2).

    normal, to_eye: (N, 3), unit. alpha: (N,). Heitz 2018, sampling the distribution of visible normals.
    """
    helper = np.where(np.abs(normal[:, 2:]) < 0.7, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    x = unit_rows(np.cross(helper, normal))
    y = np.cross(normal, x)
    local = np.stack([(to_eye * axis).sum(axis=1) for axis in (x, y, normal)], axis=1)
    a = alpha[:, None]
    stretched = unit_rows(np.column_stack([a * local[:, :2], np.maximum(local[:, 2:], 1e-3)]))
    flat = np.hypot(stretched[:, 0], stretched[:, 1])
    with np.errstate(all="ignore"):
        t1 = np.stack([-stretched[:, 1] / flat, stretched[:, 0] / flat, np.zeros_like(flat)], axis=1)
    t1[flat < 1e-7] = (1, 0, 0)
    t2 = np.cross(stretched, t1)
    radius, turn = np.sqrt(parts[:, 0]), 2 * np.pi * parts[:, 1]
    p1, p2 = radius * np.cos(turn), radius * np.sin(turn)
    share = 0.5 * (1 + stretched[:, 2])
    p2 = (1 - share) * np.sqrt(np.maximum(1 - p1 * p1, 0)) + share * p2
    up = np.sqrt(np.maximum(1 - p1 * p1 - p2 * p2, 0))
    h = p1[:, None] * t1 + p2[:, None] * t2 + up[:, None] * stretched
    h = unit_rows(np.column_stack([a * h[:, :2], np.maximum(h[:, 2:], 1e-6)]))
    return h[:, :1] * x + h[:, 1:2] * y + h[:, 2:] * normal
