"""Draws the world out of focus, once for a view: sharp on a coarse grid, and blurred there by the disk of confusion of
what is infinitely far (core/lens/backdrop.py). Whoever draws the background looks it up (lib/light/backdrop.glsl)."""

from __future__ import annotations

from ....core.lens.backdrop import BackdropGrid
from ....shading.interface import Interface
from ...device.protocol import Device, Texture
from ..uniforms import CAMERA_FIELDS, Fields, SampleView, block

MARGIN: Fields = (("int", "margin"),)  # texels around the blurred picture that the sharp one has
SHARP_BLOCK = block("Backdrop", CAMERA_FIELDS, (("vec2", "texel_size"),), MARGIN)  # pixels
BLUR_BLOCK = block("BackdropBlur", (("vec2", "radius"),), MARGIN)  # of the disk of confusion in texels
SHARP = Interface(
    "backdrop", fragment="shading/backdrop.frag", block=SHARP_BLOCK, outputs=(("vec4", "out_color"),),
    samplers=tuple(("FLOAT_2D", f"ps_{name}") for name in ("lights", "environment", "levels")),
    defines=(("PS_HAS_ENVIRONMENT", "1"),),
)  # fmt: skip
BLUR = Interface(
    "backdrop_blur", fragment="shading/backdrop_blur.frag", block=BLUR_BLOCK, outputs=(("vec4", "out_color"),),
    samplers=(("FLOAT_2D", "ps_sharp"),),
)  # fmt: skip


class Backdrop:
    """The world behind one view. Floats: the sun is brighter than half floats are."""

    def __init__(self, device: Device, grid: BackdropGrid) -> None:
        self.device, self.grid = device, grid
        self.texture: Texture = device.texture(grid.size, "RGBA32F")

    @property
    def texels(self) -> tuple[float, float]:
        """Texels that a pixel spans, across and up."""
        return 1 / self.grid.step[0], 1 / self.grid.step[1]

    def draw(self, view: SampleView, textures: dict[str, Texture]) -> None:
        """`view`: of a ray through each pixel's centre. `textures`: what SHARP reads."""
        device, grid = self.device, self.grid
        sharp = device.texture(grid.larger, "RGBA32F")
        larger, blurred = device.target([sharp]), device.target([self.texture])
        uniforms = view.record(SHARP_BLOCK, texel_size=grid.step, margin=grid.margin)
        device.draw(SHARP, larger, uniforms=uniforms, textures=textures)
        uniforms = BLUR_BLOCK.record(radius=grid.radius, margin=grid.margin)
        device.draw(BLUR, blurred, uniforms=uniforms, textures={"ps_sharp": sharp})
        for item in (larger, blurred, sharp):
            item.release()

    def release(self) -> None:
        self.texture.release()
