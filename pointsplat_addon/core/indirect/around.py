"""Estimates what falls on surfaces from what is known at positions around them, without a gather: in cells of space
whose edges double, for each of the six ways along the axes (as ambient cubes have them; McTaggart 2004).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from ..numeric.record import record
from .closed import scrambled
from .sites import SHIFT

THIN = 0.5  # of cells along the axis that normals are turned to: surfaces behind one another share none
LEAST_FACE = 0.04  # share of a normal in an axis, below which that is left out
LEAST_SHARE = 0.01  # of what is known, in a cell, below which it does not count there
NONE, ENOUGH = 0.05, 0.35  # weight of what is known, from which on cells count, and from which on larger ones do not
MOST_COMPARED, MOST_BRIGHTER = 2048, 2.0  # positions that tell by how much what is known roughly is to be brighter
NEXT_TO = 1.0  # edges of its cell: nearer things make that a position tells nothing of what is known roughly
CLIMB = 1  # levels above their own, up to which positions of which more is known count
MOST_LEVELS = 64
PRIMES = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9, 0xD6E8FEB86659FD93], np.uint64)
CORNERS = np.stack(np.meshgrid((0, 1), (0, 1), (0, 1), indexing="ij"), axis=-1).reshape(-1, 3)


@record
class LightAt:
    """What falls on surfaces at N positions."""

    position: np.ndarray  # (N, 3) float64
    normal: np.ndarray  # (N, 3), unit; 0: on balls, from all sides
    level: np.ndarray  # (N,) float64, whole: binary logarithm of how far apart such positions are
    found: np.ndarray  # (N, 8) float32: irradiance over pi, nearness; what lobes mirror, and their open share
    smooth: np.ndarray  # (N,) bool: lobes are known

    def take(self, rows: slice) -> LightAt:
        return LightAt(self.position[rows], self.normal[rows], self.level[rows], self.found[rows], self.smooth[rows])


@record
class _Cells:
    """C cells of one level, by rising keys."""

    key: np.ndarray  # (C,) uint64
    face: np.ndarray  # (C,) int64: axis, and 3 more where normals point down it
    position: np.ndarray  # (C, 3), mean
    weight: np.ndarray  # (C,), at most 1
    found: np.ndarray  # (C, 8), mean
    smooth: np.ndarray  # (C,): share of what lobes are known of
    level: np.ndarray  # (C,): the highest of those that what it holds was known at


def matched(rough: LightAt, known: LightAt) -> LightAt:
    """Returns `rough`, brighter or darker by what is `known` more exactly, mean over the area of that.

    In corners cells of what is known roughly mix what lies deep in them with what does not: they do not count.
    """
    few = known.take(slice(None, None, len(known.level) // MOST_COMPARED + 1))
    area = 4.0 ** (few.level - few.level.max(initial=0))
    free = few.found[:, 3] * np.exp2(few.level) < 1 / NEXT_TO
    area *= free if free.any() else 1
    mean = area @ few.found[:, :3]
    of_rough = area @ LightAround(rough).estimated(few.position, few.normal, few.level)[:, :3]
    ratio = np.clip(mean / np.maximum(of_rough, 1e-30), 1 / MOST_BRIGHTER, MOST_BRIGHTER)
    found = rough.found.copy()
    found[:, :3] *= np.where(of_rough > 0, ratio, 1)
    return replace(rough, found=found)


def joined(parts: Sequence[LightAt]) -> LightAt:
    """Returns one of several, at least one."""
    columns = zip(*((one.position, one.normal, one.level, one.found, one.smooth) for one in parts), strict=True)
    return LightAt(*(np.concatenate(column) for column in columns))


class LightAround:
    """Light that is known at some positions, from which it is estimated elsewhere."""

    def __init__(self, *known: LightAt) -> None:
        """`known`: at least at one position; the rest counts where less is known by what comes before it."""
        self._tiers = [_levels(one) for one in known if len(one.level)]

    def estimated(self, position: np.ndarray, normal: np.ndarray, level: np.ndarray) -> np.ndarray:
        """Returns (N, 8) float32 at positions (N, 3) with unit normals (N, 3), which are about 2^level (N,) apart.
        Where no lobe is known they mirror what falls on them from all sides."""
        row, face, share = _faces(normal)
        place, left = position[row], np.ones(len(row))
        total, sums = np.zeros(len(row)), np.zeros((len(row), 9))
        for number, levels in enumerate(self._tiers):
            first, last = min(levels), max(levels)
            begin = np.clip(np.floor(level[row]), first, last).astype(np.int64)
            others = number + 1 < len(self._tiers)
            for at, cells in sorted(levels.items()):
                some = np.flatnonzero((begin <= at) & (left > 1e-3))
                if not len(some):
                    continue
                # What is known better tells nothing far beyond where it is known.
                lowest = np.where((begin[some] < at) & others, at - CLIMB, -np.inf)
                weight, found = _interpolated(cells, place[some], face[some], at, lowest)
                covers = np.clip((weight - NONE) / (ENOUGH - NONE), 0, 1)
                if at == last and not others:
                    covers = (weight > 0) * 1.0
                covers *= left[some]
                sums[some] += covers[:, None] * found
                total[some] += covers
                left[some] -= covers
        # Ways of which nothing is known around take the mean of all that is known that way, or of everything.
        whole = self._tiers[-1][max(self._tiers[-1])]
        for way in np.unique(face[total <= 0]).tolist():
            bare = np.flatnonzero((face == way) & (total <= 0))
            here = np.flatnonzero(whole.face == way)
            sums[bare], total[bare] = _mean(whole, here if len(here) else np.arange(len(whole.key))), 1.0
        sums *= (share / total)[:, None]
        result = np.zeros((len(position), 9))
        np.add.at(result, row, sums)
        smooth = result[:, 8:]
        result[:, 4:8] += (1 - smooth) * np.column_stack([result[:, :3], np.zeros(len(result))])
        return result[:, :8].astype(np.float32)


def _levels(known: LightAt) -> dict[int, _Cells]:
    """Cells by level. They count what is known in smaller ones once each, so that positions that lie close together do
    not outweigh others."""
    # Finer than a number tells cells apart there is nothing.
    level = np.maximum(known.level, np.log2(np.abs(known.position).max(initial=1e-30)) - 40)
    level = np.ceil(level).astype(np.int64)
    row, face, share = _faces(known.normal)
    given = _spread(_items(known, level, row, face, share))
    found: dict[int, _Cells] = {}
    rest: _Cells | None = None
    first, last = int(level.min()), int(level.max())
    for at in range(first, first + MOST_LEVELS):
        here = _taken(given, np.flatnonzero(given.level == at))
        found[at] = rest = _merged(here if rest is None else _both(rest, here), at)
        if at >= last and len(rest.key) <= 8 * len(np.unique(rest.face)):
            break
    return found


def _faces(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows, ways and shares (K,) of normals (N, 3): shares of a row are 1 together."""
    squares = normal.astype(np.float64) ** 2
    size = squares.sum(axis=1)
    both = np.concatenate([np.where(normal > 0, squares, 0), np.where(normal < 0, squares, 0)], axis=1)
    both[size < 0.25] = 1 / 6
    both[both < LEAST_FACE] = 0
    both /= both.sum(axis=1, keepdims=True)
    row, face = np.nonzero(both)
    return row, face, both[row, face]


