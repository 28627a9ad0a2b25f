"""Samples triangles by area: rows of equal cells, each with a covering ellipse (Gunjee et al. 2007, section 4)."""

from __future__ import annotations

import math

import numpy as np

from ..numeric.segments import owners, ranks
from ..numeric.vectors import each_block
from ..scene.mesh import Mesh
from .samples import Samples
from .triangles import Measures, measure_triangles

# Splats at a spacing s are at most s / sqrt(2) in radius: the disk around a square cell of side s.
_RADIUS = math.sqrt(0.5)
# Steiner's circumellipse has a major half-axis of at most 2/3 of the longest edge (reached by a needle with two
# long edges), so that up to this many spacings one sample is enough.
ONE_SAMPLE = 1.5 * _RADIUS
# Float32 weights are off by up to 2^-24 each; half-diameters grown by this much still cover.
_WEIGHT_SLACK = 4e-7
# Steiner's circumellipse about the centroid: corner 1 seen from there, and an edge over sqrt(3), are conjugate.
STEINER = np.array([[2 / 3, -1 / 3], [0, 1 / math.sqrt(3)]]) * (1 + 4 * _WEIGHT_SLACK)


def sample_area(
    mesh: Mesh, spacing: float, which: np.ndarray | None = None, measures: Measures | None = None
) -> Samples:
    """Samples at most `spacing` apart, one ellipse with half-axes of at most spacing / sqrt(2) for each cell.

    A triangle is cut into rows parallel to its longest edge and each row into equal columns, so that a sliver
    thinner than the spacing gets samples along its length only; a triangle smaller than a splat gets one.
    Raises ValueError for a spacing that is not a positive number, or for more than 2^31 samples.
    """
    check_spacing(spacing)
    return _area_samples(measure_triangles(mesh, which) if measures is None else measures, spacing)


def _area_samples(m: Measures, spacing: float) -> Samples:
    _check_count(most_samples(m, spacing))
    # Rows of cells, parallel to the base. y runs from the base (0) to the apex (1), x along the base (0 to 1).
    single = m.base <= ONE_SAMPLE * spacing
    rows = np.where(single, 1.0, np.maximum(np.ceil(m.height / spacing), 1.0))
    triangle_of_row, k = _expand(rows)
    rows, alone, foot_of_row = rows[triangle_of_row], single[triangle_of_row], m.foot[triangle_of_row]
    low_of_row, high_of_row = k / rows, (k + 1) / rows
    columns = np.maximum(np.ceil(m.base[triangle_of_row] * (1 - low_of_row) / spacing), 1.0)
    columns[alone] = 1.0
    width_of_row = (1 - low_of_row) / columns
    row_of_sample, j = _expand(columns)

    count = len(row_of_sample)
    triangle = np.empty(count, np.int32)
    barycentric = np.empty((count, 2), np.float32)
    ellipse = np.empty((count, 2, 2), np.float32)

    def fill(block: slice) -> None:
        row = row_of_sample[block]
        t = triangle_of_row.take(row)
        triangle[block] = m.triangle.take(t)
        single = alone.take(row)
        if not single.all():
            low, foot, width = low_of_row.take(row), foot_of_row.take(row), width_of_row.take(row)
            left = foot * low + j[block] * width
            right = left + width
            # A cell ends where the triangle's roof does, so that its centre lies within the triangle.
            high = np.minimum(high_of_row.take(row), _roof(left, right, foot))
            x, y = (left + right) / 2, (low + high) / 2
            half_x = _RADIUS * width + _WEIGHT_SLACK
            half_y = _RADIUS * (high - low) + _WEIGHT_SLACK
            apex = m.apex.take(t)
            is_0, is_1 = apex == 0, apex == 1

            def to_corners(out: np.ndarray, start: np.ndarray, end: np.ndarray, top: np.ndarray | float) -> None:
                """Weights of corners 1 and 2 from those of the base's ends and of the apex."""
                out[:, 0] = np.where(is_0, start, np.where(is_1, top, end))
                out[:, 1] = np.where(is_0, end, np.where(is_1, start, top))

            end = x - foot * y
            to_corners(barycentric[block], *(np.minimum(np.maximum(w, 0.0), 1.0) for w in (1.0 - end - y, end, y)))
            to_corners(ellipse[block, 0], -half_x, half_x, 0.0)
            to_corners(ellipse[block, 1], (foot - 1) * half_y, -foot * half_y, half_y)
        if single.any():
            barycentric[block][single] = 1 / 3
            ellipse[block][single] = STEINER

    each_block(count, fill)
    return Samples("AREA", triangle, barycentric, ellipse)


