"""Which segments of strands a view draws, and how much of a pixel's width each of them covers.

A segment that is wider than the raster's line is drawn with its exact outline. A thinner one is a line of one pixel, in
the share of a picture's samples that is its own width over the line's (`Segments.share`): the mean over samples has its
area, and no sample draws what is not needed for that. Short strands are not seen to be broken, and have their outlines
although they are thinner. Where all that inner points of a strand change is below a fraction of a pixel they are left
out by powers of two, and what is drawn keeps the area of what it stands for.
"""

from __future__ import annotations

import numpy as np

from ..numeric.lattice import Lattice
from ..numeric.record import value_record
from ..scene.camera import Camera
from .levels import StrandBounds, StrandLevels
from .projection import ProjectedStrands, cell_shares, in_picture, line_shares, project
from .segments import ROUND, THIN, Segments, all_segments, no_segments

OUTLINE_ERROR = 0.25  # of the tolerance: how far leaving out inner points may move an outline
INVISIBLE_LENGTH = 1.0  # pixels: changes along shorter segments are not seen
UNBROKEN_LENGTH = 16.0  # pixels: shorter strands do not look broken where samples leave out some of their segments
LEAST_OUTLINED = 0.25  # widths of the raster's line: wider short strands are drawn with their outlines
LEAST_WIDTH = (
    0.1  # pixels: below this width drawing few strands in each sample saves more time than choosing them costs
)
FEW_POINTS = 3  # mean number of points of a strand up to which little could be left out
MARGIN = 2.0  # pixels beyond the picture that lines of one pixel may come from
LEAST_SIMPLIFIED = 0.02  # share of the strands: simplifying fewer saves less time than it costs


def select(
    strands: StrandLevels,
    view_from_object: np.ndarray,
    instance: int,
    camera: Camera,
    tolerance: float,
    lattice: Lattice | None = None,
    culled: bool = True,
) -> Segments:
    """The segments of one instance that a camera may see. view_from_object: (4, 4) float64; instance: its row in
    Scene.instances; tolerance: pixels; lattice: of sub-samples, if many are drawn at once. culled: without those that
    lie outside of the picture; else they are for other cameras, too, which look the same way from close by.

    Widths of tubes scale with the cube root of the instance's volume; ribbons are scaled as surfaces are.
    """
    scale = _scale(strands.bounds, view_from_object, camera, culled) if len(strands) else None
    if scale is None:
        return no_segments()
    if _all_outlined(strands, scale):
        return all_segments(strands, instance, lattice)
    picture = project(strands, view_from_object, camera)
    first, last = strands.segment_ends.T
    level = np.zeros(len(strands.start) - 1, np.int32)
    if strands.levels:
        level = _choose_levels(strands, picture, OUTLINE_ERROR * tolerance)
        kept = strands.index_in_strand & ((np.int32(1) << level) - 1)[strands.strand] == 0
        kept[strands.start[1:] - 1] = True
        index = np.flatnonzero(kept)
        first, last = index[:-1], index[1:]
        whole = strands.strand[first] == strands.strand[last]
        first, last = first[whole], last[whole]
    if not scale.inside:
        seen = in_picture(picture, first, last, camera)
        first, last = first[seen], last[seen]
    strand = strands.strand[first]
    simplified = level[strand] > 0
    if lattice is not None:
        share = cell_shares(strands, picture, first, last, simplified, camera, lattice)
    else:
        share = line_shares(strands, picture, first, last, simplified)
        exact = (strands.sum_over_strands(picture.length) <= UNBROKEN_LENGTH) & (level == 0)
        most = np.maximum(*share.T)
        share[exact[strand] & (most >= LEAST_OUTLINED) & (most < THIN)] = THIN
    visible = (share[:, 0] != 0) | (share[:, 1] != 0)
    first, last, share, strand = first[visible], last[visible], share[visible], strand[visible]
    return Segments(
        np.stack([first, last], axis=1).astype(np.int32),
        np.full(len(first), instance, np.int32),
        strands.material[strand].astype(np.int32),
        strands.instance_phase(instance)[strand],
        share,
        int(np.count_nonzero(np.diff(strand)) + 1) if len(strand) else 0,
        lattice,
    )


@value_record
class _Scale:
    """The range of sizes at which a view shows one instance."""

    least: float  # pixels per object unit across the view, at least; 0 if that is not known
    most: float  # pixels per object unit, at most; infinite if part of the instance may lie at the near plane
    inside: bool  # the whole instance lies in the picture


