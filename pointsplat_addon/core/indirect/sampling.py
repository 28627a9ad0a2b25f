"""Samples of meshes from which light is gathered: as dense as a view needs, and denser where it looks from near.

A triangle is cut into congruent parallelograms, rectangles where it has a right angle, each with a sample in its
middle, so that the samples of a surface tile it; a triangle is left at the end of each row.
Smaller triangles are taken together, in Morton order, up to what is worth one sample, where they lie side by side and
are turned one way: their areas add up to the whole.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..numeric.morton import morton_codes, sorted_by_code
from ..numeric.record import record
from ..numeric.segments import owners, ranges, segment_sums
from ..numeric.vectors import cross, dot, each_block, take_columns
from ..scene.mesh import Mesh, triangle_corners
from ..surface.samples import Samples

BIGGEST_PART = 0.4  # of its distance: the longest edge of what one spacing holds for
LARGEST = 1.25  # samples that a piece may be worth
SMALLEST = 0.3  # and below which even parts of triangles are taken together
MOST_CUTS = 24  # times that a triangle is halved
MOST_PARTS = 1 << 20  # of all triangles of a mesh
SLIVER = 8.0  # square of the longest edge over the area, from which on a triangle is cut to the length of its samples
TURNED_ONE_WAY = 0.9  # length of the mean of unit normals, below which triangles are not taken together
COMPACT = 0.5  # variance of places over the area, above which they are not either: of a square it is a sixth
WIDE = 0.5  # variance of places over the square of the spacing, above which they are not in any case
REFINEMENTS, FINER = 4, 4.0  # times that groups of triangles are divided; into so many
ALIKE = 2  # times that those are which are turned several ways
# Of places (3, n): how far apart samples are to be there, and how far away the viewer is, (n,) each.
Spacing = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


@record
class LightSamples:
    """N samples of a mesh, where they lie and what each stands for."""

    samples: Samples  # for attributes
    position: np.ndarray  # (N, 3) float64
    normal: np.ndarray  # (N, 3) float64, unit
    area: np.ndarray  # (N,) float64
    # (N, 3) float64: one side of the rectangle that it is, or of the triangle, from whose right angle the other one
    # lies on the left; (0, 0, 0): it is neither
    edge: np.ndarray
    half: np.ndarray  # (N,) bool: it is a triangle


@record
class _Parts:
    """Parts of triangles: the weights (3 corners, 2, M) of their corners, and their triangles (M,)."""

    weights: np.ndarray
    triangle: np.ndarray

    def take(self, rows: np.ndarray) -> _Parts:
        return _Parts(self.weights.take(rows, axis=2), self.triangle[rows])


def light_samples(mesh: Mesh, spacing: Spacing) -> LightSamples:
    """Samples a mesh for light.

    `spacing` tells for places (3, n) float64 in object space how far apart samples are to be there, (n,), and how far
    away the viewer is, (n,), both in object units.
    """
    parts, corners, product, apart = _parts(mesh, spacing)
    twice = np.sqrt(dot(product, product))
    area, middle = 0.5 * twice, (corners[0] + corners[1] + corners[2]) / 3
    normal = product / np.maximum(twice, 1e-300)
    worth = area / np.maximum(apart, 1e-300) ** 2  # samples
    # Parts of triangles that were cut tile these; what is taken together does not.
    cut = np.bincount(parts.triangle, minlength=len(mesh.triangles))[parts.triangle] > 1
    split_up = (worth > 1.0) | (cut & (worth > SMALLEST))
    many, few = np.flatnonzero(split_up), np.flatnonzero(~split_up & (area > 0))
    split = _split(parts.take(many), corners.take(many, axis=2), worth[many])
    pieces = area[many][split.own] * split.share
    small = np.bincount(parts.triangle, worth)[parts.triangle[few]] < 1
    merged = _merged(middle.take(few, axis=1), normal.take(few, axis=1), area[few], worth[few], small)
    together = parts.take(few[merged.row])
    samples = Samples(
        "AREA",
        np.concatenate([split.triangle, together.triangle]).astype(np.int32),
        np.concatenate([split.barycentric, together.weights.mean(axis=0).T]).astype(np.float32),
        np.concatenate(
            [split.ellipse, _ellipses(together.weights, np.sqrt(merged.area / area[few[merged.row]]))]
        ).astype(np.float32),
    )
    return LightSamples(
        samples,
        np.concatenate([split.position, merged.position]),
        np.concatenate([normal.take(many[split.own], axis=1).T, merged.normal]),
        np.concatenate([pieces, merged.area]),
        np.concatenate([split.edge, np.zeros_like(merged.position)]),
        np.append(split.half, np.zeros(len(merged.area), bool)),
    )


def _parts(mesh: Mesh, spacing: Spacing) -> tuple[_Parts, np.ndarray, np.ndarray, np.ndarray]:
    """Parts of triangles over which the spacing hardly changes, and no slivers; their corners (3 corners, 3, M), the
    cross products of their sides (3, M), and how far apart samples are to be there, (M,)."""
    triangle = np.arange(len(mesh.triangles))
    weights = np.zeros((3, 2, len(triangle)))
    weights[1, 0] = weights[2, 1] = 1.0
    corners = triangle_corners(mesh, slice(None))
    done: list[tuple[np.ndarray, ...]] = []
    count = 0
    for again in range(MOST_CUTS + 1):
        a, b, c = corners
        opposite = c - b, a - c, b - a
        edges = np.stack([dot(edge, edge) for edge in opposite])
        squared = edges.max(axis=0)
        size, product = np.sqrt(squared), cross(opposite[1], opposite[2])
        apart, away = spacing((a + b + c) / 3)
        cut = size > BIGGEST_PART * np.maximum(away - 0.5 * size, 0.0)
        cut |= (size > 0.5 * apart) & (squared > 0.5 * SLIVER * np.sqrt(dot(product, product)))
        found, whole = (weights, triangle, corners, product, apart), np.flatnonzero(~cut)
        count += len(whole)
        cuts = len(cut) - len(whole)
        if cuts == 0 or again == MOST_CUTS or count + 2 * cuts > MOST_PARTS:
            done.append(found)
            break
        done.append(tuple(one.take(whole, axis=-1) for one in found))
        parted = np.flatnonzero(cut)
        apex = edges.take(parted, axis=1).argmax(axis=0)
        triangle = np.tile(triangle[parted], 2)
        weights, corners = (_halves(one, parted, apex) for one in (weights, corners))
    weights, triangle, corners, product, apart = (np.concatenate(parts, axis=-1) for parts in zip(*done, strict=True))
    return _Parts(weights, triangle), corners, product, apart


def _halves(corners: np.ndarray, rows: np.ndarray, apex: np.ndarray) -> np.ndarray:
    """(3 corners, C, 2 n): the two halves of some of triangles (3 corners, C, M), `rows` (n,), cut from corners `apex`
    (n,)."""
    _, coordinates, size = corners.shape
    flat, found = corners.ravel(), np.empty((3, coordinates, 2, len(rows)))

    def cut(block: slice) -> None:
        turned = [(apex[block] + k) % 3 * (coordinates * size) + rows[block] for k in range(3)]
        for c in range(coordinates):
            first, second, third = (flat[c * size :].take(at) for at in turned)
            found[0, c, :, block] = first
            found[1, c, 0, block], found[2, c, 1, block] = second, third
            found[1, c, 1, block] = found[2, c, 0, block] = 0.5 * (second + third)

    each_block(len(rows), cut)
    return found.reshape(3, coordinates, -1)


@record
class _Split:
    own: np.ndarray  # (N,) int64: of which part of a triangle each is
    share: np.ndarray  # (N,) float64: of its area
    triangle: np.ndarray  # (N,)
    barycentric: np.ndarray  # (N, 2)
    ellipse: np.ndarray  # (N, 2, 2)
    position: np.ndarray  # (N, 3)
    edge: np.ndarray  # (N, 3)
    half: np.ndarray  # (N,)


def _split(parts: _Parts, corners: np.ndarray, worth: np.ndarray) -> _Split:
    """One sample in the middle of each piece of parts of triangles, which are worth so many samples, (M,), each.
    corners: (3, 3, M)."""
    # The first corner is the one with the widest angle.
    opposite = np.stack([corners[(k + 2) % 3] - corners[(k + 1) % 3] for k in range(3)])
    apex, rows = (opposite**2).sum(axis=1).argmax(axis=0), np.arange(len(worth))
    weights = np.stack([parts.weights[(apex + k) % 3, :, rows].T for k in range(3)])
    corners = np.stack([corners[(apex + k) % 3, :, rows].T for k in range(3)])
    k = np.where(worth <= LARGEST, 1, np.ceil(np.sqrt(2 * worth / LARGEST))).astype(np.int64)
    count = k * (k + 1) // 2
    own = owners(count, np.int64)
    number = ranges(np.zeros(len(count), np.int64), count, np.int64)
    k = k[own]
    # Row r holds k - r pieces, the last of which is a triangle: r k - r (r - 1) / 2 come before it.
    row = np.floor((2 * k + 1 - np.sqrt((2.0 * k + 1) ** 2 - 8.0 * number)) / 2 + 1e-9).astype(np.int64)
    place = number - (row * k - row * (row - 1) // 2)
    last = place == k - row - 1
    middle = np.where(last, 1 / 3, 0.5)
    first, second = (place + middle) / k, (row + middle) / k
    weights, corners = weights.take(own, axis=2), corners.take(own, axis=2)
    at, position = (x[0] + first * (x[1] - x[0]) + second * (x[2] - x[0]) for x in (weights, corners))
    edge = (corners[1] - corners[0]) / k
    share = np.where(last, 1.0, 2.0) / (k * k)
    return _Split(own, share, parts.triangle[own], at.T, _ellipses(weights, np.sqrt(share)), position.T, edge.T, last)


@record
class _Merged:
    """Triangles that are taken together."""

    row: np.ndarray  # (N,): one of each
    position: np.ndarray  # (N, 3)
    normal: np.ndarray  # (N, 3), unit
    area: np.ndarray  # (N,)


def _merged(middle: np.ndarray, normal: np.ndarray, area: np.ndarray, worth: np.ndarray, small: np.ndarray) -> _Merged:
    """Takes triangles together that are worth less than one sample each.

    (3, M) middles and normals, (M,) areas. `small` (M,) bool: no parts of triangles that are worth more.
    """
    if len(area) == 0:
        none = np.zeros((0, 3))
        return _Merged(np.zeros(0, np.int64), none, none, np.zeros(0))
    order, _ = sorted_by_code(morton_codes(middle.T.astype(np.float32))[0])
    centre = middle.mean(axis=1, keepdims=True)
    middle = middle - centre
    rows = area, *(middle * area), *(normal * area), dot(middle, middle) * area, worth
    columns = take_columns(np.stack(rows), order)
    worth = worth[order]
    kind, mixed = np.zeros(len(order), np.int64), np.zeros(len(order), bool)
    for again in range(REFINEMENTS + 1):
        group = np.floor(np.cumsum(worth) - 0.5 * worth)
        new = np.append(True, (group[1:] != group[:-1]) | (kind[1:] != kind[:-1]))
        groups = _groups(columns, new)
        turned = groups.length < TURNED_ONE_WAY
        apart = turned | (groups.spread > COMPACT * groups.sums[0])
        if again >= ALIKE:
            # They tile nothing evenly, and need not be compact.
            apart[mixed[groups.first]] = False
            apart |= mixed[groups.first] & (groups.spread > WIDE * groups.sums[0] / groups.sums[8])
        apart &= groups.several
        if again == REFINEMENTS or not apart.any():
            break
        number = np.cumsum(new) - 1
        finer = apart[number]
        if again == 0:
            # Small triangles that are turned several ways are taken apart by the side that they are turned to.
            mixed = finer & turned[number] & small[order]
            finer &= ~mixed
            facing = columns[4:7]
            axis = np.abs(facing).argmax(axis=0)
            side = 2 * axis + (facing[axis, np.arange(len(axis))] < 0)
            kind = np.where(mixed, 6 * number + side + 1, 0)
            rows = np.argsort(kind, kind="stable")
            order, kind, mixed, finer = order[rows], kind[rows], mixed[rows], finer[rows]
            worth, columns = worth[rows], take_columns(columns, rows)
        worth[finer] = np.minimum(worth[finer] * FINER, 1.0)
    # What is left stays by itself.
    groups = _groups(columns, new | apart[np.cumsum(new) - 1])
    first, sums = groups.first, groups.sums
    own = normal[:, order[first]]
    facing = np.where(groups.length > 1e-3, sums[4:7] / np.maximum(groups.length * sums[0], 1e-300), own)
    middle_row = (first + np.append(first[1:], len(order))) // 2
    return _Merged(order[middle_row], (sums[1:4] / sums[0] + centre).T, facing.T, sums[0])


@record
class _Groups:
    """n groups of triangles."""

    first: np.ndarray  # (n,) int64: where they begin
    sums: np.ndarray  # (9, n): of area, and times it place, normal and squared place, and of worth
    length: np.ndarray  # (n,): of the mean normal
    spread: np.ndarray  # (n,): variance of places
    several: np.ndarray  # (n,) bool: they hold more than one


def _groups(columns: np.ndarray, new: np.ndarray) -> _Groups:
    """columns (9, M): as _Groups.sums, of triangles. new (M,) bool: where groups begin."""
    first = np.flatnonzero(new)
    sums = segment_sums(columns, first)
    length = np.sqrt(dot(sums[4:7], sums[4:7])) / sums[0]
    spread = sums[7] / sums[0] - dot(sums[1:4], sums[1:4]) / sums[0] ** 2
    return _Groups(first, sums, length, spread, np.diff(np.append(first, len(new))) > 1)


def _ellipses(weights: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """(N, 2, 2): conjugate half-diameters of the ellipses with the areas of parts (3, 2, N) that are scaled."""
    a, b, c = weights
    # The Steiner circumellipse has the half-diameters a - m and (b - c) / sqrt(3), and 4 pi / (3 sqrt(3)) of the area.
    narrowed = scale * np.sqrt(3 * np.sqrt(3) / (4 * np.pi))
    middle = (a + b + c) / 3
    return np.stack([(narrowed * (a - middle)).T, (narrowed / np.sqrt(3) * (b - c)).T], axis=1)
