"""Nodes that stand for several captured splats (Kerbl et al. 2024, A Hierarchical 3D Gaussian Representation, section 4).

Splats are stored in the cells of an octree, each at the finest level whose cells are not smaller than it is. The node of
a cell merges the splats that are stored there and in all cells below: where a cell is smaller than a pixel, so is
all that its node stands for. A node is a Gaussian with the mean and the covariance of its splats, weighted by opacity
times the surface of the ellipsoid; its opacity is the sum of the weights over its own surface, and may exceed 1.
"""

from __future__ import annotations

import numpy as np

from ...numeric.morton import DEPTH, morton_codes, sorted_by_code
from ...numeric.record import record
from ...numeric.segments import batches, offsets
from ...numeric.vectors import each_block, take_rows
from ...scene.captured import CapturedSplats
from ...splat.captured import LEAST_ALPHA

SPLATS = 4  # in the cells of the finest level, in the mean, at least: cells of fewer save nothing
WIDTH = 2.0  # standard deviations along a splat's longest axis that the edge of its cell is not shorter than
BATCH = 1 << 14  # splats that are merged together, so that their working arrays stay in the cache
KNUD_THOMSEN = 1.6075  # exponent of his approximation to an ellipsoid's surface, within 1.1 %
DEGREE_0 = 0.28209479177387814
LINEAR = 15  # rows of `_rows` before the coefficients of higher degrees


@record
class CapturedTree:
    """Nodes over captured splats, level by level, coarsest first.

    Node `start[l] + c` is cell c of level l, in Morton order. It stands for the splats own[l][first_own[l][c]:
    first_own[l][c + 1]] and for the nodes from first_child[l][c] to first_child[l][c + 1] of level l + 1, counted there.
    """

    nodes: CapturedSplats  # M, of all levels; opacities may exceed 1
    means: np.ndarray  # (M, 2) float32, of the splats of each node: standard deviation, and opacity
    start: np.ndarray  # (L + 1,) int64: the first node of each level
    edge: np.ndarray  # (L,) float64: length of the cells' edges
    first_child: tuple[np.ndarray, ...]  # of each level but the last: (cells + 1,) int32
    first_own: tuple[np.ndarray, ...]  # of each level: (cells + 1,) int32
    own: tuple[np.ndarray, ...]  # of each level: rows of the splats that are stored there, int32
    always: np.ndarray  # (A,) int32: rows of splats that are larger than the largest cell

    def __len__(self) -> int:
        return len(self.nodes)

    @property
    def nbytes(self) -> int:
        parts = (*self.first_child, *self.first_own, *self.own, self.always)
        return self.nodes.nbytes + self.means.nbytes + sum(part.nbytes for part in parts)


def build_captured_tree(splats: CapturedSplats) -> CapturedTree:
    """Builds the nodes of N > 0 valid splats. Those that no view shows, of too little opacity, are in none."""
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
    merged: list[np.ndarray] = []
    cells = np.empty(0, np.uint64)  # of the level below
    for l in range(depth, -1, -1):
        mine = level == l
        own.append(rows[mine])
        shift = np.uint64(3 * (DEPTH - l))
        own_cells, child_cells = code[mine] >> shift, cells >> np.uint64(3)
        cells = _union(own_cells, child_cells)
        first_own.append(np.searchsorted(own_cells, _ends(cells)).astype(np.int32))
        if l < depth:
            first_child.append(np.searchsorted(child_cells, _ends(cells)).astype(np.int32))
        below = (merged[-1], first_child[-1]) if l < depth else None
        merged.append(_merge(splats, own[-1], first_own[-1], below))
    for levels in (own, first_own, first_child, merged):
        levels.reverse()
    start = offsets([rows.shape[1] for rows in merged])
    means = [np.stack([rows[13] ** -0.5, rows[14] / rows[13]], axis=1) for rows in merged]
    return CapturedTree(
        _nodes(merged, splats), np.concatenate(means).astype(np.float32), start, edge, tuple(first_child), tuple(first_own), tuple(own), always)


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


