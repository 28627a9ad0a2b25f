"""Tubes through the sections of a part: centres, radii, and whether the sections are round enough."""

from __future__ import annotations

import numpy as np

from ...numeric.segments import owners
from .measures import triangle_areas
from .result import FLAT_RATIO, PartStrands

TUBE_AREA_ERROR = 0.4  # the same for tubes, before they are widened to it
UNSCALED_AREA_ERROR = 0.05  # and up to which they are as they are
ROUNDNESS = 0.06  # of a section's radius: how far its corners are from it in the mean; hexagons 0.05, squares 0.11


def tubes_from_sections(
    position: np.ndarray,
    triangles: np.ndarray,
    part: np.ndarray,
    start: np.ndarray,
    ends: np.ndarray,
    section: np.ndarray,
    fits: np.ndarray,
    tips: np.ndarray,
    at: np.ndarray,
    thick: float = np.inf,
) -> PartStrands:
    """Tubes through the sections of those of C parts that `fits` (C,) selects, where sections and areas allow.

    ends (n, 2, 3): edges of sections; section (n,): the section of each edge; start (C + 1,): the first section of each
    part; tips (m, 3): sections `at` (m,) of a single vertex. Sections of tubes with mean radii beyond `thick` must be
    ROUND."""
    count, total = len(fits), int(start[-1])
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    around = np.bincount(section, length, total)
    middle = ends.mean(axis=1)
    center = np.stack([np.bincount(section, length * middle[:, k], total) for k in range(3)], axis=1)
    center /= np.maximum(around, 1e-300)[:, None]
    center[at] = tips
    away = ends - center[section][:, None]
    spread = [
        np.bincount(section, length * (away[..., j] * away[..., k]).sum(axis=1), total) for j, k in np.ndindex(3, 3)
    ]
    _, short, long = np.sqrt(np.maximum(np.linalg.eigvalsh(np.stack(spread, axis=1).reshape(-1, 3, 3)), 0)).T
    # The mean width of a convex outline is its length over pi (Cauchy). A slanted cut is longer than a straight one,
    # but not across
    radius = around / (2 * np.pi) * (2 * short / np.maximum(long + short, 1e-300))
    point = np.zeros(total, bool)
    point[at] = True
    bad = ~point & ((short**2 < FLAT_RATIO * long**2) | (around <= 0))
    strand = owners(np.diff(start))
    fits = fits & (np.bincount(strand[bad], minlength=count) == 0)
    if np.isfinite(thick):
        off = np.abs(np.linalg.norm(away, axis=2).mean(axis=1) - radius[section])
        of = strand[section]
        outline, uneven = np.bincount(of, length, count), np.bincount(of, length * off, count)
        mean = np.bincount(strand, radius, count) / np.maximum(np.diff(start), 1)
        fits &= (mean <= thick) | (uneven <= ROUNDNESS * mean * outline)
    step = np.linalg.norm(np.diff(center, axis=0), axis=1) * (radius[1:] + radius[:-1])
    inside = strand[1:] == strand[:-1]
    covered = np.pi * np.bincount(strand[1:][inside], step[inside], count)
    area = np.bincount(part, triangle_areas(position[triangles]), count)
    fits &= np.abs(covered - area) <= TUBE_AREA_ERROR * area
    off = np.abs(covered - area) > UNSCALED_AREA_ERROR * area
    radius = radius * np.where(off & fits, area / np.where(covered > 0, covered, 1), 1)[strand]
    kept, chosen = np.flatnonzero(fits[strand]), np.flatnonzero(fits)
    return PartStrands(center[kept], radius[kept], np.zeros((len(kept), 3)), np.diff(start)[chosen], chosen)
