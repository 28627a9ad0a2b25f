"""Samples of meshes from which light is gathered: as dense as a view needs, and denser where it looks from near.

A triangle is cut into congruent parts, each with a sample in its middle, so that the samples of a surface tile it.
Of triangles smaller than that, samples follow at even steps of the surface that is worth one sample (systematic
sampling), so that what they stand for adds up to the whole.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..numeric.record import record
from ..numeric.segments import owners, ranges
from ..numeric.vectors import cross, dot
from ..scene.mesh import Mesh, triangle_corners
from ..surface.samples import Samples

BIGGEST_PART = 0.25  # of its distance: the longest edge of what one spacing holds for
MOST_CUTS = 24  # times that a triangle is halved
MOST_PARTS = 1 << 20  # of all triangles of a mesh
Spacing = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


@record
class LightSamples:
    """N samples of a mesh and what each stands for."""

    samples: Samples
    area: np.ndarray  # (N,) float64, object units squared


def light_samples(mesh: Mesh, spacing: Spacing, finest: float) -> LightSamples:
    """Samples a mesh for light.

    `spacing` tells for places (3, n) float64 in object space how far apart samples are to be there, (n,), and how far
    away the viewer is, (n,), both in object units. `finest`: no part is cut below this edge.
    """
    weights, triangle = _parts(mesh, spacing, finest)
    corners = _places(mesh, triangle, weights)
    product = cross(corners[1] - corners[0], corners[2] - corners[0])
    area = 0.5 * np.sqrt(dot(product, product))
    apart, _ = spacing(corners.mean(axis=0))
    worth = area / np.maximum(apart, 1e-300) ** 2  # samples
    many = worth > 1.0
    split = _split(triangle[many], weights[:, :, many], area[many], worth[many])
    thinned = _thinned(triangle[~many], weights[:, :, ~many], area[~many], worth[~many])
    found = [np.concatenate(pair) for pair in zip(split, thinned, strict=True)]
    samples = Samples("AREA", found[0].astype(np.int32), found[1].astype(np.float32), found[2].astype(np.float32))
    return LightSamples(samples, found[3])


def _parts(mesh: Mesh, spacing: Spacing, finest: float) -> tuple[np.ndarray, np.ndarray]:
    """Parts of triangles over which the spacing hardly changes: the weights (3 corners, 2, M) of their corners, and
    their triangles (M,)."""
    triangle = np.arange(len(mesh.triangles))
    weights = np.zeros((3, 2, len(triangle)))
    weights[1, 0] = weights[2, 1] = 1.0
    done_weights, done_triangle, count = [], [], 0
    for _ in range(MOST_CUTS):
        corners = _places(mesh, triangle, weights)
        edges = np.stack(
            [dot(e, e) for e in (corners[2] - corners[1], corners[0] - corners[2], corners[1] - corners[0])]
        )
        longest, size = edges.argmax(axis=0), np.sqrt(edges.max(axis=0))
        _, away = spacing(corners.mean(axis=0))
        cut = (size > BIGGEST_PART * np.maximum(away - 0.5 * size, 0.0)) & (size > finest)
        done_weights.append(weights[:, :, ~cut])
        done_triangle.append(triangle[~cut])
        count += len(done_triangle[-1])
        if not cut.any() or count + 2 * np.count_nonzero(cut) > MOST_PARTS:
            done_weights.append(weights[:, :, cut])
            done_triangle.append(triangle[cut])
            break
        rows = np.arange(np.count_nonzero(cut))
        apex = longest[cut]
        turned = np.stack([weights[:, :, cut][(apex + k) % 3, :, rows] for k in range(3)])  # (corner, M, 2)
        middle = 0.5 * (turned[1] + turned[2])
        halves = np.stack(
            [np.concatenate(pair) for pair in ((turned[0], turned[0]), (turned[1], middle), (middle, turned[2]))]
        )
        weights, triangle = np.ascontiguousarray(halves.transpose(0, 2, 1)), np.tile(triangle[cut], 2)
    else:
        done_weights.append(weights)
        done_triangle.append(triangle)
    return np.concatenate(done_weights, axis=2), np.concatenate(done_triangle)


def _places(mesh: Mesh, triangle: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(3 corners, 3, M) float64 of parts of triangles."""
    a, b, c = triangle_corners(mesh, triangle)
    return np.stack([a + w[0] * (b - a) + w[1] * (c - a) for w in weights])


def _split(
    triangle: np.ndarray, weights: np.ndarray, area: np.ndarray, worth: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """One sample in the middle of each of k^2 congruent parts of parts of triangles."""
    k = np.ceil(np.sqrt(worth)).astype(np.int64)
    count = k * k
    own = owners(count, np.int64)
    number = ranges(np.zeros(len(count), np.int64), count, np.int64)
    k = k[own]
    # Row r of a triangle of k rows holds 2 (k - r) - 1 parts: r = k - ceil(sqrt(k^2 - number)).
    row = k - np.ceil(np.sqrt((k * k - number).astype(np.float64))).astype(np.int64)
    place = number - row * (2 * k - row)
    down = place & 1
    first, second = ((place >> 1) + (1 + down) / 3) / k, (row + (1 + down) / 3) / k
    a, b, c = weights[:, :, own]
    middle = a + first * (b - a) + second * (c - a)
    return triangle[own], middle.T, _ellipses(weights[:, :, own], 1.0 / k), area[own] / (k * k)


def _thinned(
    triangle: np.ndarray, weights: np.ndarray, area: np.ndarray, worth: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Samples in the middles of some parts, as many as all are worth together."""
    ends = np.cumsum(worth)
    total = float(ends[-1]) if len(ends) else 0.0
    count = max(round(total), 1) if total > 0 else 0
    rows = np.searchsorted(ends, (np.arange(count) + 0.5) * (total / max(count, 1)))
    rows = np.minimum(rows, max(len(triangle) - 1, 0))
    # What lies between two samples is shared by them: as much surface as a sample is worth where it lies.
    stands_for = area[rows] / np.maximum(worth[rows], 1e-300) * (total / max(count, 1))
    middle = weights[:, :, rows].mean(axis=0).T
    wider = np.sqrt(stands_for / np.maximum(area[rows], 1e-300))
    return triangle[rows], middle, _ellipses(weights[:, :, rows], wider), stands_for


def _ellipses(weights: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """(N, 2, 2): conjugate half-diameters of the ellipses with the areas of parts (3, 2, N) that are scaled."""
    a, b, c = weights
    # The Steiner circumellipse has the half-diameters a - m and (b - c) / sqrt(3), and 4 pi / (3 sqrt(3)) of the area.
    narrowed = scale * np.sqrt(3 * np.sqrt(3) / (4 * np.pi))
    middle = (a + b + c) / 3
    return np.stack([(narrowed * (a - middle)).T, (narrowed / np.sqrt(3) * (b - c)).T], axis=1)
