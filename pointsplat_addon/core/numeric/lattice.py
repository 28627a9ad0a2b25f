"""Lattices of sub-samples: one rotated grid over the whole picture, of which every pixel holds the same pattern.

A lattice takes pixels to cells by the matrix (p, -q; q, p). With q = 1 no two of the p^2 + 1 sub-samples of a pixel
share a row or a column (N-rooks), which is what matters for edges along the axes: their coverage has a third of the
error that an ordered grid of as many samples has. A rasteriser draws all sub-samples at once into a target of one
texel a cell.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from .record import value_record
from .sequences import R2


@value_record
class Lattice:
    """Sub-samples at the centres of cells; one of them lies at each pixel's centre. p + q is odd."""

    p: int
    q: int

    @property
    def count(self) -> int:
        """Sub-samples of a pixel."""
        return self.p * self.p + self.q * self.q

    @property
    def spacing(self) -> float:
        """Pixels from a sub-sample to the next."""
        return self.count**-0.5

    @cached_property
    def offsets(self) -> np.ndarray:
        """(S, 2) int64: cells from the pixel's central one. The first is that one; the others are ordered so that the
        first few, too, are spread over the pixel."""
        reach = np.arange(-self.p - self.q, self.p + self.q + 1)
        cells = np.stack(np.meshgrid(reach, reach, indexing="ij"), axis=-1).reshape(-1, 2)
        inside = cells[(np.abs(self.pixels(cells)) < 0.5).all(axis=1)]
        wanted = (R2 * np.arange(len(inside))[:, None] + 0.5) % 1.0 - 0.5
        order, free = [], list(range(len(inside)))
        for place in wanted:  # a pixel has a few sub-samples
            nearest = min(free, key=lambda i: float(np.square(self.pixels(inside[i]) - place).sum()))
            free.remove(nearest)
            order.append(nearest)
        return inside[order]

    @cached_property
    def positions(self) -> np.ndarray:
        """(S, 2) float64: the sub-samples in pixels from the pixel's centre."""
        return self.pixels(self.offsets)

    def size(self, pixels: tuple[int, int]) -> tuple[int, int]:
        """(columns, rows) of cells that hold all sub-samples of so many (columns, rows) of pixels."""
        width, height = pixels[0] - 1, pixels[1] - 1
        around = 2 * self._reach + 1
        return self.p * width + self.q * height + around, self.q * width + self.p * height + around

    def corner(self, pixels: tuple[int, int]) -> tuple[int, int]:
        """The central cell of the first pixel (0, 0): that of pixel (x, y) lies (p x - q y, q x + p y) further."""
        return self.q * (pixels[1] - 1) + self._reach, self._reach

    @property
    def _reach(self) -> int:
        return int(np.abs(self.offsets).max())

    def pixels(self, cells: np.ndarray) -> np.ndarray:
        """(..., 2) float64 in pixels, of differences of cells."""
        return cells @ np.array([[self.p, -self.q], [self.q, self.p]]) / self.count

    def cells(self, pixels: np.ndarray) -> np.ndarray:
        """(..., 2) float64 in cells, of differences of pixels (..., 2)."""
        return pixels @ np.array([[self.p, self.q], [-self.q, self.p]], float)


def lattice_of(sub_samples: int) -> Lattice:
    """Returns the lattice with so many sub-samples of a pixel. StopIteration: there is none."""
    return next(lattice for lattice in (ONE, FEW, MANY) if lattice.count == sub_samples)


def lattice_for(samples: int, few: bool) -> Lattice:
    """Returns the lattice of a picture that is asked for with so many samples; `few`: its first sub-samples are there
    soon, and more lattices of few follow them."""
    if samples <= ONE.count:
        return ONE
    return FEW if few or samples <= FEW.count else MANY


ONE, FEW, MANY = Lattice(1, 0), Lattice(2, 1), Lattice(4, 1)  # 1, 5 and 17 sub-samples
