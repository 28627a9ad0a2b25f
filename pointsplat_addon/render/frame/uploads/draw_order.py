"""The draw lists of translucent splats: which splats of a page a view shows, and in which order."""

from __future__ import annotations

import numpy as np

from ....core.lod import depth_order
from ....core.numeric.segments import ranges
from ...device.packing import paged
from ...device.protocol import Device, Texture
from ...passes.translucent.light import draw_list_rows
from ...passes.translucent.page import TranslucentPage
from ...prepare.point_sets import Layer


class SortedDrawList:
    """Translucent splats back to front on the device; sorted again only where that would matter."""

    def __init__(self) -> None:
        self.texture: Texture | None = None
        self.count = 0
        self.sorts = 0  # how often the splats were sorted
        self._order: depth_order.Order | None = None
        self._key: tuple = ()

    def update(
        self,
        device: Device,
        page: TranslucentPage,
        layer: Layer,
        world_from_object: np.ndarray,
        view_from_world: np.ndarray,
        key: tuple,
        exact: bool,
    ) -> None:
        """Sorts what `layer` shows for a view, unless the latest order is good enough, or, where `exact`, the same.
        `key`: what is drawn, and where it stands."""
        known = self._order if self.texture is not None and key == self._key else None
        if known is not None and not known.stale(view_from_world, layer.cut, exact):
            return
        entries = {row: points.hierarchy or points.cloud for row, points in layer.point_sets.items()}
        self._order = depth_order.sort_cut(
            layer.cut, entries, layer.set_of_instance, world_from_object, view_from_world
        )
        self._key, self.sorts = key, self.sorts + 1
        texel, instance = cut_texels(page, layer)
        index = self._order.index
        self.count = len(index)
        size, data = paged(draw_list_rows(texel[index], instance[index]), 2)
        self.release()
        self.texture = device.texture(size, "RG32F", data)

    def depths(self, view_from_world: np.ndarray) -> np.ndarray:
        """Returns the depths in a view (4, 4) of the splats of the list, (N,) float64, to a slice of their order."""
        assert self._order is not None
        eye = -view_from_world[:3, :3].T @ view_from_world[:3, 3]
        return self._order.distance - eye @ self._order.direction

    def release(self) -> None:
        """Frees the list."""
        if self.texture is not None:
            self.texture.release()
        self.texture = None


def cut_texels(page: TranslucentPage, layer: Layer) -> tuple[np.ndarray, np.ndarray]:
    """Returns the texel in its page, and the instance, of each splat of a layer's cut: (N,) int64 each."""
    first = np.zeros(max(layer.point_sets) + 1, np.int64)
    for row, points in layer.point_sets.items():
        first[row] = page.first[points.key]
    cut = layer.cut
    texel = ranges(first[layer.set_of_instance[cut.instance]] + cut.first, cut.count)
    return texel, np.repeat(cut.instance, cut.count)
