"""Light through participating media in float64, slow and exact: what translucency is measured against.

Two ways. `splat_optical_depth` sums what splats absorb along rays, by the same optics as the renderer: it tells what
drawing adds in error. `march` integrates emission, absorption and single scattering through the medium itself, along
camera rays and shadow rays alike: it tells what the splats add.

References: Max 1995 (optical models for volume rendering); Henyey and Greenstein 1941 (phase function); Kulla and
Fajardo 2012 (equiangular sampling, here as a substitution that removes a lamp's singularity).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.splat.kernel import kernel

OPAQUE = 100.0  # optical depth of an opaque hit, and the most that one splat of a surface has
_PAIRS = 1 << 20  # rays times splats, or points of a field, that are evaluated together
_HALVINGS = 14
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)


# ---------------------------------------------------------------------------- splats


def splat_transmittance(
    cloud: PointCloud,
    origins: np.ndarray,
    directions: np.ndarray,
    far: np.ndarray | float = np.inf,
    covered: np.ndarray | None = None,
) -> np.ndarray:
    """Transmittance (R,), or (R, 3) where extinction is coloured, of a cloud's splats along rays: their product.

    covered: (N,) share of each splat that holds matter, for nodes of a hierarchy: T = 1 - f + f exp(-tau / f).
    Everything else is as in `splat_optical_depth`.
    """
    return np.exp(-splat_optical_depth(cloud, origins, directions, far, covered))


def splat_optical_depth(
    cloud: PointCloud,
    origins: np.ndarray,
    directions: np.ndarray,
    far: np.ndarray | float = np.inf,
    covered: np.ndarray | None = None,
) -> np.ndarray:
    """Optical depth (R,), or (R, 3) where extinction is coloured, along rays from origins up to the distance `far`.

    origins, directions: (R, 3) in the cloud's object space; directions of any length; far: (R,) or a number.
    Volumetric splats (with extinction) are Gaussians along the ray, whose standard deviations are half their half-axes
    and whose optical mass is 4/3 pi a b c times extinction; the integral along the ray is exact at both of its ends.
    Translucent surface samples (with opacity) have -ln(1 - opacity) pi a b, met where the ray crosses their plane;
    opaque ones have OPAQUE inside their ellipse. Across the ray kernels are those of core.kernel.
    """
    origins, directions = np.asarray(origins, float), _unit(np.asarray(directions, float))
    far = np.broadcast_to(np.asarray(far, float), len(origins))
    colored = cloud.extinction is not None and cloud.extinction.ndim == 2
    depth = np.zeros((len(origins), 3 if colored else 1))
    for splats in _blocks(len(cloud), len(origins)):
        part = cloud.take(splats)
        optics = _volumetric if part.extinction is not None else _surface
        tau = optics(part, origins, directions, far)
        if covered is not None:
            f = np.clip(covered[splats], 1e-9, 1)[:, None]
            tau = -np.log1p(-f * -np.expm1(-tau / f))
        depth += tau.sum(axis=1)
    return depth if colored else depth[:, 0]


def _blocks(count: int, width: int) -> Iterator[slice]:
    step = max(1, _PAIRS // max(width, 1))
    return (slice(i, i + step) for i in range(0, count, step))


def _volumetric(cloud: PointCloud, origins: np.ndarray, directions: np.ndarray, far: np.ndarray) -> np.ndarray:
    """Optical depths (R, n, C) of Gaussians."""
    axes, radii = _frame(cloud), _half_axes(cloud)
    # Whitened: each splat becomes a unit Gaussian about the origin. `scale` is lengths there per length here.
    whiten = axes * (2 / radii)[:, :, None]
    start = np.einsum("nij,rnj->rni", whiten, origins[:, None] - _centre(cloud))
    step = np.einsum("nij,rj->rni", whiten, directions)
    scale = np.linalg.norm(step, axis=2)
    nearest = -np.einsum("rni,rni->rn", start, step) / scale  # where the ray comes nearest, in whitened length
    across2 = (start**2).sum(axis=2) - nearest**2
    part = _normal_cdf(far[:, None] * scale - nearest) - _normal_cdf(-nearest)
    line = kernel(across2) / (2 * np.pi) * np.linalg.det(whiten) / scale * part
    share = np.asarray(cloud.extinction, float).reshape(len(cloud), -1)
    mass = 4 / 3 * np.pi * radii.prod(axis=1)[:, None] * share
    return line[..., None] * mass


def _surface(cloud: PointCloud, origins: np.ndarray, directions: np.ndarray, far: np.ndarray) -> np.ndarray:
    """Optical depths (R, n, 1) of flat ellipses; of balls as disks that face the ray."""
    radii, to_centre = _half_axes(cloud), _centre(cloud) - origins[:, None]
    if cloud.normal is None:
        distance = np.einsum("rni,ri->rn", to_centre, directions)
        rim2 = ((to_centre - distance[..., None] * directions[:, None]) ** 2).sum(axis=2) / radii[:, 0] ** 2
    else:
        axes = _frame(cloud)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.einsum("rni,ni->rn", to_centre, axes[:, 2]) / (directions @ axes[:, 2].T)
            hit = distance[..., None] * directions[:, None] - to_centre
            rim2 = (np.einsum("rni,nki->rnk", hit, axes[:, :2] / radii[:, :2, None]) ** 2).sum(axis=2)
    met = (distance > 0) & (distance < far[:, None])
    if cloud.opacity is None:
        return (OPAQUE * (met & (rim2 <= 1)))[..., None]
    with np.errstate(divide="ignore"):
        single = np.minimum(-np.log1p(-cloud.opacity.astype(float)), OPAQUE)
    return np.minimum(2 * kernel(4 * np.where(met, rim2, np.inf)) * single, OPAQUE)[..., None]


def _centre(cloud: PointCloud) -> np.ndarray:
    return cloud.position.astype(float) + cloud.origin


def _half_axes(cloud: PointCloud) -> np.ndarray:
    """(n, 3) float64 half-axes; of balls, and of disks in their plane, the first for those that are absent."""
    if cloud.radii is None:
        raise ValueError("the splats have no radii")
    radii = cloud.radii.astype(float)
    return np.column_stack([radii, np.repeat(radii[:, :1], 3 - radii.shape[1], axis=1)])


def _frame(cloud: PointCloud) -> np.ndarray:
    """(n, 3, 3) rows: the directions of the half-axes, the last along the normal."""
    count = len(cloud)
    normal = np.broadcast_to([0.0, 0, 1], (count, 3)) if cloud.normal is None else _unit(cloud.normal.astype(float))
    helper = np.where(np.abs(normal[:, :1]) < 0.9, [1.0, 0, 0], [0.0, 1, 0])
    axis = helper if cloud.axis is None else cloud.axis.astype(float)
    axis = _unit(axis - (axis * normal).sum(axis=1, keepdims=True) * normal)
    return np.stack([axis, np.cross(normal, axis), normal], axis=1)


def _normal_cdf(x: np.ndarray) -> np.ndarray:
    """Share of a normal distribution below x, by Gauss-Legendre quadrature from 0 to x: 1e-15."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    end = np.clip(x, -9, 9)
    half = end[..., None] / 2
    return 0.5 + (np.exp(-((half * (1 + nodes)) ** 2) / 2) @ weights) * end / 2 / np.sqrt(2 * np.pi)


