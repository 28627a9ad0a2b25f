"""The farthest depth in each block of pixels: what lies behind it all over a block is hidden there.

All sub-samples of a block count, so that something seen through a gap of one of them is not hidden.
"""

from __future__ import annotations

import numpy as np

from ....core.numeric.lattice import Lattice
from ....shading.interface import Interface
from ...device.protocol import EMPTY, Device, releases_on_failure
from ..uniforms import CAMERA_FIELDS, SampleView, block
from .buffer import LATTICE_DEFINE, LATTICE_FIELDS, DepthBuffer, member_defines

BLOCK_SIDE = 2  # pixels
FARTHEST_BLOCK = block("Farthest", CAMERA_FIELDS, LATTICE_FIELDS)


def farthest_program(lattice: Lattice) -> Interface:
    """Returns the program that finds the farthest depth of each block."""
    return Interface(
        "occlusion", fragment="visibility/farthest.frag", block=FARTHEST_BLOCK, samplers=(("UINT_2D", "ps_depths"),),
        outputs=(("uint", "out_farthest"),),
        defines=(LATTICE_DEFINE, ("PS_SUB_SAMPLES", str(lattice.count)), ("PS_BLOCK_SIDE", str(BLOCK_SIDE)),
                 *member_defines(lattice)),
    )  # fmt: skip


class FarthestDepths:
    """The farthest depths of what has been drawn into a buffer so far."""

    @releases_on_failure
    def __init__(self, device: Device, buffer: DepthBuffer) -> None:
        self._device, self._buffer = device, buffer
        width, height = buffer.size
        self._texture = device.texture((-(-width // BLOCK_SIDE), -(-height // BLOCK_SIDE)), "R32UI")
        self._target = device.target([self._texture])

    def read(self, view: SampleView) -> np.ndarray:
        """Returns the depth of each block, (rows, columns) float64; infinity: some sub-sample shows nothing."""
        program, record = farthest_program(self._buffer.lattice), view.record(FARTHEST_BLOCK, **self._buffer.values)
        self._device.draw(program, self._target, uniforms=record, textures=self._buffer.textures)
        bits = self._device.read(self._texture)
        with np.errstate(invalid="ignore"):
            beyond = bits.view(np.float32).astype(np.float64)
        return np.where(bits == EMPTY, np.inf, beyond + view.near)

    def release(self) -> None:
        for item in (self._target, self._texture):
            item.release()
