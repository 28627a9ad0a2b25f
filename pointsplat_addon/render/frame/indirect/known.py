"""Receivers that have gathered light, and what others may interpolate of it (Ward et al. 1988)."""

from __future__ import annotations

import numpy as np

from .receivers import Receivers

FAR = 0.15  # harmonic mean distances of a receiver, as far as which it speaks for others
TURNED = 0.1  # 1 - cosine between normals, up to which it does
OFF = 0.1  # of these distances that others may lie off its plane
FEWEST = 1.5  # receivers, counted by their weights, from which is interpolated
UNLIKE = 0.1  # relative deviation between them, above which it is not
MOST_IN_TILE = 4  # receivers of one square that are looked at


class Known:
    """Receivers of several sizes of squares, with what they have gathered."""

    def __init__(self, position: np.ndarray, normal: np.ndarray) -> None:
        """position, normal: (N, 3) float32 each, of all groups of a picture, from the eye along the world's axes."""
        self._position, self._normal = position, normal
        self._sizes: list[tuple[Receivers, int, np.ndarray, np.ndarray]] = []

    def add(self, receivers: Receivers, side: int, found: np.ndarray, valid: np.ndarray) -> None:
        """`found` (R, 8) of receivers in squares of `side` pixels, as far as it is `valid`, (R,) bool."""
        self._sizes.append((receivers, side, found, valid))

    def interpolated(self, rows: np.ndarray, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(n, 8) at the groups `rows` (n,), at `pixels` (n, 2), and whether what is known tells it, (n,) bool."""
        sums, total, squares = np.zeros((len(rows), 8)), np.zeros(len(rows)), np.zeros(len(rows))
        bright, bright_squares = np.zeros(len(rows)), np.zeros(len(rows))
        place, normal = self._position[rows], self._normal[rows]
        for receivers, side, found, valid in self._sizes:
            high, wide = receivers.tiles.shape[:2]
            tile = np.floor(pixels / side).astype(np.int64)
            light = found[:, :3].mean(axis=1)
            for step in range(9):
                x, y = tile[:, 0] + step % 3 - 1, tile[:, 1] + step // 3 - 1
                within = (x >= 0) & (x < wide) & (y >= 0) & (y < high)
                entry = receivers.tiles[np.where(within, y, 0), np.where(within, x, 0)].astype(np.int64)
                count = np.where(within, np.minimum(entry[:, 1], MOST_IN_TILE), 0)
                for slot in range(int(count.max(initial=0))):
                    some = np.flatnonzero(slot < count)
                    other = entry[some, 0] + slot
                    some, other = some[valid[other]], other[valid[other]]
                    weight = self._weight(place[some], normal[some], receivers.rows[other], found[other, 3])
                    apart = np.abs(receivers.pixels[other] - pixels[some]) / (1.5 * side)
                    weight *= np.maximum(1 - apart, 0).prod(axis=1)
                    used = weight > 0
                    some, other, weight = some[used], other[used], weight[used]
                    sums[some] += weight[:, None] * found[other]
                    total[some] += weight
                    squares[some] += weight * weight
                    bright[some] += weight * light[other]
                    bright_squares[some] += weight * light[other] ** 2
        mean = bright / np.maximum(total, 1e-30)
        deviation = np.sqrt(np.maximum(bright_squares / np.maximum(total, 1e-30) - mean * mean, 0))
        known = (total * total >= FEWEST * squares) & (total > 0) & (deviation <= UNLIKE * mean)
        return (sums / np.maximum(total, 1e-30)[:, None]).astype(np.float32), known

    def _weight(self, place: np.ndarray, normal: np.ndarray, other: np.ndarray, nearness: np.ndarray) -> np.ndarray:
        """(n,): how far the groups `other` speak for those at places with normals (n, 3)."""
        offset, up = place - self._position[other], self._normal[other]
        far = np.sqrt((offset**2).sum(axis=1)) * nearness / FAR
        off = np.abs((offset * (up + normal)).sum(axis=1)) * nearness / (2 * OFF * FAR)
        turned = (1 - (up * normal).sum(axis=1)) / TURNED
        return np.maximum(1 - np.maximum(np.maximum(far, off), turned), 0)
