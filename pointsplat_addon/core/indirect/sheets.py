"""Sheets of balls: those in one cell of space that lie on a plane and hide what is behind it become one flat surfel.

Balls of a scan lie over each other, six times and more. Each by itself, turned to all sides, would rise above those
beside it and hide the sky from them, and would be as bright before as behind.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ..numeric.record import record
from .sites import SHIFT, cells, hashed

EVEN = 12.0  # over the variance: the squared width of an even patch
KNUD_THOMSEN = 1.6075  # exponent
WIDE = 4.0  # radii of balls, as wide as cells are at least
FEWEST = 8  # balls of a sheet
DENSE = 1.0  # over the area of a sheet, that of the pictures of its balls at least
THIN = 0.5  # the least over the middle variance of the middles of its balls, at most, were these many
BY_CHANCE = 1.5  # balls: a few in space are as flat by chance, the less the more there are, by the root of their number
RISES = 2.0  # standard deviations of these from their plane, by which balls may rise above it
SKEWED = 0.2 * np.array([0.36, 0.48, 0.8])  # what is added to the way outwards, which is none in the middle
COUNT, WHOLE, MIDDLE, PRODUCTS, LOOK = 0, 1, slice(2, 5), slice(5, 11), slice(11, 17)
COLUMNS = 17  # of sums
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


@record
class Sheets:
    """N sheets among balls in C cells of space."""

    position: np.ndarray  # (N, 3) float64
    normal: np.ndarray  # (N, 3) float64, unit, away from the middle of all
    area: np.ndarray  # (N,) float64: what is hidden by one side
    look: np.ndarray  # (N, 6) float64: mean albedo and emission of the balls
    height: np.ndarray  # (N,) float64: how far these rise above it, on both sides
    returned: np.ndarray  # (N,) float64: as of `returned_share`
    key: np.ndarray  # (C,) uint64, rising: of all cells
    share: np.ndarray  # (C,) float64: as of `shares`

    def shares(self, position: np.ndarray, apart: np.ndarray) -> np.ndarray:
        """Returns how much of balls counts beside sheets, (N,), 0 to 1: none of those in one, and of dense ones as much
        as fills their picture. The others: as of `sheets`."""
        key, _ = _cells(position, apart)
        at = np.minimum(np.searchsorted(self.key, key), len(self.key) - 1)
        return np.where(self.key[at] == key, self.share[at], 1.0)


@record
class _Planes:
    """Planes through what lies in each of C cells."""

    normal: np.ndarray  # (C, 3) float64, unit
    area: np.ndarray  # (C,) float64: how much is hidden there
    height: np.ndarray  # (C,) float64: how far balls rise above it
    returned: np.ndarray  # (C,) float64: as of `returned_share`
    flat: np.ndarray  # (C,) bool: all lies on it, and hides most of it
    share: np.ndarray  # (C,) float64: how much of the balls fills their picture, where they are not flat; 1 at most


def sheets(position: np.ndarray, area: np.ndarray, look: np.ndarray, apart: np.ndarray, each: float = 1.0) -> Sheets:
    """Returns the sheets among N > 0 balls at places (N, 3) float64, each of which stands for so many.

    area (N,): of their pictures. look (N, 6): albedo and emission. apart (N,): as wide as cells
    are about; at least WIDE radii.
    """
    key, cell, of = _sums(position, area * each, look, apart)
    planes = _planes(of, each)
    # What is cut off by the borders of cells, and too little to have a plane by itself, is on that of a wider one.
    wider = np.column_stack([cell[:, 0] + 1, np.floor(cell[:, 1:] / 2)])
    moved, off = of.copy(), (_corners(cell) - (2 * wider[:, 1:] - SHIFT) * np.exp2(cell[:, :1])).T
    moved[MIDDLE] += of[WHOLE] * off
    for row, (i, j) in enumerate(PAIRS, PRODUCTS.start):
        moved[row] += off[i] * of[MIDDLE][j] + off[j] * of[MIDDLE][i] + of[WHOLE] * off[i] * off[j]
    wide_key = hashed(wider)
    whole_key, _, whole = _together(wide_key, wider, moved)
    rising = np.argsort(whole_key)
    own = rising[np.searchsorted(whole_key, wide_key, sorter=rising)]
    by_wider = _planes(whole, each)
    lent = ~planes.flat & by_wider.flat[own] & np.isfinite(of).all(axis=0)
    part = of[WHOLE] / np.maximum(whole[WHOLE][own], 1e-300)
    normal = np.where(lent[:, None], by_wider.normal[own], planes.normal)
    hidden = np.where(lent, by_wider.area[own] * part, planes.area)
    height, returned = (
        np.where(lent, wide[own], narrow)
        for wide, narrow in ((by_wider.height, planes.height), (by_wider.returned, planes.returned))
    )
    in_sheet = planes.flat | lent
    found = np.flatnonzero(in_sheet)
    means = of[:, found] / of[WHOLE][found]
    place = _corners(cell[found]) + means[MIDDLE].T
    normal, hidden = normal[found], hidden[found]
    # Wider planes are less tilted by chance.
    guide = np.where(by_wider.flat[own][found, None], by_wider.normal[own[found]], normal)
    normal = np.where((normal * guide).sum(axis=1, keepdims=True) < 0, -normal, normal)
    normal = np.where(_inwards(place, guide, hidden)[:, None], -normal, normal)
    order = np.argsort(key)
    share = np.where(in_sheet, 0.0, planes.share)
    return Sheets(
        place, normal, hidden, means[LOOK].T, height[found], returned[found], key[order], share[order]
    )  # fmt: skip


def _cells(position: np.ndarray, apart: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The keys (N,) of the cells in which balls lie, and these (N, 4): binary logarithms of edges, and numbers along
    each axis."""
    level = np.rint(np.log2(np.maximum(apart, 1e-30)))
    cell = np.column_stack([level, cells(position, level)[0]])
    return hashed(cell), cell


