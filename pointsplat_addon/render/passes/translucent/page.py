"""Pages of translucent splats on the device.

A page holds the splats of all translucent point sets, one texel a splat:
  position        xyz relative to the set's origin; packed normal (-1: a ball)
  extent          half-axes (major, minor), packed major axis, material row
  optics          of the strongest channel; media: extinction per object unit, half-axis along the normal, 1 (voxels:
                  2); shells: optical depth of the splat's own area, half-axis along the normal, 0; opaque splats: the
                  same, -1; row of core.splat.kernel.PROFILES
  color           base colour of shells, albedo of media          \\
  surface         roughness, metallic                              |
  emission        shells: radiance; media: radiance per unit       | where any set has them
  tint            optical depth by channel over the strongest's    |
  shaded          what of that each channel's light is of          |
  shading_normal  packed normal, -1: none                         /
  span            over the splat's size, that of the flat piece of surface in which it lies; where planes tell the order
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ....core.scene.cloud import PointCloud
from ....core.scene.materials import MaterialTable
from ....core.splat import painter
from ....core.splat.kernel import PEAK, PROFILES
from ...cache.keys import Key
from ...device.protocol import Device
from ...prepare.point_sets import PointSet
from ..pages.splat_page import SplatPage, extent, filled, position_and_normal, shading_normal
from .options import TranslucentOptions, is_fuzzy

OPAQUE = 100.0  # optical depth of what is opaque


class TranslucentPage(SplatPage):
    """Translucent splats on the device."""

    def __init__(
        self,
        device: Device,
        sets: list[PointSet],
        options: TranslucentOptions,
        table: MaterialTable,
        shares: Mapping[Key, np.ndarray | float] | None = None,
    ) -> None:
        """`shares`: by key, what of its ellipse each opaque splat covers; with `options.defocus`."""
        super().__init__(device, sets)
        clouds = self.clouds
        if not options.defocus:
            clouds = [_reaching(c, len(points.cloud)) for c, points in zip(clouds, sets, strict=True)]
        self.clouds = clouds
        if options.defocus and options.fuzzy:
            held = [(shares or {}).get(points.key, 1.0) for points in sets]
            self.upload("share", "R32F", [
                np.broadcast_to(np.float32(share), len(cloud)) for share, cloud in zip(held, clouds, strict=True)
            ])  # fmt: skip
        self.upload("position", "RGBA32F", [position_and_normal(c) for c in clouds])
        self.upload("extent", "RGBA32F", [extent(c, always_axis=True) for c in clouds])
        self.upload("optics", "RGBA32F", [
            _optics(c, points.is_lattice) for c, points in zip(clouds, sets, strict=True)
        ])  # fmt: skip
        if options.slopes:
            self.upload("span", "R32F", [np.ones(len(c), "f4") if c.span is None else c.span for c in clouds])
        if options.color:
            self.upload("color", "RGBA16F", [filled(c, "color", table.base_color) for c in clouds])
        if options.surface:
            constants = np.stack([table.roughness, table.metallic], axis=1)
            self.upload("surface", "RG32F", [filled(c, "surface", constants) for c in clouds])
        if options.emission:
            dark = np.zeros_like(table.emission)
            self.upload("emission", "RGBA32F", [
                filled(c, "emission", table.emission if c.extinction is None else dark) for c in clouds
            ])  # fmt: skip
        if options.tint:
            self.upload("tint", "RGBA16F", [_tint(c) for c in clouds])
        if options.shaded:
            whole = np.ones((len(table), 3), np.float32)
            self.upload("shaded", "RGBA16F", [filled(c, "shaded", whole) for c in clouds])
        if options.shading_normal:
            self.upload("shading_normal", "R32F", [shading_normal(c) for c in clouds])
        self.clouds = []


def _reaching(cloud: PointCloud, points: int) -> PointCloud:
    """Returns a cloud whose nodes of opaque surfaces, which follow after the points, extend to the corners of what they
    stand for, as points do."""
    if not is_fuzzy(cloud) or len(cloud) == points or cloud.radii is None:
        return cloud
    radii = cloud.radii.copy()
    closed = True if cloud.disconnected is None else ~cloud.disconnected[points:, None]
    np.multiply(radii[points:], np.float32(painter.NODE_SCALE), out=radii[points:], where=closed)
    return replace(cloud, radii=radii)


def _optics(cloud: PointCloud, lattice: bool) -> np.ndarray:
    rows = np.zeros((len(cloud), 4), np.float32)
    if cloud.extinction is not None:
        rows[:, 0] = _strongest(cloud.extinction)
        rows[:, 2] = 2.0 if lattice else 1.0
        if cloud.radii is not None:
            thick = cloud.normal is not None and cloud.radii.shape[1] == 3
            # A flat splat of a medium stands for a slab as thick as it is wide.
            rows[:, 1] = (
                cloud.radii[:, 2] if thick else np.sqrt(np.abs(cloud.radii[:, 0])) * np.sqrt(np.abs(cloud.radii[:, -1]))
            )
    elif cloud.opacity is not None:
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = -np.log1p(-np.clip(_strongest(cloud.opacity).astype(np.float64), 0, 1))
        rows[:, 0] = np.minimum(depth, OPAQUE)
    else:
        # The peak of a kernel is twice what its splat has over its own area.
        rows[:, 0], rows[:, 2] = painter.DEPTH / (2 * PEAK), -1.0
    if cloud.extinction is None and cloud.radii is not None and cloud.radii.shape[1] == 3:
        # Coarse nodes of surfaces that do not lie in a plane, as of a tree's leaves.
        rows[:, 1] = cloud.radii[:, 2]
    if cloud.kernel is not None:
        rows[:, 3] = np.where(cloud.kernel < len(PROFILES), cloud.kernel, 0)
    return rows


def _strongest(channels: np.ndarray) -> np.ndarray:
    """Returns the largest of the channels (N, 3) of each splat; what has none, (N,), itself."""
    return channels if channels.ndim == 1 else channels.max(axis=1)


def _tint(cloud: PointCloud) -> np.ndarray:
    matter = cloud.opacity if cloud.extinction is None else cloud.extinction
    if matter is None or matter.ndim == 1:
        return np.ones((len(cloud), 3), np.float32)
    depth = np.maximum(matter, 0)
    if cloud.extinction is None:
        with np.errstate(divide="ignore"):
            depth = np.minimum(-np.log1p(-np.minimum(depth, 1).astype(np.float64)), OPAQUE)
    return depth / np.maximum(_strongest(depth), np.finfo(np.float32).tiny)[:, None]
