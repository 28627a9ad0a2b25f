"""Pages of splats on the device: 4,096-wide float textures, one for each attribute, one texel a splat."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ....core.lod.balls.covered import WIDER
from ....core.lod.node_splats import points_and_nodes
from ....core.numeric.vectors import basis, each_block
from ....core.scene.cloud import PointCloud
from ...cache.keys import Key
from ...device.packing import FACET_SHARE, FACET_STEPS, NO_NORMAL, PAGE_WIDTH, octahedral
from ...device.protocol import Device, Texture
from ...prepare.point_sets import PointSet

ROWS_AT_ONCE = 8  # of a page whose bounds are measured: what they need stays in the processor's cache
COVERED = 0.75  # added to a material row for what is not covered of a splat, whose fraction it tells
NODE = 0.25  # tells nodes from points beside a material row, which is whole
DIAGONAL = 0, 3, 5  # of the shape of a node: the squares of what it reaches along each axis
SMALLEST_NORMAL = 1e-6  # of shading: what is shorter has no direction
Write = Callable[[np.ndarray, slice], None]  # an attribute of the splats in a slice, into an array (n, channels)


class SplatPage:
    """The splats of several point sets, one set after the other.

    `first` is where each set begins, by its key; `textures` has what was uploaded, by sampler name.
    """

    def __init__(self, device: Device, sets: list[PointSet]) -> None:
        self.clouds = [points_and_nodes(points.hierarchy) if points.hierarchy else points.cloud for points in sets]
        ends = np.cumsum([len(cloud) for cloud in self.clouds]).tolist()
        self.first: dict[Key, int] = dict(zip((points.key for points in sets), [0, *ends], strict=False))
        self.count: int = ends[-1]
        self.textures: dict[str, Texture] = {}
        self._device = device

    def upload(self, name: str, format: str, rows: list[Write | np.ndarray]) -> None:
        """Uploads one attribute of each cloud: what writes it, or rows (n, C) of at most the format's channels.

        DeviceError: more splats than a texture holds.
        """
        height = max(1, -(-self.count // PAGE_WIDTH))
        writes = [_copy(values) if isinstance(values, np.ndarray) else values for values in rows]
        starts = np.cumsum([0, *(len(cloud) for cloud in self.clouds)]).tolist()

        def write(out: np.ndarray, texels: slice) -> None:
            out[max(self.count - texels.start, 0) :] = 0
            for one, start, stop in zip(writes, starts, starts[1:], strict=False):
                low, high = max(start, texels.start), min(stop, texels.stop)
                if low < high:
                    _write_blocks(one, out[low - texels.start : high - texels.start], low - start)

        self.textures[f"ps_{name}"] = self._device.texture((PAGE_WIDTH, height), format, write)

    def release(self) -> None:
        for texture in self.textures.values():
            texture.release()


def _write_blocks(write: Write, out: np.ndarray, first: int) -> None:
    """Writes the splats from `first` on into an array (n, channels), in several threads where they are many."""
    each_block(len(out), lambda block: write(out[block], slice(first + block.start, first + block.stop)))


def _copy(values: np.ndarray) -> Write:
    """Writes rows (N,) or (N, C) as they are, and zeros into further channels."""
    columns = values.T if values.ndim > 1 else values[None]

    def write(out: np.ndarray, block: slice) -> None:
        # Column by column: NumPy copies rows of three several times more slowly.
        for channel in range(out.shape[1]):
            out[:, channel] = columns[channel, block] if channel < len(columns) else 0

    return write


def position_and_normal(cloud: PointCloud) -> Write:
    """Writes (N, 4): position relative to the cloud's origin, packed normal (NO_NORMAL: a ball)."""

    def write(out: np.ndarray, block: slice) -> None:
        for channel, column in enumerate(cloud.position.T):
            out[:, channel] = column[block]
        out[:, 3] = NO_NORMAL
        if cloud.normal is not None:
            directed = cloud.normal[block].any(axis=1)
            np.copyto(out[:, 3], octahedral(cloud.normal[block]), where=directed)

    return write


def position_and_radius(cloud: PointCloud) -> Write:
    """Writes (N, 4): position relative to the cloud's origin, radius."""
    radii = cloud.radii
    assert radii is not None

    def write(out: np.ndarray, block: slice) -> None:
        for channel, column in enumerate((*cloud.position.T, radii[:, 0])):
            out[:, channel] = column[block]

    return write


