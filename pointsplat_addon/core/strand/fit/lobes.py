"""Ribbons of flat parts with lobes about a hub, as of maple leaves: one for each lobe and one between them."""

from __future__ import annotations

import numpy as np

from ...numeric.record import record
from ...numeric.segments import owners
from .flat import FlatParts
from .measures import sums_by_row, triangle_areas
from .outlines import DIRECTIONS, direction_bin, find_hubs, polar_outlines, split_into_lobes
from .result import AREA_ERROR, PartStrands, no_strands

PROFILE_STEPS = 16  # along a lobe, to find where it is widest
EDGE_SAMPLES = 4  # along an edge of a triangle whose area is shared out


@record
class _SurfaceSamples:
    """N samples all over flat parts. Coordinates are along the parts' two axes and across them, from the hubs."""

    own: np.ndarray  # (N,) int64: rows of parts
    position: np.ndarray  # (N, 3) float64
    area: np.ndarray  # (N,) float64: each one's share
    facing: np.ndarray  # (N, 3) float64, unit normals

    def at(self, rows: np.ndarray) -> _SurfaceSamples:
        return _SurfaceSamples(self.own[rows], self.position[rows], self.area[rows], self.facing[rows])


def fit_lobes(flat: FlatParts) -> PartStrands:
    """Ribbons of two points for flat parts with lobes about a hub: one for each lobe and one for what lies between
    them, if they need fewer points than the part has vertices."""
    if len(flat.part) == 0:
        return no_strands()
    hub = find_hubs(flat)
    outline = polar_outlines(flat, hub)
    lobe, number = split_into_lobes(outline)
    fits = (number > 2) & (2 * number + 2 < flat.vertices)
    fits &= np.abs((outline**2).sum(axis=1) * np.pi / DIRECTIONS - flat.area) <= AREA_ERROR * flat.area
    if not fits.any():
        return no_strands()
    flat, hub, lobe, number = (flat.only(fits), *(a[fits] for a in (hub, lobe, number)))
    count, most = len(number), int(number.max())
    samples = _sample_flat_parts(flat, hub)
    ends, radius, normal, beyond = _fit_triangles(samples, _farthest_corners(flat, hub, lobe, most), lobe)
    middle = _fit_rectangles(samples.at(~beyond), count)

    # Lobe by lobe; the ribbon between them comes last
    kept = np.arange(most + 1) < number[:, None]
    kept[:, most] = True
    points, radius, normal = (
        np.concatenate([a.reshape(count, most, *a.shape[1:]), b[:, None]], axis=1)[kept]
        for a, b in zip((ends, radius, normal), middle, strict=True)
    )
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    row = owners(number + 1)
    points[..., :2] += hub[row][:, None]
    points = flat.middle[row][:, None] + np.einsum("nki,nij->nkj", points, flat.axes[row])
    return PartStrands(
        points.reshape(-1, 3), radius.ravel(), np.repeat(normal, 2, axis=0), np.full(len(row), 2), flat.part[row]
    )


def _sample_flat_parts(flat: FlatParts, hub: np.ndarray) -> _SurfaceSamples:
    weights = _barycentric(EDGE_SAMPLES)
    corner = np.einsum("tki,tji->tkj", flat.corner - flat.middle[flat.own][:, None], flat.axes[flat.own])
    corner[..., :2] -= hub[flat.own][:, None]
    return _SurfaceSamples(
        np.repeat(flat.own, len(weights)),
        np.einsum("pk,tki->tpi", weights, corner).reshape(-1, 3),
        np.repeat(triangle_areas(flat.corner) / len(weights), len(weights)),
        np.repeat(flat.facing, len(weights), axis=0),
    )


def _farthest_corners(flat: FlatParts, hub: np.ndarray, lobe: np.ndarray, most: int) -> np.ndarray:
    """(C most, 2) from the hub, the corner of each lobe that is farthest from it; (1, 0) of lobes that are none."""
    own = np.repeat(flat.own, 3)
    corner = np.stack([flat.height.ravel(), flat.sideways.ravel()], axis=1) - hub[own]
    group = own * most + lobe[own, direction_bin(corner)]
    order = np.lexsort((-np.einsum("ni,ni->n", corner, corner), group))
    first = order[np.concatenate([[True], np.diff(group[order]) > 0])]
    tip = np.tile([1.0, 0.0], (len(hub) * most, 1))
    tip[group[first]] = corner[first]
    return tip


