"""Extinction, albedo and emission of voxels, by a medium as Cycles reads it or by a transfer function."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..material.blackbody import blackbody
from ..numeric.record import record
from ..scene.volume import Medium, Transfer, Volume

MOST_EXTINCTION = 1e30  # extinction, and radiance per unit of length, that leaves room for products in float32
# Stefan-Boltzmann's law as radiance, sigma T^4 / pi, times the 1e-6 by which Blender makes flames displayable
BLACKBODY_RADIANCE = 5.670374e-8 * 1e-6 / np.pi


@record
class Optics:
    """The medium in each of N voxels, per object unit."""

    extinction: np.ndarray  # (N,) or, where it is coloured, (N, 3) float32
    albedo: np.ndarray  # (N, 3) float32, scattering over extinction
    emission: np.ndarray | None  # (N, 3) float32, radiance per unit of length
    value: np.ndarray  # (N,) float32, of the grid that the density or the transfer function reads


def classify(value: np.ndarray, transfer: Transfer, extinction: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Extinction (N,) per object unit and albedo (N, 3), float32, of values (N,) under a transfer function.

    extinction: instead of transfer.density; 0 takes that.
    """
    width = transfer.high - transfer.low
    with np.errstate(all="ignore"):
        # A ramp of no width is a step, which its left end still belongs to.
        at = (value - np.float32(transfer.low)) / np.float32(width) if width else np.sign(value - transfer.low)
    stops = np.linspace(0, 1, len(transfer.ramp))
    red, green, blue, opacity = (np.interp(at, stops, column).astype(np.float32) for column in transfer.ramp.T)
    return opacity * np.float32(extinction or transfer.density), np.stack([red, green, blue], axis=1)


def voxel_optics(volume: Volume, medium: Medium, extinction: float = 0.0) -> tuple[Optics, list[str]]:
    """The optics of each voxel by its transfer function, or else by the medium as Cycles reads it; and warnings.

    Scattering is density * color and absorption density * (1 - color) * (1 - sqrt(absorption)). Values that are not
    finite, and negative densities, count as 0.
    """
    grids, warnings = _Grids(volume), []
    if volume.transfer is not None:
        value = grids.scalar(volume.transfer.grid, finite_only=True)
        if value is None:
            found = _no_optics(len(volume.index))
            return found, [f'{volume.name}: there is no grid "{volume.transfer.grid}" for the transfer function']
        alpha, albedo = classify(value, volume.transfer, extinction)
        return Optics(alpha, albedo, None, value), [*grids.warnings]

    value = grids.scalar(medium.density_grid)
    if value is None:
        if medium.density_grid and volume.share is None:
            warnings.append(
                f'{volume.name}: there is no grid "{medium.density_grid}", the density is the same everywhere'
            )
        value = np.ones(len(volume.index), np.float32)
    with np.errstate(over="ignore"):
        density = np.minimum(value * np.float32(extinction or max(medium.density, 0.0)), np.float32(MOST_EXTINCTION))
    tint = grids.read(medium.color_grid)
    color = np.maximum(np.asarray(medium.color, np.float32), 0)[None]
    if tint is not None:
        color = color * (tint if tint.ndim == 2 else tint[:, None])
    absorbed = np.maximum(1 - np.sqrt(np.maximum(np.asarray(medium.absorption, np.float32), 0)), 0)
    unit = color + np.maximum(1 - color, 0) * absorbed
    gray = bool((np.ptp(unit, axis=1) <= 1e-6 * unit.max(axis=1)).all())
    albedo = np.divide(color, unit, out=np.zeros_like(unit), where=unit > 0)
    emission = _emission(medium, grids, len(density))
    if volume.share is not None or volume.scale != 1:
        amount = np.float32(volume.scale) * (np.float32(1) if volume.share is None else volume.share)
        density = density * amount
        emission = None if emission is None else emission * np.reshape(amount, (-1, 1))
    return Optics(
        extinction=density * unit[:, 0] if gray else density[:, None] * unit,
        albedo=np.array(np.broadcast_to(albedo, (len(density), 3))),
        emission=emission,
        value=value,
    ), [*warnings, *grids.warnings]


@dataclass
class _Grids:
    """A volume's grids with invalid values replaced by 0, and warnings about them."""

    volume: Volume

    def __post_init__(self) -> None:
        self.warnings: list[str] = []

    def read(self, name: str, *, finite_only: bool = False) -> np.ndarray | None:
        """(N,) or (N, 3) float32 of a grid, or None if there is none of that name; negative values count as invalid
        unless `finite_only`."""
        grid = self.volume.grids.get(name) if name else None
        if grid is None:
            return None
        bad = ~np.isfinite(grid) if finite_only else ~((grid >= 0) & (grid < np.inf))
        if not bad.any():
            return grid
        kind = "not finite" if finite_only else "negative or not finite"
        count = int(np.count_nonzero(any_channel(bad)))
        self.warnings.append(f'{self.volume.name}: {count} voxels of the grid "{name}" are {kind} and count as 0')
        return np.where(bad, np.float32(0), grid)

    def scalar(self, name: str, *, finite_only: bool = False) -> np.ndarray | None:
        """(N,) float32 of a grid, or the mean of the components of a vector grid; None if there is none of that
        name."""
        grid = self.read(name, finite_only=finite_only)
        return grid if grid is None or grid.ndim == 1 else grid.mean(axis=1)


def _emission(medium: Medium, grids: _Grids, count: int) -> np.ndarray | None:
    """(N, 3) float32 radiance per unit of length, or None if nothing emits light."""
    constant = np.maximum(np.asarray(medium.emission, np.float32), 0)
    if medium.blackbody <= 0:
        return np.tile(constant, (count, 1)) if constant.any() else None
    kelvin = grids.scalar(medium.temperature_grid)
    kelvin = np.full(1, medium.temperature) if kelvin is None else kelvin * np.float32(medium.temperature)
    kelvin = np.maximum(kelvin, 0)
    power = BLACKBODY_RADIANCE * ((1 - medium.blackbody) + medium.blackbody * kelvin.astype(np.float64) ** 4)
    glow = blackbody(kelvin) * np.where(kelvin > 0, power, 0)[:, None] * np.asarray(medium.blackbody_tint)
    return np.array(np.broadcast_to(constant + np.clip(glow, 0, MOST_EXTINCTION), (count, 3)), np.float32)


def _no_optics(count: int) -> Optics:
    zero = np.zeros(count, np.float32)
    return Optics(zero, np.zeros((count, 3), np.float32), None, zero)


def any_channel(mask: np.ndarray) -> np.ndarray:
    """(N,) bool: where any channel of a mask (N,) or (N, C) is set."""
    return np.asarray(mask.any(axis=1)) if mask.ndim == 2 else mask
