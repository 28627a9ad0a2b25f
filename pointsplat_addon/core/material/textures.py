"""Filters images over the splats that show them (Heckbert 1989: elliptical weighted averages in texture space).

A splat's ellipse, mapped into an image, is a Gaussian of texels. Where that is wider than a texel, its mean is taken
from an image pyramid: the level and its share follow from the ellipse's minor axis, and several samples along the major
axis cover the rest (McCormack et al. 1999). Where it is narrower, the image is magnified, and interpolated as usual.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

# Standard deviation of a splat's footprint over its half-axes: a square cell of a lattice whose disks just cover.
SPREAD = 0.41
# Standard deviation in texels of a sample of the image itself, by bilinear weights (narrower Gaussians are magnified),
# and of a sample of a smaller level, whose texels are boxes (1/12), by cubic B-splines (1/3), in that level's texels.
TEXEL, SMALLER = 0.41, (1 / 12 + 1 / 3) ** 0.5
LINEAR = (1 / 12 + 1 / 6) ** 0.5  # the same by bilinear weights
MOST_ASPECT = 4.0  # largest aspect of the ellipses; narrower ones are widened
ROUND = 1.5  # aspect up to which one sample is enough, with the mean of both axes
BAND = 256  # rows that are halved at a time; even
# Samples along the major axis for ellipses up to an aspect: offsets over the remaining standard deviation, and binomial
# weights; convolved with the samples' own Gaussians these leave no gaps
MAJOR_AXIS_TAPS = (
    (ROUND, np.zeros(1), np.ones(1)),
    (2.6, np.arange(-2, 3.0), np.array([1, 4, 6, 4, 1]) / 16),
    (np.inf, np.arange(-4, 5) / 2**0.5, np.array([1, 8, 28, 56, 70, 56, 28, 8, 1]) / 256),
)


class Pyramid:
    """Image pyramid: `levels` holds images (H, W, 4) float32 from level 1 on, each half the size, of equal mean."""

    def __init__(self, rows: Callable[[slice], np.ndarray], size: tuple[int, int]) -> None:
        """rows: returns some rows (h, W, 4) float32 of level 0, which is not kept; size: its (width, height)."""
        height = size[1]
        # As floats, an image of bytes is four times as large: it is never whole in memory.
        band = BAND if height % 2 == 0 else height
        first = [half_size(rows(slice(y, min(y + band, height)))) for y in range(0, height, band)]
        self.levels = [np.concatenate(first)]
        while max(self.levels[-1].shape[:2]) > 1:
            self.levels.append(half_size(self.levels[-1]))


def half_size(texels: np.ndarray) -> np.ndarray:
    """Half as many texels (h, w, C) float32 along each axis that has more than one, by `half_rows`."""
    return np.ascontiguousarray(half_rows(half_rows(texels).swapaxes(0, 1)).swapaxes(0, 1), np.float32)


def half_rows(texels: np.ndarray) -> np.ndarray:
    """Half as many rows, each the mean of two; if their number is odd, the weighted mean of the three it overlaps."""
    count = len(texels)
    half = count // 2
    if half == 0:
        return texels
    if count % 2 == 0:
        return (texels[0::2] + texels[1::2]) * np.float32(0.5)
    i = np.arange(half, dtype=np.float32)[:, None, None]
    parts = texels[0:-1:2] * (half - i), texels[1::2] * np.float32(half), texels[2::2] * (i + 1)
    return (parts[0] + parts[1] + parts[2]) / np.float32(count)


def footprint_axes(footprint: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Standard deviations (N,) along the major and minor axis in texels, and unit major axes (N, 2), of footprints.

    footprint: (N, 2, 2), two conjugate half-diameters of each splat in UV units; those that are not finite count as
    points. size: (width, height) of the image.
    """
    texels = np.nan_to_num(np.clip(footprint, -0.5, 0.5)) * (SPREAD * np.asarray(size, np.float64))
    xx = (texels[:, :, 0] ** 2).sum(axis=1)
    yy = (texels[:, :, 1] ** 2).sum(axis=1)
    xy = (texels[:, :, 0] * texels[:, :, 1]).sum(axis=1)
    mean, half = 0.5 * (xx + yy), 0.5 * (xx - yy)
    root = np.hypot(half, xy)
    angle = 0.5 * np.arctan2(xy, half)
    major, minor = np.sqrt(mean + root), np.sqrt(np.maximum(mean - root, 0.0))
    return major, np.maximum(minor, major / MOST_ASPECT), np.stack([np.cos(angle), np.sin(angle)], axis=1)


