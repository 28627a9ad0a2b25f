"""Surfels of captured splats: those that lie in one cell of space become one, which hides as much as all of them.

A splat hides 1 - o exp(-q / 2) of what is behind it, q the squared Mahalanobis distance of a ray: an optical depth
whose integral over its picture is 2 pi a b Li2(o), with a and b its half-axes there. Splats that are larger than cells
are cut into parts. What lies in a cell covers the area F of an even patch with the same second moments (Kerbl et al.
2024 merge covariances alike), and hides F (1 - exp(-W / F)), W the sum of optical depths times areas: patches of a
surface tile it, however many splats lie over each other there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..material.color_models import linear_from_srgb
from ..numeric.record import record
from ..numeric.rotations import rotation_matrices
from ..numeric.segments import owners, ranges, starts
from ..scene.captured import CapturedSplats
from ..splat.captured import LEAST_ALPHA, MOST_ALPHA
from .sampling import Spacing
from .sites import SHIFT, cells, hashed

DEGREE_0 = 0.28209479177387814  # of spherical harmonics
AROUND = 2.5  # standard deviations of a splat that are cut into parts
PART = 0.3  # of a cell: how wide parts are at most
MOST_ALONG, MOST_PARTS = 48, 1 << 20  # parts of a splat along an axis; and of all, or twice as many as there are splats
# Splats at which is looked of very many, and cells in which the middles of these may lie.
SAMPLED, MOST_CELLS = 1 << 18, 1 << 17
EVEN = 12.0  # over the variance: the squared width of an even patch
BELL = 9.5  # the area, over both standard deviations, that stands for the picture of one opaque splat
BATCH = 1 << 18  # splats that are taken at once
TOO_ROUND = 0.15  # how far normals of a surfel lie along an axis, below which it is turned to all sides
LEAST = 1e-12  # of the widest half-axis: how wide all are at least
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
WHOLE, MIDDLE, LIGHT, TURNED, SPREAD = 0, slice(1, 4), slice(4, 7), slice(7, 13), slice(13, 19)
COLUMNS, PICTURE = 20, 19


@record
class CapturedSurfels:
    """N surfels of captured splats, in world space from some origin, each of two sides that look alike."""

    position: np.ndarray  # (N, 3) float32
    # (N, 3) float32: zero: it hides as much from all sides, half of its area; else as long as the root of
    # (2 k + 1) / 3, k how far it is flat: of its area (1 - k) / 2 and, by the cosine to the normal, k more
    normal: np.ndarray
    area: np.ndarray  # (N,) float32
    color: np.ndarray  # (N, 3) float32, linear: of degree 0


@record
class _Parts:
    """M parts of splats."""

    position: np.ndarray  # (M, 3) float64
    weight: np.ndarray  # (M,) float64: its share of the splat's area
    width: np.ndarray  # (3, 3, M) float64: coordinate, which: half-axes of its own, as standard deviations
    own: np.ndarray  # (M,) int64: rows of splats


def captured_surfels(splats: CapturedSplats, matrix: np.ndarray, spacing: Spacing) -> CapturedSurfels:
    """Returns the surfels of an instance of splats, (4, 4) float64, about as far apart as `spacing` says."""
    found = [_CellSums(np.zeros(0, np.uint64), np.zeros((0, 4)), np.zeros((COLUMNS, 0)))]
    batches = [_batch(splats, slice(start, start + BATCH)) for start in range(0, len(splats), BATCH)]
    wider = _wider(batches, matrix, spacing)
    for batch in batches:
        found.append(_of_cells(batch, matrix, spacing, wider, MOST_PARTS // len(batches)))
    sums = _together(
        np.concatenate([one.key for one in found]),
        np.concatenate([one.cell for one in found]),
        np.concatenate([one.of for one in found], axis=1),
    )
    whole, count = np.maximum(sums.of[WHOLE], 1e-300), len(sums.key)
    means = sums.of / whole
    middle, light = means[MIDDLE], means[LIGHT]
    tensor, spread = np.empty((2, 3, 3, count))
    for row, (i, j) in enumerate(PAIRS):
        tensor[i, j] = tensor[j, i] = means[TURNED][row]
        spread[i, j] = spread[j, i] = means[SPREAD][row] - middle[i] * middle[j]
    values, vectors = np.linalg.eigh(tensor.transpose(2, 0, 1))
    axis, along = vectors[:, :, 2], np.clip(1.5 * values[:, 2] - 0.5, 0, 1)
    # The second moments of its picture along the axis, which is within the picture of the cell or, where parts are
    # larger, of these.
    edge = np.exp2(sums.cell[:, 0])
    of_picture = np.einsum("ni,ijn,nj->n", axis, _cofactors(spread), axis)
    widest = np.maximum(edge**2 * np.abs(axis).sum(axis=1), means[PICTURE])
    patch = np.minimum(EVEN * np.sqrt(np.maximum(of_picture, (LEAST * widest) ** 2)), widest)
    seen = whole * 0.5 * (1 + along)
    hidden = patch * -np.expm1(-seen / patch) / seen
    axis *= np.sqrt((2 * along + 1) / 3)[:, None]
    axis[along < TOO_ROUND] = 0
    f = np.float32
    place = _corners(sums.cell) + middle.T
    made = place.astype(f), axis.astype(f), (whole * hidden).astype(f), light.T.astype(f)
    sound = np.isfinite(np.column_stack(made)).all(axis=1) & (made[2] > 0)
    return CapturedSurfels(*(array[sound] for array in made))


class _CellSums(NamedTuple):
    """Sums over what lies in C cells, weighted by areas."""

    key: np.ndarray  # (C,) uint64, of each cell
    cell: np.ndarray  # (C, 4) float64: binary logarithm of its edge, and its number along each axis
    of: np.ndarray  # (COLUMNS, C) float64: of 1, places from its corner, light, and PAIRS of normals and of places


def _batch(splats: CapturedSplats, rows: slice | np.ndarray) -> CapturedSplats:
    names = "position", "scale", "rotation", "base", "opacity"
    return CapturedSplats(*(getattr(splats, name)[rows] for name in names), origin=splats.origin)


def _corners(cell: np.ndarray) -> np.ndarray:
    """(C, 3): of cells as of _CellSums."""
    return (cell[:, 1:] - SHIFT) * np.exp2(cell[:, :1])


def _wider(batches: list[CapturedSplats], matrix: np.ndarray, spacing: Spacing) -> float:
    """How many times wider cells are to be than `spacing` says, so that there are not too many: a power of two."""
    count = sum(map(len, batches))
    if count <= SAMPLED:
        return 1.0
    some = np.concatenate([one.position[:: -(-count // SAMPLED)].astype(np.float64) + one.origin for one in batches])
    position = some @ matrix[:3, :3].T + matrix[:3, 3]
    position = position[np.isfinite(position).all(axis=1)]
    wider = 1.0
    while wider < 1e6:
        level = _levels(position, spacing, wider)
        if len(np.unique(hashed(np.column_stack([level, cells(position, level)[0]])))) <= MOST_CELLS:
            break
        wider *= 2
    return wider


def _levels(position: np.ndarray, spacing: Spacing, wider: float) -> np.ndarray:
    """(N,): binary logarithms of the edges of cells at places (N, 3)."""
    return np.rint(np.log2(np.maximum(spacing(position.T)[0] * wider, 1e-30)))


def _of_cells(splats: CapturedSplats, matrix: np.ndarray, spacing: Spacing, wider: float, most: int) -> _CellSums:
    """Sums over parts of some splats, of which there are at most so many or twice as many as splats."""
    splats, position, axes = _in_world(splats, matrix)
    if len(position) == 0:
        return _CellSums(np.zeros(0, np.uint64), np.zeros((0, 4)), np.zeros((COLUMNS, 0)))
    opacity = np.minimum(splats.opacity.astype(np.float64), MOST_ALPHA)
    normal, front, beside = _pictures(axes, opacity)
    level = _levels(position, spacing, wider)
    parts = _cut(position, axes, opacity, np.exp2(level), most)
    own = parts.own
    level = level[own]
    # Of the area that stands for both a disk and a ball, how much is the disk's.
    area, flat = front + beside, np.maximum(front - beside, 0) / np.maximum(front + beside, 1e-300)
    weight = area[own] * parts.weight
    color = linear_from_srgb(np.maximum(0.5 + DEGREE_0 * splats.base.astype(np.float64), 0))
    numbered = np.column_stack([level, cells(parts.position, level)[0]])
    away = (parts.position - _corners(numbered)).T
    of = np.empty((COLUMNS, len(own)))
    of[WHOLE], of[MIDDLE], of[LIGHT] = 1, away, color[own].T
    for row, (i, j) in enumerate(PAIRS):
        of[TURNED][row] = (flat * normal[:, i] * normal[:, j] + (i == j) * (1 - flat) / 3)[own]
        of[SPREAD][row] = away[i] * away[j] + (parts.width[i] * parts.width[j]).sum(axis=0)
    of[PICTURE] = EVEN * np.sqrt((parts.width[:, :2] ** 2).sum(axis=0).prod(axis=0))
    of *= weight
    return _together(hashed(numbered), numbered, of)


def _together(key: np.ndarray, cell: np.ndarray, of: np.ndarray) -> _CellSums:
    """Adds up what lies in equal cells."""
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.append(True, key[order][1:] != key[order][:-1])[: len(key)])
    rows = order[first]
    sums = np.add.reduceat(of[:, order], first, axis=1) if len(first) else of
    return _CellSums(key[rows], cell[rows], sums)


def _in_world(splats: CapturedSplats, matrix: np.ndarray) -> tuple[CapturedSplats, np.ndarray, np.ndarray]:
    """Splats that show, their places (N, 3), and half-axes (3, 3, N): coordinate, which, the shortest last."""
    linear = matrix[:3, :3]
    shown = np.flatnonzero(splats.opacity >= LEAST_ALPHA)
    scale = splats.scale[shown].astype(np.float64)
    scale = np.maximum(scale, LEAST * scale.max(axis=1, keepdims=True, initial=0))
    own = rotation_matrices(splats.rotation[shown].T.astype(np.float64)) * scale.T
    axes = np.einsum("ij,jkn->ikn", linear, own)
    length = (axes**2).sum(axis=0)
    axes = np.take_along_axis(axes, np.argsort(-length, axis=0)[None], axis=1)
    position = (splats.position[shown].astype(np.float64) + splats.origin) @ linear.T + matrix[:3, 3]
    sound = np.isfinite(position).all(axis=1) & np.isfinite(length).all(axis=0) & (length.max(axis=0) > 0)
    return _batch(splats, shown[sound]), position[sound], axes[:, :, sound]


def _pictures(axes: np.ndarray, opacity: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normals (N, 3), and the integrals of optical depths over the pictures of splats, (N,) from before and in the mean
    from beside."""
    a, b, c = axes.transpose(1, 2, 0)
    faces = [np.cross(one, other) for one, other in ((a, b), (b, c), (c, a))]
    front, *beside = (np.sqrt((face**2).sum(axis=1)) for face in faces)
    depth = 2 * np.pi * dilogarithm(opacity)
    return faces[0] / np.maximum(front, 1e-300)[:, None], depth * front, depth * 0.5 * sum(beside)


