"""The light tree: an octree over all surfels of a scene, whose nodes are gathered from where they look small.

A node holds what a distant receiver needs of its surfels: their mean place and the radius around it, the area, the sum
of area times normal (Bunnell 2005; Christensen 2008), the axis that most normals lie along, either way, and how far
they do. Cells with one child only are left out. Children follow one another, in the order of their octants, so that a
walk meets the near ones first.
"""

from __future__ import annotations

import numpy as np

from ..numeric.morton import DEPTH, morton_codes, sorted_by_code
from ..numeric.record import record
from ..numeric.segments import owners, starts
from .surfels import Surfels

SQUARINGS = 3  # of the matrix whose largest eigenvector is looked for
# Columns of sums over surfels, weighted by area.
AREA, POSITION, NORMAL, SCATTERED, PRODUCTS = 0, slice(1, 4), slice(4, 7), 7, slice(8, 14)
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # of coordinates, of PRODUCTS


@record
class LightTree:
    """M nodes, the root last, in no other order: `leaf` finds those of surfels."""

    position: np.ndarray  # (M, 3) float32, relative to the surfels' origin
    radius: np.ndarray  # (M,) float32: of a ball around it that holds the surfels' disks
    facing: np.ndarray  # (M, 3) float32: sum of area times normal, over the area
    area: np.ndarray  # (M,) float32
    axis: (
        np.ndarray
    )  # (M, 3) float32, unit, to the side that `facing` is on: largest eigenvector of the mean of normals' products
    along: np.ndarray  # (M,) float32: 1 where all normals lie along the axis, 0 where they are turned evenly
    scattered: np.ndarray  # (M,) float32: share of the area that belongs to leaves and hairs
    first: np.ndarray  # (M,) int32: first child; -1: a leaf
    octants: np.ndarray  # (M,) uint8: which of the eight children there are, bit by bit
    edge: np.ndarray  # (M, 3) float32: of leaves that are rectangles or triangles, as Surfels.edge; else (0, 0, 0)
    half: np.ndarray  # (M,) bool: of leaves, as Surfels.half
    leaf: np.ndarray  # (N,) int32: the node of each surfel
    # Levels of inner nodes, deepest first: the nodes (n,), how many children each has (n,), and all of these (c,).
    levels: tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...]

    def __len__(self) -> int:
        return len(self.area)

    def radiance(self, surfels: Surfels, outside: np.ndarray, inside: np.ndarray) -> np.ndarray:
        """Returns the radiance of all nodes from that of surfels' two sides, (N, 3) each: (3, M, 3) float32.

        What one sees from where the node's axis points, from the other side, and of surfaces from behind.
        """
        area = surfels.area.astype(np.float64)[:, None]
        round_ones = ~surfels.normal.any(axis=1)[:, None]
        behind = np.where(round_ones | surfels.scattered[:, None], area, 0.0)
        of_behind = np.where(round_ones, outside, inside)
        columns = [area * outside, area, behind * of_behind, behind, area * inside, area]
        total = np.zeros((len(self), 12))
        np.add.at(total, self.leaf, np.column_stack(columns))
        for nodes, count, children in self.levels:
            turned = (self.axis[children] * np.repeat(self.axis[nodes], count, axis=0)).sum(axis=1) < 0
            of_children = total[children]
            of_children[turned, :8] = of_children[turned][:, [4, 5, 6, 7, 0, 1, 2, 3]]
            total[nodes] = np.add.reduceat(of_children, starts(count))
        sums = total.reshape(len(self), 3, 4).transpose(1, 0, 2).copy()
        # A side that nothing is turned to looks like the other.
        nothing = sums[..., 3] == 0
        sums[1, nothing[1]] = sums[0, nothing[1]]
        sums[0, nothing[0]] = sums[1, nothing[0]]
        sums[2, nothing[2]] = sums[0, nothing[2]]
        return (sums[..., :3] / np.maximum(sums[..., 3:], 1e-300)).astype(np.float32)


def build_tree(surfels: Surfels) -> LightTree:
    """Builds the tree over N > 0 surfels."""
    code, _ = morton_codes(surfels.position)
    order, code = sorted_by_code(code)
    # Surfels in one finest cell share a leaf.
    new = np.append(True, code[1:] != code[:-1])
    begin = np.flatnonzero(new)
    sums = [np.add.reduceat(_columns(surfels, order), begin)]
    radii = [_leaf_radius(surfels, order, sums[0], begin)]
    masks = [np.zeros(len(begin), np.uint8)]
    levels: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    code, own_sums, own_radii, number, made = code[begin], sums[0], radii[0], np.arange(len(begin)), len(begin)
    for _ in range(DEPTH):
        if len(number) == 1:
            break
        octant, code = (code & np.uint64(7)).astype(np.uint8), code >> np.uint64(3)
        first = np.flatnonzero(np.append(True, code[1:] != code[:-1]))
        count = np.diff(np.append(first, len(code)))
        several = count > 1
        code, kept = code[first], first
        if several.any():
            parents = made + np.arange(np.count_nonzero(several))
            made += len(parents)
            children = np.repeat(several, count)
            levels.append((parents, count[several], number[children]))
            masks.append(np.bitwise_or.reduceat(np.uint8(1) << octant, first)[several])
            merged, reach = _merged(own_sums[children], own_radii[children], count[several])
            sums.append(merged)
            radii.append(reach)
            number, own_sums, own_radii = number[kept], own_sums[kept], own_radii[kept]
            number[several], own_sums[several], own_radii[several] = parents, merged, reach
    leaf = np.empty(len(order), np.int64)
    leaf[order] = np.cumsum(new) - 1
    return _placed(surfels, np.concatenate(sums), np.concatenate(radii), np.concatenate(masks), levels, leaf)


