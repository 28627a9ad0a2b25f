"""Reads sparse grids from OpenVDB files and writes dense arrays to them, by the `openvdb` module that Blender ships.

The module is handed in (host/convert/volume.py finds it), so that nothing here needs Blender.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ...core.numeric.record import record
from ...core.numeric.segments import owners, ranks
from ...core.volume.lattice import index_bounds, lattice_keys

BLOCK = 1 << 18  # voxels that are copied together whatever of them is active
SPARSE = 16  # so many voxels for each active one are still copied rather than searched
SLAB = 1 << 24  # voxels that are copied at once
VISIT = 1500  # bytes of a tree that are copied while Python visits one value
MOST = 1 << 28  # active voxels: more would not fit the memory of most machines as points
ENTRY = 128  # bytes of one of the tree's largest nodes that is constant
NODES = (4096, 128, 8)  # edges in voxels of what the tree's levels hold, of leaves last
EMPTY = -(2**31)  # what integer grids get for a background
SAME = 1e-6  # of a voxel's edge, over the whole grid: transforms that differ by less are the same
ROWS = 1 << 20  # voxels that are resampled together
KINDS: dict[str, Any] = {  # grids that are read, and a background that no value equals
    "FloatGrid": np.nan,
    "DoubleGrid": np.nan,
    "Int32Grid": EMPTY,
    "Int64Grid": EMPTY,
    "BoolGrid": False,
    "Vec3SGrid": (np.nan,) * 3,
    "Vec3DGrid": (np.nan,) * 3,
    "Vec3IGrid": (EMPTY,) * 3,
}


@record
class Grid:
    """Active voxels of one grid. An integer index is a voxel's centre."""

    name: str
    index: np.ndarray  # (N, 3) int32, distinct, in lexicographic order
    value: np.ndarray  # (N,) or (N, 3) float32
    object_from_index: np.ndarray  # (4, 4) float64


@record
class Grids:
    """Grids of one file or object on one lattice."""

    index: np.ndarray  # (N, 3) int32, distinct, in lexicographic order
    object_from_index: np.ndarray  # (4, 4) float64
    values: dict[str, np.ndarray]  # name to (N,) or (N, 3) float32; voxels that a grid lacks hold 0


def read(openvdb: Any, path: Path, names: Collection[str] | None = None) -> tuple[list[Grid], list[str]]:
    """The grids of a file with one of the `names` (None: all grids), and messages about those that cannot be read.

    If the file has none of those names, its first grid of voxels is read instead, which tells the region that it fills.
    Level sets become densities: 1 inside, falling to 0 over one voxel across the surface.
    Raises OSError where the file cannot be read.
    """
    grids, messages = [], []
    try:
        listed = list(openvdb.readAllGridMetadata(str(path)))
        usable = [m for m in listed if _problem(openvdb, m) is None]
        wanted = [m for m in listed if names is None or m.name in names]
        messages += [problem for m in wanted if (problem := _problem(openvdb, m))]
        chosen = [m for m in wanted if m in usable] or usable[:1]
        if not chosen and listed and not messages:
            messages.append(str(_problem(openvdb, listed[0])))
        for name in dict.fromkeys(m.name for m in chosen):
            try:
                grid, found = sparse(openvdb, openvdb.read(str(path), name))
            except ValueError as error:
                grid, found = None, [f'the grid "{name}" is left out: {error}']
            messages += found
            if grid is not None:
                grids.append(grid)
    except (RuntimeError, LookupError, MemoryError) as error:
        # OpenVDB takes the lengths that a file claims for granted, and kinds of grids that it does not know for errors.
        why = "it claims more than memory holds" if isinstance(error, MemoryError) else error
        raise OSError(f"{path.name} cannot be read: {why}") from error
    return grids, messages


def _problem(openvdb: Any, grid: Any) -> str | None:
    """Why the voxels of a grid cannot be drawn; returns None if they can."""
    if type(grid).__name__ not in KINDS:
        what = "points" if grid.valueTypeName.startswith("ptdata") else grid.valueTypeName
        return f'the grid "{grid.name}" holds {what}, which volumes are not drawn from'
    if not grid.transform.isLinear:
        return f'the grid "{grid.name}" is a frustum, which is not supported'
    return None


