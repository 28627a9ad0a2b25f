"""Receivers that have gathered light, and what others may interpolate of it (Ward et al. 1988), by planes through it: a
mean would carry what stands near one of them beyond it."""

from __future__ import annotations

import numpy as np

from ....core.numeric.segments import ranges
from ....core.numeric.vectors import dot
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
TOGETHER = 2048  # groups that are looked at together: pairs of these and of receivers stay in the processor's cache
PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # of (1, x, y)


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
        found, known = np.zeros((len(rows), 8), np.float32), np.zeros(len(rows), bool)
        for begin in range(0, len(rows), TOGETHER):
            some = slice(begin, begin + TOGETHER)
            found[some], known[some] = self._interpolated(rows[some], pixels[some])
        return found, known

    def _interpolated(self, rows: np.ndarray, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `interpolated`."""
        count = len(rows)
        totals = np.zeros((32, count))  # of products of (1, x, y) with what receivers have, and with (1, x, y); others
        place, normal = (np.ascontiguousarray(of[rows].T) for of in (self._position, self._normal))
        for receivers, side, found, valid in self._sizes:
            own, other = _around(receivers, valid, np.floor(pixels / side).astype(np.int64))
            away = (receivers.pixels.T[:, other] - pixels.T[:, own]) / np.float32(1.5 * side)
            near = np.maximum(1 - np.abs(away[0]), 0) * np.maximum(1 - np.abs(away[1]), 0)
            own, other, away, near = _those(near > 0, own, other, away, near)
            weight = near * self._weight(place[:, own], normal[:, own], receivers.rows[other], found[other, 3])
            own, other, away, weight = _those(weight > 0, own, other, away, weight)
            if not len(own):
                continue
            basis = np.ones((3, len(own)))
            basis[1:] = away * (side / self._widest)
            first = np.flatnonzero(np.append(True, own[1:] != own[:-1]))
            light = np.ascontiguousarray(found.T).take(other, axis=1)
            given = np.empty((32, len(own)))
            for k, one in enumerate(weight * basis):
                given[8 * k : 8 * k + 8] = one * light
            for k, (i, j) in enumerate(PAIRS, 24):
                given[k] = weight * basis[i] * basis[j]
            given[30] = weight * weight
            given[31] = weight * light[:3].mean(axis=0) ** 2
            totals[:, own[first]] += np.add.reduceat(given, first, axis=1)
        moments = np.empty((count, 3, 3))
        for k, (i, j) in enumerate(PAIRS, 24):
            moments[:, i, j] = moments[:, j, i] = totals[k]
        sums = np.moveaxis(totals[:24].reshape(3, 8, count), 2, 0)
        return _fitted(moments, sums, totals[30], totals[31])

    def _weight(self, place: np.ndarray, normal: np.ndarray, other: np.ndarray, nearness: np.ndarray) -> np.ndarray:
        """(n,): how far the groups `other` speak for those at places with normals (3, n)."""
        offset, up = place - self._position[other].T, self._normal[other].T
        far = np.sqrt(dot(offset, offset)) * nearness / FAR
        off = np.abs(dot(offset, up + normal)) * nearness / (2 * OFF * FAR)
        turned = (1 - dot(up, normal)) / TURNED
        return np.maximum(1 - np.maximum(np.maximum(far, off), turned), 0)


def _around(receivers: Receivers, valid: np.ndarray, tile: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs (P,), by rising rows of tiles (n, 2), of these and of valid receivers in the 9 tiles around them."""
    high, wide = receivers.tiles.shape[:2]
    step = np.arange(9)
    x, y = tile[:, :1] + step % 3 - 1, tile[:, 1:] + step // 3 - 1
    within = (x >= 0) & (x < wide) & (y >= 0) & (y < high)
    entry = receivers.tiles.reshape(-1, 2).astype(np.int64)[np.where(within, y * wide + x, 0)]
    there = np.where(within, np.minimum(entry[..., 1], MOST_IN_TILE), 0).ravel()
    other = ranges(entry[..., 0].ravel(), there)
    own = np.repeat(np.arange(len(tile)), there.reshape(-1, 9).sum(axis=1))
    own, other = _those(valid[other], own, other)
    return own, other


def _those(which: np.ndarray, *of: np.ndarray) -> list[np.ndarray]:
    """Items of arrays (..., n), those of `which` (n,) bool."""
    rows = np.flatnonzero(which)
    return [one.take(rows, axis=-1) for one in of]


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