def filter_image(
    sample: Callable[[int, np.ndarray], np.ndarray], size: tuple[int, int], uv: np.ndarray, footprint: np.ndarray
) -> np.ndarray:
    """Means (N, 4) float32 of an image over the footprints of splats (Heckbert 1989).

    sample: returns colours (N, 4) of a level of the image's pyramid at UVs (N, 2). size: the image's (width, height).
    uv: (N, 2), the splats' centres. footprint: (N, 2, 2), two conjugate half-diameters of each in UV units.
    """
    major, minor, along = footprint_axes(footprint, size)
    minor = np.maximum(minor, TEXEL)
    aspect = major / minor
    level, share = _levels(np.where(aspect < ROUND, np.sqrt(np.maximum(major, TEXEL) * minor), minor), max(size))
    # The deviation along the major axis that one sample does not cover, in UV units
    left = np.sqrt(np.maximum(major**2 - minor**2, 0.0))
    step = (left[:, None] * along / size).astype(np.float32)
    color, below = np.zeros((len(uv), 4), np.float32), 0.0
    for limit, offsets, weights in MAJOR_AXIS_TAPS:
        which = np.flatnonzero((aspect >= below) & (aspect < limit))
        for offset, weight in zip(offsets.tolist(), weights.tolist(), strict=True):
            if len(which):
                at = uv[which] + offset * step[which]
                color[which] += weight * _blend_levels(sample, at, level[which], share[which])
        below = limit
    return color


def sample_roughly(
    sample: Callable[[int, np.ndarray, str], np.ndarray],
    size: tuple[int, int],
    uv: np.ndarray,
    footprint: np.ndarray,
) -> np.ndarray:
    """Samples a texture once for each footprint, of the level whose bilinear samples are about as wide.

    Long footprints are taken for round ones of their area. `sample` is also told how levels are interpolated."""
    x, y = np.nan_to_num(np.clip(footprint, -0.5, 0.5)).transpose(2, 0, 1) * (
        SPREAD * np.asarray(size, np.float64)[:, None, None]
    )
    xx, yy, xy = ((one * other).sum(axis=1) for one, other in ((x, x), (y, y), (x, y)))
    mean, root = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    major, minor = np.sqrt(mean + root), np.sqrt(np.maximum(mean - root, 0.0))
    spread = np.sqrt(major * np.maximum(minor, major / MOST_ASPECT))
    level = np.rint(np.log2(np.maximum(spread, LINEAR) / LINEAR)).astype(np.int64)
    color = np.empty((len(uv), 4), np.float32)
    for k in np.unique(level).tolist():
        which = np.flatnonzero(level == k)
        color[which] = sample(k, uv[which], "Linear")
    return color


def _levels(spread: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray]:
    """The finest level (N,) int64 to sample for Gaussians of deviation `spread` (N,), and the share of the next, (N,).

    Samples of the level are narrower than the Gaussian; the share makes the variance right. side: texels along the
    longer side of the image.
    """
    top = max(side.bit_length() - 1, 1)
    known = np.array([TEXEL, *(SMALLER * 2.0**k for k in range(1, top + 1))]) ** 2
    variance = np.clip(spread**2, known[0], known[-1])
    level = np.clip(np.searchsorted(known, variance, side="right") - 1, 0, top - 1)
    return level, ((variance - known[level]) / (known[level + 1] - known[level])).astype(np.float32)


