"""Nodes that stand for several captured splats (Kerbl et al. 2024, section 4).

Splats are stored in the cells of an octree, each at the finest level whose cells are not smaller than it is. The node
of a cell merges the splats that are stored there and in all cells below: where a cell is smaller than a pixel, so is
all that its node stands for. A node is a Gaussian with the mean and the covariance of its splats, weighted by what they
hide in a view that draws it. Of antialiased splats that is opacity times the surface of the ellipsoid, as published.
The low-pass of others makes all that are smaller than a pixel equally wide: opacity alone. What a view's low-pass makes
of a node's splats follows from means over these (shaders/captured/project.frag).
"""

from __future__ import annotations

import numpy as np

from ...numeric.morton import DEPTH, morton_codes, sorted_by_code
from ...numeric.record import record
from ...numeric.rotations import rotation_matrices
from ...numeric.segments import batches, offsets
from ...numeric.vectors import each_block, take_rows
from ...scene.captured import CapturedSplats
from ...splat.captured import LEAST_ALPHA

SPLATS = 4  # in the cells of the finest level, in the mean, at least: cells of fewer save nothing
WIDTH = 2.0  # standard deviations along a splat's longest axis that the edge of its cell is not shorter than
BATCH = 1 << 14  # splats that are merged together, so that their working arrays stay in the cache
KNUD_THOMSEN = 1.6075  # exponent of his approximation to an ellipsoid's surface, within 1.1 %
DEGREE_0 = 0.28209479177387814
ROWS = 17  # of what is merged: `_rows`
PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


@record
class CapturedTree:
    """Nodes over captured splats, level by level, coarsest first.

    Node `start[l] + c` is cell c of level l, in Morton order. It stands for the splats own[l][first_own[l][c]:
    first_own[l][c + 1]] and for the nodes from first_child[l][c] to first_child[l][c + 1] of level l + 1.
    """

    nodes: CapturedSplats  # M, of all levels; opacities may exceed 1
    # (M, 4) float32, of the splats of each node: the sum of their opacities; and weighted by these, the mean opacity,
    # the mean trace of the covariances and the mean surface (`surface`).
    means: np.ndarray
    start: np.ndarray  # (L + 1,) int64: the first node of each level
    edge: np.ndarray  # (L,) float64: length of the cells' edges
    first_child: tuple[np.ndarray, ...]  # of each level but the last: (cells + 1,) int32
    first_own: tuple[np.ndarray, ...]  # of each level: (cells + 1,) int32
    own: tuple[np.ndarray, ...]  # of each level: rows of the splats that are stored there, int32
    always: np.ndarray  # (A,) int32: rows of splats that are larger than the largest cell
    # (M, 3) float32: coefficients of degree 0 whose display values are means of those of the splats, for blending
    # these; None: not asked for.
    trained_base: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.nodes)

    @property
    def nbytes(self) -> int:
        parts = (*self.first_child, *self.first_own, *self.own, self.always)
        trained = 0 if self.trained_base is None else self.trained_base.nbytes
        return self.nodes.nbytes + self.means.nbytes + trained + sum(part.nbytes for part in parts)


def build_captured_tree(splats: CapturedSplats, trained: bool = False) -> CapturedTree:
    """Builds the nodes of N > 0 valid splats. Those that no view shows, of too little opacity, are in none. `trained`:
    with colours for blending display values."""
    shown = np.flatnonzero(splats.opacity >= LEAST_ALPHA)
    shown = shown if len(shown) else np.zeros(1, np.int64)
    code, side = morton_codes(take_rows(splats.position, shown))
    order, code = sorted_by_code(code)
    rows = shown[order].astype(np.int32)
    depth = _depth(code)
    edge = side / 2.0 ** np.arange(depth + 1)
    level = _level(take_rows(splats.scale, rows), side, depth)
    always = rows[level < 0]
    own: list[np.ndarray] = []
    first_own: list[np.ndarray] = []
    first_child: list[np.ndarray] = []
    merged: list[_Merged] = []
    cells = np.empty(0, np.uint64)  # of the level below
    for row in range(depth, -1, -1):
        mine = level == row
        own.append(rows[mine])
        shift = np.uint64(3 * (DEPTH - row))
        own_cells, child_cells = code[mine] >> shift, cells >> np.uint64(3)
        cells = _union(own_cells, child_cells)
        first_own.append(np.searchsorted(own_cells, _ends(cells)).astype(np.int32))
        if row < depth:
            first_child.append(np.searchsorted(child_cells, _ends(cells)).astype(np.int32))
        below = (merged[-1], first_child[-1]) if row < depth else None
        merged.append(_merge(splats, own[-1], first_own[-1], below, trained))
    for levels in (own, first_own, first_child, merged):
        levels.reverse()
    start = offsets([level.rows.shape[1] for level in merged])
    means = [
        np.stack([level.rows[0] * level.rows[13], *(level.rows[14:17] / level.rows[13])], axis=1) for level in merged
    ]
    return CapturedTree(
        _nodes(merged, splats),
        np.concatenate(means).astype(np.float32),
        start,
        edge,
        tuple(first_child),
        tuple(first_own),
        tuple(own),
        always,
        _trained_base(merged) if trained else None,
    )