def _merge(
    splats: CapturedSplats, own: np.ndarray, first_own: np.ndarray, below: tuple[np.ndarray, np.ndarray] | None
) -> np.ndarray:
    """The merged rows (15 + H, C) of the cells of one level: see `_rows`. `below`: those of the level below, and where
    the children of each cell begin, (C + 1,)."""
    count = np.diff(first_own) + (0 if below is None else np.diff(below[1]))
    higher = 0 if splats.sh is None else splats.sh.shape[1] * 3
    out = np.empty((LINEAR + higher, len(count)))
    parts = list(batches(count, BATCH))

    def merge(which: slice) -> None:
        for a, b in parts[which]:
            rows = _rows(splats, own[first_own[a] : first_own[b]])
            ends = first_own[a : b + 1] - first_own[a]
            if below is not None:
                first = below[1]
                children = below[0][:, first[a] : first[b]]
                # Splats of each cell, then its children.
                cell = np.concatenate([np.repeat(np.arange(b - a), np.diff(part))
                                       for part in (ends, first[a : b + 1])])  # fmt: skip
                order = np.argsort(cell, kind="stable")
                rows = np.concatenate([rows, children], axis=1)[:, order]
                ends = ends + first[a : b + 1] - first[a]
            out[:, a:b] = _merged(rows, ends)

    each_block(len(parts), merge, 1)
    return out


def _rows(splats: CapturedSplats, which: np.ndarray) -> np.ndarray:
    """(15 + H, n) float64 of some splats: weight; mean (3); covariance (6), xx, xy, xz, yy, yz, zz; linear colour of
    degree 0 (3); 1 over the surface; opacity over the surface; H coefficients of higher degrees."""
    scale = splats.scale[which].T.astype(np.float64)
    higher = 0 if splats.sh is None else splats.sh.shape[1] * 3
    rows = np.empty((LINEAR + higher, len(which)))
    np.maximum(splats.opacity[which] * surface(scale), 1e-300, out=rows[0])
    rows[1:4] = splats.position[which].T
    axes = _axes(splats.rotation[which].T.astype(np.float64)) * scale
    for at, (i, j) in enumerate(((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)), 4):
        rows[at] = (axes[i] * axes[j]).sum(axis=0)
    rows[10:13] = linear_from_display(np.maximum(DEGREE_0 * splats.base[which].T + 0.5, 0))
    rows[13] = 1 / np.maximum(surface(scale), 1e-30)
    rows[14] = splats.opacity[which] * rows[13]
    if splats.sh is not None:
        rows[LINEAR:] = splats.sh[which].reshape(len(which), higher).T
    return rows


def _axes(quaternion: np.ndarray) -> np.ndarray:
    """(3, 3, n): the rotation matrices of unit quaternions (4, n), w first."""
    w, x, y, z = quaternion
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


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


def _merged(rows: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Merges the columns of rows (15 + H, n), as `_rows` has them, between the `ends` (m + 1,): (15 + H, m)."""
    begin, count = ends[:-1], np.diff(ends)
    out = np.empty((len(rows), len(begin)))
    out[0] = np.add.reduceat(rows[0], begin)
    share = rows[0] / np.repeat(out[0], count)
    position = rows[1:4].copy()
    rows[1:] *= share
    # Of colours, and the first terms of means and covariances.
    np.add.reduceat(rows[1:], begin, axis=1, out=out[1:])
    away = [axis - np.repeat(mean, count) for axis, mean in zip(position, out[1:4], strict=True)]
    for at, (i, j) in enumerate(((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)), 4):
        out[at] += np.add.reduceat(share * away[i] * away[j], begin)
    return out


def _nodes(merged: list[np.ndarray], splats: CapturedSplats) -> CapturedSplats:
    """The nodes of all levels as splats."""
    count = sum(rows.shape[1] for rows in merged)
    arrays = {"position": 3, "scale": 3, "rotation": 4, "base": 3}
    out = {name: np.empty((count, width), np.float32) for name, width in arrays.items()}
    opacity = np.empty(count, np.float32)
    sh = None if splats.sh is None else np.empty((count, *splats.sh.shape[1:]), np.float32)
    at = 0
    for rows in merged:
        to = slice(at, at + rows.shape[1])
        at = to.stop

        def fill(block: slice, rows: np.ndarray = rows, begin: int = to.start) -> None:
            here, some = slice(begin + block.start, begin + block.stop), rows[:, block]
            variance, axes = np.linalg.eigh(some[[4, 5, 6, 5, 7, 8, 6, 8, 9]].T.reshape(-1, 3, 3))
            scale = np.sqrt(np.maximum(variance, 0))
            out["position"][here] = some[1:4].T
            out["scale"][here] = scale
            out["rotation"][here] = _quaternions(axes)
            out["base"][here] = ((display_from_linear(some[10:13]) - 0.5) / DEGREE_0).T
            opacity[here] = some[0] / np.maximum(surface(scale.T), 1e-300)
            if sh is not None:
                sh[here] = some[LINEAR:].T.reshape(some.shape[1], *sh.shape[1:])

        each_block(rows.shape[1], fill)
    return CapturedSplats(**out, opacity=opacity, sh=sh, origin=splats.origin,
                          antialiased=splats.antialiased)


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
