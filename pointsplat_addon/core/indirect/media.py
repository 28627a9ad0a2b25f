"""Media of a scene in the cells of an even grid: what they let through of light, what they scatter and what they emit.

Voxels and particles of all volumes are shared out among the cells, by linear weights. What scatters mostly forwards is
taken by similarity as less of it that scatters evenly (van de Hulst 1980: scattering times 1 - g).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..numeric.record import record

# Of media that are thin within a cell, and of others: cells along the longest side, all cells, and blocks, a few cells
# wide, at which light is gathered.
THIN_MEDIA = 64, 1 << 17, 4000
DEEP_MEDIA = 96, 1 << 19, 12000
DEEP = 0.75  # optical depth across a cell, or a block, from which on it is deep
THIN = 1e-3  # of the densest cell's scattering, below which a cell has no receiver of its own
DENSE = 90.0  # percentile of cells' extinction that tells how deep they are
DEEPEST_PART, MOST_PARTS = 0.5, 4  # of a cell: optical depth of those that lamps light by themselves, and along an edge
MOST_LIT = 1 << 19  # of these in all
MOST_EXTINCTION = 1e20  # of a cell, whose products float32 holds
ROOT = 4  # of radiance is interpolated where it is seen: in dense media it falls as exponentials do
FILLED = 3  # cells around these to which what they gather is carried


@record
class Matter:
    """N splats of media, in world space from some origin."""

    position: np.ndarray  # (N, 3) float64
    # (N,) or, where it is coloured, (N, 3) float64: cross-sections, each extinction times volume; by similarity
    extinction: np.ndarray
    scattering: np.ndarray  # (N, 3) float64: of that, what is scattered
    lit: np.ndarray  # (N, 3) float64: cross-sections for the light of lamps, which similarity does not change
    emission: np.ndarray | None  # (N, 3) float64: radiance per unit of length, times volume
    apart: float  # how far splats lie from each other


@record
class MediaGrid:
    """C = X Y Z cubic cells, x running first, and a lattice of blocks of them; in world space from some origin."""

    low: np.ndarray  # (3,) float64: its corner
    edge: float  # of a cell
    shape: np.ndarray  # (3,) int64: X, Y, Z
    extinction: np.ndarray  # (C,) or, where it is coloured, (C, 3) float32, per unit of length, as all below
    scattering: np.ndarray  # (C, 3) float32
    lit: np.ndarray  # (C, 3) float32: what is scattered of the light of lamps
    emission: np.ndarray  # (C, 3) float32
    block: int  # cells along the edge of a block
    receivers: np.ndarray  # (R,) int64: blocks in whose middle light is gathered

    @property
    def colored(self) -> bool:
        """Whether extinction differs between the channels."""
        return self.extinction.ndim == 2

    @property
    def blocks(self) -> np.ndarray:
        """(3,) int64: how many along each axis."""
        return -(-self.shape // self.block)

    @property
    def places(self) -> np.ndarray:
        """(R, 3) float64: where light is gathered."""
        return self.low + (_cell_indices(self.receivers, self.blocks) + 0.5) * (self.block * self.edge)

    @property
    def lit_cells(self) -> np.ndarray:
        """(n,) int64: cells that scatter light of lamps."""
        return np.flatnonzero(self.lit.any(axis=1))

    def parts(self, cells: int) -> np.ndarray:
        """(n, 3) float64: places from the middles of so many cells at which these are lit: some, where light falls by
        much within a cell."""
        whole = grey(self.extinction)[self.lit_cells]
        depth = self.edge * float(np.percentile(whole, DENSE)) if cells else 0.0
        most = max(int((MOST_LIT / max(cells, 1)) ** (1 / 3)), 1)
        count = int(np.clip(np.ceil(depth / DEEPEST_PART), 1, min(most, MOST_PARTS)))
        along = ((np.arange(count) + 0.5) / count - 0.5) * self.edge
        return np.stack(np.meshgrid(along, along, along, indexing="ij"), -1).reshape(-1, 3)

    def centres(self, cells: np.ndarray) -> np.ndarray:
        """(n, 3) float64 of cells (n,)."""
        return self.low + (_cell_indices(cells, self.shape) + 0.5) * self.edge

    def on_blocks(self, found: np.ndarray) -> np.ndarray:
        """Returns what receivers have gathered, (R, 3), for all blocks, (B, 3) float32: others have it from their
        neighbours."""
        x, y, z = self.blocks
        sums = np.zeros((z, y, x, 4))
        flat = sums.reshape(-1, 4)
        flat[self.receivers, :3], flat[self.receivers, 3] = found, 1
        for _ in range(FILLED):
            around = sums
            for axis in range(3):
                padded = np.pad(around, [(1, 1) if k == axis else (0, 0) for k in range(4)])
                part = [np.take(padded, np.arange(k, k + sums.shape[axis]), axis) for k in range(3)]
                around = part[0] + part[1] + part[2]
            open_ones = sums[..., 3] == 0
            weight = np.maximum(around[open_ones, 3:], 1e-30)
            sums[open_ones] = np.where(around[open_ones, 3:] > 0, around[open_ones] / weight, 0)
        mean = found.mean(axis=0) if len(found) else np.zeros(3)
        return np.where(flat[:, 3:] > 0, flat[:, :3], mean).astype(np.float32)

    def in_cells(self, of_blocks: np.ndarray) -> np.ndarray:
        """Interpolates what blocks have, (B, 3), in the middles of cells, (C, 3) float32, by cubic splines (Catmull and
        Rom 1974): neither straight lines nor exponentials, one after the other in each bounce, would add or lose light.
        """
        if self.block == 1:
            return of_blocks
        x, y, z = self.blocks
        found = of_blocks.reshape(z, y, x, 3)
        for axis, (count, cells) in enumerate(zip((z, y, x), self.shape[::-1], strict=True)):
            at = np.clip((np.arange(cells) + 0.5) / self.block - 0.5, 0, count - 1)
            first = np.minimum(at.astype(np.int64), max(count - 2, 0))
            t = (at - first).reshape([-1 if k == axis else 1 for k in range(4)])
            weights = (
                0.5 * t * (t * (2 - t) - 1),
                1 + 0.5 * t * t * (3 * t - 5),
                0.5 * t * (1 + t * (4 - 3 * t)),
                0.5 * t * t * (t - 1),
            )
            steps = (np.take(found, np.clip(first + k, 0, count - 1), axis) for k in (-1, 0, 1, 2))
            found = np.sum([weight * step for weight, step in zip(weights, steps, strict=True)], axis=0)
        return np.maximum(found, 0).reshape(-1, 3).astype(np.float32)


def media_grid(parts: Sequence[Matter]) -> MediaGrid | None:
    """Returns the grid over all matter; None where there is none."""
    parts = [part for part in parts if len(part.position)]
    if not parts:
        return None
    low = np.min([part.position.min(axis=0) - 0.5 * part.apart for part in parts], axis=0)
    high = np.max([part.position.max(axis=0) + 0.5 * part.apart for part in parts], axis=0)
    extent = high - low
    main = max(parts, key=lambda part: float(part.extinction.sum())).apart
    densest = max(_densest(part) for part in parts)
    for along, most, _ in (THIN_MEDIA, DEEP_MEDIA):
        edge = max(float(extent.max()) / along, float(np.prod(extent) / most) ** (1 / 3), 1e-30)
        if main > 0:
            # Whole steps of the lattice, whose voxels then fill all cells evenly.
            edge = main * np.ceil(edge / main - 1e-6)
        if densest * edge < DEEP:
            break
    shape = np.ceil(extent / edge - 1e-6).astype(np.int64) + 1
    low = 0.5 * (low + high) - 0.5 * shape * edge
    cells = int(np.prod(shape))
    colored = any(part.extinction.ndim == 2 for part in parts)
    alike = all(part.lit is part.scattering for part in parts)
    sums = np.zeros((12, cells))
    for part in parts:
        columns = [*part.scattering.T, *(3 * [None] if alike else part.lit.T)]
        channels = part.extinction if part.extinction.ndim == 2 else part.extinction[:, None]
        columns += [*np.broadcast_to(channels, (len(channels), 3)).T] if colored else [channels[:, 0]] + 2 * [None]
        columns += [] if part.emission is None else [*part.emission.T]
        for index, weight in _shared(part.position, low, edge, shape):
            for row, column in enumerate(columns):
                if column is not None:
                    sums[row] += np.bincount(index, column * weight, cells)
    sums = np.minimum(sums / edge**3, MOST_EXTINCTION)
    scattering, lit, emission = (sums[row : row + 3].T.astype(np.float32) for row in (0, 3, 9))
    extinction = (sums[6:9].T if colored else sums[6]).astype(np.float32)
    lit = scattering if alike else lit
    block, receivers = _blocks(scattering.max(axis=1), shape, densest * edge)
    return MediaGrid(low, float(edge), shape, extinction, scattering, lit, emission, block, receivers)


def grey(extinction: np.ndarray) -> np.ndarray:
    """(N,): the mean of the channels of extinction (N,) or (N, 3)."""
    return extinction if extinction.ndim == 1 else extinction.mean(axis=1)


def _shared(position: np.ndarray, low: np.ndarray, edge: float, shape: np.ndarray):
    """Yields, eight times, a cell (N,) for each place (N, 3), and the share of it that this has, (N,)."""
    at = (position - low) / edge - 0.5
    first = np.clip(np.floor(at), 0, np.maximum(shape - 2, 0)).astype(np.int64)
    share = np.clip(at - first, 0, 1)
    for corner in range(8):
        step = np.array([corner & 1, corner >> 1 & 1, corner >> 2])
        cell = np.minimum(first + step, shape - 1)
        weight = np.where(step, share, 1 - share).prod(axis=1)
        yield cell[:, 0] + shape[0] * (cell[:, 1] + shape[1] * cell[:, 2]), weight


def _densest(part: Matter) -> float:
    """The extinction where a part of the media is dense."""
    return float(np.percentile(grey(part.extinction), DENSE)) / max(part.apart, 1e-30) ** 3


def _blocks(scattering: np.ndarray, shape: np.ndarray, depth: float) -> tuple[int, np.ndarray]:
    """How many cells along their edges blocks have, and those (R,) that scatter light.

    scattering: (C,). depth: optical depth across a dense cell.
    """
    cells = np.flatnonzero(scattering > THIN * scattering.max(initial=0.0))
    index = _cell_indices(cells, shape)
    block = 1
    while True:
        blocks = -(-shape // block)
        own = index // block
        found = np.unique(own[:, 0] + blocks[0] * (own[:, 1] + blocks[1] * own[:, 2]))
        if len(found) <= (DEEP_MEDIA if depth * block >= DEEP else THIN_MEDIA)[2]:
            return block, found
        block += 1


def _cell_indices(cells: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """(n, 3) int64 of cells (n,) in a grid of a shape (3,), x running first."""
    return np.column_stack([cells % shape[0], cells // shape[0] % shape[1], cells // (shape[0] * shape[1])])
