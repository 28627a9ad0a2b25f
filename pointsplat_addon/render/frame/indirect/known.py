"""Receivers that have gathered light, and what others may interpolate of it (Ward et al. 1988), by planes through it: a
mean would carry what stands near one of them beyond it."""

from __future__ import annotations

import numpy as np

from .receivers import Receivers

FAR = 0.15  # harmonic mean distances of a receiver, as far as which it speaks for others
TURNED = 0.1  # 1 - cosine between normals, up to which it does
OFF = 0.1  # of these distances that others may lie off its plane
FEWEST = 1.5  # receivers, counted by their weights, from which is interpolated
UNLIKE = 0.05  # relative deviation of theirs from a plane, above which it is not
STEEP = 0.2  # and from their mean: shadows have edges
FLAT = 1e-3  # squared distance, over that of the widest square, below which they tell no slope
LEVER = 4.0  # variance of a plane there over that of one receiver, above which it would be drawn out too far
MOST_IN_TILE = 4  # receivers of one square that are looked at


class Known:
    """Receivers of several sizes of squares, with what they have gathered."""

    def __init__(self, position: np.ndarray, normal: np.ndarray) -> None:
        """position, normal: (N, 3) float32 each, of all groups of a picture, from the eye along the world's axes."""
        self._position, self._normal = position, normal
        self._sizes: list[tuple[Receivers, int, np.ndarray, np.ndarray]] = []
        self._widest = 1.0

    def add(self, receivers: Receivers, side: int, found: np.ndarray, valid: np.ndarray) -> None:
        """`found` (R, 8) of receivers in squares of `side` pixels, as far as it is `valid`, (R,) bool."""
        self._sizes.append((receivers, side, found, valid))
        self._widest = max(self._widest, float(side))

    def interpolated(self, rows: np.ndarray, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, 8) at the groups `rows` (n,), at `pixels` (n, 2), and whether what is known tells it, (n,) bool."""
        count = len(rows)
        moments, sums = np.zeros((count, 3, 3)), np.zeros((count, 3, 8))
        squares, bright_squares = np.zeros(count), np.zeros(count)
        place, normal = self._position[rows], self._normal[rows]
        for receivers, side, found, valid in self._sizes:
            high, wide = receivers.tiles.shape[:2]
            tile = np.floor(pixels / side).astype(np.int64)
            light = found[:, :3].mean(axis=1)
            for step in range(9):
                x, y = tile[:, 0] + step % 3 - 1, tile[:, 1] + step // 3 - 1
                within = (x >= 0) & (x < wide) & (y >= 0) & (y < high)
                entry = receivers.tiles[np.where(within, y, 0), np.where(within, x, 0)].astype(np.int64)
                there = np.where(within, np.minimum(entry[:, 1], MOST_IN_TILE), 0)
                for slot in range(int(there.max(initial=0))):
                    some = np.flatnonzero(slot < there)
                    other = entry[some, 0] + slot
                    some, other = some[valid[other]], other[valid[other]]
                    weight = self._weight(place[some], normal[some], receivers.rows[other], found[other, 3])
                    away = (receivers.pixels[other] - pixels[some]) / (1.5 * side)
                    weight *= np.maximum(1 - np.abs(away), 0).prod(axis=1)
                    used = weight > 0
                    some, other, weight, away = some[used], other[used], weight[used], away[used]
                    basis = np.column_stack([np.ones(len(some)), away * side / self._widest])
                    weighted = weight[:, None] * basis
                    moments[some] += weighted[:, :, None] * basis[:, None]
                    sums[some] += weighted[:, :, None] * found[other, None]
                    squares[some] += weight * weight
                    bright_squares[some] += weight * light[other] ** 2
        return _fitted(moments, sums, squares, bright_squares)

    def _weight(self, place: np.ndarray, normal: np.ndarray, other: np.ndarray, nearness: np.ndarray) -> np.ndarray:
        """(n,): how far the groups `other` speak for those at places with normals (n, 3)."""
        offset, up = place - self._position[other], self._normal[other]
        far = np.sqrt((offset**2).sum(axis=1)) * nearness / FAR
        off = np.abs((offset * (up + normal)).sum(axis=1)) * nearness / (2 * OFF * FAR)
        turned = (1 - (up * normal).sum(axis=1)) / TURNED
        return np.maximum(1 - np.maximum(np.maximum(far, off), turned), 0)


def _fitted(
    moments: np.ndarray, sums: np.ndarray, squares: np.ndarray, bright_squares: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(n, 8) by planes through what receivers have gathered, and where these tell it, (n,) bool.

    Weighted sums over receivers: `moments` (n, 3, 3) of products of (1, x, y), `sums` (n, 3, 8) of these times what
    they have; of squared weights, and of squared light.
    """
    total = moments[:, 0, 0]
    some = np.flatnonzero((total > 0) & (total * total >= FEWEST * squares))
    found, known = np.zeros((len(total), 8), np.float32), np.zeros(len(total), bool)
    moments, sums = moments[some] / total[some, None, None], sums[some] / total[some, None, None]
    inverse = np.linalg.inv(moments + np.diag([0.0, FLAT, FLAT]))
    planes = inverse @ sums
    light, given = planes[:, :, :3].mean(axis=2), sums[:, :, :3].mean(axis=2)
    square, mean = bright_squares[some] / total[some], given[:, 0]
    of_planes = (light * (moments @ light[:, :, None])[:, :, 0]).sum(axis=1)
    off = square + of_planes - 2 * (light * given).sum(axis=1)
    even = (off <= (UNLIKE * mean) ** 2) & (square - mean * mean <= (STEEP * mean) ** 2)
    found[some] = np.maximum(planes[:, 0], 0)
    known[some] = even & (inverse[:, 0, 0] <= LEVER)
    return found, known
