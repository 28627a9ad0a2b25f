"""Which instance and which material each sub-sample shows, for Cryptomatte."""

from __future__ import annotations

import numpy as np

from ...device.protocol import EMPTY, Device
from ...passes.pages.point_page import PageDraw
from ...passes.strands.strand_ids import StrandKind
from ...passes.visibility.buffer import RASTERISED, VisibilityBuffer
from ...passes.visibility.polygon_draw import Drawn


def identities(
    device: Device,
    buffer: VisibilityBuffer,
    splats: list[PageDraw],
    polygons: list[Drawn],
    strands: list[StrandKind],
) -> np.ndarray:
    """Returns the instance and the material of each sub-sample of each pixel, (S, H, W, 2) int32; -1: there is none."""
    ids = np.moveaxis(buffer.read(), 2, 0)
    found = np.full((*ids.shape, 2), -1, np.int32)
    number = (ids & ~np.uint32(RASTERISED)).astype(np.int64)
    for draw in splats:
        mine = (ids != EMPTY) & (number >= draw.first_index) & (number < draw.first_index + draw.elements)
        if mine.any():
            found[mine] = _of_splats(device, draw, number[mine] - draw.first_index)
    for draw in polygons:
        local = number - draw.first_id
        mine = (ids != EMPTY) & (local >= 0) & (local < draw.triangles)
        found[mine] = draw.identify(local[mine])
    for draw in strands:
        local = number - draw.first_id
        mine = (ids != EMPTY) & (ids & RASTERISED != 0) & (local >= 0) & (local < draw.count)
        segment = draw.segments[local[mine]]
        segments = draw.draw.segments
        found[mine] = np.stack([segments.instance[segment], segments.material[segment]], axis=1)
    return found


def _of_splats(device: Device, draw: PageDraw, index: np.ndarray) -> np.ndarray:
    """The instance and the material, (N, 2), of splats of a page by their numbers among those that are drawn."""
    if draw.blocks is None:
        splat, instance = index, np.full(len(index), draw.whole)
    else:
        rows = device.read(draw.blocks).reshape(-1, 4)[index >> draw.shift].astype(np.int64)
        splat = rows[:, 0] + rows[:, 1] * draw.blocks.size[0] + (index & ((1 << draw.shift) - 1))
        instance = rows[:, 3]
    if draw.page.ball_material >= 0:
        material = np.full(len(index), draw.page.ball_material)
    else:
        material = np.floor(device.read(draw.page.textures["ps_extent"]).reshape(-1, 4)[splat, 3]).astype(np.int64)
    return np.stack([instance, material], axis=1)
