"""The partition of points into a data-driven point-octree (Pajarola 2003, section 3).

Nodes lie breadth first with the children of a node next to each other, and points lie in tree order:
a level is a slice, and the points of a node are one range.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...numeric.segments import offsets, ranges, starts
from .tree import MAX_DEPTH, Tree, link

BLOCK = 1 << 17  # points that are partitioned down to the leaves together: their arrays stay in the cache


@dataclass
class _Front:
    """Nodes of one level that are still to be split, and their points, in the nodes' order."""

    position: list[np.ndarray]  # x, y, z: (n,) float32 each
    index: np.ndarray  # (n,) int32, original index
    first: np.ndarray  # (k,) int64, index of the node's first point in tree order
    count: np.ndarray  # (k,) int64


@dataclass
class _Piece:
    """Nodes of one level whose points follow one another in tree order."""

    child_count: np.ndarray  # (k,) uint8
    first: np.ndarray  # (k,) int64
    count: np.ndarray  # (k,) int64


@dataclass
class _Root:
    """A node whose subtree is still to be built: node `at` of `piece`."""

    piece: _Piece
    at: int
    depth: int

    @property
    def first(self) -> int:
        return int(self.piece.first[self.at])

    @property
    def count(self) -> int:
        return int(self.piece.count[self.at])


def partition(position: np.ndarray, leaf_size: int) -> tuple[np.ndarray, Tree]:
    """Splits points (N, 3) at their mean into eight octants, again and again, until leaves hold at most `leaf_size`.

    Returns the tree order, (N,) int32 original indices, and the links. Nodes of more than BLOCK points are split one by
    one, in passes over memory. Below, neighbouring subtrees are finished together, all nodes of a level at once, with
    working arrays that stay in the processor's cache.
    """
    n = len(position)
    order = np.arange(n, dtype=np.int32)
    if n == 0:
        return order, link(np.empty(0, np.uint8), np.empty(0, np.int32), np.empty(0, np.int32), np.zeros(1, np.int64))
    coordinates = [position[:, i].copy() for i in range(3)]
    top = _piece(np.zeros(1, np.int64), np.array([n]))
    levels = [[top]]
    roots = _descend_large(coordinates, order, _Root(top, 0, 0), levels, leaf_size)
    for group in _neighbours(roots):
        _descend_block(coordinates, order, group, levels, leaf_size)
    return order, _join(levels)


def _piece(first: np.ndarray, count: np.ndarray) -> _Piece:
    """Nodes without children as yet."""
    return _Piece(np.zeros(len(first), np.uint8), first, count)


def _add(levels: list[list[_Piece]], depth: int, piece: _Piece) -> None:
    if depth == len(levels):
        levels.append([])
    levels[depth].append(piece)


def _descend_large(
    coordinates: list[np.ndarray], order: np.ndarray, root: _Root, levels: list[list[_Piece]], leaf_size: int
) -> list[_Root]:
    """Splits nodes of more than BLOCK points; returns the smaller ones that are to be split further, in tree order."""
    waiting, done = [root], []
    while waiting:
        root = waiting.pop()
        if root.count <= leaf_size or root.depth == MAX_DEPTH:
            continue
        if root.count <= BLOCK:
            done.append(root)
            continue
        size = _regroup(coordinates, order, slice(root.first, root.first + root.count))
        size = size[size > 0]
        if len(size) > 1:
            root.piece.child_count[root.at] = len(size)
            piece = _piece(root.first + starts(size), size)
            _add(levels, root.depth + 1, piece)
            waiting += [_Root(piece, i, root.depth + 1) for i in reversed(range(len(size)))]
    return done


def _regroup(coordinates: list[np.ndarray], order: np.ndarray, node: slice) -> np.ndarray:
    """Sorts the points of one node by octant in place, a block at a time; returns the points in each octant (8,)."""
    means = [x[node].mean() for x in coordinates]
    blocks = [slice(i, min(i + BLOCK, node.stop)) for i in range(node.start, node.stop, BLOCK)]
    octants = []
    for block in blocks:
        octant = np.zeros(block.stop - block.start, np.uint8)
        for bit, (x, mean) in enumerate(zip(coordinates, means, strict=True)):
            octant |= (x[block] > mean).view(np.uint8) << bit
        octants.append(octant)
    sizes = np.array([np.bincount(octant, minlength=8) for octant in octants])
    total = sizes.sum(axis=0)
    if np.count_nonzero(total) == 1:
        return total

    # Every block's run of an octant follows that of the block before.
    target = starts(total) + np.cumsum(sizes, axis=0) - sizes
    sorted_by = [octant.argsort(kind="stable") for octant in octants]
    for array in (*coordinates, order):
        out = np.empty(node.stop - node.start, array.dtype)
        for block, index, size, to in zip(blocks, sorted_by, sizes, target, strict=True):
            grouped = array[block][index]
            for begin, n, at in zip(starts(size), size, to, strict=True):
                out[at : at + n] = grouped[begin : begin + n]
        array[node] = out
    return total


