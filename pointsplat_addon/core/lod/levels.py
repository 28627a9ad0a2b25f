"""Fixed levels of detail of one hierarchy, shared by many instances (Coconu and Hege 2002, section 5.1).

Each level is a cut of the hierarchy at one size of nodes, copied so that it is one run of splats; sizes fall by a
quarter of an octave. Coarse levels are corrected for what the moments of nodes lose: the area of the silhouette, and
the directions of a surface that faces several ways.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..numeric.record import record
from ..numeric.segments import ranges, starts
from ..scene.cloud import PointCloud
from ..splat.ellipsoids import splat_frames, splat_weight
from .hierarchy import Hierarchy
from .node_splats import points_and_nodes
from .nodes.tree import sum_over_nodes

LEVELS_PER_OCTAVE = 4  # levels in an octave of size: on average a fifth more splats than the tolerance asks for
MIN_LEVEL_SPLATS = 8  # splats of the coarsest level: a single flat splat would vanish when seen from its side
WHOLE_CLOUD = 3  # times the splats of a cut: drawing that many costs less than finding the cut
MAX_LEVEL_SPLATS = 1 << 18  # splats of the finest level: instances that need more are wide on the screen, and so few
SMALL_BODY = 16  # levels whose nodes are larger than 1 / SMALL_BODY of the body close no surface on the screen
FACETS = 4  # largest sides of a node; it shows one that faces the viewer
MEASURED_SPLATS = 256  # the silhouette is measured on levels of at most so many splats
OUTLINE_CELLS = 64  # along each side of the grid that measures the silhouette of points
RAYS = 20  # along each side of the grid that measures the silhouette of splats
VIEW_COUNT = 6  # directions that silhouettes are measured from
ROUNDS = 6  # of fitting the splats' size to the silhouette
MAX_GROWTH = 1.25  # largest factor on the size of a splat
# Axes by which a surface's normals are sorted into six sides. They are nearly those of the body, as walls often are,
# but turned a little, so that walls at 45 degrees between them are not split at random.
SIDE_AXES = np.linalg.qr(np.array([[1, 0.13, 0.09], [-0.13, 1, 0.17], [-0.09, -0.17, 1]]))[0].astype(np.float32)


@record
class Levels:
    """Cuts of one hierarchy at K sizes of nodes, coarsest first."""

    cloud: PointCloud  # splats of all levels, one level after the other
    drawn: PointCloud  # these splats, enlarged to the area of the silhouette, and with facets
    first: np.ndarray  # (K,) int64: the first splat of each level
    count: np.ndarray  # (K,) int64: its splats
    nodes: np.ndarray  # (K,) int64: how many of these splats stand for several points
    size: np.ndarray  # (K,) float64, object units: no descendant disk lies farther from its node's centre
    center: np.ndarray  # (3,) float64, object space: the centre of a ball that holds everything
    radius: float  # of that ball, object units
    cut_short: bool  # whether still finer levels would leave out many points

    @property
    def nbytes(self) -> int:
        given = self.cloud.arrays()
        return self.cloud.nbytes + sum(
            array.nbytes for name, array in self.drawn.arrays().items() if array is not given.get(name)
        )


def make_levels(hierarchy: Hierarchy) -> Levels | None:
    """The levels of a hierarchy that have at least MIN_LEVEL_SPLATS splats; returns None if there is none.

    The finest has at most MAX_LEVEL_SPLATS splats, or half as many as there are points.
    """
    tree, size = hierarchy.tree, hierarchy.size.astype(np.float64)
    # A node is drawn at sizes from its own up to the least size among its ancestors.
    above = np.full(len(tree), np.inf)
    for begin, end in zip(tree.levels[:-1], tree.levels[1:], strict=True):
        count = tree.child_count[begin:end]
        above[ranges(tree.first_child[begin:end].astype(np.int64), count)] = np.repeat(
            np.minimum(size[begin:end], above[begin:end]), count
        )
    # A node with a single point is drawn as that point.
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
        # Small bodies are disconnected splats: closing their surface on the screen would join them with neighbours.
        small = np.repeat(hierarchy.sphere[0] < SMALL_BODY * np.array(limits), count)
        cloud = replace(cloud, disconnected=small if cloud.disconnected is None else small | cloud.disconnected)
        drawn = cloud
        if hierarchy.cloud.disconnected is None:
            radii, facets = _radii_true_to_area(hierarchy.cloud, cloud, count), _facets(hierarchy, np.concatenate(rows))
            drawn = replace(cloud, radii=radii, facets=facets)
    center = hierarchy.cloud.origin + hierarchy.center[0]
    radius, short = float(hierarchy.sphere[0]), len(hierarchy.cloud) > WHOLE_CLOUD * MAX_LEVEL_SPLATS
    return Levels(cloud, drawn, starts(count), count, np.array(nodes), np.array(limits), center, radius, short)


def _view_planes() -> list[np.ndarray]:
    """Image planes as pairs of unit vectors (2, 3); their normals are spread evenly over half a sphere."""
    k = np.arange(VIEW_COUNT)
    z, turn = (k + 0.5) / VIEW_COUNT, k * np.pi * (3 - np.sqrt(5))
    across = np.stack([-np.sin(turn), np.cos(turn), 0 * z], axis=1)
    normal = np.stack([np.cos(turn) * np.sqrt(1 - z * z), np.sin(turn) * np.sqrt(1 - z * z), z], axis=1)
    return list(np.stack([across, np.cross(normal, across)], axis=1))


def _radii_true_to_area(points: PointCloud, cloud: PointCloud, count: np.ndarray) -> np.ndarray:
    """Half-axes (N, 2 or 3) float32 of the levels' splats, enlarged so that each level has the silhouette of the
    points.

    `points` is the whole cloud, `cloud` the splats of all levels, `count` (K,) of each level. Flat splats leave gaps at
    the outline of a curved surface; areas are compared as means over VIEW_COUNT views. No splat shrinks.
    """
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
    """The area of the silhouette of dense points on a plane given by two unit vectors (2, 3).

    Counts the cells of a grid that hold points, those at the outline half. Cells are as wide as most splats.
    """
    assert cloud.radii is not None
    x, y = (cloud.position @ a.astype(np.float32) for a in plane)
    wide = 2 * float(np.quantile(cloud.radii[:: max(1, len(cloud) // 4096), 0], 0.9))
    cell = max(max(float(np.ptp(x)), float(np.ptp(y))) / OUTLINE_CELLS * (1 + 1e-5), wide, 1e-30)
    grid = np.zeros((OUTLINE_CELLS + 3, OUTLINE_CELLS + 3), bool)
    # Edges along the axes, as buildings have them, then cut cells in half.
    grid[((x - x.min()) / cell + 0.5).astype(int) + 1, ((y - y.min()) / cell + 0.5).astype(int) + 1] = True
    rows = grid[:-2] & grid[1:-1] & grid[2:]
    inner = rows[:, :-2] & rows[:, 1:-1] & rows[:, 2:]
    return cell**2 * (int(grid.sum()) + int(inner.sum())) / 2


def _ellipses_area(at: np.ndarray, ends: np.ndarray, plane: np.ndarray) -> float:
    """The area that ellipses about `at` (3, n), with the half-axes `ends` (2, 3, n), cover together on a plane (2,
    3)."""
    middle, (a, b) = plane @ at, plane @ ends
    extent = np.hypot(a, b)
    low, high = (middle - extent).min(axis=1), (middle + extent).max(axis=1)
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
    """PointCloud.facets (R, FACETS, 3) int8 of `rows` (R,) of `points_and_nodes`; None if every node has one side only.

    The points of a node are sorted by their normals into six sides. A facet is the mean normal of a side, as long as
    the side's share in the node's area, for the FACETS largest sides; points have none.
    """
    cloud, tree = hierarchy.cloud, hierarchy.tree
    normal = cloud.normal if cloud.shading_normal is None else cloud.shading_normal
    assert normal is not None
    # The side that each point belongs to.
    turned = normal @ SIDE_AXES
    face = np.abs(turned).argmax(axis=1)
    side = 2 * face + (turned[np.arange(len(face)), face] < 0)

    def columns(which: slice) -> np.ndarray:
        weighted = splat_weight(cloud, which) * normal[which].T
        return np.concatenate([np.where(side[which] == k, weighted, 0.0) for k in range(6)])

    sums = sum_over_nodes(tree, len(cloud), columns)
    nodes = rows >= len(cloud)
    vector = sums[:, rows[nodes] - len(cloud)].T.reshape(-1, 6, 3)
    weight = np.sqrt((vector * vector).sum(axis=2))
    order = np.argsort(-weight, axis=1)[:, :FACETS, None]
    facets = np.zeros((len(rows), FACETS, 3), np.int8)
    share = np.take_along_axis(vector, order, axis=1) / np.maximum(weight.sum(axis=1), 1e-300)[:, None, None]
    facets[nodes] = np.rint(127 * share)
    return facets if facets[:, 1:].any() else None
