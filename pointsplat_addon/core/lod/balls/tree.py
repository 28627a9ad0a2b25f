"""Nodes over an opaque cloud of balls: cells of an octree, level by level, as ellipsoids of which a part is covered.

Balls lie in Morton order, so that the balls of a cell, and its descendants at any level, are one range: a level is a
list of where its cells begin, and whole levels are cuts that many instances share. A node keeps the moments of its
balls and the sum of their areas; what a ray meets of it follows from both when it is drawn
(shaders/lib/splat/covered.glsl).
"""

from __future__ import annotations

import numpy as np

from ...numeric.morton import DEPTH, morton_codes, sorted_by_code
from ...numeric.record import record
from ...numeric.segments import batches, offsets
from ...numeric.vectors import each_block
from ...scene.cloud import PointCloud

BALLS = 4  # in the cells of the finest level, in the mean, at least: cells of fewer save nothing
# Squared half-axes of a node's ellipsoid over the variances of its balls' centres; their own mean square is added.
# With 6, the circle around a square that is evenly filled: nodes of a closed surface leave no holes.
SPREAD = 6.0
BATCH = 1 << 16  # balls that are merged together, so that their working arrays stay in the cache
# Of `saturation`, which was fitted to balls at random, jittered and regular places on planes, from two directions:
RUNS, RUN = 4096, 64  # points that are looked at, and neighbours in Morton order to either side of each
DIGAMMA_1_TO_4, DIGAMMA_4_TO_16 = 1.8333, 1.4849  # differences of the digamma function
MOST_SATURATION, SATURATION_STEP = 1.25, 2.6
RANDOM_EXCESS = 0.06  # what random points exceed the expected distance by, as not all neighbours are among the run
FEW_SATURATION = 2.0  # of nodes of n random balls, times n: moments of few balls are smaller than the cells they lie in
ONE_SATURATION = 1e4  # of a single ball, which is covered
AVERAGED = ("color", "surface", "emission", "velocity")  # attributes of nodes that are means, weighted by area


@record
class BallTree:
    """The balls of a cloud and the nodes above them. Lengths are object units, positions relative to cloud.origin.

    Node `start[l] + i` is cell i of level l, which holds the balls first[l][i] to first[l][i + 1].
    """

    cloud: PointCloud  # N balls in Morton order
    first: tuple[np.ndarray, ...]  # of L levels, coarsest first: (cells + 1,) int32, rising; the last is N
    start: np.ndarray  # (L + 1,) int64: the first node of each level
    edge: np.ndarray  # (L,) float64: length of the cells' edges
    nodes: PointCloud  # M nodes: means of position and attributes, weighted by area; no radii
    shape: np.ndarray  # (M, 8) float32: squared half-axes xx, xy, xz, yy, yz, zz; total area; saturation
    radius: float  # of the largest ball

    def __len__(self) -> int:
        return len(self.nodes)

    @property
    def nbytes(self) -> int:
        return self.cloud.nbytes + self.nodes.nbytes + self.shape.nbytes + sum(f.nbytes for f in self.first)


def build_ball_tree(cloud: PointCloud) -> BallTree:
    """Builds the nodes of a cloud of N > 0 balls with radii, all finite.

    The finest level has at least BALLS balls in a cell, in the mean. The node of a single ball is that ball.
    """
    code, side = morton_codes(cloud.position)
    order, code = sorted_by_code(code)
    cloud = cloud.take(order)
    count = len(cloud)
    # Two codes that follow one another lie in different cells of level l where they differ by 8^(DEPTH - l) or more.
    step = np.empty(count, np.uint64)
    step[0] = np.iinfo(np.uint64).max
    np.bitwise_xor(code[1:], code[:-1], out=step[1:])
    del code
    depth, too_deep = 0, DEPTH + 1
    while too_deep - depth > 1:
        middle = (depth + too_deep) // 2
        few = BALLS * np.count_nonzero(step >= _threshold(middle)) <= count
        depth, too_deep = (middle, too_deep) if few else (depth, middle)
    at = np.flatnonzero(step >= _threshold(depth))
    step = step[at]
    first, fastest = [_ends(at, count)], saturation(cloud.position)
    rows = _merge_balls(cloud, first[0])
    columns = [_node_columns(rows, fastest)]
    for level in range(depth - 1, -1, -1):
        begin = np.flatnonzero(step >= _threshold(level))
        step = step[begin]
        first.append(_ends(first[-1][begin], count))
        rows = merged_rows(rows, _ends(begin, rows.shape[1]))
        columns.append(_node_columns(rows, fastest))
    first.reverse()
    position, shape, averages = (np.concatenate(levels) for levels in zip(*reversed(columns), strict=True))
    assert cloud.radii is not None
    return BallTree(
        cloud,
        tuple(first),
        offsets([len(f) - 1 for f in first]),
        side / 2.0 ** np.arange(depth + 1),
        _node_cloud(cloud, first, position, averages),
        shape,
        float(cloud.radii[:, 0].max()),
    )