def extent(cloud: PointCloud, always_axis: bool = False, points: int | None = None) -> Write:
    """Writes (N, 4): half-axes (major, minor), packed major axis, material row.

    `always_axis`: disks have one, too. The minor half-axis of disconnected splats is negative. Where a part of splats
    is covered, COVERED times what is not is added to the row. `points`: what follows after so many are nodes, whose
    material row has NODE added.
    """

    def write(out: np.ndarray, block: slice) -> None:
        out[:, :2] = 0
        if cloud.radii is not None:
            out[:, 0] = cloud.radii[block, 0]
            out[:, 1] = cloud.radii[block, min(1, cloud.radii.shape[1] - 1)]
        if cloud.disconnected is not None:
            out[cloud.disconnected[block], 1] *= -1
        out[:, 2] = 0
        if cloud.axis is not None:
            out[:, 2] = octahedral(cloud.axis[block])
        elif always_axis and cloud.normal is not None:
            out[:, 2] = octahedral(basis(cloud.normal[block].T.astype(np.float64))[0].T)
        out[:, 3] = 0 if cloud.material is None else cloud.material[block]
        if cloud.share is not None:
            out[:, 3] += COVERED * (1 - cloud.share[block])
        if points is not None:
            out[max(points - block.start, 0) :, 3] += NODE

    return write


def row_bounds(cloud: PointCloud, shape: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Returns (R, 2, 3) float32, low and high corner of a box around the splats of each row of a page's textures,
    relative to the cloud's origin, and (R,) float32, the largest radius of one of them.

    shape: (N, 8) float32 of nodes over balls, see BallTree, which count as wide as they may be drawn; None: they are
    none."""
    rows = -(-len(cloud) // PAGE_WIDTH)
    boxes, widest = np.empty((rows, 2, 3), np.float32), np.zeros(rows, np.float32)
    radii = cloud.radii

    def measure(block: slice) -> None:
        splats = slice(block.start * PAGE_WIDTH, min(block.stop * PAGE_WIDTH, len(cloud)))
        starts = np.arange(0, splats.stop - splats.start, PAGE_WIDTH)
        squares = 0.0
        reach = 0.0 if radii is None else radii[splats].max(axis=1) if radii.shape[1] > 1 else radii[splats, 0]
        for channel, column in enumerate(cloud.position[splats].T):
            if shape is not None:
                square = WIDER * shape[splats, DIAGONAL[channel]]
                squares, reach = squares + square, np.sqrt(square)
            boxes[block, 0, channel] = np.minimum.reduceat(column - reach, starts)
            boxes[block, 1, channel] = np.maximum.reduceat(column + reach, starts)
        if shape is not None:  # no half-axis is longer than the root of the sum of their squares
            widest[block] = np.sqrt(np.maximum.reduceat(squares, starts))
        elif radii is not None:
            widest[block] = np.maximum.reduceat(reach, starts)

    each_block(rows, measure, ROWS_AT_ONCE)
    return boxes, widest


def filled(cloud: PointCloud, name: str, constants: np.ndarray) -> np.ndarray:
    """Returns an attribute (N, C), or its material's constant (M, C) for each splat where the cloud has none."""
    own = getattr(cloud, name)
    if own is not None:
        return own
    if cloud.material is None:
        return np.broadcast_to(constants[0], (len(cloud), constants.shape[1]))
    return constants.take(cloud.material, axis=0)


def velocity(cloud: PointCloud) -> np.ndarray:
    """Returns velocities (N, 3), zeros where the cloud has none."""
    return np.broadcast_to(np.float32(0), (len(cloud), 3)) if cloud.velocity is None else cloud.velocity


def shading_normal(cloud: PointCloud) -> Write:
    """Writes (N, 1): packed shading normals, NO_NORMAL where there is none."""
    own = cloud.shading_normal

    def write(out: np.ndarray, block: slice) -> None:
        if own is None:
            out[:, 0] = NO_NORMAL
        else:
            x, y, z = own[block].T
            out[:, 0] = octahedral(own[block])
            out[np.abs(x) + np.abs(y) + np.abs(z) < SMALLEST_NORMAL, 0] = NO_NORMAL

    return write


def facets(cloud: PointCloud) -> Write:
    """Writes (N, 4) facets: packed normal in 18 bits, and above it the share of the area in 6; 0 where there is no
    facet."""
    own = cloud.facets

    def write(out: np.ndarray, block: slice) -> None:
        if own is None:
            out[:] = 0
            return
        for i in range(own.shape[1]):
            facet = own[block, i].astype(np.float32)
            share = np.minimum(np.rint(np.sqrt((facet * facet).sum(axis=1)) * (63 / 127)), 63)
            out[:, i] = share * FACET_SHARE + octahedral(facet, FACET_STEPS)

    return write