# ---------------------------------------------------------------------------- media


@dataclass(frozen=True, eq=False)
class Field:
    """A participating medium inside a convex region. Positions are (P, 3), rays (R, 3) with unit directions."""

    extinction: Callable[[np.ndarray], np.ndarray]  # positions to (P, 3), per unit of length
    interval: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]  # rays to entry and exit, (R,) each
    albedo: np.ndarray = field(default_factory=lambda: np.zeros(3))  # (3,)
    anisotropy: float = 0.0  # Henyey-Greenstein's g
    emission: Callable[[np.ndarray], np.ndarray] | None = None  # positions to (P, 3) radiance per unit of length


@dataclass(frozen=True, eq=False)
class Marched:
    """What comes along R rays."""

    radiance: np.ndarray  # (R, 3) that the medium adds
    transmittance: np.ndarray  # (R, 3) of what is behind
    error: float  # the most that the last halving of the steps changed, of radiance or transmittance


def sphere(centre: ArrayLike, radius: float, extinction: ArrayLike, **medium) -> Field:
    """A uniform sphere; `medium` are further fields of Field."""
    centre = np.asarray(centre, float)
    return Field(_uniform(extinction), lambda o, d: chord(o, d, centre, radius), **medium)


def box(low: ArrayLike, high: ArrayLike, extinction: ArrayLike, **medium) -> Field:
    """A uniform box between two corners, which may lie infinitely far away: a slab."""
    return Field(
        _uniform(extinction), lambda o, d: _slabs(o, d, np.asarray(low, float), np.asarray(high, float)), **medium
    )


