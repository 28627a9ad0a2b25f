"""Casters of shadows: splats in world space, of media, of translucent surfaces and of opaque ones."""

from __future__ import annotations

from functools import cached_property, reduce

import numpy as np

from ..numeric.record import record
from ..numeric.vectors import cross, each_block
from ..scene.cloud import PointCloud

OPAQUE_DEPTH = 100.0  # optical depth that counts as opaque
KINDS = ("OPAQUE", "SHELL", "VOLUME", "CAPTURED")
TYPICAL_QUANTILE = 0.9  # quantile of the radii of a surface's samples that counts as typical
QUANTILE_SAMPLES = 1 << 16  # radii that the quantile is taken from
CHUNK = 1 << 14  # splats that are handled together, so that scratch arrays stay in the cache


@record
class Casters:
    """Splats of one kind in world space: balls (`radius`), ellipses or ellipsoids (`axes`)."""

    kind: str  # one of KINDS
    origin: np.ndarray  # (3,) float64
    position: np.ndarray  # (N, 3) float32, relative to origin
    radius: np.ndarray | None = None  # (N,) float32
    axes: np.ndarray | None = None  # (N, K, 3) float32, half-axes: K = 2 flat, 3 solid
    # VOLUME: (N,) or (N, 3) float32, optical mass in units^2: the integral of extinction over the splat.
    # SHELL: (N,) or (N, 3) float32, optical depth -ln(1 - opacity) face on. OPAQUE, CAPTURED: None.
    mass: np.ndarray | None = None
    opacity: np.ndarray | None = None  # CAPTURED: (N,) float32, at the splats' centres; else None

    def __len__(self) -> int:
        return len(self.position)

    @property
    def colored(self) -> bool:
        return self.mass is not None and self.mass.ndim == 2

    def take(self, index: np.ndarray | slice) -> Casters:
        arrays = (self.position, self.radius, self.axes, self.mass, self.opacity)
        position, radius, axes, mass, opacity = (None if a is None else a[index] for a in arrays)
        assert position is not None
        some = Casters(self.kind, self.origin, position, radius, axes, mass, opacity)
        if "reach" in self.__dict__:
            some.__dict__["reach"] = self.reach[index]  # so that it is not computed again
        return some

    @cached_property
    def reach(self) -> np.ndarray:
        """(N,) float32: the longest half-axis."""
        if self.axes is None:
            assert self.radius is not None
            return self.radius
        squared = np.einsum("nkc,nkc->kn", self.axes, self.axes)
        # Row by row: along the last, short axis NumPy is many times slower.
        return np.sqrt(reduce(np.maximum, squared))

    def extent_along(self, direction: np.ndarray) -> np.ndarray:
        """Returns (N,) float32: how far each splat extends from its middle along a unit vector (3,)."""
        if self.axes is None:
            assert self.radius is not None
            return self.radius
        along = self.axes @ direction.astype(np.float32)
        return np.sqrt(np.einsum("nk,nk->n", along, along))

    @cached_property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """The low and high corner (3,) float64 of a box around all splats."""
        low, high = (np.array([end(column) for column in self.position.T], float) for end in (np.min, np.max))
        widest = float(self.reach.max())
        return self.origin + low - widest, self.origin + high + widest


