"""The light tree: an octree over all surfels of a scene, whose nodes are gathered from where they look small.

A node holds what a distant receiver needs of its surfels: their mean place and the radius around it, the area, the sum
of area times normal (Bunnell 2005; Christensen 2008), and the mean radiance of either side. Cells with one child only
are left out. Children follow one another, in the order of their octants, so that a walk meets the near ones first.
"""

from __future__ import annotations

import numpy as np

from ..numeric.morton import DEPTH, morton_codes, sorted_by_code
from ..numeric.record import record
from ..numeric.segments import owners
from .surfels import Surfels


@record
class LightTree:
    """M nodes, the root last; those of surfels first in no order that matters: `leaf` finds them."""

    position: np.ndarray  # (M, 3) float32, relative to the surfels' origin
    radius: np.ndarray  # (M,) float32: of a ball around it that holds the surfels' disks
    facing: np.ndarray  # (M, 3) float32: sum of area times normal, over the area
    area: np.ndarray  # (M,) float32
    closed: np.ndarray  # (M,) float32: share of the area that belongs to closed surfaces
    scattered: np.ndarray  # (M,) float32: share of the area that belongs to leaves and hairs
    first: np.ndarray  # (M,) int32: first child; -1: a leaf
    octants: np.ndarray  # (M,) uint8: which of the eight children there are, bit by bit
    leaf: np.ndarray  # (N,) int32: the node of each surfel
    # Levels of inner nodes, deepest first: the nodes (n,), how many children each has (n,), and all of these (c,).
    levels: tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...]

    def __len__(self) -> int:
        return len(self.area)

    def averaged(self, values: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """Returns means (M, C) float32 for all nodes of values (N, C) of surfels, weighted by `weight` (N,)."""
        total = np.zeros((len(self), values.shape[1] + 1))
        np.add.at(total, self.leaf, np.column_stack([values * weight[:, None], weight]))
        for nodes, count, children in self.levels:
            total[nodes] = np.add.reduceat(total[children], np.cumsum(count) - count)
        return (total[:, :-1] / np.maximum(total[:, -1:], 1e-300)).astype(np.float32)


def build_tree(surfels: Surfels) -> LightTree:
    """Builds the tree over N > 0 surfels."""
    code, _ = morton_codes(surfels.position)
    order, code = sorted_by_code(code)
    # Surfels in one finest cell share a leaf.
    new = np.append(True, code[1:] != code[:-1])
    begin = np.flatnonzero(new)
    weight = surfels.area[order].astype(np.float64)
    sums = _sums(surfels, order, weight, begin)
    extent = _leaf_radius(surfels, order, sums, begin)

    codes, node_sums, radii = code[begin], sums, extent
    leaves = len(begin)
    firsts, masks = np.full(leaves, -1, np.int64), np.zeros(leaves, np.uint8)
    # Nodes get their place when their parent does: children side by side.
    made = _Made(leaves)
    current = np.arange(leaves)
    for _ in range(DEPTH):
        if len(current) == 1:
            break
        octant, codes = (codes & np.uint64(7)).astype(np.uint8), codes >> np.uint64(3)
        begin_group = np.flatnonzero(np.append(True, codes[1:] != codes[:-1]))
        count = np.diff(np.append(begin_group, len(codes)))
        several = count > 1
        in_several = np.repeat(several, count)
        children = current[in_several]
        parents = made.add(children, count[several])
        own_sums = (
            np.add.reduceat(node_sums[children], np.cumsum(count[several]) - count[several])
            if len(parents)
            else node_sums[:0]
        )
        mask = np.bitwise_or.reduceat(np.uint8(1) << octant, begin_group)[several]
        node_sums = np.concatenate([node_sums, own_sums])
        middle, child_middle = own_sums[:, 1:4] / own_sums[:, :1], node_sums[children, 1:4] / node_sums[children, :1]
        apart = np.sqrt(((child_middle - np.repeat(middle, count[several], axis=0)) ** 2).sum(axis=1)) + radii[children]
        own_radii = (
            np.maximum.reduceat(apart, np.cumsum(count[several]) - count[several]) if len(parents) else apart[:0]
        )
        radii = np.concatenate([radii, own_radii])
        firsts, masks = np.concatenate([firsts, np.zeros(len(parents), np.int64)]), np.concatenate([masks, mask])
        following = current[begin_group].copy()
        following[several] = parents
        current, codes = following, codes[begin_group]
    return made.finished(node_sums, radii, masks, leaf_of=_inverse(order, new))


class _Made:
    """Numbers nodes as they are made, and gives them their places."""

    def __init__(self, leaves: int) -> None:
        self.count = leaves
        self.levels: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

    def add(self, children: np.ndarray, count: np.ndarray) -> np.ndarray:
        """Returns the numbers of new nodes with so many (n,) of the children (c,)."""
        parents = np.arange(self.count, self.count + len(count))
        self.count += len(count)
        if len(parents):
            self.levels.append((parents, count, children))
        return parents

    def finished(self, sums: np.ndarray, radii: np.ndarray, masks: np.ndarray, leaf_of: np.ndarray) -> LightTree:
        placed = np.concatenate([children for *_, children in self.levels] + [np.array([self.count - 1])])
        place = np.empty(self.count, np.int64)
        place[placed] = np.arange(self.count)
        first = np.full(self.count, -1, np.int32)
        at = 0
        for parents, count, _ in self.levels:
            first[place[parents]] = at + np.cumsum(count) - count
            at += int(count.sum())
        area = sums[placed, 0]
        f = np.float32
        return LightTree(
            position=(sums[placed, 1:4] / area[:, None]).astype(f),
            radius=radii[placed].astype(f),
            facing=(sums[placed, 4:7] / area[:, None]).astype(f),
            area=area.astype(f),
            closed=(sums[placed, 7] / area).astype(f),
            scattered=(sums[placed, 8] / area).astype(f),
            first=first,
            octants=masks[placed],
            leaf=place[leaf_of].astype(np.int32),
            levels=tuple((place[parents], count, place[children]) for parents, count, children in self.levels),
        )


def _sums(surfels: Surfels, order: np.ndarray, weight: np.ndarray, begin: np.ndarray) -> np.ndarray:
    """(L, 9) float64 of the leaves: area, and times it position, normal, and whether surfaces are closed or scattered."""
    columns = np.column_stack(
        [
            np.ones(len(order)),
            surfels.position[order],
            surfels.normal[order],
            surfels.closed[order],
            surfels.scattered[order],
        ]
    )
    return np.add.reduceat(columns * weight[:, None], begin)


def _leaf_radius(surfels: Surfels, order: np.ndarray, sums: np.ndarray, begin: np.ndarray) -> np.ndarray:
    """(L,) float64: of balls around the leaves' middles that hold the disks of their surfels."""
    own = owners(np.diff(np.append(begin, len(order))))
    away = surfels.position[order] - (sums[:, 1:4] / sums[:, :1])[own]
    reach = np.sqrt((away**2).sum(axis=1)) + np.sqrt(surfels.area[order] / np.pi)
    return np.maximum.reduceat(reach, begin)


def _inverse(order: np.ndarray, new: np.ndarray) -> np.ndarray:
    """(N,): the leaf of each surfel, in the order that they had before they were sorted."""
    leaf = np.empty(len(order), np.int64)
    leaf[order] = np.cumsum(new) - 1
    return leaf
