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

MOST = 1e30  # extinction and emission of a splat, that leave room for sums
MOST_SPLATS = 1 << 21  # of a geometry's instances, from which on some stand for all
SMALLEST = 1e-3  # 1 - g, at least: what scatters all light forwards does nothing


@record
class BakedMedia:
    """Media as shaders read them (shaders/lib/indirect/media.glsl), with their light after some bounces."""

    low: np.ndarray  # (3,) float64: the grid's corner, in the tree's space
    edge: float  # of a cell
    shape: np.ndarray  # (3,) int64: cells along each axis
    # (C, 4) float32, x running first: what is sent per unit of length, and extinction; where that is coloured (C, 8),
    # with zeros between both and after them
    cells: np.ndarray
    block: int  # cells along the edge of a block
    # (B, 4) float32, x running first: fourth roots of mean radiance, but for that of lamps, in the blocks' middles
    light: np.ndarray

    @property
    def colored(self) -> bool:
        """Whether extinction differs between the channels."""
        return self.cells.shape[1] == 8


def baked_media(grid: MediaGrid, sent: np.ndarray, light: np.ndarray) -> BakedMedia:
    """Returns media that send so much, (C, 3), and on which so much light falls, (R, 3) at the grid's receivers."""
    none = np.zeros(len(sent), np.float32)
    columns = [sent, none, grid.extinction, none] if grid.colored else [sent, grid.extinction]
    cells = np.column_stack(columns).astype(np.float32)
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
        if len(rows):
            check()
            matrices = scene.instances.world_from_object[rows].copy()
            matrices[:, :3, 3] -= origin
            found.append(_matter(cloud, scene.materials, matrices))
    return media_grid(found)


def _matter(cloud: PointCloud, table: MaterialTable, matrices: np.ndarray) -> Matter:
    """The splats of some instances; `matrices` (I, 4, 4): to world space from some origin. Of very many some stand for
    all."""
    every = min(-(-len(cloud) * len(matrices) // MOST_SPLATS), len(cloud))
    cloud = cloud.take(slice(None, None, every)) if every > 1 else cloud
    extinction, rows = cloud.extinction, np.zeros(len(cloud), np.uint16)
    assert extinction is not None
    if cloud.material is not None:
        rows = np.minimum(cloud.material, len(table) - 1)
    scale = np.abs(np.linalg.det(matrices[:, :3, :3])) ** (1 / 3)
    radii = np.full((len(cloud), 1), 0.01) if cloud.radii is None else np.abs(cloud.radii.astype(np.float64))
    # A flat splat of a medium stands for a slab as thick as it is wide: render/passes/translucent/page.py.
    a, b = radii[:, 0], radii[:, min(1, radii.shape[1] - 1)]
    c = radii[:, 2] if radii.shape[1] == 3 else np.sqrt(a * b)
    volume = (4 / 3 * np.pi * every) * a * b * c
    base = table.base_color[rows] if cloud.color is None else cloud.color
    albedo = np.clip(np.nan_to_num(base.astype(np.float64)), 0, 1)
    channels = np.clip(np.nan_to_num(extinction.astype(np.float64)), 0, MOST)
    colored = channels.ndim == 2
    channels = np.broadcast_to(channels.reshape(len(cloud), -1), (len(cloud), 3)) * volume[:, None]
    lit = channels * albedo
    evenly = np.ones(len(cloud))
    if table.anisotropy is not None:
        evenly = np.maximum(1 - np.clip(table.anisotropy[rows], -1, 1).astype(np.float64), SMALLEST)
    scattering = lit * evenly[:, None]
    # Of equal channels albedo may differ, and with it what similarity leaves.
    whole = channels - lit + scattering
    colored |= bool((np.ptp(whole, axis=1) > 1e-6 * whole.max(axis=1)).any())
    emission = None
    if cloud.emission is not None:
        emission = np.clip(np.nan_to_num(cloud.emission.astype(np.float64)), 0, MOST) * volume[:, None]
    linear, middle = matrices[:, :3, :3], matrices[:, None, :3, 3]
    position = (cloud.position.astype(np.float64) + cloud.origin) @ linear.transpose(0, 2, 1) + middle
    # What is counted per object unit, on a volume in object units, is an area that grows with the square of the scale.
    square = scale[:, None] ** 2
    sound = np.isfinite(position).all(axis=2).reshape(-1)
    sound &= (whole.max(axis=1, initial=0.0) * square).reshape(-1) < MOST

    def of_all(values: np.ndarray) -> np.ndarray:
        found = (values * square[..., None]).reshape(-1, 3)
        return found if sound.all() else found[sound]

    size = np.cbrt(a * b * c)
    apart = float(np.median(size) * np.median(scale)) / (2 * EVEN_SPACING)
    hidden, scatters = of_all(whole) if colored else of_all(whole)[:, 0], of_all(scattering)
    return Matter(
        position.reshape(-1, 3)[sound], hidden, scatters, scatters if (evenly == 1).all() else of_all(lit),
        None if emission is None else of_all(emission), apart,
    )  # fmt: skip