def _columns(surfels: Surfels, order: np.ndarray) -> np.ndarray:
    """(N, 14) float64: area, and times it position, normal, whether they are scattered, and products of normals."""
    normal = surfels.normal[order].astype(np.float64)
    columns = np.column_stack(
        [
            np.ones(len(order)), surfels.position[order], normal, surfels.scattered[order],
            *(normal[:, a] * normal[:, b] for a, b in PAIRS),
        ]
    )  # fmt: skip
    return columns * surfels.area[order].astype(np.float64)[:, None]


def _leaf_radius(surfels: Surfels, order: np.ndarray, sums: np.ndarray, begin: np.ndarray) -> np.ndarray:
    """(L,) float64: of balls around the leaves' middles that hold the disks of their surfels."""
    own = owners(np.diff(np.append(begin, len(order))))
    away = surfels.position[order] - (sums[:, POSITION] / sums[:, :1])[own]
    reach = np.sqrt((away**2).sum(axis=1)) + np.sqrt(surfels.area[order] / np.pi)
    return np.maximum.reduceat(reach, begin)


def _merged(sums: np.ndarray, radii: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sums (n, 14) and radii (n,) of nodes with so many (n,) of the children."""
    first = starts(count)
    merged = np.add.reduceat(sums, first)
    middle = np.repeat(merged[:, POSITION] / merged[:, :1], count, axis=0)
    apart = np.sqrt(((sums[:, POSITION] / sums[:, :1] - middle) ** 2).sum(axis=1)) + radii
    return merged, np.maximum.reduceat(apart, first)


def _placed(
    surfels: Surfels,
    sums: np.ndarray,
    radii: np.ndarray,
    masks: np.ndarray,
    levels: list[tuple[np.ndarray, np.ndarray, np.ndarray]],
    leaf: np.ndarray,
) -> LightTree:
    """The tree of nodes that are numbered as they were made, in its order: children side by side."""
    number = np.concatenate([children for *_, children in levels] + [np.array([len(sums) - 1])])
    place = np.empty(len(sums), np.int64)
    place[number] = np.arange(len(sums))
    first, begin = np.full(len(sums), -1, np.int32), 0
    for parents, count, _ in levels:
        first[place[parents]] = begin + starts(count)
        begin += int(count.sum())
    means = sums[number] / sums[number, :1]
    axis, along = _axes(means[:, PRODUCTS])
    axis[(axis * means[:, NORMAL]).sum(axis=1) < 0] *= -1
    f, leaf = np.float32, place[leaf]
    edge = np.zeros((len(sums), 3), f)
    half = np.zeros(len(sums), bool)
    edge[leaf], half[leaf] = surfels.edge, surfels.half
    edge[np.bincount(leaf, minlength=len(sums)) > 1] = 0
    return LightTree(
        position=means[:, POSITION].astype(f),
        radius=radii[number].astype(f),
        facing=means[:, NORMAL].astype(f),
        area=sums[number, AREA].astype(f),
        axis=axis.astype(f),
        along=along.astype(f),
        scattered=means[:, SCATTERED].astype(f),
        first=first,
        octants=masks[number],
        edge=edge,
        half=half,
        leaf=leaf.astype(np.int32),
        levels=tuple((place[parents], count, place[children]) for parents, count, children in levels),
    )


def _axes(products: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Axes (M, 3) along which most normals lie, and how far they all do, (M,), from means of their products (M, 6)."""
    matrix = np.empty((len(products), 3, 3))
    for column, (a, b) in zip(products.T, PAIRS, strict=True):
        matrix[:, a, b] = matrix[:, b, a] = column
    power = matrix
    for _ in range(SQUARINGS):
        power = power @ power
        power /= np.maximum(np.trace(power, axis1=1, axis2=2), 1e-300)[:, None, None]
    largest = np.diagonal(power, axis1=1, axis2=2).argmax(axis=1)
    axis = power[np.arange(len(power)), largest]
    length = np.sqrt((axis**2).sum(axis=1, keepdims=True))
    axis = np.where(length > 0, axis / np.maximum(length, 1e-300), (0.0, 0.0, 1.0))
    value = np.einsum("ni,nij,nj->n", axis, matrix, axis)
    # Of normals that are turned evenly it is a third of the trace.
    return axis, np.clip(1.5 * value - 0.5, 0.0, 1.0)