def sparse(openvdb: Any, grid: Any) -> tuple[Grid | None, list[str]]:
    """The active voxels of an `openvdb` grid (None if it has none), and messages about what was wrong with it.

    The grid is changed in the process. Raises ValueError where voxels are so far apart that their cells cannot be
    numbered with 64 bits.
    """
    name, matrix = grid.name, transform(grid)
    if np.linalg.matrix_rank(matrix[:3, :3]) < 3 or not np.isfinite(matrix).all():
        return None, [f'the grid "{name}" has voxels without volume']
    count = grid.activeVoxelCount()
    if count == 0:
        return None, []
    if count > MOST:
        return None, [f'the grid "{name}" has {count} active voxels, more than the {MOST} that are supported']
    if grid.gridClass == openvdb.GridClass.LEVEL_SET:
        return _inside(grid, name, matrix)
    # With a background that no value equals, copies tell what is active.
    grid.background = empty = KINDS[type(grid).__name__]
    parts = [part for part, low, high in _boxes(grid, empty) for part in _voxels(part, low, high, empty)]
    index, value = (np.concatenate(column) for column in zip(*parts, strict=True))
    lost = 0 if empty is False else count - len(index)
    messages = [f'{lost} voxels of the grid "{name}" are not a number and are left out'] if lost else []
    if len(index) == 0:
        return None, messages
    key = lattice_keys(index, *index_bounds(index))
    if (key[1:] < key[:-1]).any():
        order = np.argsort(key)
        index, value = index[order], value[order]
    return Grid(name, index, value, matrix), messages


def transform(grid: Any) -> np.ndarray:
    """object_from_index (4, 4) float64 of a grid with a linear transform."""
    matrix = np.eye(4)
    matrix[:3, 3] = grid.transform.indexToWorld((0, 0, 0))
    for k in range(3):
        # A far origin would take digits from the edges: many voxels away they are found again.
        step = [0, 0, 0]
        step[k] = 1 << 20
        matrix[:3, k] = (np.array(grid.transform.indexToWorld(tuple(step))) - matrix[:3, 3]) / (1 << 20)
    return matrix


