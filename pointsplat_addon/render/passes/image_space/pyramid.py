"""Image-space reconstruction (Marroquim et al. 2008): pull the splats up a pyramid, push surfaces down into holes."""

from __future__ import annotations

import math

from ....shading.interface import Interface
from ...device.protocol import Device
from ..gbuffer import GBuffer, Variant
from ..tiles import Region
from ..uniforms import SampleView, block

# `level`: that is written, of which a pixel spans 2^level pixels of the picture along each side.
PULL = block("Pull", (("float", "near"), ("int", "level")))
PUSH = block("Push", (("float", "near"), ("int", "level")))
FINEST_LEVELS = 2  # even sub-pixel splats leave some pixels without a centre


def levels(radius: float, size: tuple[int, int]) -> int:
    """Returns how many coarser levels a pyramid needs for splats of at most `radius` pixels: a pixel of the coarsest
    level, with its neighbours, spans a splat."""
    wanted = FINEST_LEVELS + max(0, math.ceil(math.log2(max(radius, 1e-6))))
    return max(1, min(wanted, math.ceil(math.log2(max(*size, 2)))))


class Pyramid:
    """Coarser levels above a G-buffer that points and polygons share; holes in that are filled in place."""

    def __init__(self, device: Device, variant: Variant, base: GBuffer, count: int) -> None:
        self.device = device
        sides = [tuple(-(-side // (1 << level)) for side in base.size) for level in range(1, count + 1)]
        self.levels = [base, *(GBuffer(device, variant, (width, height)) for width, height in sides)]
        self.pull_program = Interface(
            "pull", fragment="image_space/pull.frag", block=PULL, samplers=variant.samplers(),
            outputs=variant.front_outputs, defines=tuple(entry for entry in variant.front_defines if entry[0] !=
            "PS_SURFACE"),
        )  # fmt: skip
        self.fill_program = Interface(
            "push", fragment="image_space/push.frag", block=PUSH, outputs=variant.outputs(),
            samplers=(("FLOAT_2D", "ps_front"), *variant.samplers("ps_coarse_")),
            defines=tuple((name, "1") for name in variant.defines if name != "PS_SURFACE"),
        )  # fmt: skip
        self.finest_program = self.fill_program.with_defines("PS_FINEST")

    def pull(self, view: SampleView, region: Region) -> None:
        """Writes each level from the next finer one."""
        for level in range(1, len(self.levels)):
            record = view.record(PULL, level=level)
            coarse = self.levels[level]
            coarse.clear()
            textures = self.levels[level - 1].bound()
            region.draw(self.device, self.pull_program, coarse.target, uniforms=record, textures=textures, level=level)

    def push(self, view: SampleView, region: Region) -> None:
        """Fills the holes of each level from the next coarser one."""
        for level in range(len(self.levels) - 2, -1, -1):
            record = view.record(PUSH, level=level)
            fine, coarse = self.levels[level], self.levels[level + 1]
            region.draw(
                self.device,
                self.fill_program if level else self.finest_program,
                fine.fill_target,
                uniforms=record,
                textures={"ps_front": fine.front, **coarse.bound("ps_coarse_")},
                level=level,
            )

    def release(self) -> None:
        for buffer in self.levels[1:]:
            buffer.release()