def _edges(face: np.ndarray, level: np.ndarray | int) -> np.ndarray:
    """(N, 3), of cells of levels (N,), or one, that belong to ways (N,)."""
    edges = np.repeat(np.exp2(np.broadcast_to(level, face.shape).astype(np.float64))[:, None], 3, axis=1)
    edges[np.arange(len(face)), face % 3] *= THIN
    return edges


def _in_cells(position: np.ndarray, face: np.ndarray, level: np.ndarray | int) -> np.ndarray:
    """Positions (N, 3), in edges of cells."""
    return position / _edges(face, level) + SHIFT


def _keys(cell: np.ndarray, face: np.ndarray) -> np.ndarray:
    """(...,) uint64 of cells (..., 3) of whole numbers, of ways (...,)."""
    with np.errstate(over="ignore"):
        parts = cell.astype(np.int64).view(np.uint64) * PRIMES[:3]
        return scrambled(parts[..., 0] + parts[..., 1] + parts[..., 2] + face.astype(np.uint64) * PRIMES[3])


def _items(known: LightAt, level: np.ndarray, row: np.ndarray, face: np.ndarray, share: np.ndarray) -> _Cells:
    """What is known, at levels (N,), of the ways that `_faces` tells."""
    of = known.found[row].astype(np.float64), known.smooth[row].astype(np.float64)
    return _Cells(np.zeros(len(row), np.uint64), face, known.position[row], share, *of, level[row].astype(np.float64))


