"""The depth under each pixel's centre, of pictures that are shown and have no passes that read more of it."""

from __future__ import annotations

from ....core.numeric.lattice import Lattice
from ....shading.interface import Interface
from ...device.protocol import Device, Texture, releases_on_failure
from ..uniforms import CAMERA_FIELDS, RECTANGLE_FIELDS, SampleView, block
from ..visibility.buffer import LATTICE_DEFINE, LATTICE_FIELDS, VisibilityBuffer
from .groups import CORNER_FIELDS, Rectangle

CENTRE_BLOCK = block("Centre", CAMERA_FIELDS, LATTICE_FIELDS, CORNER_FIELDS, RECTANGLE_FIELDS)


def centre_program(lattice: Lattice) -> Interface:
    """Returns the program that takes depths from the visibility buffer."""
    return Interface(
        "centre", vertex="common/rectangle.vert", fragment="grouping/centre.frag", block=CENTRE_BLOCK,
        samplers=(("UINT_2D", "ps_depths"),), outputs=(("vec4", "out_centre"),), defines=(LATTICE_DEFINE,),
    )  # fmt: skip


class CentreDepths:
    """Of a picture: what a G-buffer calls its centre."""

    @releases_on_failure
    def __init__(self, device: Device, size: tuple[int, int]) -> None:
        """`size`: (width, height) of the picture in pixels."""
        self._device = device
        self.textures: dict[str, Texture] = {"centre": device.texture(size, "RGBA32F")}
        self._target = device.target(list(self.textures.values()))

    def draw(self, view: SampleView, buffer: VisibilityBuffer, rectangle: Rectangle, corner: tuple[int, int]) -> None:
        """Takes the depths of a tile. `rectangle`: its own pixels in the picture, from 0 to 1. `corner`: where it
        begins in the picture, in pixels."""
        record = view.record(CENTRE_BLOCK, **buffer.values, rectangle=rectangle, corner=corner)
        program = centre_program(buffer.lattice)
        self._device.draw(program, self._target, uniforms=record, textures={"ps_depths": buffer.depths}, vertices=6)

    def release(self) -> None:
        for item in (self._target, *self.textures.values()):
            item.release()