def saturation(position: np.ndarray, looked_at: int = RUNS) -> float:
    """How much faster nodes over points (N, 3) in Morton order become opaque than nodes over random ones would, by so
    many of them.

    A node that its balls cover t times, in the sum of their areas, is covered by 1 - exp(-t (1 + s t)). Balls that keep
    away from each other overlap less than random ones. Distances to the k-th neighbour, among a run of points, tell how
    far they do: of random points in D dimensions, the logarithm of that distance is (digamma(k) + constant) / D in the
    mean, so that the fourth and the sixteenth neighbour tell where the first one is expected.
    """
    if len(position) <= 2 * RUN:
        return MOST_SATURATION
    middle = np.linspace(RUN, len(position) - RUN - 1, looked_at).astype(np.int64)
    around = middle[:, None] + np.r_[-RUN:0, 1 : RUN + 1]
    away = position[around].astype(np.float64) - position[middle][:, None]
    square = np.sort((away * away).sum(axis=2), axis=1)[:, [0, 3, 15]]
    first, fourth, sixteenth = 0.5 * np.log(np.maximum(square, 1e-300)).mean(axis=0)
    inverse_dimension = max((sixteenth - fourth) / DIGAMMA_4_TO_16, 0.2)
    excess = (first - fourth) / inverse_dimension + DIGAMMA_1_TO_4 - RANDOM_EXCESS
    return float(np.clip(SATURATION_STEP * excess, 0.0, MOST_SATURATION))


def _threshold(level: int) -> np.uint64:
    return np.uint64(1 << 3 * (DEPTH - level))


def _ends(begin: np.ndarray, count: int) -> np.ndarray:
    """(n + 1,) int32: where segments begin, and where the last one ends."""
    return np.append(begin, count).astype(np.int32)


def _merge_balls(cloud: PointCloud, first: np.ndarray) -> np.ndarray:
    """The rows (11 + A, n) float64 of the cells that begin at balls `first` (n + 1,): see `merged_rows`."""
    assert cloud.radii is not None
    averaged = [array for name in AVERAGED if (array := getattr(cloud, name)) is not None]
    out = np.empty((11 + sum(array.shape[1] for array in averaged), len(first) - 1))
    parts = list(batches(np.diff(first), BATCH))

    def merge(which: slice) -> None:
        for a, b in parts[which]:
            balls = slice(first[a], first[b])
            rows = np.empty((len(out), balls.stop - balls.start))
            rows[0] = cloud.radii[balls, 0]  # type: ignore[index]
            np.maximum(rows[0], 1e-30, out=rows[0])
            rows[0] *= rows[0]
            rows[1:4] = cloud.position[balls].T
            rows[10] = rows[0]
            at = 11
            for array in averaged:
                rows[at : at + array.shape[1]] = array[balls].T
                at += array.shape[1]
            out[:, a:b] = merged_rows(rows, first[a : b + 1] - first[a], points=True)

    each_block(len(parts), merge, 1)
    return out


def merged_rows(rows: np.ndarray, ends: np.ndarray, points: bool = False) -> np.ndarray:
    """Merges the columns of `rows` (11 + A, n) between the `ends` (m + 1,) into one each, (11 + A, m) float64.

    Rows: weight (squared radius); mean position (3); covariance (6) about it; weighted means of the squared radius and
    of A attributes. `points`: covariances are zeros, and not looked at.
    """
    begin, count = ends[:-1], np.diff(ends)
    weight = np.add.reduceat(rows[0], begin)
    share = rows[0] / np.repeat(weight, count)
    out = np.empty((len(rows), len(begin)))
    out[0] = weight
    away, product = [], np.empty_like(share)
    for axis in (1, 2, 3):
        np.multiply(share, rows[axis], out=product)
        out[axis] = np.add.reduceat(product, begin)
        away.append(rows[axis] - np.repeat(out[axis], count))
    pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    for at, (i, j) in enumerate(pairs, 4):
        np.multiply(away[i], away[j], out=product)
        if not points:
            product += rows[at]
        product *= share
        out[at] = np.add.reduceat(product, begin)
    for at in range(10, len(rows)):
        np.multiply(share, rows[at], out=product)
        out[at] = np.add.reduceat(product, begin)
    return out


def _node_columns(rows: np.ndarray, saturation: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions (n, 3), BallTree.shape (n, 8) and averages (n, A) of nodes, float32, from the rows of `merged_rows`."""
    shape = np.empty((rows.shape[1], 8), np.float32)
    for column in range(6):
        np.multiply(rows[4 + column], SPREAD, out=shape[:, column], casting="same_kind")
    shape[:, [0, 3, 5]] += rows[10, :, None]
    np.multiply(rows[0], np.pi, out=shape[:, 6], casting="same_kind")
    balls = rows[0] / rows[10]  # of one size that would have this area and this mean square
    np.maximum(saturation, FEW_SATURATION / balls, out=shape[:, 7], casting="same_kind")
    shape[balls < 1.01, 7] = ONE_SATURATION
    return rows[1:4].T.astype(np.float32), shape, rows[11:].T.astype(np.float32)


def _node_cloud(cloud: PointCloud, first: list[np.ndarray], position: np.ndarray, averages: np.ndarray) -> PointCloud:
    """The nodes, of all levels, with their attributes. Nodes have the material of the ball in their middle."""
    arrays: dict[str, np.ndarray] = {}
    at = 0
    for name in AVERAGED:
        if (array := getattr(cloud, name)) is not None:
            arrays[name] = np.ascontiguousarray(averages[:, at : at + array.shape[1]])
            at += array.shape[1]
    if cloud.material is not None:
        middle = np.concatenate([(f[:-1].astype(np.int64) + f[1:]) // 2 for f in first])
        arrays["material"] = cloud.material[middle]
    return PointCloud(position, origin=cloud.origin, **arrays)