def blob(centre: ArrayLike, deviation: float, extinction: ArrayLike, **medium) -> Field:
    """A Gaussian with a standard deviation in units of length and an extinction at its centre; 9 deviations wide."""
    centre, peak = np.asarray(centre, float), np.broadcast_to(np.asarray(extinction, float), 3)

    def at(p: np.ndarray) -> np.ndarray:
        return np.exp(-((p - centre) ** 2).sum(axis=1) / (2 * deviation**2))[:, None] * peak

    return Field(at, lambda o, d: chord(o, d, centre, 9 * deviation), **medium)


def voxels(values: np.ndarray, world_from_index: np.ndarray, extinction: ArrayLike = 1.0, **medium) -> Field:
    """Voxels (X, Y, Z) of density, trilinear between their centres at integer indices, 0 one voxel outside.

    world_from_index: (4, 4); extinction: (3,) or a number, where the density is 1.
    """
    padded = np.pad(np.asarray(values, float), 1)
    per_density = np.broadcast_to(np.asarray(extinction, float), 3)
    index_from_world = np.linalg.inv(world_from_index)
    linear, shift = index_from_world[:3, :3].T, index_from_world[:3, 3]

    def at(p: np.ndarray) -> np.ndarray:
        place = np.clip(p @ linear + shift + 1, 0, np.array(padded.shape) - 1.000001)
        cell = place.astype(int)
        weight = np.stack([1 - (place - cell), place - cell])  # (2, P, 3)
        density = np.zeros(len(p))
        for i, j, k in np.ndindex(2, 2, 2):
            corner = padded[cell[:, 0] + i, cell[:, 1] + j, cell[:, 2] + k]
            density += corner * weight[i, :, 0] * weight[j, :, 1] * weight[k, :, 2]
        return density[:, None] * per_density

    def interval(o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return _slabs(o @ linear + shift, d @ linear, np.full(3, -1.0), np.array(values.shape, float))

    return Field(at, interval, **medium)


def chord(
    origins: np.ndarray, directions: np.ndarray, centre: np.ndarray, radius: float
) -> tuple[np.ndarray, np.ndarray]:
    """Distances (R,) at which rays enter and leave a sphere; equal where they miss it."""
    to_centre = centre - origins
    middle = (to_centre * directions).sum(axis=1)
    across2 = ((to_centre - middle[:, None] * directions) ** 2).sum(axis=1)
    half = np.sqrt(np.maximum(radius**2 - across2, 0))
    return middle - half, middle + half


def optical_depth(
    medium: Field,
    origins: np.ndarray,
    directions: np.ndarray,
    far: np.ndarray | float = np.inf,
    tolerance: float = 1e-9,
) -> np.ndarray:
    """Optical depth (R, 3) along rays with unit directions from their origins up to the distance `far`.

    Steps are halved until no depth changes by more than `tolerance` (relative where it exceeds 1).
    Raise ArithmeticError where 4 * 2^14 steps do not suffice.
    """
    near, length = _within(medium, origins, directions, far)

    def integral(steps: int) -> np.ndarray:
        places, weights = _panels(steps)
        depth = np.zeros((len(origins), 3))
        for rays in _blocks(len(origins), len(places)):
            along = near[rays, None] + length[rays, None] * places
            p = origins[rays, None] + along[..., None] * directions[rays, None]
            sigma = medium.extinction(p.reshape(-1, 3)).reshape(*along.shape, 3)
            depth[rays] = length[rays, None] * np.einsum("rkc,k->rc", sigma, weights)
        return depth

    return _converged(integral, tolerance)[0]


def march(
    medium: Field,
    origins: np.ndarray,
    directions: np.ndarray,
    lights: Sequence[Light] = (),
    far: np.ndarray | float = np.inf,
    tolerance: float = 1e-6,
) -> Marched:
    """Emission, absorption and single scattering along rays with unit directions from their origins up to `far`.

    Lights are points, spots without blend, and suns, all without size: their light decays by Beer's law on its way
    through the medium. Steps are halved until nothing changes by more than `tolerance` (relative where it exceeds 1).
    Raise ValueError for area lights, ArithmeticError where the integrals do not converge: a ray through a lamp.
    """
    origins, directions = np.asarray(origins, float), np.asarray(directions, float)
    far = np.broadcast_to(np.asarray(far, float), len(origins))
    inner = tolerance / 10
    transmittance = np.exp(-optical_depth(medium, origins, directions, far, inner))
    sources = [_Emitted(medium)] if medium.emission is not None else []
    sources += [_Scattered(medium, light, inner) for light in lights]
    radiance, error = np.zeros_like(transmittance), inner
    for source in sources:

        def integral(steps: int, source: _Emitted = source) -> np.ndarray:
            total = np.zeros_like(transmittance)
            for rays in _blocks(len(origins), len(_NODES) * steps):
                total[rays] = _gathered(medium, source, origins[rays], directions[rays], far[rays], steps, inner)
            return total

        part, change = _converged(integral, tolerance)
        radiance, error = radiance + part, max(error, change)
    return Marched(radiance, transmittance, error)


def henyey_greenstein(anisotropy: float, cosine: np.ndarray) -> np.ndarray:
    """Phase function per steradian at the cosine between the directions in which light travels before and after."""
    g = anisotropy
    return (1 - g**2) / (4 * np.pi * (1 + g**2 - 2 * g * cosine) ** 1.5)


def _gathered(
    medium: Field,
    source: _Emitted,
    origins: np.ndarray,
    directions: np.ndarray,
    far: np.ndarray,
    steps: int,
    tolerance: float,
) -> np.ndarray:
    """Radiance (R, 3) that a source sends along rays, by a quadrature of so many steps."""
    near, length = _within(medium, origins, directions, far)
    places, weights = _panels(steps)
    along, measure = source.places(origins, directions, near, length, places)
    p = (origins[:, None] + along[..., None] * directions[:, None]).reshape(-1, 3)
    back = np.repeat(-directions, len(places), axis=0)
    seen = np.exp(-optical_depth(medium, p, back, along.reshape(-1), tolerance))
    sent = (source.radiance(p, back) * seen).reshape(*along.shape, 3)
    return np.einsum("rkc,rk,k->rc", sent, measure, weights)


class _Emitted:
    """What the medium emits."""

    def __init__(self, medium: Field) -> None:
        self.medium = medium

    def places(
        self, origins: np.ndarray, directions: np.ndarray, near: np.ndarray, length: np.ndarray, u: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Distances (R, K) along rays for u (K,) in [0, 1], and their derivatives by u."""
        return near[:, None] + length[:, None] * u, np.repeat(length[:, None], len(u), axis=1)

    def radiance(self, p: np.ndarray, towards: np.ndarray) -> np.ndarray:
        """(P, 3) per unit of length, sent from p into unit directions."""
        assert self.medium.emission is not None
        return self.medium.emission(p)


class _Scattered(_Emitted):
    """What the medium scatters of one light."""

    def __init__(self, medium: Field, light: Light, tolerance: float) -> None:
        if light.kind == "AREA":
            raise ValueError(f'Light "{light.name}": area lights are not marched')
        super().__init__(medium)
        self.light, self.tolerance = light, tolerance

    def places(
        self, origins: np.ndarray, directions: np.ndarray, near: np.ndarray, length: np.ndarray, u: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Equiangular about a lamp: its inverse square then cancels."""
        if self.light.kind == "SUN":
            return super().places(origins, directions, near, length, u)
        to_lamp = self.light.position - origins
        foot = (to_lamp * directions).sum(axis=1)
        height = np.linalg.norm(to_lamp - foot[:, None] * directions, axis=1)
        first, last = np.arctan2(near - foot, height), np.arctan2(near + length - foot, height)
        angle = first[:, None] + (last - first)[:, None] * u
        derivative = (last - first)[:, None] * height[:, None] / np.cos(angle) ** 2
        return foot[:, None] + height[:, None] * np.tan(angle), derivative

    def radiance(self, p: np.ndarray, towards: np.ndarray) -> np.ndarray:
        light, medium = self.light, self.medium
        if light.kind == "SUN":
            to_light, distance = np.broadcast_to(-light.direction, p.shape), np.full(len(p), np.inf)
            received = np.ones(len(p))
        else:
            distance = np.linalg.norm(light.position - p, axis=1)
            to_light = (light.position - p) / distance[:, None]
            received = 1 / distance**2
        if light.kind == "SPOT":
            received = received * (-to_light @ light.direction >= light.spot_cos)
        phase = henyey_greenstein(medium.anisotropy, -(to_light * towards).sum(axis=1))
        reaching = np.exp(-optical_depth(medium, p, to_light, distance, self.tolerance)) if light.shadow else 1.0
        return medium.extinction(p) * medium.albedo * (phase * received)[:, None] * light.color * reaching


def _converged(integral: Callable[[int], np.ndarray], tolerance: float) -> tuple[np.ndarray, float]:
    """The integral with steps halved until it changes by no more than the tolerance, and the last change."""
    before = integral(1)
    for halving in range(1, _HALVINGS + 1):
        value = integral(1 << halving)
        error = float((np.abs(value - before) / np.maximum(np.abs(value), 1)).max(initial=0.0))
        if error <= tolerance:
            return value, error
        before = value
    raise ArithmeticError(f"{1 << _HALVINGS} steps leave an error of {error:g} where {tolerance:g} was asked for")


def _within(
    medium: Field, origins: np.ndarray, directions: np.ndarray, far: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray]:
    """Where rays enter the medium, and how far they go in it, (R,) each."""
    near, end = medium.interval(origins, directions)
    near = np.maximum(near, 0)
    length = np.maximum(np.minimum(end, far) - near, 0)
    return np.where(length > 0, near, 0), length


def _panels(steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Places and weights of a composite Gauss-Legendre quadrature over [0, 1]."""
    places = (np.arange(steps)[:, None] + (_NODES + 1) / 2) / steps
    return places.ravel(), np.tile(_WEIGHTS / 2 / steps, steps)


def _slabs(
    origins: np.ndarray, directions: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Distances (R,) at which rays enter and leave a box; equal where they miss it."""
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (low - origins) / directions, (high - origins) / directions
    # A ray that runs along a wall: inside everywhere or nowhere.
    flat = directions == 0
    outside = flat & ((origins < low) | (origins > high))
    near = np.where(flat, np.where(outside, np.inf, -np.inf), np.minimum(a, b)).max(axis=1)
    far = np.where(flat, np.where(outside, -np.inf, np.inf), np.maximum(a, b)).min(axis=1)
    miss = near >= far
    return np.where(miss, 0, near), np.where(miss, 0, far)


def _uniform(extinction: ArrayLike) -> Callable[[np.ndarray], np.ndarray]:
    sigma = np.broadcast_to(np.asarray(extinction, float), 3)
    return lambda p: np.broadcast_to(sigma, (len(p), 3))


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-300)