def _corners(cell: np.ndarray) -> np.ndarray:
    """(C, 3)."""
    return (cell[:, 1:] - SHIFT) * np.exp2(cell[:, :1])


def _sums(
    position: np.ndarray, area: np.ndarray, look: np.ndarray, apart: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Keys (C,), cells (C, 4), and sums over the balls in each, (COLUMNS, C): how many there are; their areas,
    and times these their places from the corner of the cell, products of PAIRS of these, and looks."""
    key, cell = _cells(position, apart)
    away = (position - _corners(cell)).T
    of = np.empty((COLUMNS, len(key)))
    of[COUNT], of[WHOLE], of[MIDDLE], of[LOOK] = 1, area, away * area, look.T * area
    for row, (i, j) in enumerate(PAIRS, PRODUCTS.start):
        of[row] = area * away[i] * away[j]
    return _together(key, cell, of)


def _together(key: np.ndarray, cell: np.ndarray, of: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Adds up what lies in equal cells, which are then in the order of the first in each: that of keys depends on the
    unit of length."""
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.append(True, key[order][1:] != key[order][:-1]))
    rows = order[first]
    by_first = np.argsort(rows)
    rows = rows[by_first]
    return key[rows], cell[rows], np.add.reduceat(of[:, order], first, axis=1).take(by_first, axis=1)


