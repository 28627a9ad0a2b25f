"""Adaptive sampling: tiles of the picture whose samples agree get no more of them.

After 5, 9, 17 ... samples each tile is asked how far the mean of its samples lies from the mean of their first half,
in its worst pixel; where that is below the threshold the tile is done. The measure is Cycles' (difference of two
estimates over the square root of the brightness), but both are means of a fixed sequence of sample positions: no random
numbers, and the same picture every time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...shading.interface import Interface
from ..device.protocol import Device, Target, Texture

TILE = 16  # pixels on a side
TILE_DEFINE = ("PS_TILE", str(TILE))
FINEST_LEVELS = 4  # coarser levels of a pyramid have pixels wider than a tile, and are small: they are drawn whole


def tiled(program: Interface) -> Interface:
    """The same full-screen pass over the tiles that a mask names."""
    return replace(program, vertex="common/tiles.vert", samplers=(*program.samplers, ("FLOAT_2D", "ps_tiles")))


@dataclass(frozen=True)
class Region:
    """Where full-screen passes draw: everywhere, or in the tiles where `mask` (R32F, one texel a tile) is not 0."""

    mask: Texture | None = None

    def draw(
        self,
        device: Device,
        program: Interface,
        target: Target,
        *,
        uniforms: np.ndarray,
        textures: dict[str, Texture],
        level: int = 0,
        **state: Any,
    ) -> None:
        """Device.draw; `target` is `level` levels of a pyramid above the picture."""
        if self.mask is None or level > FINEST_LEVELS:
            device.draw(program, target, uniforms=uniforms, textures=textures, **state)
            return
        columns, rows = self.mask.size
        side = TILE / (1 << level)
        uniforms["tile"][0, :2] = [side / pixels for pixels in target.colors[0].size]
        device.draw(
            tiled(program),
            target,
            uniforms=uniforms,
            textures={**textures, "ps_tiles": self.mask},
            vertices=6 * columns * rows,
            **state,
        )


EVERYWHERE = Region()
