"""Textures of depth maps as files of a cache keep them: runs of texels, but for those that nothing covers."""

from __future__ import annotations

from typing import Any

import numpy as np

from ....core.numeric.vectors import each_block
from ....shading.interface import Interface
from ...cache.on_disk import Form
from ...device.protocol import BYTES_PER_PIXEL, EMPTY, Device, Texture, released_on_failure
from ..visibility.buffer import DEPTH_OUTPUT
from .keep_depths import keep_depths

RUN = 64  # texels
UNCOVERED = np.float32(-1)  # depths are not negative
SMALLEST, INFINITE = 0x00800000, 0x7F800000  # bits of float32 numbers: a device may take what is smaller for 0
BLOCK = 1 << 12  # runs at once
PROGRAM = Interface(
    "shadow maps",
    fragment="shadow/kept_depths.frag",
    samplers=(("FLOAT_2D", "ps_kept"),),
    outputs=DEPTH_OUTPUT,
)


def depths_form(device: Device) -> Form[Texture]:
    """The form of R32UI textures of a device that hold bits of depths, or of other numbers from 0 on."""

    def save(texture: Texture) -> dict[str, Any] | None:
        return kept(device.read(texture))

    def load(found: dict[str, Any]) -> Texture:
        values = as_numbers(found)
        height, width = values.shape
        with released_on_failure(device):
            numbers = device.texture((width, height), "R32F", values.reshape(-1))
            texture = device.texture((width, height), "R32UI")
            target = device.target([texture])
            device.draw(PROGRAM, target, textures={"ps_kept": numbers})
        target.release()
        numbers.release()
        return texture

    def settle(texture: Texture) -> int:
        corner = device.texture((1, 1), "R32UI")
        target = device.target([corner])
        keep_depths(device, texture, (0, 0), (1, 1), target)
        device.read(corner)  # which waits for what it shows
        target.release()
        corner.release()
        return texture.size[0] * texture.size[1] * BYTES_PER_PIXEL[texture.format]

    return Form(save, load, {}, settle)


def kept(bits: np.ndarray) -> dict[str, Any] | None:
    """What is kept of a texture (H, W) uint32; None where some number could become another one on its way back."""
    height, width = bits.shape
    runs = _runs(bits)
    covered, fits = np.empty(len(runs), bool), np.empty(len(runs), bool)

    def look(block: slice) -> None:
        part = runs[block]
        empty = part == EMPTY
        covered[block] = ~empty.all(axis=1)
        fits[block] = (empty | (part == 0) | ((part >= SMALLEST) & (part < INFINITE))).all(axis=1)

    each_block(len(runs), look, BLOCK)
    if not fits.all():
        return None
    return {"size": (width, height), "covered": np.packbits(covered), "runs": runs[covered]}


def as_numbers(found: dict[str, Any]) -> np.ndarray:
    """(H, W) float32: the depths that are kept, UNCOVERED where there are none."""
    width, height = found["size"]
    columns = -(-width // RUN)
    covered = np.unpackbits(found["covered"], count=height * columns).astype(bool)
    values = np.full((height * columns, RUN), UNCOVERED, np.float32)
    runs = found["runs"].view(np.float32)
    start = np.concatenate([[0], np.cumsum(covered)])

    def put(block: slice) -> None:
        mine = runs[start[block.start] : start[block.stop]]
        values[block][covered[block]] = np.where(mine.view(np.uint32) == EMPTY, UNCOVERED, mine)

    each_block(len(values), put, BLOCK)
    return values.reshape(height, columns * RUN)[:, :width]


def _runs(bits: np.ndarray) -> np.ndarray:
    """(N, RUN) uint32, row by row; rows end with runs of which the rest is empty."""
    height, width = bits.shape
    if width % RUN:
        padded = np.full((height, -(-width // RUN) * RUN), EMPTY, np.uint32)
        padded[:, :width] = bits
        bits = padded
    return np.ascontiguousarray(bits, np.uint32).reshape(-1, RUN)
