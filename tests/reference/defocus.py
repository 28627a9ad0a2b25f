"""Depth of field by splats, in float64 (model: core/lens/kernel.py): what shaders/defocus/gather.frag computes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pointsplat_addon.core.lens.kernel import NEGLIGIBLE, SOFT_RIM
from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.splat.blur import IN_FOCUS, OUT_OF_FOCUS
from pointsplat_addon.core.splat.kernel import POWER

# Pixels^2 of variance, along each axis, of the filter by which render/frame/sample_positions.py distributes samples.
PIXEL = 0.11
# Of splats that add up with their neighbours, over the exponent whose fourth moment is right: the smoother kernels are,
# the more even are their sums, and what is alone is all disk, whose exponent is 0 either way.
SMOOTHER = 2.0
# Sums of kernels over a surface are uneven by some percent still (`evened_coverage`).
EVEN = 0.05
BLOCK = 1 << 15  # pixels times splats that are composited at once: so many stay in a processor's cache
# Of what backs cover where fronts of the same surface are: sums are uneven, and closed bodies end with fronts alone.
BACK_SHARE = 0.8


def in_focus_share(radius: np.ndarray) -> np.ndarray:
    """The share, in [0, 1], of splats with disks of these radii (pixels) that is drawn as in focus."""
    t = np.clip((radius - IN_FOCUS) / (OUT_OF_FOCUS - IN_FOCUS), 0, 1)
    return 1 - t * t * (3 - 2 * t)


def lens_mean(camera: Camera, place: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """(N, 2): the offset of flat splats' centres within their disks of confusion, in half-axes of the disks (those to
    the right are `radius` over the aperture's ratio); of what lies before the focus, the other way.

    place, normal (N, 3): in view space, of either length and sign. From a place u on the unit disk of the lens a splat
    is seen as large as 1 + g u, so that u has the mean g / 4 and the covariance (1/4) I - g g^T / 16. Where |g| > 1 a
    part of the lens sees the other side; g is taken for 1 there, and what little is seen of it is left as it is.
    """
    aperture = camera.aperture
    assert aperture is not None
    facing = -(normal * place).sum(axis=1) if camera.perspective else normal[:, 2] * aperture.focus
    slope = aperture.radius * normal[:, :2] / [aperture.ratio, 1.0] * np.where(facing < 0, -1.0, 1.0)[:, None]
    return slope / np.maximum(4 * np.maximum(np.abs(facing), np.linalg.norm(slope, axis=1)), 1e-300)[:, None]


def evened_coverage(sums: np.ndarray) -> np.ndarray:
    """What a surface covers, for the sum s <= 1 of its splats: s + EVEN s^8, at most 1. Almost complete coverage
    becomes complete, and edges keep their slope."""
    return np.minimum(sums + EVEN * sums**8, 1)


def kernel_exponent(radius: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """k for disks of confusion of a `radius`, and the variance along an axis, pixels^2, of what else is in a splat."""
    disk = np.asarray(radius, np.float64) ** 2 / 4
    share = disk / (disk + variance)
    return np.minimum(3 * (1 - share**2) / np.maximum(share**2, 1e-6), float(POWER))


def kernel(q: np.ndarray, k: np.ndarray, determinant: np.ndarray) -> np.ndarray:
    """K at squared Mahalanobis distances q, per pixel^2, for covariances of this determinant."""
    support = 2 * (k + 2)
    inside = np.maximum(1 - q / support, 0)
    peak = (k + 1) / (np.pi * support * np.sqrt(determinant))
    return np.where(q < support, peak * np.where(inside > 0, inside, 1.0) ** k, 0.0)


@dataclass(frozen=True, eq=False)
class Splats:
    """N splats of one picture, by depth, the nearest first."""

    centre: np.ndarray  # (N, 2) pixels
    depth: np.ndarray  # (N,)
    covariance: np.ndarray  # (N, 2, 2) pixels^2: M
    exponent: np.ndarray  # (N,): k
    weight: np.ndarray  # (N,) pixels^2: the area that opaque ones cover, the integral of the others' optical depth
    color: np.ndarray  # (N, 3)
    reach: np.ndarray  # (N,) how far before and behind its depth an opaque one's surface may lie in its kernel
    back: np.ndarray  # (N,) bool: shows its back
    translucent: np.ndarray  # (N,) bool
    disconnected: np.ndarray  # (N,) bool: opaque, but of no surface


def composite(pixels: np.ndarray, splats: Splats) -> np.ndarray:
    """(P, 4) premultiplied colour and alpha at positions (P, 2) in pixels.

    From the front, opaque splats of one surface add what they cover of the lens, up to all of it. What lies behind them
    by more than their reach is another surface, which sees what they leave open as if the two knew nothing of each
    other: one behind the other, they cover 1 - (1 - a)(1 - b) (section 5.4). So do splats that belong to no surface.
    Backs show where they cover more than fronts of the same surface do: closed bodies end with both at the same edge.
    Translucent splats take their share of what is open (Beer's law).
    """
    at_once = max(1, BLOCK // max(len(splats.depth), 1))
    starts = range(0, len(pixels), at_once)
    return np.concatenate([_composited(pixels[start : start + at_once], splats) for start in starts])


def _composited(pixels: np.ndarray, splats: Splats) -> np.ndarray:
    middle = splats.weight * kernel(np.zeros(len(splats.weight)), splats.exponent, np.linalg.det(splats.covariance))
    amount = splats.weight * drawn_kernel(pixels, splats)
    amount = np.where(amount > NEGLIGIBLE * np.minimum(middle, 1), amount, 0.0)
    surface = ~(splats.translucent | splats.disconnected)
    there = (amount > 0) & surface
    # A surface goes on while the next splat's near end lies before the farthest end so far.
    farthest = np.maximum.accumulate(np.where(there, splats.depth + splats.reach, -np.inf), axis=1)
    before = np.concatenate([np.full((len(pixels), 1), -np.inf), farthest[:, :-1]], axis=1)
    begins = there & (splats.depth - splats.reach > before)
    number = np.cumsum(begins, axis=1)  # of the surface that is being gathered; 0: none yet

    front = _within(np.where(there & ~splats.back, amount, 0.0), begins)
    back = _within(np.where(there & splats.back, np.where(front > 0, BACK_SHARE, 1.0) * amount, 0.0), begins)
    sums = np.minimum(np.maximum(front, back), 1)
    was = np.where(begins, 0.0, np.concatenate([np.zeros((len(pixels), 1)), sums[:, :-1]], axis=1))
    # What a surface as a whole covers, for its sum so far; at its end, and for what lies within it.
    covers = evened_coverage(sums)
    ends = np.concatenate([begins[:, 1:], np.ones((len(pixels), 1), bool)], axis=1)
    last = _last(np.where(ends, covers, 0.0), ends)
    total = _last(np.where(ends, sums, 0.0), ends)
    passes = np.where(splats.translucent, np.exp(-amount), 1 - np.minimum(amount, 1))
    passes = np.where(surface, 1.0, passes)
    open_ = np.cumprod(np.concatenate([np.ones((len(pixels), 1)), passes], axis=1), axis=1)[:, :-1]
    closed = np.cumprod(np.where(ends & (number > 0), 1 - covers, 1.0), axis=1)
    left = open_ * np.concatenate([np.ones((len(pixels), 1)), closed[:, :-1]], axis=1)
    whole = last / np.maximum(total, 1e-300)
    behind = np.where(surface, 0.0, (1 - sums * whole) * (1 - passes))
    share = left * np.where(there, (sums - was) * whole, behind)
    return np.concatenate([share @ splats.color, share.sum(axis=1, keepdims=True)], axis=1)


def drawn_kernel(pixels: np.ndarray, splats: Splats) -> np.ndarray:
    """(P, N) per pixel^2: `kernel`, with a rim as soft as a pixel is wide."""
    offset = pixels[:, None] - splats.centre
    q = np.einsum("pni,nij,pnj->pn", offset, np.linalg.inv(splats.covariance), offset)
    k = splats.exponent
    share = np.maximum(q / (2 * (k + 2)), 1e-12)
    rim = np.clip(np.linalg.norm(offset, axis=-1) * (1 / np.sqrt(share) - 1) + 0.5, 0, 1)
    peak = kernel(np.zeros(len(k)), k, np.linalg.det(splats.covariance))
    return peak * np.maximum(1 - share, SOFT_RIM) ** k * rim


def _last(values: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """(P, N): at each place of a row, the value at the next end."""
    count = values.shape[1]
    at = np.where(ends, np.arange(count), count - 1)[:, ::-1]
    following = np.minimum.accumulate(at, axis=1)[:, ::-1]
    return np.take_along_axis(values, following, axis=1)


def _within(values: np.ndarray, begins: np.ndarray) -> np.ndarray:
    """Sums (P, N) along rows that start anew where `begins`."""
    total = np.cumsum(values, axis=1)
    first = np.maximum.accumulate(np.where(begins, np.arange(values.shape[1]), 0), axis=1)
    return total - np.take_along_axis(total - values, first, axis=1)
