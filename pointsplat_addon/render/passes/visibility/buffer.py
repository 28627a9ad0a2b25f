"""The visibility buffer: for each sub-sample of each pixel, which primitive is nearest and how far away it is.

Three textures of one texel a cell of the lattice (core/numeric/lattice.py; Burns and Hunt 2013): the primitive's
number, the bits of its depth beyond the near plane, which grow with it, and a key that tells surfaces apart
(shaders/lib/visibility/surface_key.glsl). The rasteriser and compute shaders write into the same textures.
"""

from __future__ import annotations

import numpy as np

from ....core.numeric.lattice import Lattice
from ...device.protocol import Device, Texture, releases_on_failure
from ..uniforms import Fields, Values

RASTERISED = 1 << 31  # of a primitive's number: the hardware has rasterised it
OUTPUTS = (("uint", "out_id"), ("uint", "out_depth"), ("uint", "out_key"))
DEPTH_OUTPUT = (("uint", "out_depth"),)  # of passes into depths alone
DEPTH_ONLY_DEFINE = ("PS_DEPTH_ONLY", "1")
IN_A_WORD = 10  # sub-samples of which a word holds three bits each
# What lib/visibility/lattice.glsl reads, with its define.
LATTICE_FIELDS: Fields = (("vec4", "lattice"), ("vec2", "cells"))
LATTICE_DEFINE = ("PS_LATTICE", "1")


def member_defines(lattice: Lattice) -> tuple[tuple[str, str], ...]:
    """The defines of shaders that loop over the sub-samples of a group: words of three bits a sub-sample, as those of
    lib/visibility/groups.glsl, with ones and with columns and rows of the cells from the least on, which is that far
    from the central one."""
    reach = int(np.abs(lattice.offsets).max())
    columns, rows = (lattice.offsets + reach).T.tolist()
    ones = [1] * lattice.count
    words = {"PS_MEMBER_BITS": ones, "PS_MEMBER_COLUMNS": columns, "PS_MEMBER_ROWS": rows}
    return *((name, _words(values)) for name, values in words.items()), ("PS_MEMBER_REACH", str(reach))


def _words(values: list[int]) -> str:
    """Two words of GLSL that hold three bits of each value, the first ten in the first."""
    first, second = (
        sum(value << 3 * i for i, value in enumerate(part)) for part in (values[:IN_A_WORD], values[IN_A_WORD:])
    )
    return f"uvec2({first}u, {second}u)"


def offset_defines(lattice: Lattice) -> tuple[tuple[str, str], ...]:
    """The defines of shaders that read where a pixel's sub-samples lie: how many, and their offsets in pixels."""
    offsets = ", ".join(f"vec2({x!r}, {y!r})" for x, y in lattice.positions.tolist())
    return ("PS_SUB_SAMPLES", str(lattice.count)), ("PS_OFFSETS", f"vec2[{lattice.count}]({offsets})")


def rank_defines(lattice: Lattice, multiple: int = 1) -> tuple[tuple[str, str], ...]:
    """The defines of lib/visibility/ranks.glsl; `multiple`: of cells' numbers, which ranks are."""
    column, row = multiple, multiple * (lattice.count - lattice.p) % lattice.count
    return ("PS_RANKS", str(lattice.count)), ("PS_RANK_COLUMN", str(column)), ("PS_RANK_ROW", str(row))


def lattice_values(lattice: Lattice, size: tuple[int, int]) -> Values:
    """Values of LATTICE_FIELDS of a lattice over a picture of a size (width, height) in pixels."""
    x, y = lattice.corner(size)
    # The centre of pixel (0, 0) is that of the cell (x, y).
    origin = x + 0.5 - 0.5 * (lattice.p - lattice.q), y + 0.5 - 0.5 * (lattice.p + lattice.q)
    return {"lattice": (lattice.p, lattice.q, *origin), "cells": lattice.size(size)}


class DepthBuffer:
    """The depth of what is nearest at each cell: of the three textures the one."""

    @releases_on_failure
    def __init__(self, device: Device, lattice: Lattice, size: tuple[int, int]) -> None:
        """`size`: (width, height) of the picture in pixels."""
        self._device, self.lattice, self.size = device, lattice, size
        self.cells = lattice.size(size)
        self.depths = device.texture(self.cells, "R32UI")
        self.target = device.target(self._colors(), depth=True)

    def _colors(self) -> list[Texture]:
        """The textures that are drawn into."""
        return [self.depths]

    def clear(self) -> None:
        """Empties all sub-samples."""
        self._device.clear(self.target)

    @property
    def values(self) -> Values:
        """Values of LATTICE_FIELDS."""
        return lattice_values(self.lattice, self.size)

    @property
    def textures(self) -> dict[str, Texture]:
        """The textures by sampler name."""
        return {"ps_depths": self.depths}

    def release(self) -> None:
        for item in (self.target, *self.textures.values()):
            item.release()


class IdBuffer(DepthBuffer):
    """Two of the three textures: which primitive is nearest, and its depth."""

    keyed = False  # surfaces are told apart

    def _colors(self) -> list[Texture]:
        self.ids = self._device.texture(self.cells, "R32UI")
        return [self.ids, self.depths]

    @property
    def textures(self) -> dict[str, Texture]:
        """The textures by sampler name."""
        return {"ps_ids": self.ids, "ps_depths": self.depths}


class VisibilityBuffer(IdBuffer):
    """The nearest primitive of each sub-sample of a picture."""

    keyed = True

    def _colors(self) -> list[Texture]:
        self.keys = self._device.texture(self.cells, "R32UI")
        return [*super()._colors(), self.keys]

    def cell_offset(self, corner: tuple[int, int]) -> tuple[int, int]:
        """Returns what takes cells to those of a picture of which this one is a part, the same for all parts: (columns,
        rows). `corner`: the first pixel of the part."""
        (x, y), (column, row), p, q = corner, self.lattice.corner(self.size), self.lattice.p, self.lattice.q
        return p * x - q * y - column, q * x + p * y - row

    @property
    def textures(self) -> dict[str, Texture]:
        """The textures by sampler name."""
        return {**super().textures, "ps_keys": self.keys}

    def read(self) -> np.ndarray:
        """Reads the number of the primitive of each sub-sample of each pixel, (H, W, S) uint32; EMPTY: none."""
        ids, (width, height) = self._device.read(self.ids), self.size
        x, y = np.meshgrid(np.arange(width), np.arange(height))
        corner, p, q = self.lattice.corner(self.size), self.lattice.p, self.lattice.q
        column, row = corner[0] + p * x - q * y, corner[1] + q * x + p * y
        offsets = self.lattice.offsets
        return ids[row[..., None] + offsets[:, 1], column[..., None] + offsets[:, 0]]
