"""Gathers light from the tree at receivers: shaders/indirect/gather.frag."""

from __future__ import annotations

import numpy as np

from ....shading.interface import Interface
from ...device.protocol import Device, Texture
from ..uniforms import block
from .pages import NODE_WIDTH, RECEIVER_WIDTH

CELLS = 8  # along either side of a hemisphere
COARSENESS = 1.0  # cells that a node may cover
GATHER_BLOCK = block("Gather", (("mat4", "view_from_world"), ("int", "root"), ("float", "coarseness")))
OUTPUTS = (("vec4", "out_diffuse"), ("vec4", "out_glossy"))


def gather_program(world: tuple[str, ...], glossy: bool) -> Interface:
    """Returns the program that gathers. `world`: the PS_ names of the sky. `glossy`: what smooth surfaces mirror."""
    lights = (("FLOAT_2D", "ps_lights"),) if world else ()
    picture = (("FLOAT_2D", "ps_environment"),) if "PS_HAS_ENVIRONMENT" in world else ()
    names = (*world, *(("PS_GLOSSY",) if glossy else ()))
    return Interface(
        "gather", fragment="indirect/gather.frag", block=GATHER_BLOCK, outputs=OUTPUTS,
        samplers=(*(("FLOAT_2D", name) for name in ("ps_nodes", "ps_receivers")), *lights, *picture),
        defines=(("PS_NODE_WIDTH", str(NODE_WIDTH)), ("PS_CELLS", str(CELLS)), *((name, "1") for name in names)),
    )  # fmt: skip


class Gather:
    """What some receivers have gathered; one texel a receiver."""

    def __init__(
        self, device: Device, receivers: Texture, program: Interface, record: np.ndarray, textures: dict[str, Texture]
    ) -> None:
        """Gathers at once. `receivers`: as of receiver_texture; `record`, `textures`: what the program reads."""
        self.size = (RECEIVER_WIDTH, receivers.size[1])
        self.diffuse, self.glossy = (device.texture(self.size, "RGBA32F") for _ in OUTPUTS)
        self._target = device.target([self.diffuse, self.glossy])
        device.clear(self._target)
        device.draw(program, self._target, uniforms=record, textures={**textures, "ps_receivers": receivers})

    def release(self) -> None:
        for item in (self._target, self.diffuse, self.glossy):
            item.release()
