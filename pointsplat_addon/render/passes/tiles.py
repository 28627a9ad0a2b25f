"""Full-screen passes over only some tiles of the picture."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ...core.numeric.record import value_record
from ...shading.interface import Block, Interface
from ..device.protocol import Device, Target, Texture

TILE = 16  # pixels on a side
TILE_DEFINE = ("PS_TILE", str(TILE))
FINEST_LEVELS = 4  # coarser levels of a pyramid have pixels wider than a tile, and are small: they are drawn whole


def tiled(program: Interface) -> Interface:
    """Returns a full-screen program that draws over the tiles of a mask only."""
    assert program.block is not None
    samplers = (*program.samplers, ("FLOAT_2D", "ps_tiles"))
    return replace(program, vertex="common/tiles.vert", block=_tiled_block(program.block), samplers=samplers)


def _tiled_block(block: Block) -> Block:
    """With the side of a tile as a part of the target's sides."""
    return block.extended("Tiles", ("vec2", "tile_size"))


@value_record
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
        """Draws a full-screen pass in the region. `level`: of the pyramid that `target` is; 0 is the picture."""
        if self.mask is None or level > FINEST_LEVELS:
            device.draw(program, target, uniforms=uniforms, textures=textures, **state)
            return
        columns, rows = self.mask.size
        side = TILE / (1 << level)
        assert program.block is not None
        tile_size = [side / pixels for pixels in target.colors[0].size]
        device.draw(
            tiled(program),
            target,
            uniforms=_tiled_block(program.block).extend(uniforms, tile_size=tile_size),
            textures={**textures, "ps_tiles": self.mask},
            vertices=6 * columns * rows,
            **state,
        )


EVERYWHERE = Region()