def _spread(items: _Cells) -> _Cells:
    """Items, each in the middles of cells of its level around it, by how near it is."""
    at = _in_cells(items.position, items.face, items.level) - 0.5
    base = np.floor(at)
    part = at - base
    weight = np.stack([np.where(corner, part, 1 - part).prod(axis=1) for corner in CORNERS], axis=1)
    row, corner = np.nonzero(weight > LEAST_SHARE)
    middle = (base[row] + CORNERS[corner] + 0.5 - SHIFT) * _edges(items.face[row], items.level[row])
    spread = _taken(items, row)
    return replace(spread, position=middle, weight=spread.weight * weight[row, corner])


def _merged(items: _Cells, level: int) -> _Cells:
    """The cells of a level in which items lie."""
    key = _keys(np.floor(_in_cells(items.position, items.face, level)), items.face)
    unique, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    inverse, count = inverse.reshape(-1), len(unique)
    weight = np.bincount(inverse, items.weight, count)
    highest = np.full(count, -np.inf)
    np.maximum.at(highest, inverse, items.level)
    columns = np.column_stack([items.position, items.found[:, :4]])
    columns = np.column_stack([columns, items.smooth, items.smooth[:, None] * items.found[:, 4:]])
    sums = np.stack([np.bincount(inverse, items.weight * one, count) for one in columns.T], axis=1)
    means = sums / weight[:, None]
    smooth = means[:, 7]
    lobes = means[:, 8:] / np.maximum(smooth, 1e-30)[:, None]
    found = np.column_stack([means[:, 3:7], lobes])
    return _Cells(unique, items.face[first], means[:, :3], np.minimum(weight, 1), found, smooth, highest)


def _interpolated(
    cells: _Cells, position: np.ndarray, face: np.ndarray, level: int, lowest: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The weight (N,) of what is known around positions (N, 3), and what it is, (N, 9): as `estimated`, with the share
    of what lobes are known of, which weighs those. `lowest` (N,): level from which on cells count."""
    at = _in_cells(position, face, level) - 0.5
    base = np.floor(at)
    part = at - base
    total, sums = np.zeros(len(at)), np.zeros((len(at), 9))
    values = np.column_stack([cells.found[:, :4], cells.smooth[:, None] * cells.found[:, 4:], cells.smooth])
    for corner in CORNERS:
        weight = np.where(corner, part, 1 - part).prod(axis=1)
        key = _keys(base + corner, face)
        row = np.minimum(np.searchsorted(cells.key, key), len(cells.key) - 1)
        weight = np.where((cells.key[row] == key) & (cells.level[row] >= lowest), weight * cells.weight[row], 0)
        total += weight
        sums += weight[:, None] * values[row]
    return total, sums / np.maximum(total, 1e-30)[:, None]


def _mean(cells: _Cells, rows: np.ndarray) -> np.ndarray:
    """(9,) of rows (n,): as of `_interpolated`."""
    smooth = cells.smooth[rows, None]
    values = np.column_stack([cells.found[rows, :4], smooth * cells.found[rows, 4:], smooth])
    weight = cells.weight[rows]
    return (weight[:, None] * values).sum(axis=0) / weight.sum()


def _taken(cells: _Cells, rows: np.ndarray) -> _Cells:
    return _Cells(*(getattr(cells, field.name)[rows] for field in fields(_Cells)))


def _both(a: _Cells, b: _Cells) -> _Cells:
    return _Cells(*(np.concatenate([getattr(one, field.name) for one in (a, b)]) for field in fields(_Cells)))