def _neighbours(roots: list[_Root]) -> Iterator[list[_Root]]:
    """Groups roots of one depth whose points follow one another, of at most BLOCK points together."""
    group: list[_Root] = []
    points = 0
    for root in roots:
        points += root.count
        gap = group and (root.depth != group[-1].depth or root.first != group[-1].first + group[-1].count)
        if group and (gap or points > BLOCK):
            yield group
            group, points = [], root.count
        group.append(root)
    if group:
        yield group


def _descend_block(
    coordinates: list[np.ndarray], order: np.ndarray, group: list[_Root], levels: list[list[_Piece]], leaf_size: int
) -> None:
    """Splits the subtrees of a group of roots, all nodes of a level at once, until only leaves are left."""
    points = slice(group[0].first, group[-1].first + group[-1].count)
    first, count = np.array([root.first for root in group]), np.array([root.count for root in group])
    depth = group[0].depth
    piece = _piece(first, count)
    front = _Front([x[points] for x in coordinates], order[points].copy(), first, count)
    while len(front.count):
        depth += 1
        children, child_first, child_size, front = _split(front, order, leaf_size if depth < MAX_DEPTH else BLOCK)
        piece.child_count[piece.count > leaf_size] = children
        if depth == group[0].depth + 1:
            for root, n in zip(group, piece.child_count, strict=True):
                root.piece.child_count[root.at] = n
        if len(child_size):
            piece = _piece(child_first, child_size)
            _add(levels, depth, piece)


def _split(front: _Front, order: np.ndarray, leaf_size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, _Front]:
    """Splits every node of the front at its mean.

    Returns each node's number of children (0 where all its points fell into one octant), the children's first
    point and count, and the front of those children with more than `leaf_size` points. The points of
    finished nodes are written to `order`.
    """
    nodes = len(front.count)
    begin = starts(front.count)
    octant = np.zeros(len(front.index), np.uint8)
    for bit, x in enumerate(front.position):
        mean = np.add.reduceat(x, begin) / front.count.astype(np.float32)
        octant |= (x > np.repeat(mean, front.count)).view(np.uint8) << bit

    # A stable sort by octant groups the points by (octant, node); `source` says where each group begins.
    by_octant = octant.argsort(kind="stable")
    key = np.repeat(np.arange(0, 8 * nodes, 8), front.count)
    key += octant
    size = np.bincount(key, minlength=8 * nodes).reshape(nodes, 8)
    del key, octant
    source = starts(size.T.ravel()).reshape(8, nodes).T
    occupied = size > 0
    children = np.count_nonzero(occupied, axis=1)
    size, source = size[occupied], source[occupied]
    first = np.repeat(front.first - begin, children) + starts(size)

    # Finished groups are written in tree order, the others become the next front.
    stuck = np.repeat(children == 1, children)
    open_ = ~stuck & (size > leaf_size)
    order[ranges(first[~open_], size[~open_])] = front.index[by_octant[ranges(source[~open_], size[~open_])]]
    left = by_octant[ranges(source[open_], size[open_])]
    del by_octant
    rest = _Front([x[left] for x in front.position], front.index[left], first[open_], size[open_])
    children[children == 1] = 0
    return children, first[~stuck], size[~stuck], rest


def _join(levels: list[list[_Piece]]) -> Tree:
    """Joins all pieces breadth first; within a level, they hold separate ranges of the tree order."""
    pieces = [piece for level in levels for piece in sorted(level, key=lambda piece: piece.first[0])]
    sizes = [sum(len(piece.first) for piece in level) for level in levels]
    child_count = np.concatenate([piece.child_count for piece in pieces])
    first, count = (np.concatenate([getattr(p, name) for p in pieces]).astype(np.int32) for name in ("first", "count"))
    return link(child_count, first, count, offsets(sizes))
