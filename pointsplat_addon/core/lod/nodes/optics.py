"""Optics of merged splats: nodes of translucent clouds transmit as much light as the splats below them do.

All are drawn by the same law, T = exp(-tau). Where splats fill a node evenly, optical masses (the integral of
extinction over volume) add up. Where they are scattered at random, their cross-sections do (`kernel_cross_section`: the
area whose light a splat alone takes away), since light passes between them, however dense they are. *Media* have an
extinction; *shells* are surfaces with an opacity.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from ...numeric.vectors import as_columns, as_rows
from ...scene.cloud import PointCloud
from ...splat.ellipsoids import half_surface
from ...splat.kernel import SUPPORT, kernel

OPAQUE_DEPTH = 100.0  # optical depth of an opaque splat
# Kernels of media are drawn wider than their moments, so that those of adjacent cells add up to an even medium (a
# standard deviation of 0.29 of the cell leaves ripples of 28 %, one of 0.33 of 12 %). Outlines grow no more by this
# than they shrink where the medium becomes too thin to be seen.
MEDIUM_KERNEL_SCALE = 1.15


def optical_sums(cloud: PointCloud, which: slice, radii: np.ndarray) -> np.ndarray:
    """Returns the optical quantities of points that nodes add up, (B, n) float64; B is 0 for opaque clouds.

    `which`: the n points of the cloud; `radii` (3, n): their half-axes. Media: squared optical mass over volume, mass
    and cross-section of each channel, a weight and the colour times it, and the volume times the emission. Shells:
    area, and optical mass and cross-section of each channel.
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
        # Splats without mass have a colour, too, which only counts among their like.
        weight = np.maximum(mean, 1e-60)
        rows += [weight[None], weight * as_rows(cloud.color, which)]
    if cloud.emission is not None:
        rows.append(volume * as_rows(cloud.emission, which))
    return np.concatenate(rows)


def optical_area(cloud: PointCloud, radii: np.ndarray) -> np.ndarray:
    """The area (n,) that the optical mass of ellipsoids with half-axes (3, n) is spread over.

    Media: the silhouette of the ball of the same volume. Shells: half the surface, which for flat splats is their area
    (and twice the mean silhouette).
    """
    if cloud.extinction is not None:
        return np.pi * np.cbrt(np.prod(np.maximum(radii.astype(np.float64), 1e-30), axis=0)) ** 2
    return half_surface(radii)


def drawn_radii(cloud: PointCloud, radii: np.ndarray) -> np.ndarray:
    """Returns the half-axes (3, n) with which nodes are drawn, from those of their kernels, `radii` (3, n).

    Opaque clouds draw the kernels themselves. Translucent clouds without normals draw balls with the root mean square
    of the half-axes; media are enlarged by MEDIUM_KERNEL_SCALE.
    """
    if cloud.extinction is None and cloud.opacity is None:
        return radii
    if cloud.normal is None:
        radii = np.broadcast_to(np.sqrt((radii.astype(np.float64) ** 2).mean(axis=0)), radii.shape)
    return radii if cloud.extinction is None else MEDIUM_KERNEL_SCALE * radii


def kernel_cross_section(depth: np.ndarray) -> np.ndarray:
    """The cross-section of kernels: the integral of 1 - exp(-tau) over the plane, in areas of their ellipse (rim at
    2 sigma), float64. `depth`: their optical mass in the same unit, which is the mean depth of the ellipse."""
    x, y = _cross_section_table()
    thin = np.asarray(depth, np.float64)
    return np.where(thin < x[0], thin, np.exp(np.interp(np.log(np.maximum(thin, x[0])), np.log(x), np.log(y))))


