"""Receivers that have gathered light, and what others may interpolate of it (Ward et al. 1988), by planes through it: a
mean would carry what stands near one of them beyond it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ....core.numeric.record import record
from ....core.numeric.segments import owners, ranges, ranks, starts
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
MOST_IN_TILE = 4  # receivers of one square that are looked at, whether they tell anything or not
TOGETHER = 2048  # groups that are looked at together: pairs of these and of receivers stay in the processor's cache
PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # of (1, x, y)


@record
class _OneSize:
    """What receivers in squares of one size have gathered: R, tile by tile. Columns are taken faster than rows."""

    side: int  # of the squares, in pixels
    first: np.ndarray  # (rows, columns) int64: of each tile
    count: np.ndarray  # (rows, columns) int64
    pixels: np.ndarray  # (2, R) float32
    places: np.ndarray  # (6, R) float32: positions and normals
    found: np.ndarray  # (8, R) float32


class Known:
    """Receivers of several sizes of squares, with what they have gathered."""

    def __init__(self, position: np.ndarray, normal: np.ndarray) -> None:
        """position, normal: (N, 3) float32 each, of all groups of a picture, from the eye along the world's axes."""
        self._position, self._normal = position, normal
        self._sizes: list[_OneSize] = []
        self._widest = 1.0

    def add(self, receivers: Receivers, side: int, found: np.ndarray, valid: np.ndarray) -> None:
        """`found` (R, 8) of receivers in squares of `side` pixels, as far as it is `valid`, (R,) bool."""
        in_tile = receivers.tiles[..., 1].astype(np.int64)
        kept = np.flatnonzero(valid & (ranks(in_tile.ravel()) < MOST_IN_TILE))
        count = np.bincount(owners(in_tile.ravel())[kept], minlength=in_tile.size)
        first, count = (of.reshape(in_tile.shape) for of in (starts(count), count))
        pixels, found = (np.ascontiguousarray(of[kept].T) for of in (receivers.pixels, found))
        self._sizes.append(_OneSize(side, first, count, pixels, self._places(receivers.rows[kept]), found))
        self._widest = max(self._widest, float(side))

    def _places(self, rows: np.ndarray) -> np.ndarray:
        """(6, n): positions and normals of the groups `rows` (n,)."""
        return np.concatenate([self._position[rows].T, self._normal[rows].T])

    def interpolated(self, rows: np.ndarray, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, 8) at the groups `rows` (n,), at `pixels` (n, 2), and whether what is known tells it, (n,) bool."""
        found, known = np.zeros((len(rows), 8), np.float32), np.zeros(len(rows), bool)
        # On one thread: NumPy takes so little time for each step that two of them wait for the interpreter's lock.
        for begin in range(0, len(rows), TOGETHER):
            some = slice(begin, begin + TOGETHER)
            found[some], known[some] = self._interpolated(rows[some], pixels[some])
        return found, known

    def _interpolated(self, rows: np.ndarray, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `interpolated`."""
        count = len(rows)
        totals = np.zeros((32, count))  # of products of (1, x, y) with what receivers have, and with (1, x, y); others
        places, columns = self._places(rows), np.ascontiguousarray(pixels.T)
        for known in self._sizes:
            own, other = _around(known, np.floor(columns / known.side).astype(np.int64))
            away = (known.pixels.take(other, axis=1) - columns.take(own, axis=1)) / np.float32(1.5 * known.side)
            near = np.maximum(1 - np.abs(away[0]), 0) * np.maximum(1 - np.abs(away[1]), 0)
            own, other, away, near = _those(near > 0, own, other, away, near)
            nearness = known.found[3].take(other)
            weight = near * _weight(places.take(own, axis=1), known.places.take(other, axis=1), nearness)
            own, other, away, weight = _those(weight > 0, own, other, away, weight)
            if not len(own):
                continue
            first = np.flatnonzero(np.append(True, own[1:] != own[:-1]))
            at, light = own[first], known.found.take(other, axis=1)
            for total, given in zip(totals, _products(weight, away * (known.side / self._widest), light), strict=True):
                total[at] += np.add.reduceat(given, first)
        moments = np.empty((count, 3, 3))
        for k, (i, j) in enumerate(PAIRS, 24):
            moments[:, i, j] = moments[:, j, i] = totals[k]
        sums = np.moveaxis(totals[:24].reshape(3, 8, count), 2, 0)
        return _fitted(moments, sums, totals[30], totals[31])


def _products(weight: np.ndarray, away: np.ndarray, light: np.ndarray) -> Iterator[np.ndarray]:
    """Yields what is summed up, 32 times (n,) float64, each of which stays in the processor's cache: weights (n,) times
    products of (1, x, y) with light (8, n) and with (1, x, y), squares of weights, and weights times squared light.

    away: (2, n), x and y.
    """
    basis = np.ones((3, len(weight)))
    basis[1:] = away
    for one in weight * basis:
        for channel in light:
            yield one * channel
    for i, j in PAIRS:
        yield weight * basis[i] * basis[j]
    yield (weight * weight).astype(np.float64)
    yield (weight * light[:3].mean(axis=0) ** 2).astype(np.float64)


def _weight(places: np.ndarray, others: np.ndarray, nearness: np.ndarray) -> np.ndarray:
    """(n,): how far others speak for places, positions and normals (6, n) each."""
    offset, up, normal = places[:3] - others[:3], others[3:], places[3:]
    far = np.sqrt(dot(offset, offset)) * nearness / FAR
    off = np.abs(dot(offset, up + normal)) * nearness / (2 * OFF * FAR)
    turned = (1 - dot(up, normal)) / TURNED
    return np.maximum(1 - np.maximum(np.maximum(far, off), turned), 0)


def _around(known: _OneSize, tile: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs (P,), by rising rows of tiles (2, n), of these and of receivers in the 9 tiles around them."""
    high, wide = known.count.shape
    step = np.arange(9)
    x, y = tile[0][:, None] + step % 3 - 1, tile[1][:, None] + step // 3 - 1
    at = np.flatnonzero((x >= 0) & (x < wide) & (y >= 0) & (y < high))
    entry = (y * wide + x).ravel()[at]
    count = known.count.ravel()[entry]
    other = ranges(known.first.ravel()[entry], count)
    return np.repeat(at // 9, count), other


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