def dilogarithm(x: np.ndarray) -> np.ndarray:
    """Li2 of x (N,), 0 <= x <= 1, within 1e-10."""
    # Landen's relation by which the series converges from a half on: Li2(x) + Li2(1 - x) = pi^2 / 6 - ln(x) ln(1 - x).
    small = np.where(x > 0.5, 1 - x, x)
    series, power = np.zeros_like(small), np.ones_like(small)
    for k in range(1, 32):
        power = power * small
        series += power / (k * k)
    logs = np.log(np.maximum(x, 1e-300)) * np.log(np.maximum(1 - x, 1e-300))
    return np.where(x > 0.5, np.pi**2 / 6 - logs - series, series)


def _cut(position: np.ndarray, axes: np.ndarray, opacity: np.ndarray, cell: np.ndarray, most: int) -> _Parts:
    """Cuts splats along their two longest half-axes to what is small beside a cell, (N,) wide; to larger parts where
    there would be too many."""
    length = np.sqrt((axes[:, :2] ** 2).sum(axis=0))
    for _ in range(32):
        along = np.clip(np.ceil(2 * AROUND * length / (PART * cell)), 1, MOST_ALONG).astype(np.int64)
        whole = (2 * AROUND * length <= cell).all(axis=0)
        along[:, whole] = 1
        count = along.prod(axis=0)
        if count.sum() <= max(most, 2 * len(position)):
            break
        cell = np.where(whole, 1.0, 1.4) * cell
    own = owners(count)
    number = ranges(np.zeros(len(count), np.int64), count)
    k = along[:, own]
    index = np.stack([number % k[0], number // k[0]])
    at = np.where(k > 1, ((index + 0.5) / k - 0.5) * 2 * AROUND, 0.0)
    depth = -np.log1p(-opacity[own] * np.exp(-0.5 * (at**2).sum(axis=0)))
    total = np.add.reduceat(depth, starts(count))
    # Of what is not cut, by the picture of one splat; of parts, by even patches.
    wide = np.where(k > 1, 2 * AROUND / k / np.sqrt(EVEN), np.sqrt(BELL / EVEN))
    wide = np.concatenate([wide, np.ones((1, len(own)))])
    away = (at[None] * axes[:, :2, own]).sum(axis=1)
    return _Parts(position[own] + away.T, depth / total[own], axes[:, :, own] * wide[None], own)


def _cofactors(of: np.ndarray) -> np.ndarray:
    """(3, 3, N) of matrices (3, 3, N)."""
    rows = [np.cross(of[(k + 1) % 3], of[(k + 2) % 3], axis=0) for k in range(3)]
    return np.stack(rows)