def _planes(of: np.ndarray, each: float) -> _Planes:
    """By sums (COLUMNS, C). `each`: balls that one stands for."""
    sound = np.isfinite(of).all(axis=0) & (of[WHOLE] > 0)
    of = np.where(sound, of, 1.0)
    count, whole = of[COUNT], of[WHOLE]
    middle, spread = of[MIDDLE] / whole, np.empty((3, 3, len(count)))
    for row, (i, j) in enumerate(PAIRS, PRODUCTS.start):
        spread[i, j] = spread[j, i] = of[row] / whole - middle[i] * middle[j]
    values, vectors = np.linalg.eigh(spread.transpose(2, 0, 1))
    values = np.maximum(values, 0)
    several = sound & (count >= FEWEST)
    # The determinant of the covariance of a few balls is less, in the mean, than that of the sheet.
    few = count / np.sqrt(np.maximum((count - 1) * (count - 2), 1))
    patch = EVEN * few * np.sqrt(values[:, 1] * values[:, 2])
    dense = whole / np.maximum(patch, 1e-12 * whole)
    thin = THIN * (1 - np.sqrt(BY_CHANCE / np.maximum(count, FEWEST)))
    flat = several & (values[:, 0] < thin * values[:, 1]) & (dense > DENSE)
    # Knud Thomsen's approximation to the surface of an ellipsoid, of which a quarter is its mean picture (Cauchy).
    squared = whole / (np.pi * each * count)  # radius
    axes = values + 0.25 * squared[:, None]
    faces = [np.sqrt(axes[:, k] * axes[:, (k + 1) % 3]) for k in range(3)]
    picture = EVEN * (sum(face**KNUD_THOMSEN for face in faces) / 3) ** (1 / KNUD_THOMSEN)
    share = np.where(several, np.minimum(picture / whole, 1.0), 1.0)
    radius, spread_across = np.sqrt(squared), np.sqrt(values[:, 0])
    returned = returned_share(dense, spread_across / radius)
    return _Planes(
        vectors[:, :, 0], patch * -np.expm1(-dense), radius + RISES * spread_across, returned, flat, share
    )  # fmt: skip


def _inwards(place: np.ndarray, normal: np.ndarray, area: np.ndarray) -> np.ndarray:
    """(N,) bool: of normals (N, 3) at places (N, 3). Those beside each other are then turned alike."""
    away = place - (place * area[:, None]).sum(axis=0) / max(float(area.sum()), 1e-300)
    away /= max(float(np.sqrt((away**2).sum(axis=1)).max(initial=0)), 1e-300)
    return (normal * (away + SKEWED)).sum(axis=1) < 0


def returned_share(dense: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Returns how much of the light that sheets send on falls on their own balls again, (N,), 0 to 1.

    dense (N,): balls over each other. spread (N,): standard deviation of their middles from the sheet's plane, in
    radii. What is seen of balls from before has A times the area of the plane. What it sends evenly leaves through the
    plane: 1 / A of it, and the rest falls on it again.
    """
    levels, table = _returned_table()
    at = [
        np.interp(of, level, np.arange(len(level)))
        for of, level in zip((np.log(np.maximum(dense, 1e-30)), spread), levels, strict=True)
    ]
    low = [np.minimum(of.astype(np.int64), len(level) - 2) for of, level in zip(at, levels, strict=True)]
    (i, j), (x, y) = low, (of - first for of, first in zip(at, low, strict=True))
    return (1 - x) * ((1 - y) * table[i, j] + y * table[i, j + 1]) + x * (
        (1 - y) * table[i + 1, j] + y * table[i + 1, j + 1]
    )


@lru_cache(1)
def _returned_table() -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Logarithms of `dense` and spreads, (n,) and (m,), and the share for each, (n, m): of balls whose middles lie at
    random, at heights with a normal distribution."""
    dense, spread = np.linspace(0.0, np.log(100.0), 24), np.linspace(0.0, 2.0, 17)
    heights, of_heights = np.polynomial.hermite_e.hermegauss(16)
    of_heights /= of_heights.sum()
    above, steps = np.polynomial.legendre.leggauss(12)
    above, steps = 0.5 * (above + 1), 0.5 * steps  # of a ball's surface over its middle, and over its radius the cosine
    middle = spread[:, None] * heights
    # A place is open where no ball's surface lies above it.
    higher = np.clip(middle[:, :, None, None] + above[:, None] - middle[:, None, None, :], 0.0, 1.0)
    hiding = ((1 - higher**2) * of_heights).sum(axis=3)
    weight = of_heights[:, None] * steps * np.exp(-np.exp(dense)[:, None, None, None] * hiding)
    flat, whole = ((weight * of).sum(axis=(2, 3)) for of in (above, 1.0))
    return (dense, spread), 1 - flat / whole
