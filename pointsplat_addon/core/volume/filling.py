"""What of each voxel of a lattice lies within a closed mesh.

Lines along the third axis, SIDE x SIDE through each voxel, cross the mesh's triangles. The winding number above a point
of a line is the sum of the signs of the crossings below it (Barill et al. 2018 have it for all directions), so that the
length of a line that is inside a voxel follows from the heights of the crossings: exact along the line, sampled across.
"""

from __future__ import annotations

import numpy as np

from ..numeric.record import record
from ..numeric.segments import batches, owners, ranks

SIDE = 4  # lines through a voxel along each axis
CELLS = 1 << 19  # voxels of the box around a mesh, if no edge is given
MOST_CELLS = 1 << 23  # if one is
LEAST = 4  # voxels across the thinnest box
PAIRS = 1 << 20  # of triangles and lines that are looked at together


@record
class Filling:
    """The voxels of a lattice that lie within a mesh at least in part; an integer index is a voxel's centre."""

    index: np.ndarray  # (N, 3) int32
    share: np.ndarray  # (N,) float32 in (0, 1]
    object_from_index: np.ndarray  # (4, 4) float64
    closed: bool  # otherwise the lines that leave the mesh open are left out

    @property
    def nbytes(self) -> int:
        return self.index.nbytes + self.share.nbytes


def fill_mesh(
    position: np.ndarray, triangles: np.ndarray, scale: np.ndarray, edge: float = 0.0, cells: int = CELLS
) -> Filling:
    """Returns the voxels within a mesh with vertices (V, 3) and triangles (T, 3) int: none if its box has no volume.

    Voxels divide the mesh's box evenly along its axes. scale: (3,) positive lengths of the axes in the space where
    voxels are nearly cubes. edge: their length there; 0: as long as makes `cells` of the box. Solids that overlap are
    one; which side of a triangle is the outer one does not matter, as long as all agree.
    """
    corner = position[triangles].astype(np.float64)  # (T, 3, 3)
    nothing = Filling(np.zeros((0, 3), np.int32), np.zeros(0, np.float32), np.eye(4), closed=False)
    if len(corner) == 0:
        return nothing
    low, high = corner.min(axis=(0, 1)), corner.max(axis=(0, 1))
    extent = high - low
    with np.errstate(all="ignore"):
        wide = extent * scale
    if not (np.isfinite(wide).all() and (wide > 1e-9 * wide.max()).all()):
        return nothing
    count = _counts(wide, edge, cells)
    step = extent / count
    ends, closed = _ends_along_lines((corner - low) / step, triangles, count)
    # From the ends to lengths, and from lines to voxels.
    lengths = np.minimum(np.abs(np.cumsum(ends, axis=2)[..., :-1]), 1)
    share = lengths.reshape(count[0], SIDE, count[1], SIDE, count[2]).mean(axis=(1, 3), dtype=np.float32)
    index = np.argwhere(share > 1e-4)
    matrix = np.eye(4)
    matrix[:3, :3] = np.diag(step)
    matrix[:3, 3] = low + step / 2
    return Filling(index.astype(np.int32), share[tuple(index.T)], matrix, closed)


def _counts(wide: np.ndarray, edge: float, cells: int) -> np.ndarray:
    """Returns the number of voxels (3,) int along each side of a box (3,)."""
    most = MOST_CELLS if edge > 0 else cells
    shortest = np.cbrt(wide.prod() / most)
    # Where the box is thinner than that, the other axes have what is left.
    for _ in range(2):
        thin = wide < LEAST * shortest
        if thin.any() and not thin.all():
            rest = most / LEAST ** np.count_nonzero(thin)
            shortest = (wide[~thin].prod() / rest) ** (1 / np.count_nonzero(~thin))
    return np.maximum(np.ceil(wide / max(edge, shortest) - 1e-6), LEAST).astype(np.int64)


def _ends_along_lines(corner: np.ndarray, triangles: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, bool]:
    """Returns (SIDE nx, SIDE ny, nz + 1) float32, whose running sums are the lengths within voxels; and if all end.

    corner: (T, 3, 3) float64 in voxels from the lattice's low corner.
    """
    sides = count[:2] * SIDE
    ends = np.zeros((*sides, count[2] + 1), np.float32)
    crossings = np.zeros(sides, np.int32)
    # A line of number n has its place between n and n + 1, in lines.
    first = np.clip(np.floor(corner[..., :2].min(axis=1) * SIDE), 0, sides - 1).astype(np.int64)
    last = np.clip(np.floor(corner[..., :2].max(axis=1) * SIDE), 0, sides - 1).astype(np.int64)
    width = last - first + 1
    pairs = width.prod(axis=1)
    for a, b in batches(pairs, PAIRS):
        which, rank = a + owners(pairs[a:b]), ranks(pairs[a:b])
        column = first[which, 0] + rank // width[which, 1]
        row = first[which, 1] + rank % width[which, 1]
        at = np.stack([_place(column, row), _place(row, column)], axis=1)
        met, height, sign = _crossed(corner[which], triangles[which], at)
        column, row, height, sign = column[met], row[met], height[met], sign[met]
        voxel = np.clip(np.floor(height), 0, count[2] - 1).astype(np.int64)
        part = np.clip(voxel + 1 - height, 0, 1)
        np.add.at(ends, (column, row, voxel), (sign * part).astype(np.float32))
        np.add.at(ends, (column, row, voxel + 1), (sign * (1 - part)).astype(np.float32))
        np.add.at(crossings, (column, row), sign.astype(np.int32))
    open_lines = crossings != 0
    ends[open_lines] = 0
    return ends, not open_lines.any()


def _place(number: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Returns where lines lie along one axis, in voxels: no two of a voxel in the same row or column."""
    return (number + (other % SIDE + 0.5) / SIDE) / SIDE


def _crossed(corner: np.ndarray, vertex: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns which lines (P, 2) cross their triangles (P, 3, 3), where (P,), and 1 where they enter, else -1.

    A line through an edge crosses one of the two triangles at it: both find the same number of opposite sign, since
    they take its vertices (P, 3) in the same order.
    """
    weight = np.empty((3, len(at)))
    inside = np.ones(len(at), bool)
    area = _turn(corner[:, 0], corner[:, 1], corner[:, 2])
    for k, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        swap = vertex[:, i] > vertex[:, j]
        low = np.where(swap[:, None], corner[:, j], corner[:, i])
        high = np.where(swap[:, None], corner[:, i], corner[:, j])
        found = _turn(low, high, at)
        left = found >= 0
        inside &= (left != swap) == (area > 0)
        weight[k] = np.where(swap, -found, found)
    inside &= area != 0
    with np.errstate(all="ignore"):
        height = (weight * corner[:, :, 2].T).sum(axis=0) / weight.sum(axis=0)
    height = np.clip(np.nan_to_num(height), corner[:, :, 2].min(axis=1), corner[:, :, 2].max(axis=1))
    return inside, height, np.where(area > 0, -1, 1)


def _turn(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Returns twice the signed area of triangles in the plane of the first two axes."""
    return (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
