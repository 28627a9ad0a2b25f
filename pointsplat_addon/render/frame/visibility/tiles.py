"""Divides pictures whose sub-samples would take too much memory into tiles, which are drawn one after the other."""

from __future__ import annotations

from dataclasses import replace

from ....core.numeric.lattice import Lattice
from ....core.numeric.record import value_record
from ...passes.uniforms import SampleView

# Of a tile, with 16 bytes each and about as much for its groups: 17 sub-samples of 290 x 290 pixels, and of 1280 x 720.
FEWEST_CELLS, MOST_CELLS = 1 << 21, 28_000_000
# Of a picture that is shown while it is drawn: 17 sub-samples of 410 x 410 pixels. A lattice of few comes first, of
# which tiles of many have about as many cells.
SHOWN_CELLS = 1 << 22
IN_INSTANCE = 4  # primitives that take as much memory as the transforms of an instance


@value_record
class PictureTile:
    """A part of a picture, in pixels."""

    corner: tuple[int, int]  # of the pixels that are its own
    end: tuple[int, int]  # beyond the last of them
    origin: tuple[int, int]  # of all that is drawn: that of a margin, too
    size: tuple[int, int]  # of all that is drawn

    def view(self, view: SampleView) -> SampleView:
        """Returns the view of the tile."""
        x, y, width, height = view.camera.window
        if self.size == (width, height):
            return view
        region = (x + self.origin[0], y + self.origin[1], *self.size)
        return replace(view, camera=replace(view.camera, region=region))

    def rectangle(self, size: tuple[int, int]) -> tuple[float, float, float, float]:
        """Its own pixels in a picture of a size, from 0 to 1: low and high corner."""
        return self.corner[0] / size[0], self.corner[1] / size[1], self.end[0] / size[0], self.end[1] / size[1]


def tiles_of_part(tiles: list[PictureTile], part: tuple[int, int]) -> list[PictureTile]:
    """Returns the tiles of a part of a picture: (k, n), the k-th of n, from 0. Each tile is in one part."""
    index, count = part
    return tiles[len(tiles) * index // count : len(tiles) * (index + 1) // count]


def cells_of_tile(primitives: int, shown: bool, streamed: bool) -> int:
    """Returns how many cells a tile has at most, where so many primitives are drawn for each tile: two for a primitive,
    so that cells take about as much memory as what is drawn, and few primitives are drawn several times. `shown`: while
    it is drawn, and another one of the same view follows. `streamed`: a scan is read by pages, which have most of the
    memory that there is, and of whose nodes each tile draws those that it shows."""
    if shown or streamed:
        return SHOWN_CELLS if shown else FEWEST_CELLS
    wanted = 1 << (2 * primitives - 1).bit_length()  # a power of two: targets then fit the next picture, too
    return min(max(wanted, FEWEST_CELLS), MOST_CELLS)


def picture_tiles(
    size: tuple[int, int], lattice: Lattice, most_side: int, most_cells: int, margin: int
) -> list[PictureTile]:
    """Returns the tiles of a picture of `size` (width, height) pixels, all of one size.

    `most_side`: cells along a side of a texture. `most_cells`: see cells_of_tile. `margin`: pixels around a tile that
    the pixel filter takes in.
    """

    def fits(size: tuple[int, int]) -> bool:
        columns, rows = lattice.size(size)
        return columns * rows <= most_cells and max(columns, rows) <= most_side

    if fits(size):
        return [PictureTile((0, 0), size, (0, 0), size)]
    counts = [1, 1]
    while not fits((-(-size[0] // counts[0]) + 2 * margin, -(-size[1] // counts[1]) + 2 * margin)):
        wider = 0 if size[0] / counts[0] >= size[1] / counts[1] else 1
        counts[wider] += 1
    sides = -(-size[0] // counts[0]), -(-size[1] // counts[1])
    found = []
    for y in range(0, size[1], sides[1]):
        for x in range(0, size[0], sides[0]):
            end = min(x + sides[0], size[0]), min(y + sides[1], size[1])
            origin = min(x, size[0] - sides[0]) - margin, min(y, size[1] - sides[1]) - margin
            found.append(PictureTile((x, y), end, origin, (sides[0] + 2 * margin, sides[1] + 2 * margin)))
    return found
