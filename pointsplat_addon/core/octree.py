"""The partition of points into a data-driven point-octree (Pajarola 2003, section 3).

Nodes lie breadth first with the children of a node next to each other, and points lie in tree order:
a level is a slice, and the points of a node are one range.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

MAX_DEPTH = 64  # levels; only geometric sequences of points come near it
BLOCK = 1 << 17  # points that are partitioned down to the leaves together: their arrays stay in the cache


@dataclass(frozen=True, eq=False)
class Tree:
    """Links of M nodes over N points, breadth first: node 0 is the root."""

    child_count: np.ndarray  # (M,) uint8; 0 for leaves
    first_child: np.ndarray  # (M,) int32; 0 for leaves
    point_count: np.ndarray  # (M,) int32
    first_point: np.ndarray  # (M,) int32, position in tree order
    levels: np.ndarray  # (L + 1,) int64: level l is the nodes levels[l] to levels[l + 1]

    def __len__(self) -> int:
        return len(self.child_count)


def starts(count: np.ndarray) -> np.ndarray:
    """Exclusive prefix sums, int64: where each of consecutive segments begins."""
    begin = np.zeros(len(count), np.int64)
    np.cumsum(count[:-1], out=begin[1:])
    return begin


def ranges(first: np.ndarray, count: np.ndarray) -> np.ndarray:
    """The integers first[i] ... first[i] + count[i] - 1 of every i, one after the other, int64."""
    index = np.repeat(first - starts(count), count)
    index += np.arange(len(index))
    return index


@dataclass
class _Front:
    """Nodes of one level that are still to be split, and their points, packed in the nodes' order."""

    position: list[np.ndarray]  # x, y, z: (n,) float32 each
    index: np.ndarray  # (n,) int32, original index
    first: np.ndarray  # (k,) int64, place of the node's points in tree order
    count: np.ndarray  # (k,) int64


_Level = tuple[np.ndarray, np.ndarray, np.ndarray]  # child_count, first_point, point_count of a level's nodes


def partition(position: np.ndarray, leaf_size: int) -> tuple[np.ndarray, Tree]:
    """Split points (N, 3) at their mean, eight octants at a time; the tree order (N,) int32 and the links.

    The top levels run over all points at once. Then blocks of neighbouring subtrees are finished one by one,
    so that their working arrays stay in the processor's cache and small in memory.
    """
    n = len(position)
    order = np.empty(n, np.int32)
    if n == 0:
        return order, link(np.empty(0, np.uint8), np.empty(0, np.int32), np.empty(0, np.int32), np.zeros(1, np.int64))
    index = np.arange(n, dtype=np.int32)
    front = _Front([position[:, i].copy() for i in range(3)], index, np.zeros(1, np.int64), np.array([n]))
    top: list[_Level] = [(np.zeros(1, np.uint8), front.first, front.count)]
    if n <= leaf_size:
        order[:], front.count = index, front.count[:0]
    front = _descend(front, top, order, leaf_size, block=BLOCK)
    below: list[list[_Level]] = []
    for block in _blocks(front):
        mine: list[_Level] = [(np.zeros(len(block.count), np.uint8), block.first, block.count)]
        _descend(block, mine, order, leaf_size, block=0, depth=len(top) - 1)
        below.append(mine)
    return order, _join(top, below, leaf_size)


def _descend(
    front: _Front, levels: list[_Level], order: np.ndarray, leaf_size: int, block: int, depth: int = 0
) -> _Front:
    """Split level after level, appending to `levels`, until nothing is left or no node has more than `block` points."""
    while len(front.count) and front.count.max() > block:
        limit = leaf_size if depth + len(levels) < MAX_DEPTH else np.iinfo(np.int64).max
        # The nodes of the front are those of the last level with too many points; `split` says what became of them.
        child_count, _, count = levels[-1]
        children, child_first, child_size, front = _split(front, order, limit)
        child_count[count > leaf_size] = children
        if len(child_size) == 0:
            break
        levels.append((np.zeros(len(child_size), np.uint8), child_first, child_size))
    return front


def _split(front: _Front, order: np.ndarray, leaf_size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, _Front]:
    """Split every node of the front at its mean.

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

    # Finished groups go to their place in tree order, the others become the next front.
    stuck = np.repeat(children == 1, children)
    open_ = ~stuck & (size > leaf_size)
    order[ranges(first[~open_], size[~open_])] = front.index[by_octant[ranges(source[~open_], size[~open_])]]
    kept = by_octant[ranges(source[open_], size[open_])]
    del by_octant
    rest = _Front([x[kept] for x in front.position], front.index[kept], first[open_], size[open_])
    children[children == 1] = 0
    return children, first[~stuck], size[~stuck], rest


def _blocks(front: _Front) -> Iterator[_Front]:
    """The front in runs of nodes of about BLOCK points each."""
    begin = starts(front.count)
    for a, b in runs(front.count, BLOCK):
        lo, hi = begin[a], begin[b - 1] + front.count[b - 1]
        yield _Front([x[lo:hi] for x in front.position], front.index[lo:hi], front.first[a:b], front.count[a:b])


def runs(count: np.ndarray, most: int) -> Iterator[tuple[int, int]]:
    """Cut consecutive segments into runs (a, b) that hold at most `most` elements, or one segment."""
    end = np.cumsum(count)
    a = 0
    while a < len(count):
        b = int(np.searchsorted(end, (end[a - 1] if a else 0) + most, side="right"))
        b = max(b, a + 1)
        yield a, b
        a = b


def _join(top: list[_Level], below: list[list[_Level]], leaf_size: int) -> Tree:
    """Concatenate levels breadth first. Blocks follow each other in tree order, hence so do their levels."""
    levels = list(top)
    if below:
        child_count, _, count = top[-1]
        child_count[count > leaf_size] = np.concatenate([block[0][0] for block in below])
        for depth in range(1, max(len(block) for block in below)):
            parts = [block[depth] for block in below if depth < len(block)]
            children, first, count = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
            levels.append((children, first, count))
    offsets = np.concatenate([[0], np.cumsum([len(level[0]) for level in levels])])
    child_count, first, count = (np.concatenate(arrays) for arrays in zip(*levels, strict=True))
    return link(child_count, first.astype(np.int32), count.astype(np.int32), offsets)


def link(child_count: np.ndarray, first_point: np.ndarray, point_count: np.ndarray, levels: np.ndarray) -> Tree:
    """Breadth-first order makes the first child a prefix sum: the root is node 0, its children start at node 1."""
    first_child = (starts(child_count) + 1).astype(np.int32) if len(child_count) else np.empty(0, np.int32)
    first_child[child_count == 0] = 0
    return Tree(child_count, first_child, point_count, first_point, levels)
