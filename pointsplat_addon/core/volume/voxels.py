"""Participating media as points: each active voxel becomes one splat.

A splat's `extinction` is the share that it alone contributes, spread over its own ellipsoid (radius 2 sigma): its
optical mass 4/3 pi a b c * extinction is that of the voxel, extinction times the voxel's volume. Overlapping splats of
neighbouring voxels then add up to the medium: kernels of EVEN voxel edges are wide enough that the lattice does not
show, and no wider than needed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..scene.cloud import PointCloud
from ..scene.volume import Medium, Transfer, Volume
from ..splat.kernel import EVEN_SPACING

SHARE = 1 / (4 / 3 * np.pi * (2 * EVEN_SPACING) ** 3)  # the volume of a voxel over that of its splat's ellipsoid
NEARLY_CUBIC = 1.03  # ratio of a voxel's principal lengths up to which its splat is a ball
OPAQUE = 1e6  # optical depth of a voxel's edge that is as good as any above it
BRIGHT = 1e30  # extinction, and radiance per unit of length, that leaves room for products in float32
ROWS = 1 << 20  # voxels that are handled together: temporary arrays stay small

# Planck's law times the observer, relative to its luminance; Cycles holds the colour constant outside this range, too.
BLACKBODY_KELVIN = np.geomspace(800.0, 12000.0, 256)
# Stefan-Boltzmann's law as radiance, sigma T^4 / pi, times the 1e-6 by which Blender makes flames displayable
BLACKBODY_RADIANCE = 5.670374e-8 * 1e-6 / np.pi


@dataclass(frozen=True, eq=False)
class Optics:
    """The medium in each of N voxels, per object unit."""

    extinction: np.ndarray  # (N,) or, where it is coloured, (N, 3) float32
    albedo: np.ndarray  # (N, 3) float32, scattering over extinction
    emission: np.ndarray | None  # (N, 3) float32, radiance per unit of length
    value: np.ndarray  # (N,) float32, of the grid that the density or the transfer function reads


def point_cloud(
    volume: Volume, medium: Medium | None = None, extinction: float = 0.0, spacing: float = 0.0
) -> tuple[PointCloud, list[str]]:
    """One splat for each voxel that is seen, in object space, and warnings that name the object.

    medium: what fills the volume where it has no transfer function; None is Blender's default, a Principled Volume.
    extinction: instead of the medium's (or the transfer function's) density; 0 takes theirs. spacing: distance of
    splats in object units; blocks of 2^k voxels to a side that are no longer than it become one splat of their mass.

    Under a transfer function all voxels stay, so that another function (`recolor`) finds them in the same places, and
    `shading_normal` holds the normals of `normals`.
    """
    found, warnings = optics(volume, medium or Medium(), extinction)
    index, matrix, shading = volume.index, volume.object_from_index, None
    if volume.transfer is None:
        seen = _any(found.extinction > 0)
        if found.emission is not None:
            seen |= _any(found.emission > 0)
    else:
        grid = volume.grids.get(volume.transfer.grid)
        shading = None if grid is None else normals(volume, volume.transfer.grid)
        seen = np.zeros(len(index), bool) if grid is None else _any(np.isfinite(grid))
    if not seen.all():
        index, found, shading = index[seen], _take(found, seen), None if shading is None else shading[seen]
    level = _level(matrix, spacing)
    if level > 0 and len(index):
        index, found, shading = _merge(index, found, shading, level)
    position, origin = _place(index, matrix)
    normal, axis, radii = _ellipsoid(matrix[:3, :3] * 2.0**level, len(index))
    share, edge = np.float32(SHARE), max(np.cbrt(abs(np.linalg.det(matrix[:3, :3]))), 1e-30)
    cloud = PointCloud(
        position=position,
        origin=origin,
        normal=normal,
        axis=axis,
        radii=radii,
        color=found.albedo,
        emission=None if found.emission is None else found.emission * share,
        shading_normal=shading,
        extinction=np.minimum(found.extinction, np.float32(OPAQUE / edge)) * share,
        material=np.full(len(index), volume.material, np.uint16) if volume.material else None,
        value=found.value,
    )
    return cloud, warnings


def recolor(cloud: PointCloud, transfer: Transfer, extinction: float = 0.0) -> PointCloud:
    """The cloud of a volume, in any order and not merged, by another transfer function of the same grid."""
    assert cloud.value is not None
    alpha, albedo = classify(cloud.value, transfer, extinction)
    return replace(cloud, color=albedo, extinction=alpha * np.float32(SHARE))


def classify(value: np.ndarray, transfer: Transfer, extinction: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Extinction (N,) per object unit and albedo (N, 3) of values (N,) by a transfer function, float32.

    extinction: instead of transfer.density; 0 takes that.
    """
    width = transfer.high - transfer.low
    with np.errstate(all="ignore"):
        # A ramp of no width is a step, which its left end still belongs to.
        at = (value - np.float32(transfer.low)) / np.float32(width) if width else np.sign(value - transfer.low)
    stops = np.linspace(0, 1, len(transfer.ramp))
    red, green, blue, opacity = (np.interp(at, stops, column).astype(np.float32) for column in transfer.ramp.T)
    return opacity * np.float32(extinction or transfer.density), np.stack([red, green, blue], axis=1)