def casters(cloud: PointCloud, world_from_object: np.ndarray) -> Casters:
    """The splats of `cloud` as casters: VOLUME where it has `extinction`, SHELL where it has `opacity`, else OPAQUE.

    world_from_object: (4, 4) float64. Extinction is per object unit, so scaling an object keeps its optical depths.
    Splats with a NaN or infinity, or without size or mass, are left out.
    """
    linear = np.asarray(world_from_object[:3, :3], float)
    origin = linear @ cloud.origin + world_from_object[:3, 3]
    position = cloud.position @ linear.T.astype(np.float32)
    kind = "VOLUME" if cloud.extinction is not None else "SHELL" if cloud.opacity is not None else "OPAQUE"
    radii = np.zeros((len(cloud), 1), np.float32) if cloud.radii is None else cloud.radii
    radius, axes, size = None, None, radii[:, 0]
    solid = kind == "VOLUME" and radii.shape[1] == 3
    with np.errstate(over="ignore", invalid="ignore"):
        if cloud.normal is None or (kind == "VOLUME" and not solid):
            scale = np.linalg.norm(linear, axis=0)
            if np.allclose(linear.T @ linear, np.eye(3) * scale[0] ** 2, atol=1e-4 * scale.max() ** 2):
                radius = radii[:, 0] * np.float32(scale[0])
            else:
                axes = radii[:, :1, None] * linear.T.astype(np.float32)
        else:
            axes = rotate_vectors(_half_axes(cloud, radii, solid), linear.T.astype(np.float32))
        mass = None
        if cloud.extinction is not None:
            volume = 4 / 3 * np.pi * (radii[:, :3].prod(axis=1) if solid else radii[:, 0] ** 3)
            volume *= abs(np.linalg.det(linear)) ** (2 / 3)
            extinction = cloud.extinction[:, 0] if cloud.extinction.shape[1:] == (1,) else cloud.extinction
            mass = np.maximum(extinction, 0) * (volume if extinction.ndim == 1 else volume[:, None])
            size = mass if mass.ndim == 1 else mass.sum(axis=1)
        elif cloud.opacity is not None:
            least = np.float32(np.exp(-OPAQUE_DEPTH / 2))  # float32 holds it
            mass = -np.log(np.maximum(1 - np.clip(cloud.opacity, 0, 1), least))
            mass[cloud.opacity >= 1] = OPAQUE_DEPTH
            size = size * (mass if mass.ndim == 1 else mass.sum(axis=1))
        good = _finite(position) & np.isfinite(size) & (size > 0)
        good &= _finite(axes) if axes is not None else np.isfinite(radii[:, 0])
    if mass is not None:
        mass = mass.astype(np.float32, copy=False)
    result = Casters(kind, origin, position, radius, axes, mass)
    return result if good.all() else result.take(good)


def typical_radius(radii: np.ndarray) -> float:
    """The TYPICAL_QUANTILE of the radii (N,) of splats, from a subset of them."""
    step = len(radii) // QUANTILE_SAMPLES | 1  # odd: out of step with what repeats
    return float(np.quantile(radii[::step], TYPICAL_QUANTILE))


def _finite(values: np.ndarray) -> np.ndarray:
    """(N,) bool: rows of (N, ...) without a NaN or infinity."""
    finite = np.isfinite(values)
    # Row by row only where there is something to find: that takes many times as long.
    return np.ones(len(values), bool) if finite.all() else finite.all(axis=tuple(range(1, values.ndim)))


def _half_axes(cloud: PointCloud, radii: np.ndarray, solid: bool) -> np.ndarray:
    """(N, 2 or 3, 3) float32: half-axes of ellipses, or of ellipsoids if `solid`, in object space."""
    normal = cloud.normal
    assert normal is not None
    first, balls = cloud.axis, ~normal.any(axis=1)
    if balls.any():
        # Balls among disks cast as disks that lie flat.
        normal = np.where(balls[:, None], np.array([0, 0, 1], np.float32), normal)
        first = None if first is None else np.where(balls[:, None], np.array([1, 0, 0], np.float32), first)
    if first is None:
        # Any direction in the plane of a disk: the cross product with the axis that is farthest from the normal.
        least = np.eye(3, dtype=np.float32)[np.abs(normal).argmin(axis=1)]
        first = np.cross(normal, least)
        first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), np.float32(1e-20))
    axes = np.empty((3, 3 if solid else 2, len(normal)), np.float32)

    def fill(block: slice) -> None:
        along, facing, radius = first[block].T.copy(), normal[block].T.copy(), radii[block].T.copy()
        frame = (along, cross(facing, along), facing)[: axes.shape[1]]
        for k, direction in enumerate(frame):
            np.multiply(direction, radius[min(k, len(radius) - 1)], out=axes[:, k, block])

    each_block(len(normal), fill)
    return axes.transpose(2, 1, 0)


def rotate_vectors(vectors: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Row vectors (N, K, 3) times a matrix (3, 3). In memory they are rows of coordinates, which NumPy handles several
    times faster than vectors one by one."""
    rows = vectors.transpose(2, 1, 0)
    return (matrix.T @ rows.reshape(3, -1)).reshape(rows.shape).transpose(2, 1, 0)
