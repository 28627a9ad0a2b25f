"""Outlines of flat parts in polar coordinates about a hub, and their division into lobes."""

from __future__ import annotations

import numpy as np

from .flat import FlatParts

DIRECTIONS = 128  # about a hub, in which lobes are looked for
LEVELS = np.linspace(0.3, 0.8, 11)  # of the farthest tip: distances at which lobes may stand apart


def direction_bin(position: np.ndarray) -> np.ndarray:
    """(...) int64: the direction from the hub, of DIRECTIONS, that positions (..., 2) lie in."""
    turn = np.arctan2(position[..., 1], position[..., 0]) * DIRECTIONS / (2 * np.pi)
    return np.floor(turn).astype(np.int64) % DIRECTIONS


def find_hubs(flat: FlatParts) -> np.ndarray:
    """(C, 2) where each part has the vertex at which most of its triangles meet, along its two axes."""
    _, index, many = np.unique(flat.vertex, return_index=True, return_counts=True)
    part = flat.own[index // 3]
    order = np.lexsort((-many, part))
    first = np.concatenate([[True], np.diff(part[order]) > 0])
    return np.stack([flat.height.ravel(), flat.sideways.ravel()], axis=1)[index[order[first]]]


def polar_outlines(flat: FlatParts, hub: np.ndarray) -> np.ndarray:
    """(C, DIRECTIONS) how far the parts reach from their hubs (C, 2) that way; 0 where nothing is."""
    found = np.zeros((DIRECTIONS, len(hub)))
    position = np.stack([flat.height, flat.sideways], axis=2) - hub[flat.own][:, None]
    following = np.roll(position, -1, axis=1)
    for k, angle in enumerate((np.arange(DIRECTIONS) + 0.5) * 2 * np.pi / DIRECTIONS):
        c, s = np.cos(angle), np.sin(angle)
        a, b = (c * p[..., 1] - s * p[..., 0] for p in (position, following))
        crosses = (a < 0) != (b < 0)
        t = np.where(crosses, a / np.where(crosses, a - b, 1), 0)
        reached = c * position[..., 0] + s * position[..., 1]
        reached += t * (c * following[..., 0] + s * following[..., 1] - reached)
        np.maximum.at(found[k], flat.own, (reached * crosses).max(axis=1))
    return found.T.copy()


def split_into_lobes(outline: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The lobes of outlines (C, DIRECTIONS), at the distance at which most stand apart: the lobe of each direction (C,
    DIRECTIONS), and how many there are (C,)."""
    levels = LEVELS[:, None, None] * outline.max(axis=1)[:, None]
    above = outline > levels
    begins = above & ~np.roll(above, 1, axis=2)
    best = begins.sum(axis=2).argmax(axis=0)
    row = np.arange(len(outline))
    above, begins = above[best, row], begins[best, row]
    number = begins.sum(axis=1)
    run = (np.cumsum(begins, axis=1) - 1) % np.maximum(number, 1)[:, None]
    # Directions between two lobes belong to the nearer one
    index = np.arange(3 * DIRECTIONS)
    there = np.tile(above, 3)
    before = np.maximum.accumulate(np.where(there, index, -DIRECTIONS), axis=1)
    after = np.minimum.accumulate(np.where(there, index, 4 * DIRECTIONS)[:, ::-1], axis=1)[:, ::-1]
    middle = slice(DIRECTIONS, 2 * DIRECTIONS)
    nearer = np.where(index - before <= after - index, before, after)[:, middle] % DIRECTIONS
    return np.take_along_axis(run, nearer, axis=1), number
