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
from ..numeric.segments import owners, segment_sums, starts
from ..numeric.vectors import dot, each_block, rows_at_once, take_columns
from ..surface.neighbourhoods.planes import eigenvalues
from .surfels import Surfels

EVEN = 12.0  # over the variance: the squared width of an even patch
KNUD_THOMSEN = 1.6075  # exponent
SQUARINGS = 3  # of the matrix whose largest eigenvector is looked for
ROUGH = 0.95  # of the area of rough nodes only stands for fine triangles: nodes at corners of walls hold some
LEAST_SHOWN = 1e-3  # cosine: where a side has nothing else, what is seen of it from aslant counts
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
    # (M,) float32: 1 where all normals lie along the axis, 0 where they are turned evenly; of hairs alone, which have
    # no normals, both are of the ways they run
    along: np.ndarray
    thickness: np.ndarray  # (M,) float32: how far along the axis, either way, all its surfels' disks lie at most
    scattered: np.ndarray  # (M,) float32: share of the area that belongs to leaves and hairs
    # (M,) bool: all its surfels are turned to every side, as balls and hairs; None: of no node
    round: np.ndarray | None
    # (M,) bool: most of the area belongs to leaves and hairs that are closed; None: of no node
    solid: np.ndarray | None
    captured: np.ndarray | None  # (M,) bool: most of the area belongs to captured splats; None: of no node
    # (M,) bool: most of the area emits light; None: of no node, or there are captured splats
    shining: np.ndarray | None
    # (M,) bool: nearly all of the area only stands for fine triangles near it; None: of no node
    rough: np.ndarray | None
    first: np.ndarray  # (M,) int32: first child; -1: a leaf
    level: np.ndarray  # (M,) int32: how many times the cube is halved to the cell whose octants its children are in
    cube: np.ndarray  # (4,) float32: low corner and side of the cube that holds the surfels' places
    octants: np.ndarray  # (M,) uint8: which of the eight children there are, bit by bit
    edge: np.ndarray  # (M, 3) float32: of leaves that are rectangles or triangles, as Surfels.edge; else (0, 0, 0)
    half: np.ndarray  # (M,) bool: of leaves, as Surfels.half
    leaf: np.ndarray  # (N,) int32: the node of each surfel
    turned: np.ndarray  # (M,) bool: whether its axis points away from the side that its parent's points to
    shown: np.ndarray  # (M,) float32: cosine between its axis and its parent's; by it its sides count in those
    # Levels of inner nodes, deepest first: the nodes (n,), how many children each has (n,), and all of these.
    levels: tuple[tuple[np.ndarray, np.ndarray, slice], ...]

    def __len__(self) -> int:
        return len(self.area)

    def radiance(self, surfels: Surfels, outside: np.ndarray, inside: np.ndarray) -> np.ndarray:
        """Returns the radiance of all nodes from that of surfels' two sides, (N, 3) each: (3, M, 3) float32.

        What one sees from where the node's axis points, from the other side, and of surfaces from behind.
        """
        area = surfels.area
        round_ones = ~surfels.normal.any(axis=1)
        behind = np.where(round_ones | surfels.scattered, area, 0)
        of_behind = np.where(round_ones[:, None], outside, inside)
        # Rows: of three sides, red, green, blue and area.
        total, of_sides = np.zeros((12, len(self)), np.float32), ((outside, area), (of_behind, behind), (inside, area))
        several = np.flatnonzero(np.bincount(self.leaf)[self.leaf] > 1)  # surfels that share a leaf
        shared, which = np.unique(self.leaf[several], return_inverse=True)

        def add(rows: slice) -> None:
            for row in range(rows.start, rows.stop):
                light, weight = of_sides[row // 4]
                values = weight if row % 4 == 3 else light[:, row % 4] * weight
                total[row, self.leaf] = values
                total[row, shared] = np.bincount(which, values[several], len(shared))

        each_block(len(total), add, rows_at_once(len(area)))
        area = total[3] + total[7]  # of both sides
        for nodes, count, children in self.levels:
            of_children = total[:, children].copy()
            turned = self.turned[children]
            of_children[:8, turned] = np.roll(of_children[:8, turned], 4, axis=0)
            of_children[:8] *= self.shown[children]
            first = starts(count)
            found = segment_sums(of_children, first)
            # Its sides count in its parent's by all of their area, or what is turned to all sides would hardly.
            area[nodes] = whole = np.add.reduceat(area[children], first)
            found[:8] *= whole / np.maximum(found[3] + found[7], np.float32(1e-37))
            total[:, nodes] = found
        sums = total.reshape(3, 4, len(self))
        # A side that nothing is turned to looks like the other.
        nothing = sums[:, 3] == 0
        for side, other in ((1, 0), (0, 1), (2, 0)):
            np.copyto(sums[side], sums[other], where=nothing[side])
        return (sums[:, :3] / np.maximum(sums[:, 3:], np.float32(1e-37))).transpose(0, 2, 1)


def build_tree(surfels: Surfels) -> LightTree:
    """Builds the tree over N > 0 surfels."""
    code, side = morton_codes(surfels.position)
    cube = np.append(surfels.position.min(axis=0), side).astype(np.float32)
    order, code = sorted_by_code(code)
    # Surfels in one finest cell share a leaf.
    new = np.append(True, code[1:] != code[:-1])
    begin = np.flatnonzero(new)
    made = len(begin)
    sums = np.empty((14, 2 * made - 1))  # of as many nodes as there are at most
    sums[:, :made] = segment_sums(_columns(surfels, order), begin)
    radii = np.empty(2 * made - 1)
    radii[:made] = _leaf_radius(surfels, order, sums[:, :made], begin)
    masks = [np.zeros(len(begin), np.uint8)]
    halved = [np.full(len(begin), DEPTH)]
    levels: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    code, number = code[begin], np.arange(made)
    for level in range(DEPTH - 1, -1, -1):
        if len(number) == 1:
            break
        octant, code = (code & np.uint64(7)).astype(np.uint8), code >> np.uint64(3)
        first = np.flatnonzero(np.append(True, code[1:] != code[:-1]))
        count = np.diff(np.append(first, len(code)))
        several = count > 1
        code, kept = code[first], first
        if several.any():
            parents = made + np.arange(np.count_nonzero(several))
            halved.append(np.full(len(parents), level))
            children = number[np.repeat(several, count)]
            levels.append((parents, count[several], children))
            masks.append(np.bitwise_or.reduceat(np.uint8(1) << octant, first)[several])
            merged, reach = _merged(take_columns(sums, children), radii[children], count[several])
            sums[:, made : made + len(parents)], radii[made : made + len(parents)] = merged, reach
            made += len(parents)
            number = number[kept]
            number[several] = parents
    leaf = np.empty(len(order), np.int64)
    leaf[order] = np.cumsum(new) - 1
    masks, halved = np.concatenate(masks), np.concatenate(halved)
    return _placed(surfels, sums, radii[:made], masks, halved, cube, levels, leaf)


def _columns(surfels: Surfels, order: np.ndarray) -> np.ndarray:
    """(14, N) float64: area, and times it position, normal, whether they are scattered, and products of normals."""
    area, normal = surfels.area[order].astype(np.float64), surfels.normal[order].T.astype(np.float64)
    found = np.empty((14, len(order)))
    found[AREA] = 1
    found[POSITION], found[NORMAL], found[SCATTERED] = surfels.position[order].T, normal, surfels.scattered[order]
    for row, (a, b) in enumerate(PAIRS, PRODUCTS.start):
        found[row] = normal[a] * normal[b]
    hairs = np.flatnonzero(surfels.hairs[order])
    if len(hairs):
        # Normals of tubes lie evenly around them.
        run = surfels.edge[order[hairs]].T.astype(np.float64)
        run /= np.maximum(np.sqrt(dot(run, run)), 1e-300)
        for row, (a, b) in enumerate(PAIRS, PRODUCTS.start):
            found[row, hairs] = 0.5 * ((a == b) - run[a] * run[b])
    found *= area
    return found


def _leaf_radius(surfels: Surfels, order: np.ndarray, sums: np.ndarray, begin: np.ndarray) -> np.ndarray:
    """(L,) float64: of balls around the leaves' middles that hold the disks of their surfels."""
    own = owners(np.diff(np.append(begin, len(order))))
    away = surfels.position[order].T - (sums[POSITION] / sums[AREA])[:, own]
    reach = np.sqrt(dot(away, away)) + np.sqrt(surfels.area[order] / np.pi)
    return np.maximum.reduceat(reach, begin)


def _merged(sums: np.ndarray, radii: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sums (14, n) and radii (n,) of nodes with so many (n,) of the children."""
    first = starts(count)
    merged = segment_sums(sums, first)
    away = sums[POSITION] / sums[AREA] - np.repeat(merged[POSITION] / merged[AREA], count, axis=1)
    apart = np.sqrt(dot(away, away)) + radii
    return merged, np.maximum.reduceat(apart, first)


def _placed(
    surfels: Surfels,
    sums: np.ndarray,
    radii: np.ndarray,
    masks: np.ndarray,
    halved: np.ndarray,
    cube: np.ndarray,
    levels: list[tuple[np.ndarray, np.ndarray, np.ndarray]],
    leaf: np.ndarray,
) -> LightTree:
    """The tree of nodes that are numbered as they were made, in its order: children side by side."""
    size = len(radii)
    number = np.concatenate([children for *_, children in levels] + [np.array([size - 1])])
    place = np.empty(size, np.int64)
    place[number] = np.arange(size)
    first, placed, end = np.full(size, -1, np.int32), [], 0
    for parents, count, children in levels:
        begin, end = end, end + len(children)
        first[place[parents]] = begin + starts(count)
        placed.append((place[parents], count, slice(begin, end)))
    means = take_columns(sums, number)
    area = means[AREA].copy()
    means /= area
    f, leaf = np.float32, place[leaf]
    held = np.bincount(leaf, minlength=size)
    # Of a single surfel the axis is its normal.
    axis = means[NORMAL].copy()
    length = np.sqrt(dot(axis, axis))
    along = np.where(length > 0, 1.0, 0.0)
    axis /= np.maximum(length, 1e-300)
    axis[2, length == 0] = 1
    several = np.flatnonzero(held != 1)

    def find_axes(block: slice) -> None:
        some = several[block]
        axis[:, some], along[some] = _axes(means[PRODUCTS].take(some, axis=1))

    each_block(len(several), find_axes)
    flat = surfels.normal.any(axis=1)
    round_ones = None if flat.all() else _held(flat, surfels, leaf, placed, size) == 0
    hairs = np.flatnonzero(round_ones & (means[SCATTERED] > 0.5)) if round_ones is not None else leaf[:0]
    if len(hairs):
        of = means[PRODUCTS].take(hairs, axis=1)
        axis[:, hairs], along[hairs] = _axes(np.concatenate([of[:3].sum(axis=0) - 2 * of[:3], -2 * of[3:]]))
    axis *= np.where(dot(axis, means[NORMAL]) < 0, -1, 1)
    turned, shown = np.zeros(size, bool), np.ones(size, f)
    for nodes, count, children in placed:
        cosine = dot(axis[:, children], np.repeat(axis[:, nodes], count, axis=1))
        turned[children] = cosine < 0
        shown[children] = np.maximum(np.abs(cosine), LEAST_SHOWN)
    if round_ones is not None:
        shown[round_ones] = 0.5  # what is turned to all sides, on average
    radii, position = radii[number], means[POSITION]
    of_flat = np.zeros(size, bool)
    of_flat[leaf] = flat
    thickness = np.where(of_flat & (held == 1), 0.0, radii)
    for nodes, count, children in placed:
        of_parent = np.repeat(axis[:, nodes], count, axis=1)
        away = np.abs(dot(position[:, children] - np.repeat(position[:, nodes], count, axis=1), of_parent))
        tilted = np.minimum(np.abs(dot(axis[:, children], of_parent)), 1.0)
        reach = thickness[children] * tilted + radii[children] * np.sqrt(1 - tilted * tilted)
        highest = np.maximum.reduceat(away + np.minimum(reach, radii[children]), starts(count))
        thickness[nodes] = np.minimum(highest, radii[nodes])
    captured = shining = solid = None
    if (bodies := surfels.scattered & surfels.closed).any():
        solid = _held(bodies, surfels, leaf, placed, size) > 0.5 * area
    if surfels.captured is not None:
        captured = _held(surfels.captured, surfels, leaf, placed, size) > 0.5 * area
        area = _areas_seen(surfels, leaf, placed, captured, area, position)
    elif (shines := surfels.emission.any(axis=1)).any():
        shining = _held(shines, surfels, leaf, placed, size) > 0.5 * area
    rough = None
    if surfels.fine is not None:
        # What shines has outlines that are seen.
        fine = surfels.fine & ~surfels.emission.any(axis=1)
        rough = _held(fine, surfels, leaf, placed, size) > ROUGH * area
    edge = np.zeros((size, 3), f)
    half = np.zeros(size, bool)
    edge[leaf], half[leaf] = surfels.edge, surfels.half
    edge[held > 1] = 0
    edge[hairs] = 0
    return LightTree(
        position=means[POSITION].T.astype(f),
        radius=radii.astype(f),
        facing=means[NORMAL].T.astype(f),
        area=area.astype(f),
        axis=axis.T.astype(f),
        along=along.astype(f),
        thickness=thickness.astype(f),
        scattered=means[SCATTERED].astype(f),
        round=round_ones,
        solid=solid,
        captured=captured,
        shining=shining,
        rough=rough,
        first=first,
        level=halved[number].astype(np.int32),
        cube=cube,
        octants=masks[number],
        edge=edge,
        half=half,
        leaf=leaf.astype(np.int32),
        turned=turned,
        shown=shown,
        levels=tuple(placed),
    )


def _held(
    which: np.ndarray,
    surfels: Surfels,
    leaf: np.ndarray,
    levels: list[tuple[np.ndarray, np.ndarray, slice]],
    size: int,
) -> np.ndarray:
    """(M,): the area in nodes that belongs to surfels of a kind, (N,) bool. `leaf`, `levels`: as of LightTree."""
    held = np.bincount(leaf, surfels.area * which, size)
    for nodes, count, children in levels:
        held[nodes] = np.add.reduceat(held[children], starts(count))
    return held


def _areas_seen(
    surfels: Surfels,
    leaf: np.ndarray,
    levels: list[tuple[np.ndarray, np.ndarray, slice]],
    captured: np.ndarray,
    area: np.ndarray,
    position: np.ndarray,
) -> np.ndarray:
    """(M,): the areas of nodes, those of captured splats, (M,) bool, at most as large as fills, in the mean over all
    directions, their own pictures: what lies behind other things within a node hides nothing more. An even patch with a
    node's second moments has its picture. position: (3, M)."""
    size = len(area)
    turned = surfels.normal.astype(np.float64)
    own = surfels.area.astype(np.float64)
    away = surfels.position.T - position[:, leaf]
    moments = np.empty((6, size))
    for row, (a, b) in enumerate(PAIRS):
        patch = own / EVEN * ((a == b) - turned[:, a] * turned[:, b])
        moments[row] = np.bincount(leaf, own * (away[a] * away[b] + patch), size)
    seen = area.copy()
    for nodes, count, children in levels:
        first = starts(count)
        off = position[:, children] - np.repeat(position[:, nodes], count, axis=1)
        for row, (a, b) in enumerate(PAIRS):
            moments[row, nodes] = np.add.reduceat(moments[row, children] + area[children] * off[a] * off[b], first)
        xx, yy, zz, xy, xz, yz = moments[:, nodes] / area[nodes]
        values = np.sqrt(np.maximum(eigenvalues(np.stack([xx, xy, xz, yy, yz, zz])), 0))
        faces = [values[k] * values[(k + 1) % 3] for k in range(3)]
        # Knud Thomsen's approximation to the surface of an ellipsoid, of which a quarter is its mean picture (Cauchy).
        mean = EVEN * (sum(face**KNUD_THOMSEN for face in faces) / 3) ** (1 / KNUD_THOMSEN)
        together = np.add.reduceat(seen[children], first)
        seen[nodes] = np.where(captured[nodes], np.minimum(together, 2 * mean), together)
    return seen


def _axes(products: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Axes (3, M) along which most normals lie, and how far they all do, (M,), from means of their products (6, M)."""
    power = products
    for _ in range(SQUARINGS):
        xx, yy, zz, xy, xz, yz = power
        power = np.stack([
            xx * xx + xy * xy + xz * xz, xy * xy + yy * yy + yz * yz, xz * xz + yz * yz + zz * zz,
            xy * (xx + yy) + xz * yz, xz * (xx + zz) + xy * yz, yz * (yy + zz) + xy * xz,
        ])  # fmt: skip
        power /= np.maximum(power[:3].sum(axis=0), 1e-300)
    xx, yy, zz, xy, xz, yz = power
    # The longest column.
    axis = np.where(xx >= np.maximum(yy, zz), (xx, xy, xz), np.where(yy >= zz, (xy, yy, yz), (xz, yz, zz)))
    length = np.sqrt(dot(axis, axis))
    axis = np.where(length > 0, axis / np.maximum(length, 1e-300), ((0.0,), (0.0,), (1.0,)))
    x, y, z = axis
    xx, yy, zz, xy, xz, yz = products
    value = x * x * xx + y * y * yy + z * z * zz + 2 * (x * y * xy + x * z * xz + y * z * yz)
    # Of normals that are turned evenly it is a third of the trace.
    return axis, np.clip(1.5 * value - 0.5, 0.0, 1.0)
