"""TODO: say what this module is."""

from __future__ import annotations

from functools import cache

import numpy as np

from ...numeric.vectors import as_columns, as_rows
from ...scene.cloud import PointCloud
from ...splat.ellipsoids import half_surface
from ...splat.kernel import SUPPORT, kernel

OPAQUE_DEPTH = 100.0  # optical depth of an opaque splat
# Kernels of media are drawn wider than their moments: those of cells side by side then add up to an even medium (a
# standard deviation of 0.29 of the cell leaves ripples of 28 %, one of 0.33 of 12 %), and outlines grow no more than
# the thickness at which they are seen shrinks.
MEDIUM_KERNEL_SCALE = 1.15


def optical_sums(cloud: PointCloud, which: slice, radii: np.ndarray) -> np.ndarray:
    """Quantities (B, n) of points that add up, none for clouds that are simply opaque.

    Of media the optical mass squared over the volume, the mass and the cross-section of each channel, a weight and the
    colour times it, and the volume times the emission. Of shells the area, the optical mass and the cross-section.
    """
    if cloud.radii is None or (cloud.extinction is None and cloud.opacity is None):
        return np.empty((0, radii.shape[1]))
    area = optical_area(cloud, radii)
    if cloud.extinction is None:
        with np.errstate(divide="ignore"):
            depth = -np.log1p(-np.clip(as_rows(cloud.opacity, which).astype(np.float64), 0, 1))  # type: ignore[arg-type]
        depth = np.minimum(depth, OPAQUE_DEPTH)
        return np.concatenate([area[None], area * depth, area * kernel_cross_section(depth)])
    volume = 4 / 3 * np.pi * np.prod(radii, axis=0)
    mass = volume * np.maximum(as_rows(cloud.extinction, which), 0)
    mean = mass.mean(axis=0)
    rows = [(mean**2 / np.maximum(volume, 1e-150))[None], mass, area * kernel_cross_section(mass / area)]
    if cloud.color is not None:
        # What is not there has a colour, too: one that only counts among its like.
        weight = np.maximum(mean, 1e-60)
        rows += [weight[None], weight * as_rows(cloud.color, which)]
    if cloud.emission is not None:
        rows.append(volume * as_rows(cloud.emission, which))
    return np.concatenate(rows)


def optical_area(cloud: PointCloud, radii: np.ndarray) -> np.ndarray:
    """(n,) area of ellipsoids of half-axes (3, n): of media that of a disk as wide as the ball of the same volume; of
    shells half the surface, which is twice what is seen of it on average, and of flat ones their area."""
    if cloud.extinction is not None:
        return np.pi * np.cbrt(np.prod(np.maximum(radii.astype(np.float64), 1e-30), axis=0)) ** 2
    return half_surface(radii)


def drawn_radii(cloud: PointCloud, radii: np.ndarray) -> np.ndarray:
    """Half-axes (3, n) by which nodes of these kernels are drawn: as they are where they are opaque."""
    if cloud.extinction is None and cloud.opacity is None:
        return radii
    if cloud.normal is None:
        radii = np.broadcast_to(np.sqrt((radii.astype(np.float64) ** 2).mean(axis=0)), radii.shape)
    return radii if cloud.extinction is None else MEDIUM_KERNEL_SCALE * radii


def kernel_cross_section(depth: np.ndarray) -> np.ndarray:
    """The cross-section of a kernel, the integral of 1 - exp(-tau) over the plane, in areas of its ellipse (rim at
    2 sigma), float64. `depth` is its optical mass in the same unit: the mean depth of the ellipse."""
    x, y = _cross_section_table()
    thin = np.asarray(depth, np.float64)
    return np.where(thin < x[0], thin, np.exp(np.interp(np.log(np.maximum(thin, x[0])), np.log(x), np.log(y))))


