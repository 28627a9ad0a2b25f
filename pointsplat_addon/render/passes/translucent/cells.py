"""Blends narrow translucent splats over all sub-samples of the visibility buffer at once.

The splats of a block of pixels are drawn into a target of one texel a cell of the lattice, which is turned and finer
than the picture: what it takes to project and to draw them does not depend on the number of sub-samples, and each of
these has its own place, depth and colour. What that changes goes through the pixel filter, see strata.py.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ....core.numeric.lattice import Lattice
from ....core.numeric.record import value_record
from ....core.splat.kernel import SUPPORT
from ....shading.interface import Interface
from ..tiles import TILE, TILE_DEFINE
from ..uniforms import CAMERA_FIELDS, RECTANGLE_FIELDS, block
from ..visibility.buffer import LATTICE_DEFINE, LATTICE_FIELDS
from .options import TranslucentOptions

BLOCK = 16  # tiles along a side of a block: 1.8 million cells of 17 sub-samples, with 20 bytes each
Pixel = tuple[int, int]
CORNER_FIELD = (("ivec2", "corner"),)
EXPAND_CELLS = block(
    "ExpandCells", CAMERA_FIELDS, LATTICE_FIELDS, CORNER_FIELD, RECTANGLE_FIELDS, (("ivec2", "low"), ("ivec2", "high"))
)
DIFFERENCE_CELLS = block(
    "DifferenceCells", CAMERA_FIELDS, LATTICE_FIELDS, CORNER_FIELD, (("int", "sub_samples"), ("int", "neighbours"))
)
CODES = (("UINT_2D", "ps_first"), ("UINT_2D", "ps_second"))


def _opaque(behind: bool, places: bool) -> tuple[tuple[str, ...], tuple[tuple[str, str], ...]]:
    """The samplers and the defines of programs that read what the groups of a pixel show."""
    names = (*(("ps_behind",) if behind else ()), *(("ps_places",) if places else ()))
    defines = (*((("PS_BEHIND", "1"),) if behind else ()), *((("PS_PLACES", "1"),) if places else ()))
    return ("ps_starts", "ps_combined", *names), (LATTICE_DEFINE, *defines)


def expand_cells_program(behind: bool, places: bool) -> Interface:
    """Returns the program that writes what is opaque in each sub-sample, and its depth.

    `behind`: open sub-samples show something. `places`: the list of groups is not in the order of the pixels.
    """
    read, defines = _opaque(behind, places)
    return Interface(
        "expand", vertex="common/rectangle.vert", fragment="translucent/expand_cells.frag", block=EXPAND_CELLS,
        samplers=(*CODES, ("UINT_2D", "ps_depths"), *(("FLOAT_2D", n) for n in ("ps_numbers", "ps_wanted", *read))),
        outputs=(("vec4", "out_layer"), ("float", "out_place")), defines=(*defines, TILE_DEFINE),
    )  # fmt: skip


def difference_cells_program(options: TranslucentOptions, behind: bool, places: bool) -> Interface:
    """Returns the program that adds what blending has changed in the sub-samples.

    `behind`, `places`: as of `expand_cells_program`.
    """
    read, defines = _opaque(behind, places)
    names = ("ps_layer", "ps_members", "ps_weights", *read, *(("ps_cut",) if options.holdout else ()))
    return Interface(
        "difference", fragment="translucent/difference_cells.frag", block=DIFFERENCE_CELLS,
        samplers=(*CODES, *(("FLOAT_2D", name) for name in names)), outputs=(("vec4", "out_difference"),),
        defines=(*defines, *((("PS_HOLDOUT", "1"),) if options.holdout else ())),
    )  # fmt: skip


def number_texels(lattice: Lattice) -> np.ndarray:
    """Returns the number of the sub-sample in each cell around a pixel's central one, (N, N, 1) float32; N is odd."""
    reach = int(np.abs(lattice.offsets).max())
    found = np.zeros((2 * reach + 1, 2 * reach + 1, 1), np.float32)
    found[lattice.offsets[:, 1] + reach, lattice.offsets[:, 0] + reach, 0] = np.arange(lattice.count)
    return found


@value_record
class PixelBlock:
    """A part of a picture, in pixels."""

    low: Pixel  # of the pixels whose sub-samples are drawn: those of a margin, too
    high: Pixel  # beyond the last of them

    @property
    def size(self) -> Pixel:
        """Its width and height."""
        return self.high[0] - self.low[0], self.high[1] - self.low[1]


def largest_block(size: Pixel, margin: int) -> Pixel:
    """Returns the size of the largest block of a picture of a size, in pixels."""
    return tuple(min(side, BLOCK * TILE) + 2 * margin for side in size)  # pyright: ignore[reportReturnType]


def blocks(tiles: np.ndarray, size: Pixel, margin: int) -> Iterator[tuple[PixelBlock, np.ndarray]]:
    """Yields the blocks of a picture that hold tiles (rows, columns) bool, each with its own of these, (rows, columns)
    bool of the whole picture.

    size: (width, height) of the picture in pixels. margin: pixels around its tiles that a block holds, within the
    picture.
    """
    rows, columns = tiles.shape
    for row in range(0, rows, BLOCK):
        for column in range(0, columns, BLOCK):
            own = np.zeros_like(tiles)
            own[row : row + BLOCK, column : column + BLOCK] = tiles[row : row + BLOCK, column : column + BLOCK]
            where = np.nonzero(own)
            if len(where[0]) == 0:
                continue
            low = [max(TILE * int(axis.min()) - margin, 0) for axis in reversed(where)]
            ends = zip(reversed(where), size, strict=True)
            high = [min(TILE * (int(axis.max()) + 1) + margin, side) for axis, side in ends]
            yield PixelBlock((low[0], low[1]), (high[0], high[1])), own


def first_cell(lattice: Lattice, found: PixelBlock, size: Pixel) -> Pixel:
    """Returns the cell of a picture of a size at which the cells of a block begin."""
    (x, y), whole, own = found.low, lattice.corner(size), lattice.corner(found.size)
    p, q = lattice.p, lattice.q
    return whole[0] + p * x - q * y - own[0], whole[1] + q * x + p * y - own[1]


def splats_in(
    found: PixelBlock, centre: np.ndarray, shape: np.ndarray, principal_point: tuple[float, float]
) -> np.ndarray:
    """Returns which splats reach into a block, (K,) int64, in their order.

    centre, shape: (N, 4) as the pass `light` left them, of a view with this principal point.
    """
    with np.errstate(all="ignore"):
        there = centre[:, 3] > 0
        for k in (0, 1):
            half = np.sqrt(SUPPORT * np.maximum(shape[:, 2 * k], 0))
            middle = centre[:, k] + np.float32(principal_point[k])
            there &= (middle + half > found.low[k]) & (middle - half < found.high[k])
    return np.flatnonzero(there)