def _fit_triangles(
    samples: _SurfaceSamples, tip: np.ndarray, lobe: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Returns for L lobes of each of C parts a triangle from where it is widest, which is where most of its area lies,
    to its tip (C L, 2): of the area that lies beyond, and beside the middle of that. Points (C L, 2, 3), half
    widths (C L, 2), normals (C L, 3) of any length, and which samples (N,) bool lie beyond."""
    lobes = len(tip)
    group = samples.own * (lobes // len(lobe)) + lobe[samples.own, direction_bin(samples.position)]
    reach = np.linalg.norm(tip, axis=1)
    ahead = tip / reach[:, None]
    aside = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    along = np.einsum("ni,ni->n", samples.position[:, :2], ahead[group])
    step = np.floor(PROFILE_STEPS * along / reach[group]).astype(np.int64)
    inner = (step >= 0) & (step < PROFILE_STEPS - 1)
    profile = np.bincount((group * PROFILE_STEPS + step)[inner], samples.area[inner], lobes * PROFILE_STEPS).reshape(
        -1, PROFILE_STEPS
    )
    base = profile.argmax(axis=1) * reach / PROFILE_STEPS
    beyond = along >= base[group]

    own, along, there = group[beyond], along[beyond], samples.at(beyond)
    total = np.bincount(own, there.area, lobes)
    rise, slope = _weighted_line(own, along, there.position[:, 2], there.area, lobes)
    off = np.einsum("ni,ni->n", there.position[:, :2], aside[own])
    # The middle of a triangle lies a third of the way from its base to its tip
    off = 1.5 * np.bincount(own, there.area * off, lobes) / np.maximum(total, 1e-300)
    ends = np.zeros((lobes, 2, 3))
    ends[:, 0, :2] = base[:, None] * ahead + off[:, None] * aside
    ends[:, 1, :2] = tip
    ends[:, :, 2] = rise[:, None] + slope[:, None] * np.stack([base, reach], axis=1)
    radius = np.stack([total / (reach - base), np.zeros(lobes)], axis=1)
    return ends, radius, sums_by_row(own, there.area[:, None] * there.facing, lobes), beyond


def _fit_rectangles(samples: _SurfaceSamples, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns for each part a rectangle with its samples' area and variance along the longer axis: points
    (C, 2, 3), half widths (C, 2) and normals (C, 3) of any length."""
    own, area = samples.own, samples.area
    whole = np.maximum(np.bincount(own, area, count), 1e-300)
    middle = sums_by_row(own, area[:, None] * samples.position, count) / whole[:, None]
    off = (samples.position - middle[own])[:, :2]
    moments = sums_by_row(own, area[:, None, None] * off[:, :, None] * off[:, None], count) / whole[:, None, None]
    variance, axes = np.linalg.eigh(moments)
    half = np.sqrt(3 * np.maximum(variance[:, 1], 1e-300))
    rise, slope = _weighted_line(own, np.einsum("ni,ni->n", off, axes[own, :, 1]), samples.position[:, 2], area, count)
    to = half[:, None] * np.array([-1.0, 1.0])
    flat = middle[:, None, :2] + to[..., None] * axes[:, None, :, 1]
    ends = np.concatenate([flat, (rise[:, None] + slope[:, None] * to)[..., None]], axis=2)
    radius = np.repeat((whole / (4 * half))[:, None], 2, axis=1)
    return ends, radius, sums_by_row(own, area[:, None] * samples.facing, count)


def _barycentric(steps: int) -> np.ndarray:
    """(steps^2, 3) barycentric coordinates of the middles of as many equal parts of a triangle."""
    i, j, upper = np.meshgrid(np.arange(steps), np.arange(steps), (0, 1), indexing="ij")
    inside = i + j + upper < steps
    a, b = ((k[inside] + (1 + upper[inside]) / 3) / steps for k in (i, j))
    return np.stack([a, b, 1 - a - b], axis=1)


def _weighted_line(
    own: np.ndarray, x: np.ndarray, y: np.ndarray, weight: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """(count,) heights at 0 and slopes of the lines that are nearest to samples (N,) of each row by least squares."""
    w, wx, wy, wxx, wxy = (np.bincount(own, weight * v, count) for v in (np.ones_like(x), x, y, x * x, x * y))
    w = np.maximum(w, 1e-300)
    variance = wxx / w - (wx / w) ** 2
    slope = np.where(variance > 0, (wxy / w - wx * wy / w**2) / np.where(variance > 0, variance, 1), 0.0)
    return wy / w - slope * wx / w, slope
