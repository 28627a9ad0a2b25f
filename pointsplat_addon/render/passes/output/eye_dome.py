"""Eye-dome lighting: darkens pixels by how far their neighbours lie in front of them: depth shows without light.

Boucheny, Visualisation scientifique de grands volumes de données (thesis, 2009); one scale of it, and depths compared
by their ratio, so that a step looks alike from near and far.
"""

from __future__ import annotations

from math import tau

from ....core.scene.camera import Camera
from ....shading.interface import Interface
from ...device.protocol import Device, Target, Texture, releases_on_failure
from ..uniforms import block

NEIGHBOURS = 8  # on a circle around each pixel
DARKNESS = 120.0  # of strength 1, for each doubling of depth that all neighbours lie nearer by
BLOCK = block("EyeDome", (
    ("float", "radius"),  # of the circle, pixels
    ("float", "strength"),  # times DARKNESS
    ("float", "width"),  # of what a parallel view shows, world units
    ("int", "perspective"),  # 0 or 1
))  # fmt: skip
PROGRAM = Interface(
    "eye dome", fragment="output/eye_dome.frag", block=BLOCK,
    samplers=(("FLOAT_2D", "ps_combined"), ("FLOAT_2D", "ps_centre")), outputs=(("vec4", "out_color"),),
    defines=(("PS_NEIGHBOURS", str(NEIGHBOURS)), ("PS_TURN", repr(tau / NEIGHBOURS))),
)  # fmt: skip


class EyeDome:
    """The picture with eye-dome lighting."""

    @releases_on_failure
    def __init__(self, device: Device, size: tuple[int, int]) -> None:
        """`size`: (width, height) of the picture in pixels."""
        self._device = device
        self.lit: Texture = device.texture(size, "RGBA32F")
        self._target: Target = device.target([self.lit])

    def draw(self, combined: Texture, centre: Texture, camera: Camera, radius: int, strength: float) -> None:
        """Lights a picture. `combined`: its sums. `centre`: of the G-buffer, depths under the pixels' centres.
        `radius`: pixels. `strength`: 1 is usual."""
        record = BLOCK.record(
            radius=radius,
            strength=DARKNESS * strength,
            width=2.0 / abs(float(camera.clip_from_view[0, 0])),
            perspective=int(camera.perspective),
        )
        textures = {"ps_combined": combined, "ps_centre": centre}
        self._device.draw(PROGRAM, self._target, uniforms=record, textures=textures)

    def release(self) -> None:
        self._target.release()
        self.lit.release()