def _blend_levels(
    sample: Callable[[int, np.ndarray], np.ndarray], uv: np.ndarray, level: np.ndarray, share: np.ndarray
) -> np.ndarray:
    """Colours (N, 4) at `uv` (N, 2), blended from `level` (N,) and, with weight `share` (N,), the next one."""
    color = np.zeros((len(uv), 4), np.float32)
    for k in range(int(level.min(initial=0)), int(level.max(initial=0)) + 2):
        weight = np.where(level == k, 1 - share, np.where(level == k - 1, share, 0))
        which = np.flatnonzero(weight > 0)
        if len(which):
            color[which] += weight[which, None] * sample(k, uv[which])
    return color


def look_up(texels: np.ndarray, uv: np.ndarray, interpolation: str, extension: str) -> np.ndarray:
    """Interpolates texels (H, W, 4), uint8 or float32, at UVs (N, 2): (N, 4) float32, still encoded.

    Texel centres lie at (i + 1/2) / size. interpolation: Closest, Linear or Cubic; extension: REPEAT, EXTEND, CLIP or
    MIRROR, as in Blender.
    """
    height, width = texels.shape[:2]
    # UVs that are not finite, or so large that float32 holds no fraction, read texel 0
    uv = np.where(np.abs(uv[:, :2]) < 2.0**24, uv[:, :2], 0).astype(np.float32)
    axes = [_axis_taps(uv[:, k], size, interpolation, extension) for k, size in enumerate((width, height))]
    # One element for a whole texel: gathering is several times faster than by rows of four
    whole = np.ascontiguousarray(texels).view(np.uint32 if texels.dtype == np.uint8 else np.complex128).ravel()
    out = np.zeros((len(uv), 4), np.float32)
    for row, row_weight in axes[1]:
        for column, column_weight in axes[0]:
            gathered = whole.take(row * width + column).view(texels.dtype).reshape(-1, 4)
            out += gathered * (row_weight * column_weight)[:, None]
    return out / np.float32(255) if texels.dtype == np.uint8 else out


def _axis_taps(x: np.ndarray, size: int, interpolation: str, extension: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """(texel index, weight) arrays along one axis; weight 0 where the image is clipped."""
    scaled = x * np.float32(size)
    if interpolation == "Closest":
        low, offsets, weights = np.floor(scaled).astype(np.int64), (0,), (np.ones_like(x),)
    else:
        scaled = scaled - np.float32(0.5)
        low = np.floor(scaled)
        t = scaled - low
        low = low.astype(np.int64)
        if interpolation == "Linear":
            offsets, weights = (0, 1), (1 - t, t)
        else:
            offsets, weights = (-1, 0, 1, 2), uniform_b_spline(t)
    return [_wrap(low + o, w, size, extension) for o, w in zip(offsets, weights, strict=True)]


def _wrap(index: np.ndarray, weight: np.ndarray, size: int, extension: str) -> tuple[np.ndarray, np.ndarray]:
    if extension == "REPEAT":
        return index % size, weight
    if extension == "MIRROR":
        index = index % (2 * size)
        return np.minimum(index, 2 * size - 1 - index), weight
    inside = np.clip(index, 0, size - 1)
    return inside, (weight * (inside == index) if extension == "CLIP" else weight)


def uniform_b_spline(t: np.ndarray) -> tuple[np.ndarray, ...]:
    """Weights of four neighbours of the uniform cubic B-spline at t in [0, 1]."""
    t2, t3 = t * t, t * t * t
    return (1 - t) ** 3 / 6, (3 * t3 - 6 * t2 + 4) / 6, (-3 * t3 + 3 * t2 + 3 * t + 1) / 6, t3 / 6