def kernel_depth(depth: np.ndarray) -> np.ndarray:
    """The mean depth of the kernel with the same cross-section as an ellipse of the uniform optical depth `depth`.

    Equal to it in the first two orders, and less than 2.2 where the ellipse is opaque.
    """
    x, y = _cross_section_table()
    wanted = -np.expm1(-np.asarray(depth, np.float64))
    return np.where(wanted < y[0], depth, np.exp(np.interp(np.log(np.maximum(wanted, y[0])), np.log(y), np.log(x))))


@cache
def _cross_section_table() -> tuple[np.ndarray, np.ndarray]:
    """Mean depths, evenly spaced in the logarithm, and their `kernel_cross_section`, by Simpson's rule."""
    depth = np.geomspace(1e-5, 1e9, 2801)
    # With q = SUPPORT (1 - x^4), dx dy is pi a b dq / 4; the fourth power spreads the rim, where deep kernels end.
    x = np.linspace(0, 1, 513)
    simpson = np.r_[1, np.tile([4, 2], 255), 4, 1] * (x[1] - x[0]) / 3
    absorbs = -np.expm1(-2 * depth[:, None] * kernel(SUPPORT * (1 - x**4)))
    return depth, absorbs @ (simpson * SUPPORT * x**3)


def node_optics(cloud: PointCloud, radii: np.ndarray, sums: np.ndarray) -> dict[str, np.ndarray]:
    """Hierarchy's columns mass, covered, and opacity or extinction, color and emission, by name, float32.

    `radii` (3, n): the nodes' kernels; `sums` (B, n): of `optical_sums`, merged.
    """
    drawn = drawn_radii(cloud, radii)
    area = optical_area(cloud, drawn)
    if cloud.extinction is None:
        assert cloud.opacity is not None
        covered, shape = _tiled_fraction(sums[0], radii), cloud.opacity.shape[1:]
        mass, section = np.split(sums[1:], 2)
        opacity = -np.expm1(-_mixed_depth(mass / area, section / area, covered))
        named = {name: as_columns(rows).reshape(-1, *shape) for name, rows in (("mass", mass), ("opacity", opacity))}
        return named | {"covered": covered.astype(np.float32)}
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


def _mixed_depth(filled: np.ndarray, scattered: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """The optical depth of nodes of which the fraction `covered` is filled evenly, and the rest with scattered splats.

    It has the mean of the transmittances of both parts, whose depths are `filled` and `scattered`.
    """
    filled, scattered = np.minimum(filled, OPAQUE_DEPTH), np.minimum(scattered, np.minimum(filled, OPAQUE_DEPTH))
    difference = scattered - filled
    # The first form keeps the digits of small differences, the second those of large ones.
    return scattered - np.where(
        difference > -1,
        np.log1p(covered * np.expm1(difference)),
        np.log((1 - covered) + covered * np.exp(difference)),
    )


def _tiled_fraction(area: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """The degree (n,), 0 to 1, to which sheets of a total `area` (n,) tile a plane instead of leaving gaps or
    overlapping.

    The cube makes opaque sheets that cover a fraction f of a plane without overlap absorb f of the light, within 0.032.
    """
    a, b, c = np.maximum(radii.astype(np.float64), 1e-30)
    return np.minimum(area / (np.pi * a * b), 1) ** 3 * np.clip(1 - 2 * c / b, 0, 1)


def merged_shells(cloud: PointCloud, sums: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Corrects the sums of shells that were merged into nodes for their overlap: (1 + 2 C, n) float64.

    `sums` (1 + 2 C, n): area, and optical mass and cross-section of C channels, added up; `radii` (3, n): the nodes'
    kernels. The area is at most that of the node, and where shells tile the node, cross-sections are at most those of
    an even layer.
    """
    area, (mass, section) = sums[0], np.split(sums[1:], 2)
    ellipse = optical_area(cloud, drawn_radii(cloud, radii))
    covered = _tiled_fraction(area, radii)
    whole = ellipse * -np.expm1(-mass / ellipse)
    return np.concatenate([np.minimum(area, ellipse)[None], mass, section + covered * np.minimum(whole - section, 0)])