def _depth(code: np.ndarray) -> int:
    """The finest level at which cells hold SPLATS splats in the mean. code: (N,) uint64, rising."""
    step = code[1:] ^ code[:-1]
    depth = 0
    while depth < DEPTH:
        cells = 1 + np.count_nonzero(step >= np.uint64(1 << 3 * (DEPTH - depth - 1)))
        if SPLATS * cells > len(code):
            break
        depth += 1
    return depth


def _level(scale: np.ndarray, side: float, depth: int) -> np.ndarray:
    """(N,) int8: the finest level whose cells are not smaller than splats; -1: larger than all."""
    found = np.empty(len(scale), np.int8)

    def find(block: slice) -> None:
        with np.errstate(divide="ignore"):
            level = np.floor(np.log2(side / (WIDTH * scale[block].max(axis=1))))
        found[block] = np.clip(level, -1, depth)

    each_block(len(scale), find)
    return found


def _union(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The cells that two rising lists hold, rising."""
    both = np.concatenate([a, b])
    if len(a) and len(b):
        both.sort(kind="stable")
    new = np.ones(len(both), bool)
    new[1:] = both[1:] != both[:-1]
    return both[new]


def _ends(cells: np.ndarray) -> np.ndarray:
    """The cells, and one behind the last."""
    return np.append(cells, cells[-1:] + np.uint64(1))


@record
class _Merged:
    """Splats, or the cells of one level, n of them."""

    rows: np.ndarray  # (R, n) float64, see `_rows`
    sh: np.ndarray  # (n, H) float32: coefficients of higher degrees


def _merge(
    splats: CapturedSplats,
    own: np.ndarray,
    first_own: np.ndarray,
    below: tuple[_Merged, np.ndarray] | None,
    trained: bool,
) -> _Merged:
    """The merged splats of the cells of one level. `below`: those of the level below, and where the children of each
    cell begin, (C + 1,). `trained`: with their display values."""
    count = np.diff(first_own) + (0 if below is None else np.diff(below[1]))
    height = ROWS + 3 * trained
    out = _Merged(np.empty((height, len(count))), np.empty((len(count), _coefficients(splats)), np.float32))
    parts = list(batches(count, BATCH))

    def merge(which: slice) -> None:
        for a, b in parts[which]:
            some = own[first_own[a] : first_own[b]]
            rows, sh, ends = _rows(splats, some, trained), _higher(splats, some), first_own[a : b + 1] - first_own[a]
            if below is not None:
                level, first = below
                children, first = slice(first[a], first[b]), first[a : b + 1] - first[a]
                # Splats of each cell, then its children.
                cell = np.concatenate([np.repeat(np.arange(b - a), np.diff(part)) for part in (ends, first)])
                order = np.argsort(cell, kind="stable")
                rows = np.concatenate([rows, level.rows[:, children]], axis=1)[:, order]
                sh = np.concatenate([sh, level.sh[children]])[order]
                ends = ends + first
            out.rows[:, a:b], out.sh[a:b] = _merged(rows, sh, ends)

    each_block(len(parts), merge, 1)
    return out


def _coefficients(splats: CapturedSplats) -> int:
    """How many coefficients of higher degrees a splat has, of all channels."""
    return 0 if splats.sh is None else splats.sh.shape[1] * 3


def _higher(splats: CapturedSplats, which: np.ndarray) -> np.ndarray:
    """(n, H) float32: the coefficients of higher degrees of some splats."""
    if splats.sh is None:
        return np.empty((len(which), 0), np.float32)
    return np.take(splats.sh.reshape(len(splats), _coefficients(splats)), which, axis=0)


def _rows(splats: CapturedSplats, which: np.ndarray, trained: bool) -> np.ndarray:
    """(R, n) float64 of some splats: weight; mean (3); covariance (6), xx, xy, xz, yy, yz, zz; linear colour of
    degree 0 (3); opacity over the weight; and times that, opacity, trace of the covariance and surface. `trained`: and
    its display values (3)."""
    scale = splats.scale[which].T.astype(np.float64)
    area = surface(scale)
    counts = area if splats.antialiased else np.ones_like(area)
    rows = np.empty((ROWS + 3 * trained, len(which)))
    np.maximum(splats.opacity[which] * counts, 1e-300, out=rows[0])
    rows[1:4] = splats.position[which].T
    axes = rotation_matrices(splats.rotation[which].T.astype(np.float64)) * scale
    for at, (i, j) in enumerate(PAIRS, 4):
        rows[at] = (axes[i] * axes[j]).sum(axis=0)
    display = np.maximum(DEGREE_0 * splats.base[which].T + 0.5, 0)
    rows[10:13] = linear_from_display(display)
    rows[ROWS:] = display[: 3 * trained]
    rows[13] = 1 / np.maximum(counts, 1e-30)
    rows[14] = splats.opacity[which] * rows[13]
    rows[15] = (rows[4] + rows[7] + rows[9]) * rows[13]
    rows[16] = area * rows[13]
    return rows


def surface(scale: np.ndarray) -> np.ndarray:
    """(n,): surfaces over 4 pi of ellipsoids with half-axes (3, n), after Knud Thomsen."""
    a, b, c = scale**KNUD_THOMSEN
    return ((a * b + a * c + b * c) / 3) ** (1 / KNUD_THOMSEN)


def linear_from_display(c: np.ndarray) -> np.ndarray:
    """Scene-linear values of sRGB display values."""
    return np.where(c > 0.04045, ((np.maximum(c, 0.04045) + 0.055) / 1.055) ** 2.4, c / 12.92)


def display_from_linear(c: np.ndarray) -> np.ndarray:
    """sRGB display values of scene-linear values."""
    return np.where(c > 0.0031308, 1.055 * np.maximum(c, 0.0031308) ** (1 / 2.4) - 0.055, c * 12.92)


def _merged(rows: np.ndarray, sh: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Merges rows (R, n), as `_rows` has them, and coefficients (n, H) between the `ends` (m + 1,)."""
    begin, count = ends[:-1], np.diff(ends)
    out = np.empty((len(rows), len(begin)))
    out[0] = np.add.reduceat(rows[0], begin)
    share = rows[0] / np.repeat(out[0], count)
    position = rows[1:4].copy()
    rows[1:] *= share
    # Of colours, and the first terms of means and covariances.
    np.add.reduceat(rows[1:], begin, axis=1, out=out[1:])
    away = [axis - np.repeat(mean, count) for axis, mean in zip(position, out[1:4], strict=True)]
    for at, (i, j) in enumerate(PAIRS, 4):
        out[at] += np.add.reduceat(share * away[i] * away[j], begin)
    sh *= share.astype(np.float32)[:, None]
    return out, np.add.reduceat(sh, begin, axis=0)


def _nodes(merged: list[_Merged], splats: CapturedSplats) -> CapturedSplats:
    """The nodes of all levels as splats."""
    rows = np.concatenate([level.rows for level in merged], axis=1)
    count = rows.shape[1]
    scale, rotation, base = (np.empty((count, width), np.float32) for width in (3, 4, 3))
    opacity = np.empty(count, np.float32)

    def fill(block: slice) -> None:
        some = rows[:, block]
        variance, axes = np.linalg.eigh(some[[4, 5, 6, 5, 7, 8, 6, 8, 9]].T.reshape(-1, 3, 3))
        scales = np.sqrt(np.maximum(variance, 0))
        scale[block], rotation[block] = scales, _quaternions(axes)
        base[block] = ((display_from_linear(some[10:13]) - 0.5) / DEGREE_0).T
        opacity[block] = some[0] * some[16] / np.maximum(surface(scales.T), 1e-300)

    each_block(count, fill, BATCH)
    sh = None if splats.sh is None else np.concatenate([level.sh for level in merged]).reshape(-1, *splats.sh.shape[1:])
    position = np.ascontiguousarray(rows[1:4].T, np.float32)
    return CapturedSplats(position, scale, rotation, base, opacity, sh, splats.origin, splats.antialiased)


def _trained_base(merged: list[_Merged]) -> np.ndarray:
    display = np.concatenate([level.rows[ROWS:] for level in merged], axis=1)
    return np.ascontiguousarray((display.T - 0.5) / DEGREE_0, np.float32)


def _quaternions(axes: np.ndarray) -> np.ndarray:
    """(n, 4): unit quaternions of orthogonal matrices (n, 3, 3), turned where they mirror (Bar-Itzhack 2000)."""
    axes = axes * np.where(np.linalg.det(axes) < 0, -1.0, 1.0)[:, None, None]
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = np.moveaxis(axes, 0, -1)
    # Four times each product of two components, of which the row of the largest square is divided by its root.
    table = np.array([
        [1 + xx + yy + zz, zy - yz, xz - zx, yx - xy],
        [zy - yz, 1 + xx - yy - zz, xy + yx, xz + zx],
        [xz - zx, xy + yx, 1 - xx + yy - zz, yz + zy],
        [yx - xy, xz + zx, yz + zy, 1 - xx - yy + zz],
    ])  # fmt: skip
    most = np.argmax(table[[0, 1, 2, 3], [0, 1, 2, 3]], axis=0)
    found = table[most, :, np.arange(len(axes))]
    return found / np.linalg.norm(found, axis=1, keepdims=True)
