"""One level of a shadow table: cells of one size and kind, with sorted entries."""

from __future__ import annotations

import numpy as np

from ..numeric.record import record
from .grid import Grid

MASK_CELLS = 24  # cells to a mask: as many bits as a float32 holds as an integer
TEXEL_CELLS = 3 * MASK_CELLS  # cells to a texel: where its entries start, then three masks


@record
class TableLevel:
    """Cells of one size and kind. Cell c holds entries links[k] .. links[k + 1], k its rank among occupied cells."""

    kind: str
    grid: Grid
    rank: np.ndarray  # (W,) int32: occupied cells before cell W * TEXEL
    mask: np.ndarray  # (W, 3) int32: WORD cells each, lowest bit first
    links: np.ndarray  # (O + 1,) int32
    distance: np.ndarray  # (E,) float32, ascending within a cell
    total: np.ndarray  # (E, 1 or 3) float32: optical depth up to and with the entry
    ramp: float  # cells: entries set in along the ray from so far before their distance to as far after it

    @property
    def nbytes(self) -> int:
        rows = 16 * len(self.grid.count)
        return sum(a.nbytes for a in (self.rank, self.mask, self.links, self.distance, self.total)) + rows

    def occupied(self) -> np.ndarray:
        """(O,) int64: cells that hold entries."""
        bits = np.unpackbits(self.mask.astype("<u4")[..., None].view(np.uint8), axis=-1, bitorder="little")
        return np.flatnonzero(bits.reshape(-1, 32)[:, :MASK_CELLS])
