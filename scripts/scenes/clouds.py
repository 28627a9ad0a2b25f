"""Point clouds of simple shapes: spheres, planes, balls of smoke and crowns of leaves."""

from __future__ import annotations

import numpy as np

from pointsplat_addon.core.scene.cloud import PointCloud
from scripts.scenes.cameras import Vector


def sphere_points(count: int = 400, size: float = 1.0) -> np.ndarray:
    """(count, 3) float64: a spiral of nearly equal spacing (Fibonacci)."""
    i = np.arange(count) + 0.5
    polar, around = np.arccos(1 - 2 * i / count), np.pi * (1 + 5**0.5) * i
    return size * np.stack([np.cos(around) * np.sin(polar), np.sin(around) * np.sin(polar), np.cos(polar)], axis=1)


def sphere_cloud(count: int = 400, **more) -> PointCloud:
    """A unit sphere of disks that cover it."""
    position = sphere_points(count).astype(np.float32)
    radii = np.full((count, 1), 1.5 * np.sqrt(4 / count), np.float32)
    return PointCloud(position, normal=position.copy(), radii=radii, **more)


def plane_cloud(cells: int = 20, size: float = 1.0, **more) -> PointCloud:
    """A square in XZ from -size to size that faces -Y, of disks that cover it."""
    grid = ((np.arange(cells) + 0.5) / cells * 2 - 1) * size
    x, z = (a.ravel() for a in np.meshgrid(grid, grid))
    position = np.stack([x, np.zeros_like(x), z], axis=1).astype(np.float32)
    normal = np.tile(np.array([0, -1, 0], np.float32), (len(x), 1))
    radii = np.full((len(x), 1), np.sqrt(2) * size / cells, np.float32)
    return PointCloud(position, normal=normal, radii=radii, **more)


def smoke_cloud(cells: int = 12, extinction: float | Vector = 2.0, **more) -> PointCloud:
    """A unit ball of voxels, each a Gaussian of 0.6 voxels' edges as its standard deviation."""
    edge = 2 / cells
    middle = (np.arange(cells) + 0.5) * edge - 1
    position = np.stack(np.meshgrid(middle, middle, middle, indexing="ij"), -1).reshape(-1, 3)
    position = position[(position**2).sum(axis=1) < 1].astype(np.float32)
    radius = 1.2 * edge
    share = np.asarray(extinction, np.float32) * np.float32(edge**3 / (4 / 3 * np.pi * radius**3))
    given = np.broadcast_to(share, (len(position), *share.shape)).copy()
    return PointCloud(position, radii=np.full((len(position), 1), radius, np.float32), extinction=given, **more)


def leaves(count: int, depth: float) -> PointCloud:
    """Disks in all directions, strewn over the unit ball; their seen areas add up to `depth` times its silhouette."""
    rng = np.random.default_rng(0)
    p, normal = rng.standard_normal((2, count, 3))
    p *= np.cbrt(rng.random((count, 1))) / np.linalg.norm(p, axis=1, keepdims=True)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    radii = np.full((count, 1), np.sqrt(2 * depth / count), np.float32)
    return PointCloud(p.astype(np.float32), normal=normal.astype(np.float32), radii=radii)