def optics(volume: Volume, medium: Medium, extinction: float = 0.0) -> tuple[Optics, list[str]]:
    """The medium in each voxel by the transfer function, or else by the medium as Cycles reads it; and warnings.

    Scattering is density * color and absorption density * (1 - color) * (1 - sqrt(absorption)). Values that are not
    finite, and negative densities, count as 0.
    """
    grids, warnings = _Grids(volume), []
    if volume.transfer is not None:
        value = grids.scalar(volume.transfer.grid, finite_only=True)
        if value is None:
            found = _nothing(len(volume.index))
            return found, [f'{volume.name}: there is no grid "{volume.transfer.grid}" for the transfer function']
        alpha, albedo = classify(value, volume.transfer, extinction)
        return Optics(alpha, albedo, None, value), [*grids.warnings]

    value = grids.scalar(medium.density_grid)
    if value is None:
        if medium.density_grid:
            warnings.append(
                f'{volume.name}: there is no grid "{medium.density_grid}", the density is the same everywhere'
            )
        value = np.ones(len(volume.index), np.float32)
    with np.errstate(over="ignore"):
        density = np.minimum(value * np.float32(extinction or max(medium.density, 0.0)), np.float32(BRIGHT))
    tint = grids.read(medium.color_grid)
    color = np.maximum(np.asarray(medium.color, np.float32), 0)[None]
    if tint is not None:
        color = color * (tint if tint.ndim == 2 else tint[:, None])
    absorbed = np.maximum(1 - np.sqrt(np.maximum(np.asarray(medium.absorption, np.float32), 0)), 0)
    unit = color + np.maximum(1 - color, 0) * absorbed
    gray = bool((np.ptp(unit, axis=1) <= 1e-6 * unit.max(axis=1)).all())
    albedo = np.divide(color, unit, out=np.zeros_like(unit), where=unit > 0)
    return Optics(
        extinction=density * unit[:, 0] if gray else density[:, None] * unit,
        albedo=np.array(np.broadcast_to(albedo, (len(density), 3))),
        emission=_emission(medium, grids, len(density)),
        value=value,
    ), [*warnings, *grids.warnings]


