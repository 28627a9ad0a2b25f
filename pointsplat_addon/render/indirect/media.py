"""The media of a scene, in a grid, and what of light they send."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...core.indirect.media import ROOT, Matter, MediaGrid, media_grid
from ...core.numeric.record import record
from ...core.scene.cloud import PointCloud
from ...core.scene.materials import MaterialTable
from ...core.scene.scene import Scene
from ...core.splat.kernel import EVEN_SPACING

MOST_EXTINCTION = 1e30  # of a splat, that leaves room for sums
SMALLEST = 1e-3  # 1 - g, at least: what scatters all light forwards does nothing


@record
class BakedMedia:
    """Media as shaders read them (shaders/lib/indirect/media.glsl), with their light after some bounces."""

    low: np.ndarray  # (3,) float64: the grid's corner, in the tree's space
    edge: float  # of a cell
    shape: np.ndarray  # (3,) int64: cells along each axis
    cells: np.ndarray  # (C, 4) float32, x running first: what is sent per unit of length, and extinction
    block: int  # cells along the edge of a block
    # (B, 4) float32, x running first: fourth roots of mean radiance, but for that of lamps, in the blocks' middles
    light: np.ndarray


def baked_media(grid: MediaGrid, sent: np.ndarray, light: np.ndarray) -> BakedMedia:
    """Returns media that send so much, (C, 3), and on which so much light falls, (R, 3) at the grid's receivers."""
    cells = np.column_stack([sent, grid.extinction]).astype(np.float32)
    roots = grid.on_blocks(light) ** (1 / ROOT)
    padded = np.column_stack([roots, np.zeros(len(roots))]).astype(np.float32)
    return BakedMedia(grid.low, grid.edge, grid.shape, cells, grid.block, padded)


def scene_media(scene: Scene, usable: np.ndarray, origin: np.ndarray, check: Callable[[], None]) -> MediaGrid | None:
    """Returns the media of instances, (I,) bool, in world space from `origin`; None where there are none."""
    found = []
    for geometry, rows in zip(scene.geometries, scene.instances.of_each(len(scene.geometries), usable), strict=True):
        cloud = geometry.cloud
        if cloud is None or cloud.extinction is None or len(cloud) == 0:
            continue
        for row in rows.tolist():
            check()
            matrix = scene.instances.world_from_object[row].copy()
            matrix[:3, 3] -= origin
            found.append(_matter(cloud, scene.materials, matrix))
    return media_grid(found)


def has_media(scene: Scene) -> bool:
    """Tells whether something fills a volume."""
    return any(one.cloud is not None and one.cloud.extinction is not None for one in scene.geometries)


def _matter(cloud: PointCloud, table: MaterialTable, matrix: np.ndarray) -> Matter:
    """The splats of an instance; `matrix` (4, 4): to world space from some origin."""
    extinction, rows = cloud.extinction, np.zeros(len(cloud), np.uint16)
    assert extinction is not None
    if cloud.material is not None:
        rows = np.minimum(cloud.material, len(table) - 1)
    scale = abs(float(np.linalg.det(matrix[:3, :3]))) ** (1 / 3)
    radii = np.full((len(cloud), 1), 0.01) if cloud.radii is None else np.abs(cloud.radii.astype(np.float64))
    # A flat splat of a medium stands for a slab as thick as it is wide: render/passes/translucent/page.py.
    a, b = radii[:, 0], radii[:, min(1, radii.shape[1] - 1)]
    c = radii[:, 2] if radii.shape[1] == 3 else np.sqrt(a * b)
    # Lengths count in object units in extinction, and squares of them in world units.
    volume = (4 / 3 * np.pi) * a * b * c * scale**2
    base = table.base_color[rows] if cloud.color is None else cloud.color
    albedo = np.clip(np.nan_to_num(base.astype(np.float64)), 0, 1)
    channels = np.clip(np.nan_to_num(extinction.astype(np.float64)), 0, MOST_EXTINCTION)
    channels = np.broadcast_to(channels.reshape(len(cloud), -1), (len(cloud), 3)) * volume[:, None]
    lit = channels * albedo
    evenly = np.ones(len(cloud))
    if table.anisotropy is not None:
        evenly = np.maximum(1 - np.clip(table.anisotropy[rows], -1, 1).astype(np.float64), SMALLEST)
    scattering = lit * evenly[:, None]
    whole = (channels - lit + scattering).mean(axis=1)
    emission = None if cloud.emission is None else np.maximum(cloud.emission, 0) * volume[:, None]
    position = (cloud.position.astype(np.float64) + cloud.origin) @ matrix[:3, :3].T + matrix[:3, 3]
    apart = float(np.median(np.cbrt(a * b * c))) / (2 * EVEN_SPACING) * scale
    sound = np.isfinite(position).all(axis=1) & np.isfinite(whole)
    if not sound.all():
        position, whole, scattering, lit = position[sound], whole[sound], scattering[sound], lit[sound]
        emission = None if emission is None else emission[sound]
    return Matter(position, whole, scattering, lit, emission, apart)