def _scale(bounds: StrandBounds, view_from_object: np.ndarray, camera: Camera, culled: bool = True) -> _Scale | None:
    """The range of sizes of an instance with these bounds; None if it lies outside the picture. Where nothing is
    `culled`, everything counts as inside."""
    linear = view_from_object[:3, :3]
    x, y, z = linear @ bounds.center + view_from_object[:3, 3]
    if not (np.isfinite(linear).all() and np.isfinite([x, y, z]).all()):
        return _Scale(0.0, np.inf, not culled)
    scales = np.linalg.svd(linear, compute_uv=False)
    # Radii of tubes are scaled by the geometric mean of the three, which is no greater.
    reach = bounds.radius * float(scales[0])
    nearest, farthest = -z - reach, -z + reach
    if culled and (farthest <= camera.near or nearest >= camera.far):
        return None
    if camera.perspective and nearest <= camera.near:
        return _Scale(0.0, np.inf, not culled)
    fx, fy, cx, cy = camera.pixel_from_view()
    depths = (nearest, farthest) if camera.perspective else (1.0, 1.0)
    inside = nearest > camera.near and farthest < camera.far
    for middle, f, c, most in ((x, fx, cx, camera.window[2]), (y, fy, cy, camera.window[3])):
        sides = [f * (middle + side) / depth + c for side in (-reach, reach) for depth in depths]
        if culled and (min(sides) > most + MARGIN or max(sides) < -MARGIN):
            return None
        inside &= min(sides) >= 0 and max(sides) <= most
    f = float(np.sqrt(abs(fx * fy)))
    # Away from the centre of the picture, perspective stretches segments that lead away from the eye.
    slope = (np.array([x, y]) + reach * np.sign([x, y])) / nearest if camera.perspective else np.zeros(2)
    stretched = float(np.sqrt(1 + slope @ slope))
    return _Scale(
        f * float(scales[2]) / depths[1], stretched * f * float(scales[0]) / depths[0], bool(inside) or not culled
    )


def _all_outlined(strands: StrandLevels, scale: _Scale) -> bool:
    """Whether all segments of a geometry may be drawn with their outlines without a decision for each: strands have few
    points, are short in the picture and mostly not too thin."""
    bounds = strands.bounds
    few = len(strands) <= FEW_POINTS * (len(strands.start) - 1)
    flat = strands.side is not None or bounds.widest * scale.most < ROUND
    return (
        few and flat and bounds.longest * scale.most <= UNBROKEN_LENGTH and bounds.typical * scale.least >= LEAST_WIDTH
    )


def _choose_levels(strands: StrandLevels, picture: ProjectedStrands, allowed: float) -> np.ndarray:
    """(S,) int32: the coarsest level of each strand whose outline is off by at most `allowed` pixels."""
    q, length = picture.pixel, picture.length
    beside = 0.5 * picture.width[:, None] if picture.across is None else picture.across
    count = len(strands.start) - 1
    level, off = np.zeros(count, np.int32), np.zeros(count, np.float32)
    total = strands.sum_over_strands(length)
    # Each level has half as many segments as the one before.
    short = np.floor(np.log2(np.maximum(INVISIBLE_LENGTH * np.diff(strands.start) / np.maximum(total, 1e-20), 1)))
    most = np.maximum(strands.detail, np.minimum(short, 126))
    fine = np.ones(count, bool)
    for number, part in enumerate(strands.levels, 1):
        a, b, m = q[part.low], q[part.high], q[part.middle]
        chord, to = b - a, m - a
        squared = np.maximum(np.einsum("nc,nc->n", chord, chord), np.float32(1e-12))
        t = np.clip(np.einsum("nc,nc->n", chord, to) / squared, 0, 1)[:, None]
        away = to - t * chord
        error = np.sqrt(np.einsum("nc,nc->n", away, away))
        edge = beside[part.middle] - (beside[part.low] * (1 - t) + beside[part.high] * t)
        error += np.sqrt(np.einsum("nc,nc->n", edge, edge))
        off[part.strand] += np.maximum.reduceat(error, part.first)
        fine &= (off <= allowed) & (most >= number)
        if np.count_nonzero(fine) <= LEAST_SIMPLIFIED * count:
            break
        # A strand without inner points left to leave out gets no coarser level.
        level[part.strand[fine[part.strand]]] = number
    return level