@dataclass
class _Grids:
    """A volume's grids without values that cannot be drawn."""

    volume: Volume

    def __post_init__(self) -> None:
        self.warnings: list[str] = []

    def read(self, name: str, *, finite_only: bool = False) -> np.ndarray | None:
        """(N,) or (N, 3) float32 of a grid, None where there is none of that name; negative values only if asked."""
        grid = self.volume.grids.get(name) if name else None
        if grid is None:
            return None
        bad = ~np.isfinite(grid) if finite_only else ~((grid >= 0) & (grid < np.inf))
        if not bad.any():
            return grid
        kind = "not finite" if finite_only else "negative or not finite"
        count = int(np.count_nonzero(_any(bad)))
        self.warnings.append(f'{self.volume.name}: {count} voxels of the grid "{name}" are {kind} and count as 0')
        return np.where(bad, np.float32(0), grid)

    def scalar(self, name: str, *, finite_only: bool = False) -> np.ndarray | None:
        """(N,): `read`, and the mean of a vector's components."""
        grid = self.read(name, finite_only=finite_only)
        return grid if grid is None or grid.ndim == 1 else grid.mean(axis=1)


def _emission(medium: Medium, grids: _Grids, count: int) -> np.ndarray | None:
    """(N, 3) float32 radiance per unit of length, or None where nothing glows."""
    constant = np.maximum(np.asarray(medium.emission, np.float32), 0)
    if medium.blackbody <= 0:
        return np.tile(constant, (count, 1)) if constant.any() else None
    kelvin = grids.scalar(medium.temperature_grid)
    kelvin = np.full(1, medium.temperature) if kelvin is None else kelvin * np.float32(medium.temperature)
    kelvin = np.maximum(kelvin, 0)
    power = BLACKBODY_RADIANCE * ((1 - medium.blackbody) + medium.blackbody * kelvin.astype(np.float64) ** 4)
    glow = blackbody(kelvin) * np.where(kelvin > 0, power, 0)[:, None] * np.asarray(medium.blackbody_tint)
    return np.array(np.broadcast_to(constant + np.clip(glow, 0, BRIGHT), (count, 3)), np.float32)


def blackbody(kelvin: np.ndarray) -> np.ndarray:
    """Linear Rec. 709 colour (N, 3) float64 of luminance 1 of black bodies; below 800 K that of 800 K.

    Planck's law integrated with the CIE 1931 observer in the fit of Wyman, Sloan & Shirley 2013, equation 4. Colours
    outside the gamut are clamped.
    """
    x = np.log(np.maximum(kelvin, 1.0))
    at = np.log(BLACKBODY_KELVIN)
    return np.stack([np.interp(x, at, column) for column in _blackbody_table().T], axis=1)


def _blackbody_table() -> np.ndarray:
    wave = np.arange(360.0, 831.0)  # nanometres

    def lobe(middle: float, left: float, right: float) -> np.ndarray:
        return np.exp(-0.5 * ((wave - middle) * np.where(wave < middle, left, right)) ** 2)

    observer = np.stack([
        0.362 * lobe(442.0, 0.0624, 0.0374) + 1.056 * lobe(599.8, 0.0264, 0.0323) - 0.065 * lobe(501.1, 0.0490, 0.0382),
        0.821 * lobe(568.8, 0.0213, 0.0247) + 0.286 * lobe(530.9, 0.0613, 0.0322),
        1.217 * lobe(437.0, 0.0845, 0.0278) + 0.681 * lobe(459.0, 0.0385, 0.0725),
    ])  # fmt: skip
    with np.errstate(over="ignore"):
        planck = 1 / (wave**5 * np.expm1(1.438777e7 / (wave * BLACKBODY_KELVIN[:, None])))
    xyz = planck @ observer.T
    linear = (xyz / xyz[:, 1:2]) @ np.array([
        [3.2404542, -0.9692660, 0.0556434],
        [-1.5371385, 1.8760108, -0.2040259],
        [-0.4985314, 0.0415560, 1.0572252],
    ])  # fmt: skip
    return np.maximum(linear, 0)


# Places and shapes


