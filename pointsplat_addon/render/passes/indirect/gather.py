"""Gathers light from the tree at receivers: shaders/indirect/gather.frag."""

from __future__ import annotations

import numpy as np

from ....core.indirect.moments import MOMENTS
from ....shading.interface import Block, Interface
from ...device.protocol import Device, Texture
from ..uniforms import Fields, block
from .pages import MEDIA_WIDTH, NODE_WIDTH, RECEIVER_WIDTH

CELLS = 8
BOUNCE_CELLS = 6  # where what is gathered lights other surfaces
RAYS, BOUNCE_RAYS = 3, 2  # through media, along each side of a cell
COARSENESS = 1.0  # cells that a node may cover
GATHER_FIELDS: Fields = (
    ("int", "root"),
    ("float", "coarseness"),
    ("float", "sky"),
    ("vec4", "cube"),  # low corner and side of the tree's, in its space
)
GATHER_BLOCK = block("Gather", GATHER_FIELDS)
MEDIA_FIELDS: Fields = (
    ("vec4", "media_corner"),  # of the grid, in the tree's space, and the edge of a cell
    ("ivec4", "media_cells"),  # along each axis
)
WITHIN_FIELDS: Fields = (("float", "within"),)  # how far away what occludes may be


def _block(media: bool, occlusion: bool) -> Block:
    """The uniforms of one variant."""
    named = "Gather" + "Media" * media + "Within" * occlusion
    return block(named, GATHER_FIELDS, MEDIA_FIELDS if media else (), WITHIN_FIELDS if occlusion else ())


def gather_program(
    world: tuple[str, ...],
    glossy: bool,
    bounces: bool = False,
    media: bool = False,
    every_side: bool = False,
    colored: bool = False,
    moments: bool = False,
    captured: bool = False,
    occlusion: bool = False,
    shining: bool = False,
    bodies: bool = False,
) -> Interface:
    """Returns the program that gathers. `world`: the PS_ names of the sky. `glossy`: what smooth surfaces mirror.
    `bounces`: light for surfaces that light others. `media`: there are some; its block then has MEDIA_FIELDS, too.
    `every_side`: for receivers within media, of each of two hemispheres. `colored`: extinction of media differs between
    the channels. `moments`: of what is seen all around, of each of two hemispheres. `captured`: the tree has captured
    splats. `occlusion`: what hides the world sends no light, and does so within a distance alone, of WITHIN_FIELDS.
    `shining`: some nodes of the tree emit light, and hide what lies behind them in parts of cells. `bodies`: some stand
    for fine triangles, of which what lies behind bodies does not add up."""
    lights = (("FLOAT_2D", "ps_lights"),) if world else ()
    picture = (("FLOAT_2D", "ps_environment"),) if "PS_HAS_ENVIRONMENT" in world else ()
    names = (*world, *(("PS_GLOSSY",) if glossy else ()), *(("PS_BOUNCES",) if bounces else ()))
    names += (*(("PS_MEDIA",) if media else ()), *(("PS_EVERY_SIDE",) if every_side or moments else ()))
    names += ("PS_MOMENTS",) if moments else ()
    names += ("PS_MEDIA_COLORED",) if media and colored else ()
    names += ("PS_CAPTURED",) if captured else ()
    names += ("PS_OCCLUSION",) if occlusion else ()
    names += ("PS_SHINING",) if shining else ()
    names += ("PS_BODIES",) if bodies else ()
    cells, rays = (BOUNCE_CELLS, BOUNCE_RAYS) if bounces else (CELLS, RAYS)
    of_media = (("PS_MEDIA_WIDTH", str(MEDIA_WIDTH)), ("PS_RAYS", str(rays))) if media else ()
    outputs = (("vec4", "out_diffuse"), *((("vec4", "out_glossy"),) if glossy else ()))
    if moments:
        outputs = tuple(("vec4", f"out_moments_{k}") for k in range(MOMENTS // 4))
    return Interface(
        "gather", fragment="indirect/gather.frag", block=_block(media, occlusion),
        outputs=outputs,
        samplers=(*(("FLOAT_2D", name) for name in ("ps_nodes", "ps_receivers")), *lights, *picture,
                  *((("FLOAT_2D", "ps_media"),) if media else ())),
        defines=(("PS_NODE_WIDTH", str(NODE_WIDTH)), ("PS_CELLS", str(cells)),
                 *of_media, *((name, "1") for name in names)),
    )  # fmt: skip


class Gather:
    """What some receivers have gathered; one texel a receiver."""

    def __init__(
        self, device: Device, receivers: Texture, program: Interface, record: np.ndarray, textures: dict[str, Texture]
    ) -> None:
        """Gathers at once. `receivers`: as of receiver_texture; `record`, `textures`: what the program reads."""
        self.size = (RECEIVER_WIDTH, receivers.size[1])
        self._textures = [device.texture(self.size, "RGBA32F") for _ in program.outputs]
        self._target = device.target(self._textures)
        device.clear(self._target)
        device.draw(program, self._target, uniforms=record, textures={**textures, "ps_receivers": receivers})

    @property
    def textures(self) -> tuple[Texture, ...]:
        """All of it."""
        return tuple(self._textures)

    @property
    def diffuse(self) -> Texture:
        """Irradiance over pi."""
        return self._textures[0]

    @property
    def glossy(self) -> Texture:
        """What the glossy lobe shows of surfaces, and how much of it is open; where the program was made for it."""
        return self._textures[1]

    def release(self) -> None:
        for item in (self._target, *self._textures):
            item.release()