def kernel_depth(depth: np.ndarray) -> np.ndarray:
    """The mean depth of the kernel that has the cross-section of an ellipse of an even depth: equal to it in the
    first two orders, and less than 2.2 where the ellipse is opaque."""
    x, y = _cross_section_table()
    wanted = -np.expm1(-np.asarray(depth, np.float64))
    return np.where(wanted < y[0], depth, np.exp(np.interp(np.log(np.maximum(wanted, y[0])), np.log(y), np.log(x))))


@cache
def _cross_section_table() -> tuple[np.ndarray, np.ndarray]:
    """Mean depths, evenly spaced in the logarithm, and `absorbed` of them, by Simpson's rule."""
    depth = np.geomspace(1e-5, 1e9, 2801)
    # With q = SUPPORT (1 - x^4), dx dy is pi a b dq / 4; the fourth power spreads the rim, where deep kernels end.
    x = np.linspace(0, 1, 513)
    simpson = np.r_[1, np.tile([4, 2], 255), 4, 1] * (x[1] - x[0]) / 3
    absorbs = -np.expm1(-2 * depth[:, None] * kernel(SUPPORT * (1 - x**4)))
    return depth, absorbs @ (simpson * SUPPORT * x**3)


def node_optics(cloud: PointCloud, radii: np.ndarray, sums: np.ndarray) -> dict[str, np.ndarray]:
    """Optical mass, filled fraction, and the attributes by which nodes of these kernels (3, n) are drawn."""
    drawn = drawn_radii(cloud, radii)
    area = optical_area(cloud, drawn)
    if cloud.extinction is None:
        covered = _tiled_fraction(sums[0], radii)
        depth = _mixed_depth(sums[1] / area, sums[2] / area, covered)
        named = {"mass": sums[1], "opacity": -np.expm1(-depth), "covered": covered}
        return {name: array.astype(np.float32) for name, array in named.items()}
    shape = cloud.extinction.shape[1:]
    channels = int(np.prod(shape))
    volume = np.maximum(4 / 3 * np.pi * np.prod(drawn.astype(np.float64), axis=0), 1e-60)
    mass, section, rest = np.split(sums[1:], [channels, 2 * channels])
    mean = mass.mean(axis=0)
    covered = np.clip(mean**2 / np.maximum(sums[0] * volume, 1e-300), 0, 1)
    extinction = area / volume * _mixed_depth(kernel_depth(mass / area), section / area, covered)
    named = {"mass": as_columns(mass).reshape(-1, *shape), "extinction": as_columns(extinction).reshape(-1, *shape)}
    if cloud.color is not None:
        named["color"] = as_columns(rest[1:4] / rest[0])
    if cloud.emission is not None:
        named["emission"] = as_columns(rest[-3:] / volume)
    return named | {"covered": covered.astype(np.float32)}


def _mixed_depth(filled: np.ndarray, strewn: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """The depth of nodes that are filled over a part of their area, by the mean of the transmittances."""
    filled, strewn = np.minimum(filled, OPAQUE_DEPTH), np.minimum(strewn, np.minimum(filled, OPAQUE_DEPTH))
    apart = strewn - filled
    # The first form keeps the digits of small differences, the second what is left of the largest.
    return strewn - np.where(
        apart > -1, np.log1p(covered * np.expm1(apart)), np.log((1 - covered) + covered * np.exp(apart))
    )


def _tiled_fraction(area: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """(n,) how far sheets of this area close a plane, instead of lying far apart in it, or behind one another.

    With the cube, opaque ones that cover a fraction f of a plane without overlap stop f of the light, within 0.032.
    """
    a, b, c = np.maximum(radii.astype(np.float64), 1e-30)
    return np.minimum(area / (np.pi * a * b), 1) ** 3 * np.clip(1 - 2 * c / b, 0, 1)


def merged_shells(cloud: PointCloud, sums: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Area, optical mass and cross-section of merged shells, whose parts count once where they overlap."""
    area, mass, section = sums
    ellipse = optical_area(cloud, drawn_radii(cloud, radii))
    covered = _tiled_fraction(area, radii)
    whole = ellipse * -np.expm1(-mass / ellipse)
    return np.stack([np.minimum(area, ellipse), mass, section + covered * np.minimum(whole - section, 0)])
