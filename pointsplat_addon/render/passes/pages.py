"""Splats on the device: pages of 4,096-wide float textures, one texel a splat, texture by texture."""

from __future__ import annotations

import numpy as np

from ...core.cloud import PointCloud
from ...core.hierarchy import basis, splats
from ..device import Device, Texture
from ..packing import NO_NORMAL, pack_normal, paged
from ..prepare import PointSet


class SplatPage:
    """The splats of several point sets, one set after the other.

    `first` is where each set begins, by its key; `textures` has what was uploaded, by sampler name.
    """

    def __init__(self, device: Device, sets: list[PointSet]) -> None:
        self.clouds = [splats(points.hierarchy) if points.hierarchy else points.cloud for points in sets]
        ends = np.cumsum([len(cloud) for cloud in self.clouds]).tolist()
        self.first: dict[tuple, int] = dict(zip((points.key for points in sets), [0, *ends], strict=False))
        self.count: int = ends[-1]
        self.textures: dict[str, Texture] = {}
        self._device = device

    def upload(self, name: str, format: str, channels: int, rows: list[np.ndarray]) -> None:
        """One attribute: rows (n, C <= channels) of each cloud. DeviceError: more splats than a texture holds."""
        size, data = paged(rows[0] if len(rows) == 1 else np.concatenate(rows), channels)
        self.textures[f"ps_{name}"] = self._device.texture(size, format, data)

    def release(self) -> None:
        for texture in self.textures.values():
            texture.release()


def place(cloud: PointCloud) -> np.ndarray:
    """(N, 4) float32: position relative to the cloud's origin, packed normal (NO_NORMAL: a ball)."""
    rows = np.empty((len(cloud), 4), np.float32)
    rows[:, :3] = cloud.position
    rows[:, 3] = NO_NORMAL if cloud.normal is None else pack_normal(cloud.normal)
    return rows


def extent(cloud: PointCloud, always_axis: bool = False) -> np.ndarray:
    """(N, 4) float32: half-axes (major, minor), packed major axis, material row. `always_axis`: disks have one, too."""
    rows = np.zeros((len(cloud), 4), np.float32)
    if cloud.radii is not None:
        rows[:, 0] = cloud.radii[:, 0]
        rows[:, 1] = cloud.radii[:, min(1, cloud.radii.shape[1] - 1)]
    if cloud.axis is not None:
        rows[:, 2] = pack_normal(cloud.axis)
    elif always_axis and cloud.normal is not None:
        rows[:, 2] = pack_normal(basis(cloud.normal.T.astype(np.float64))[0].T)
    if cloud.material is not None:
        rows[:, 3] = cloud.material
    return rows


def filled(cloud: PointCloud, name: str, constants: np.ndarray) -> np.ndarray:
    """(N, C): an attribute, or its material's constant (M, C) where the cloud has none."""
    own = getattr(cloud, name)
    if own is not None:
        return own
    if cloud.material is None:
        return np.broadcast_to(constants[0], (len(cloud), constants.shape[1]))
    return constants[cloud.material]


def shading_normal(cloud: PointCloud) -> np.ndarray:
    """(N,) float32: packed shading normals, NO_NORMAL where there is none."""
    if cloud.shading_normal is None:
        return np.full(len(cloud), NO_NORMAL, np.float32)
    size = np.linalg.norm(cloud.shading_normal, axis=1, keepdims=True)
    code = pack_normal(cloud.shading_normal / np.maximum(size, 1e-20))
    return np.where(size[:, 0] > 1e-6, code, NO_NORMAL).astype(np.float32)
