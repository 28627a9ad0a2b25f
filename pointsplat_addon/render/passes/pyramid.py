"""Image-space reconstruction (Marroquim et al. 2008): pull the splats up a pyramid, push surfaces down into holes."""

from __future__ import annotations

import math

import numpy as np

from ...shading.interface import Interface
from ..device import Device
from .common import FRAME, GBuffer, Variant

FINEST_LEVELS = 2  # even sub-pixel splats leave some pixels without a centre


def levels(radius: float, size: tuple[int, int]) -> int:
    """How many coarser levels are needed for splats of at most `radius` pixels: a pixel of the coarsest one, with its
    neighbours, spans a splat."""
    wanted = FINEST_LEVELS + max(0, math.ceil(math.log2(max(radius, 1e-6))))
    return max(1, min(wanted, math.ceil(math.log2(max(*size, 2)))))


class PyramidPass:
    """Level 0 is the G-buffer that points and polygons share; the result is another one."""

    def __init__(self, device: Device, variant: Variant, size: tuple[int, int], count: int) -> None:
        self.device = device
        self.pulled: list[GBuffer] = []
        self.pushed: list[GBuffer] = []
        for level in range(count + 1):
            of_level = (-(-size[0] // (1 << level)), -(-size[1] // (1 << level)))
            if level > 0:
                self.pulled.append(GBuffer(device, variant, of_level))
            if level < count:
                self.pushed.append(GBuffer(device, variant, of_level))
        self.pull = Interface(
            "pull", fragment="pull.frag", block=FRAME, samplers=variant.samplers(), outputs=variant.outputs(),
            defines=tuple((name, "1") for name in variant.defines),
        )  # fmt: skip
        self.push = Interface(
            "push", fragment="push.frag", block=FRAME, outputs=variant.outputs(),
            samplers=(*variant.samplers(), *variant.samplers("ps_coarse_")),
            defines=tuple((name, "1") for name in variant.defines),
        )  # fmt: skip

    @property
    def result(self) -> GBuffer:
        return self.pushed[0]

    def run_pull(self, source: GBuffer, record: np.ndarray) -> None:
        fine = source
        for level, coarse in enumerate(self.pulled, start=1):
            record["size"][0, 2] = level
            self.device.draw(self.pull, coarse.target, uniforms=record, textures=fine.bound())
            fine = coarse

    def run_push(self, source: GBuffer, record: np.ndarray) -> None:
        coarse = self.pulled[-1]
        for level in range(len(self.pushed) - 1, -1, -1):
            own = source if level == 0 else self.pulled[level - 1]
            record["size"][0, 2] = level
            textures = {**own.bound(), **coarse.bound("ps_coarse_")}
            self.device.draw(self.push, self.pushed[level].target, uniforms=record, textures=textures)
            coarse = self.pushed[level]

    def release(self) -> None:
        for buffer in (*self.pulled, *self.pushed):
            buffer.release()