def _boxes(grid: Any, empty: Any) -> Iterator[tuple[Any, np.ndarray, np.ndarray]]:
    """(grid, low, high) that together hold all active voxels, each box small, well filled, or of few voxels far apart.

    Boxes are halved, and shrunk to what is active in them, by copies of the tree that have the other half cleared.
    """
    rest = [grid]
    while rest:
        grid = rest.pop()
        count = grid.activeVoxelCount()
        if count == 0:
            continue
        low, high = (np.array(corner, np.int64) for corner in grid.evalActiveVoxelBoundingBox())
        # Constant regions are one value each; cleared ones take an entry for each of the largest nodes.
        visited = VISIT * grid.activeLeafVoxelCount()
        copied = grid.memUsage() + ENTRY * _volume(low, high) / NODES[0] ** 3
        if _dense(low, high, count) or visited < copied * np.log2(_volume(low, high) / (SPARSE * count)):
            yield grid, low, high
            continue
        size = high - low + 1
        axis = int(np.argmax(size))
        # Along the largest nodes that can be parted: a cut through nodes makes smaller ones all over its plane.
        edge = next(n for n in NODES if size[axis] > 2 * n or n == NODES[-1])
        middle = (low[axis] + size[axis] // 2) // edge * edge
        low, high = low // NODES[0] * NODES[0], (high // NODES[0] + 1) * NODES[0] - 1
        left, right = high.copy(), low.copy()
        left[axis], right[axis] = middle - 1, middle
        other = grid.deepCopy()
        grid.fill(_tuple(low), _tuple(left), empty, False)
        other.fill(_tuple(right), _tuple(high), empty, False)
        grid.pruneInactive()
        other.pruneInactive()
        rest += [grid, other]


def _dense(low: np.ndarray, high: np.ndarray, count: int) -> bool:
    return _volume(low, high) <= max(BLOCK, SPARSE * count)


def _voxels(grid: Any, low: np.ndarray, high: np.ndarray, empty: Any) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Indices (n, 3) int32 and values of the active voxels of a box, piece by piece."""
    width = (3,) if isinstance(empty, tuple) else ()
    if not _dense(low, high, grid.activeVoxelCount()):
        yield _visited(grid, width)
        return
    background = np.float32(np.ravel(empty)[0])
    for start, block in _slabs(grid, low, high, width):
        head = block[..., 0] if width else block
        yield _listed(block, ~np.isnan(head) if np.isnan(background) else head != background, start)


def _visited(grid: Any, width: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Indices and values of a few voxels that lie far apart; constant regions come as one item each."""
    items = [(item.min, item.max, item.value) for item in grid.citerOnValues()]
    low, high = (np.array([item[k] for item in items], np.int64) for k in (0, 1))
    value = np.array([item[2] for item in items], np.float32).reshape(-1, *width)
    size = high - low + 1
    owner, place = owners(size.prod(axis=1)), ranks(size.prod(axis=1))
    x, rest = np.divmod(place, (size[:, 1] * size[:, 2])[owner])
    y, z = np.divmod(rest, size[owner, 2])
    return (np.stack([x, y, z], axis=1) + low[owner]).astype(np.int32), value[owner]


def _slabs(
    grid: Any, low: np.ndarray, high: np.ndarray, width: tuple[int, ...] = ()
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Low corners and dense values (X, Y, Z, *width) float32 of slices of a box."""
    size = high - low + 1
    thick = max(1, int(SLAB // (size[1] * size[2])))
    for x in range(int(low[0]), int(high[0]) + 1, thick):
        block = np.empty((min(thick, int(high[0]) + 1 - x), size[1], size[2], *width), np.float32)
        start = np.array([x, low[1], low[2]])
        grid.copyToArray(block, ijk=_tuple(start))
        yield start, block


def _listed(block: np.ndarray, where: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    places = np.nonzero(where)
    return np.stack([(p + s).astype(np.int32) for p, s in zip(places, start, strict=True)], axis=1), block[places]


def _inside(grid: Any, name: str, matrix: np.ndarray) -> tuple[Grid | None, list[str]]:
    """The density of a level set: the fraction of each voxel that lies inside, with the surface in it taken as flat.

    Voxels inside are not active but negative; they are found by copying the whole bounding box.
    """
    low, high = (np.array(corner, np.int64) for corner in grid.evalActiveVoxelBoundingBox())
    if _volume(low, high) > 8 * MOST:
        return None, [f'the level set "{name}" spans {" x ".join(map(str, high - low + 1))} voxels, which is too many']
    edge = np.float32(np.cbrt(abs(np.linalg.det(matrix[:3, :3]))))
    parts = []
    for start, block in _slabs(grid, low, high):
        density = np.clip(np.float32(0.5) - block / edge, 0, 1)
        parts.append(_listed(density, density > 0, start))
    index, value = (np.concatenate(column) for column in zip(*parts, strict=True))
    message = f'the grid "{name}" is a level set, not a density: it counts as 1 inside and 0 outside'
    return (Grid(name, index, value, matrix) if len(index) else None), [message]


def _volume(low: np.ndarray, high: np.ndarray) -> float:
    """Voxels of a box; it may be more than integers hold."""
    return float(np.prod((high - low + 1).astype(np.float64)))


def _tuple(corner: np.ndarray) -> tuple[int, int, int]:
    return int(corner[0]), int(corner[1]), int(corner[2])


# Several grids on one lattice


def combine(grids: list[Grid]) -> tuple[Grids, list[str]]:
    """All grids on the lattice of the first one, and messages about those that had to be resampled.

    Grids with the same transform add their voxels; others are resampled at these. Raises ValueError for no grids.
    """
    if not grids:
        raise ValueError("there are no grids")
    first = grids[0]
    alike = [g for g in grids if _same_transform(g, first)]
    others = [g for g in grids if not _same_transform(g, first)]
    index = first.index
    if any(len(g.index) != len(index) or not np.array_equal(g.index, index) for g in alike[1:]):
        index = _union([g.index for g in alike])
    values = {g.name: _spread(g, index) for g in alike}
    values |= {g.name: _resampled(g, index, first.object_from_index) for g in others}
    messages = [
        f'the grid "{g.name}" has a lattice of its own and is resampled to that of "{first.name}"' for g in others
    ]
    return Grids(index, first.object_from_index, {g.name: values[g.name] for g in grids}), messages


def _same_transform(a: Grid, b: Grid) -> bool:
    if np.array_equal(a.object_from_index, b.object_from_index):
        return True
    edge = np.abs(b.object_from_index[:3, :3]).max()
    reach = np.append(np.maximum(np.abs(b.index.min(axis=0)), np.abs(b.index.max(axis=0))), 1.0)
    return bool((np.abs(a.object_from_index - b.object_from_index)[:3] @ reach <= SAME * edge * reach.max()).all())


def _union(indices: list[np.ndarray]) -> np.ndarray:
    every = np.concatenate(indices)
    low, extent = index_bounds(every)
    key = np.unique(lattice_keys(every, low, extent))
    x, rest = np.divmod(key, extent[1] * extent[2])
    y, z = np.divmod(rest, extent[2])
    return (np.stack([x, y, z], axis=1) + low).astype(np.int32)


def _spread(grid: Grid, index: np.ndarray) -> np.ndarray:
    """The grid's values at a lexicographic superset of its voxels, 0 elsewhere."""
    if len(grid.index) == len(index):
        return grid.value
    low, extent = index_bounds(index)
    result = np.zeros((len(index), *grid.value.shape[1:]), np.float32)
    result[np.searchsorted(lattice_keys(index, low, extent), lattice_keys(grid.index, low, extent))] = grid.value
    return result


def _resampled(grid: Grid, index: np.ndarray, object_from_index: np.ndarray) -> np.ndarray:
    """Trilinear values (N,) or (N, 3) at voxels of another lattice."""
    own_from_other = np.linalg.inv(grid.object_from_index) @ object_from_index
    low, extent = index_bounds(grid.index, margin=1)
    key = lattice_keys(grid.index, low, extent)
    result = np.zeros((len(index), *grid.value.shape[1:]), np.float32)
    for i in range(0, len(index), ROWS):
        place = index[i : i + ROWS] @ own_from_other[:3, :3].T + own_from_other[:3, 3]
        # Beyond the margin all is empty.
        place = np.clip(place, low, low + extent - 1.001)
        corner = np.floor(place).astype(np.int64)
        part = place - corner
        for offset in np.ndindex(2, 2, 2):
            weight = np.prod(np.where(offset, part, 1 - part), axis=1)
            wanted = lattice_keys(corner + offset, low, extent)
            at = np.minimum(np.searchsorted(key, wanted), len(key) - 1)
            weight = np.where(key[at] == wanted, weight, 0)
            result[i : i + ROWS] += grid.value[at] * (weight if grid.value.ndim == 1 else weight[:, None])
    return result


# Writing


def write(openvdb: Any, path: Path, name: str, array: np.ndarray, object_from_index: np.ndarray, empty: float) -> int:
    """Writes a dense array (X, Y, Z) as a fog volume without the voxels of the value `empty`; returns how many it has.

    Raises OSError where the file cannot be written.
    """
    grid = openvdb.FloatGrid(float(empty))
    grid.copyFromArray(np.ascontiguousarray(array, np.float32), tolerance=0.0)
    grid.prune()
    grid.name, grid.gridClass = name, openvdb.GridClass.FOG_VOLUME
    # Row vectors, as OpenVDB has them
    grid.transform = openvdb.createLinearTransform(object_from_index.T.tolist())
    try:
        openvdb.write(str(path), grids=[grid])
    except RuntimeError as error:
        raise OSError(f"{path} cannot be written: {error}") from error
    return grid.activeVoxelCount()
