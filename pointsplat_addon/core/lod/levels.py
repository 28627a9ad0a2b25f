"""TODO: say what this module is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..numeric.segments import ranges, starts
from ..scene.cloud import PointCloud
from ..splat.ellipsoids import splat_frames, splat_weight
from .hierarchy import Hierarchy
from .node_splats import points_and_nodes
from .nodes.tree import sum_over_nodes

LEVELS_PER_OCTAVE = 4  # levels to each octave of size: a fifth more splats than the tolerance asks for, in the mean
MIN_LEVEL_SPLATS = 8  # splats of the coarsest level: one flat splat alone is no body, seen from its side it vanishes
WHOLE_CLOUD = 3  # times the splats of a cut: drawing so many costs less than finding the cut
MAX_LEVEL_SPLATS = (
    1 << 18
)  # splats of the finest level: instances that need more are wide on the screen, and so are few
SMALL_BODY = 16  # levels on which nodes are as large as that part of the body close no surface in the picture
FACETS = 4  # sides of a node, the largest, of which it shows one that faces the viewer
MEASURED_SPLATS = 256  # splats: of levels of at most so many the area is measured
OUTLINE_CELLS = 64  # of the grid that measures the area of what they stand for
RAYS = 20  # along each side of the grid that measures theirs
VIEW_COUNT = 6  # from which it is measured
ROUNDS = 6  # of measuring it
MAX_GROWTH = 1.25  # times its size a splat is drawn at most
# Axes about which sides of a surface are told apart: nearly those of the body, as walls are, and not where walls at 45
# degrees between them would fall apart.
SIDE_AXES = np.linalg.qr(np.array([[1, 0.13, 0.09], [-0.13, 1, 0.17], [-0.09, -0.17, 1]]))[0].astype(np.float32)


@dataclass(frozen=True, eq=False)
class Levels:
    """Cuts of one hierarchy for K sizes of nodes, coarsest first."""

    cloud: PointCloud  # splats of all levels, one level after the other
    drawn: PointCloud  # the same, true to size
    first: np.ndarray  # (K,) int64: where each begins
    count: np.ndarray  # (K,) int64
    nodes: np.ndarray  # (K,) int64: how many of these splats stand for several points
    size: np.ndarray  # (K,) float64, object units: no descendant disk lies farther from its node's centre
    center: np.ndarray  # (3,) float64, object space: a ball about it holds everything
    reach: float  # of that ball
    cut_short: bool  # finer ones would still leave out many points

    @property
    def nbytes(self) -> int:
        given = self.cloud.arrays()
        return self.cloud.nbytes + sum(
            array.nbytes for name, array in self.drawn.arrays().items() if array is not given.get(name)
        )


def make_levels(hierarchy: Hierarchy) -> Levels | None:
    """Levels of at least COARSEST splats, and at most MOST or half as many as there are points; None: there is none."""
    tree, size = hierarchy.tree, hierarchy.size.astype(np.float64)
    # A node is drawn at sizes from its own up to the least one among its ancestors.
    above = np.full(len(tree), np.inf)
    for begin, end in zip(tree.levels[:-1], tree.levels[1:], strict=True):
        count = tree.child_count[begin:end]
        above[ranges(tree.first_child[begin:end].astype(np.int64), count)] = np.repeat(
            np.minimum(size[begin:end], above[begin:end]), count
        )
    # What stands for a single point is drawn as that point.
    single = tree.point_count == 1
    own = np.where(single, -np.inf, size)
    leaf = tree.child_count == 0
    found: list[tuple[float, np.ndarray, int]] = []
    limit, most = float(size[0]) if len(size) else 0.0, min(MAX_LEVEL_SPLATS, len(hierarchy.cloud) // 2)
    while limit > 0.0:
        node = np.flatnonzero((own <= limit) & (above > limit) & ~single)
        bare = np.flatnonzero(leaf & (above > limit) & ((own > limit) | single))
        points = np.sort(ranges(tree.first_point[bare].astype(np.int64), tree.point_count[bare]))
        total = len(node) + len(points)
        if total > most or len(node) == 0:
            break
        if total >= MIN_LEVEL_SPLATS:
            found.append((limit, np.concatenate([points, len(hierarchy.cloud) + node]), len(node)))
        limit *= 2 ** (-1 / LEVELS_PER_OCTAVE)
    if not found:
        return None
    limits, rows, nodes = zip(*found, strict=True)
    count = np.array([len(r) for r in rows])
    cloud = drawn = points_and_nodes(hierarchy).take(np.concatenate(rows))
    if cloud.normal is not None and cloud.radii is not None and cloud.opacity is None and cloud.extinction is None:
        # Small bodies are what stands apart: surfaces that are closed in the picture would join neighbours.
        small = np.repeat(hierarchy.sphere[0] < SMALL_BODY * np.array(limits), count)
        cloud = replace(cloud, disconnected=small if cloud.disconnected is None else small | cloud.disconnected)
        drawn = cloud
        if hierarchy.cloud.disconnected is None:
            radii, facets = _radii_true_to_area(hierarchy.cloud, cloud, count), _facets(hierarchy, np.concatenate(rows))
            drawn = replace(cloud, radii=radii, facets=facets)
    center = hierarchy.cloud.origin + hierarchy.center[0]
    reach, short = float(hierarchy.sphere[0]), len(hierarchy.cloud) > WHOLE_CLOUD * MAX_LEVEL_SPLATS
    return Levels(cloud, drawn, starts(count), count, np.array(nodes), np.array(limits), center, reach, short)


def _view_planes() -> list[np.ndarray]:
    """Unit vectors (2, 3) of planes to look at a body in, whose normals lie evenly on half a sphere."""
    k = np.arange(VIEW_COUNT)
    z, turn = (k + 0.5) / VIEW_COUNT, k * np.pi * (3 - np.sqrt(5))
    across = np.stack([-np.sin(turn), np.cos(turn), 0 * z], axis=1)
    normal = np.stack([np.cos(turn) * np.sqrt(1 - z * z), np.sin(turn) * np.sqrt(1 - z * z), z], axis=1)
    return list(np.stack([across, np.cross(normal, across)], axis=1))


def _radii_true_to_area(points: PointCloud, cloud: PointCloud, count: np.ndarray) -> np.ndarray:
    """Half-axes of the levels' splats (N, 2 or 3), by which coarse levels cover as much of the picture as the points
    that they stand for, in the mean over views: flat splats for what bends leave gaps at the outline. None shrinks."""
    assert cloud.radii is not None
    planes = _view_planes()
    covered = sum(_silhouette_area(points, plane) for plane in planes)
    factor, last = np.ones(len(count)), np.cumsum(count)
    coarse = np.flatnonzero(count <= MEASURED_SPLATS)
    for level in coarse:
        normal, axis, radii = splat_frames(cloud, slice(last[level] - count[level], last[level]))
        at = cloud.position[last[level] - count[level] : last[level]].T.astype(np.float64)
        ends = np.stack([axis * radii[0], np.cross(normal, axis, axis=0) * radii[1]])
        for _ in range(ROUNDS):
            found = sum(_ellipses_area(at, factor[level] * ends, plane) for plane in planes)
            factor[level] = np.clip(factor[level] * np.sqrt(covered / max(found, 1e-300)), 1.0, MAX_GROWTH)
    finer = count > MEASURED_SPLATS
    factor[finer] = 1 + (factor[coarse[-1]] - 1) * MEASURED_SPLATS / count[finer] if len(coarse) else 1.0
    return cloud.radii * np.repeat(factor, count)[:, None].astype(np.float32)


def _silhouette_area(cloud: PointCloud, plane: np.ndarray) -> float:
    """The area of the shadow of dense points on a plane of two unit vectors (2, 3): that of the cells of a grid that
    hold some, of which those at the outline count half. Cells are as wide as most splats."""
    assert cloud.radii is not None
    x, y = (cloud.position @ a.astype(np.float32) for a in plane)
    wide = 2 * float(np.quantile(cloud.radii[:: max(1, len(cloud) // 4096), 0], 0.9))
    cell = max(max(float(np.ptp(x)), float(np.ptp(y))) / OUTLINE_CELLS * (1 + 1e-5), wide, 1e-30)
    grid = np.zeros((OUTLINE_CELLS + 3, OUTLINE_CELLS + 3), bool)
    # Edges along the grid's lines, as buildings have them, cut cells in half.
    grid[((x - x.min()) / cell + 0.5).astype(int) + 1, ((y - y.min()) / cell + 0.5).astype(int) + 1] = True
    rows = grid[:-2] & grid[1:-1] & grid[2:]
    inner = rows[:, :-2] & rows[:, 1:-1] & rows[:, 2:]
    return cell**2 * (int(grid.sum()) + int(inner.sum())) / 2


def _ellipses_area(at: np.ndarray, ends: np.ndarray, plane: np.ndarray) -> float:
    """The area that ellipses about `at` (3, n), whose half-axes are `ends` (2, 3, n), cover of that plane together."""
    middle, (a, b) = plane @ at, plane @ ends
    reach = np.hypot(a, b)
    low, high = (middle - reach).min(axis=1), (middle + reach).max(axis=1)
    step = (high - low) / RAYS
    x, y = (low + step * (np.arange(RAYS)[:, None] + 0.5)).T[:, None] - middle[:, :, None]  # (n, RAYS) each
    # Coordinates along the half-axes, in units of these, are linear in x and y.
    det = a[0] * b[1] - a[1] * b[0]
    inverse = (1 / np.where(np.abs(det) < 1e-30, 1e-30, det))[:, None]
    p = ((inverse * b[1][:, None] * x)[:, :, None] - (inverse * b[0][:, None] * y)[:, None]).astype(np.float32)
    q = ((inverse * a[0][:, None] * y)[:, None] - (inverse * a[1][:, None] * x)[:, :, None]).astype(np.float32)
    with np.errstate(over="ignore"):
        inside = p * p + q * q <= 1
    return float(np.prod(step)) * np.count_nonzero(inside.any(axis=0))


def _facets(hierarchy: Hierarchy, rows: np.ndarray) -> np.ndarray | None:
    """PointCloud.facets (R, FACETS, 3) for rows of `splats`: of the sides that most of a node is turned to, the share
    that the points of a side have in its area, times their mean normal. None: all nodes have one side."""
    cloud, tree = hierarchy.cloud, hierarchy.tree
    normal = cloud.normal if cloud.shading_normal is None else cloud.shading_normal
    assert normal is not None
    # To which of six sides each is turned.
    turned = normal @ SIDE_AXES
    face = np.abs(turned).argmax(axis=1)
    side = 2 * face + (turned[np.arange(len(face)), face] < 0)

    def columns(which: slice) -> np.ndarray:
        weighted = splat_weight(cloud, which) * normal[which].T
        return np.concatenate([np.where(side[which] == k, weighted, 0.0) for k in range(6)])

    sums = sum_over_nodes(tree, len(cloud), columns)
    of = rows >= len(cloud)
    vector = sums[:, rows[of] - len(cloud)].T.reshape(-1, 6, 3)
    weight = np.sqrt((vector * vector).sum(axis=2))
    order = np.argsort(-weight, axis=1)[:, :FACETS, None]
    facets = np.zeros((len(rows), FACETS, 3), np.int8)
    share = np.take_along_axis(vector, order, axis=1) / np.maximum(weight.sum(axis=1), 1e-300)[:, None, None]
    facets[of] = np.rint(127 * share)
    return facets if facets[:, 1:].any() else None