def _roof(left: np.ndarray, right: np.ndarray, foot: np.ndarray) -> np.ndarray:
    """Greatest height of the triangle over [left, right] of its base, as fractions."""
    smallest = np.finfo(np.float64).tiny
    rising = right / np.maximum(foot, smallest)
    falling = (1 - left) / np.maximum(1 - foot, smallest)
    return np.minimum(np.minimum(rising, falling), 1.0)


def _expand(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For counts [2, 0, 3]: owners [0, 0, 2, 2, 2] (int32) and positions within them [0, 1, 0, 1, 2] (int64)."""
    counts = counts.astype(np.int64)
    return owners(counts, np.int32), ranks(counts)


def most_samples(m: Measures, spacing: float) -> float:
    """At least as many samples as sample_area makes, and at most one more for each row."""
    return float(most_samples_each(m, spacing).sum())


def most_samples_each(m: Measures, spacing: float) -> np.ndarray:
    """(M,) the same of each triangle."""
    columns = m.base / spacing
    rows = np.maximum(np.ceil(m.height / spacing), 1.0)
    return np.where(columns <= ONE_SAMPLE, 1.0, (columns * (rows + 1)) / 2 + rows)


def check_spacing(spacing: float) -> None:
    if not (spacing > 0 and math.isfinite(spacing)):
        raise ValueError(f"spacing must be a positive number, not {spacing}")


def _check_count(count: float) -> None:
    if count >= 2**31:
        raise ValueError(f"{count:.3g} samples are too many; use a larger spacing")


def cell_areas(weights: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """(n,) area of AREA's cells within their triangles, where the base and the height have length 1.

    weights (2, n) and shape (2, 2, n) are Samples.barycentric and Samples.ellipse of cells, which tell the cells'
    bounds; those of triangles with a single sample give anything.
    """
    along, up = (np.stack([-a - b, a, b]) for a, b in shape)  # half-diameters as weights of all three corners
    place = np.stack([1 - weights[0] - weights[1], *weights])
    apex = np.abs(along).argmin(axis=0)[None]
    end = (apex + 2) % 3

    def at(values: np.ndarray, corner: np.ndarray) -> np.ndarray:
        return np.take_along_axis(values, corner, axis=0)[0]

    half_y = at(up, apex)
    foot = np.clip(-at(up, end) / half_y, 0.0, 1.0)
    width = (np.abs(at(along, end)) - _WEIGHT_SLACK) / _RADIUS
    height = (half_y - _WEIGHT_SLACK) / _RADIUS
    x, y = at(place, end) + foot * at(place, apex), at(place, apex)
    low, high = y - height / 2, y + height / 2
    smallest = np.finfo(np.float64).tiny

    def missing(x: np.ndarray) -> np.ndarray:
        """The area above the roof and below `high`, from 0 to x."""
        before = np.maximum(high - x / np.maximum(foot, smallest), 0.0)
        after = np.maximum(high - (1 - x) / np.maximum(1 - foot, smallest), 0.0)
        return (foot * (high**2 - before**2) + (1 - foot) * after**2) / 2

    left, right = np.maximum(x - width / 2, 0.0), np.minimum(x + width / 2, 1.0)
    return (high - low) * (right - left) - (missing(right) - missing(left))


def estimate_by_part(m: Measures, spacing: float, part: np.ndarray, parts: int) -> np.ndarray:
    """(parts,) float64: about how many samples AREA makes of the triangles of each part; `part` (M,) names them."""
    check_spacing(spacing)
    return np.bincount(part, most_samples_each(m, spacing), parts)
