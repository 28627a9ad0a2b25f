"""Gathers what is out of focus, and what is translucent before and behind it: each pixel goes through the splats of its
tile from the front (core/lens/kernel.py), once for all samples of the picture.

The pass `light` (passes/translucent/light.py) leaves of each splat, one texel each:
  centre  in pixels from the principal point, depth, kernel's middle: share of the lens; optical depth
  shape   inverse of the covariance (xx, xy, yy); exponent of the kernel, plus what kind it is (lib/splat/defocus.glsl)
  source  radiance, half extent in depth
  slope   as in passes/translucent/light.py: where planes tell what lies before what
  tint    as in passes/translucent/light.py
Tiles hold the column and the row at which their entries begin in the list, and their number.
"""

from __future__ import annotations

import numpy as np

from ....shading.interface import Interface
from ...device.packing import PAGE_WIDTH, paged
from ...device.protocol import Device, Target, Texture, releases_on_failure
from ..shading.background import term_defines, world_block
from ..shading.lighting import fog_defines, lighting_defines, lighting_samplers
from ..shading.terms import Term
from ..tiles import TILE_DEFINE
from ..uniforms import LENS_FIELDS
from .tile_lists import TileLists


def defocus_program(
    lighting: tuple[str, ...],
    transparent: bool,
    slopes: bool,
    tint: bool,
    holdout: bool,
    adaptive: bool,
    tile: int,
    term: Term | None = None,
) -> Interface:
    """Returns the program that gathers the splats of each pixel's tile.

    lighting: defines of the lights that are used; without fog only those of the world matter. transparent: the film is
    transparent, so that no background is drawn. slopes: of planes are known. tint: splats transmit colours differently.
    holdout: some splats are holdouts. adaptive: pixels differ in their number of samples. tile: pixels along a side of
    a tile. term: of light, that is drawn alone.
    """
    of_world = ("PS_HAS_WORLD", "PS_HAS_ENVIRONMENT", "PS_BACKDROP")
    world = lighting if "PS_FOG" in lighting else tuple(name for name in lighting if name in of_world)
    named = {
        "PS_BACKGROUND": not transparent and "PS_BACKDROP" not in world,
        "PS_SLOPES": slopes,
        "PS_TINT": tint,
        "PS_HOLDOUT": holdout,
        "PS_ADAPTIVE": adaptive,
    }
    read = ["splat_centre", "shape", "source", "list", "tiles", "focused", "focus"]
    read += ["slope"] * slopes + ["tint"] * tint + ["counts"] * adaptive
    return Interface(
        "defocus",
        fragment="defocus/gather.frag",
        block=world_block("Gather", world, LENS_FIELDS, (("float", "sample_weight"),)),
        outputs=(("vec4", "out_combined"),),
        samplers=(*(("FLOAT_2D", f"ps_{name}") for name in read), *lighting_samplers(world)),
        defines=(
            *lighting_defines(world),
            *fog_defines(world),
            ("PS_TILE_SIZE", str(tile)),
            *((TILE_DEFINE,) if adaptive else ()),
            *((name, "1") for name, on in named.items() if on),
            *((name, "1") for name in term_defines(world, term)),
        ),
    )


class Defocus:
    """The tiles of one view on the device."""

    @releases_on_failure
    def __init__(self, device: Device, lists: TileLists) -> None:
        self.device, self.tile = device, lists.tile
        size, data = paged(lists.entries[:, None].astype(np.float32), 1)
        self.list = device.texture(size, "R32F", data)
        rows, columns, _ = lists.tiles.shape
        texels = np.zeros((rows, columns, 4), np.float32)
        texels[..., 0] = lists.tiles[..., 0] % PAGE_WIDTH
        texels[..., 1] = lists.tiles[..., 0] // PAGE_WIDTH
        texels[..., 2] = lists.tiles[..., 1]
        self.tiles = device.texture((columns, rows), "RGBA32F", texels.reshape(-1))

    def draw(
        self,
        program: Interface,
        target: Target,
        record: np.ndarray,
        lit: dict[str, Texture],
        textures: dict[str, Texture],
    ) -> None:
        """Draws the gathered picture into `target`.

        record: the program's uniforms; lit: the textures that the pass `light` wrote; textures: the picture of what is
        in focus, and the world's.
        """
        read = {"ps_splat_centre": lit["ps_centre"], **{k: v for k, v in lit.items() if k != "ps_centre"}, **textures}
        read |= {"ps_list": self.list, "ps_tiles": self.tiles}
        self.device.draw(program, target, uniforms=record, textures=read)

    def release(self) -> None:
        """Frees the textures of the tiles."""
        self.list.release()
        self.tiles.release()