def _place(index: np.ndarray, matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions (N, 3) float32 relative to an origin (3,) float64, of indices (N, 3) in object space."""
    if len(index) == 0:
        return np.empty((0, 3), np.float32), matrix[:3, 3].copy()
    middle = np.round((index.min(axis=0).astype(np.float64) + index.max(axis=0)) / 2)
    position = np.empty((len(index), 3), np.float32)
    for i in range(0, len(index), ROWS):
        position[i : i + ROWS] = (index[i : i + ROWS] - middle) @ matrix[:3, :3].T
    return position, matrix[:3, :3] @ middle + matrix[:3, 3]


def _ellipsoid(linear: np.ndarray, count: int) -> tuple[np.ndarray | None, np.ndarray | None, np.ndarray]:
    """Normal, axis (both None for balls) and half-axes of the Gaussian of `count` voxels under a linear map (3, 3).

    The map's left singular vectors and values are the principal axes; they hold shear, too.
    """
    axes, lengths, _ = np.linalg.svd(linear)
    radii = 2 * EVEN_SPACING * lengths
    if lengths[0] <= NEARLY_CUBIC * lengths[2]:
        return None, None, np.full((count, 1), np.cbrt(np.prod(radii)), np.float32)
    axis, normal = (np.tile(axes[:, k].astype(np.float32), (count, 1)) for k in (0, 2))
    return normal, axis, np.tile(radii.astype(np.float32), (count, 1))


def _level(matrix: np.ndarray, spacing: float) -> int:
    """How often voxels may be merged two by two along each axis until they are no longer than `spacing`."""
    edge = float(np.linalg.norm(matrix[:3, :3], axis=0).max())
    if not (spacing > 0 and edge > 0):
        return 0
    return int(np.clip(np.floor(np.log2(spacing / edge) + 1e-6), 0, 20))


def _merge(
    index: np.ndarray, found: Optics, shading: np.ndarray | None, level: int
) -> tuple[np.ndarray, Optics, np.ndarray | None]:
    """One voxel for each block of 2^level to a side: (K, 3) float64 indices at the centres of mass, mean optics.

    Means are over the block's volume, so that mass stays. Blocks lie on a lattice through index 0 whatever is active,
    and do not swim in animations.
    """
    order, first = runs_of(index >> level)
    voxels = 8.0**level
    inside = np.diff(np.append(first, len(index)))

    def total(array: np.ndarray) -> np.ndarray:
        return np.add.reduceat(array[order], first, axis=0, dtype=np.float64)

    depth = found.extinction if found.extinction.ndim == 1 else found.extinction.mean(axis=1)
    weight = depth if found.emission is None else depth + found.emission.mean(axis=1)
    # Voxels of no optics still have a place.
    weight = np.maximum(weight, max(float(weight.max()), 1e-30) * np.float32(1e-12)).astype(np.float64)
    mass = total(weight)[:, None]
    scattering = found.albedo * (found.extinction if found.extinction.ndim == 2 else depth[:, None])
    extinction = total(found.extinction)
    across = extinction if extinction.ndim == 2 else extinction[:, None]
    albedo = np.divide(total(scattering), across, out=np.zeros((len(first), 3)), where=across > 0)
    merged = Optics(
        extinction=(extinction / voxels).astype(np.float32),
        albedo=albedo.astype(np.float32),
        emission=None if found.emission is None else (total(found.emission) / voxels).astype(np.float32),
        value=(total(found.value) / inside).astype(np.float32),
    )
    if shading is not None:
        shading = _unit(total(shading * weight[:, None].astype(np.float32)))
    # An index is a voxel's centre in the finer lattice; the merged splat is placed by the finer matrix as well.
    return total(index * weight[:, None]) / mass, merged, shading


def _take(found: Optics, which: np.ndarray) -> Optics:
    emission = None if found.emission is None else found.emission[which]
    return Optics(found.extinction[which], found.albedo[which], emission, found.value[which])


def _nothing(count: int) -> Optics:
    zero = np.zeros(count, np.float32)
    return Optics(zero, np.zeros((count, 3), np.float32), None, zero)


def _any(mask: np.ndarray) -> np.ndarray:
    return np.asarray(mask.any(axis=1)) if mask.ndim == 2 else mask


# The sparse lattice


def keys(index: np.ndarray, low: np.ndarray, extent: np.ndarray) -> np.ndarray:
    """(N,) int64: rows of integer indices (N, 3) as one number each, lexicographic, x first.

    Indices lie in low + [0, extent). Raises ValueError where so many cells have no 64-bit number.
    """
    if float(extent[0]) * float(extent[1]) * float(extent[2]) >= 2.0**62:
        raise ValueError("the voxels lie too far apart: " + " x ".join(str(int(e)) for e in extent))
    key = index[:, 0].astype(np.int64)
    key -= low[0]
    for k in (1, 2):
        key *= extent[k]
        key += index[:, k]
        key -= low[k]
    return key


def bounds(index: np.ndarray, margin: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Low corner and extent (3,) int64 each of indices (N, 3), N > 0, with a margin on all sides."""
    low = index.min(axis=0).astype(np.int64) - margin
    return low, index.max(axis=0) - low + 1 + margin


def runs_of(index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """An order (N,) that brings equal rows of indices (N, 3) together, and where (K,) in it a new one begins."""
    key = keys(index, *bounds(index))
    order = np.argsort(key, kind="stable")
    key = key[order]
    return order, np.flatnonzero(np.append(True, key[1:] != key[:-1]))


def normals(volume: Volume, grid: str) -> np.ndarray:
    """(N, 3) float32 unit vectors in object space towards lower values of a grid: negated 3D Sobel gradients.

    Voxels that are not active hold 0. Where the gradient vanishes, so does the normal.
    """
    index, value = volume.index, volume.grids[grid]
    if len(index) == 0:
        return np.empty((0, 3), np.float32)
    value = np.where(np.isfinite(value), value, np.float32(0))
    value = value if value.ndim == 1 else value.mean(axis=1)
    low, extent = bounds(index, margin=1)
    key = keys(index, low, extent)
    back = None
    if (key[1:] <= key[:-1]).any():
        order = np.argsort(key)
        key, value, back = key[order], value[order], order
    result = np.empty((len(index), 3), np.float32)
    gradient = np.empty((len(index), 3))
    for i in range(0, len(index), ROWS):
        gradient[i : i + ROWS] = _sobel(key, value, slice(i, i + ROWS), extent)
    # A gradient is a covector: g_object = A^-T g_index.
    with np.errstate(all="ignore"):
        linear = volume.object_from_index[:3, :3] / np.abs(volume.object_from_index[:3, :3]).max()
    found = _unit(-gradient @ np.linalg.pinv(linear))
    if back is None:
        return found
    result[back] = found
    return result


def _sobel(key: np.ndarray, value: np.ndarray, part: slice, extent: np.ndarray) -> np.ndarray:
    """(n, 3) float64 gradient of rows `part` in index space: central differences smoothed by 1 2 1 across.

    `key` is sorted, so that neighbours along z lie next to each other and only the nine columns are searched for.
    """
    here = key[part]
    last = len(key) - 1
    gradient = np.zeros((len(here), 3))
    for dx in (-1, 0, 1):
        for dy in (-1, 0, 1):
            wanted = here + (dx * extent[1] + dy) * extent[2]
            at = np.searchsorted(key, wanted - 1)
            column = []
            for dz in (-1, 0, 1):
                near = np.minimum(at, last)
                there = key[near] == wanted + dz
                column.append(np.where(there, value[near], 0).astype(np.float64))
                at = at + there
            below, middle, above = column
            across = below + 2 * middle + above
            wx, wy = 2 - abs(dx), 2 - abs(dy)
            gradient[:, 0] += dx * wy * across
            gradient[:, 1] += dy * wx * across
            gradient[:, 2] += wx * wy * (above - below)
    return gradient / 32


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Normalised rows, float32; zero vectors stay zero."""
    scale = np.abs(vectors).max(axis=1, keepdims=True)
    vectors = np.divide(vectors, scale, out=np.zeros_like(vectors), where=scale > 0)
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0).astype(np.float32)
