"""Many instances of one hierarchy: what each of them draws, found for all of them at once.

A field of instances that are small on the screen needs no cut of its own for each. `Levels` are the cuts of one
hierarchy at fixed sizes of nodes, copied so that each is one run of splats (the levels of detail of Coconu and Hege
2002, section 5.1, in steps of a quarter of an octave). An instance takes the first level that is fine enough all over
it: one range, whatever the level holds. Near instances, whose parts differ much in depth, keep a cut of their own.

Instances on which even the coarsest level is much finer than the tolerance are thinned (the randomised z-buffer of
Wand et al. 2001, as Křivánek 2003 tells of it): of those that project to the share p of the area at which thinning
begins, p stay, and are enlarged by 1 / p in area. The expected area of the field, and with it its mean colour
and optical mass, stay as they are. Which ones stay depends on the instance's row alone, and each fades from no area, so
that nothing jumps as the camera moves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..numeric.linear import all_finite, largest_singular_value
from ..numeric.segments import ranges, starts
from ..numeric.vectors import number
from ..scene.camera import Camera
from ..scene.cloud import PointCloud
from .cut import Cut, Lens, against_frustum, lens_of
from .hierarchy import Hierarchy, frames, splat_weight, splats, sum_up

STEPS = 4  # levels to each octave of size: a fifth more splats than the tolerance asks for, in the mean
COARSEST = 8  # splats of the coarsest level: one flat splat alone is no body, seen from its side it vanishes
WHOLE = 3  # times the splats of a cut: drawing so many costs less than finding the cut
MOST = 1 << 18  # splats of the finest level: instances that need more are wide on the screen, and so are few
DEEPEST = 0.3  # reach over depth: of nearer instances a cut of their own leaves out more than it costs to find
SMALL = 16  # levels on which nodes are as large as that part of the body close no surface in the picture
THIN = 0.25  # of the tolerance: where the coarsest nodes are smaller than that, instances are thinned
FADE = 0.5  # share of the instances that stay which are not at their full size
FACETS = 4  # sides of a node, the largest, of which it shows one that faces the viewer
MEASURED = 256  # splats: of levels of at most so many the area is measured
OUTLINE_CELLS = 64  # of the grid that measures the area of what they stand for
RAYS = 20  # along each side of the grid that measures theirs
VIEWS = 6  # from which it is measured
ROUNDS = 6  # of measuring it
LARGEST = 1.25  # times its size a splat is drawn at most
# Axes about which sides of a surface are told apart: nearly those of the body, as walls are, and not where walls at 45
# degrees between them would fall apart.
TURN = np.linalg.qr(np.array([[1, 0.13, 0.09], [-0.13, 1, 0.17], [-0.09, -0.17, 1]]))[0].astype(np.float32)
# Instead of a level: a cut of its own; all points; nothing, since it is out of view or thinned away.
OWN, ALL, NONE = -1, -2, -3


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
    limit, most = float(size[0]) if len(size) else 0.0, min(MOST, len(hierarchy.cloud) // 2)
    while limit > 0.0:
        node = np.flatnonzero((own <= limit) & (above > limit) & ~single)
        bare = np.flatnonzero(leaf & (above > limit) & ((own > limit) | single))
        points = np.sort(ranges(tree.first_point[bare].astype(np.int64), tree.point_count[bare]))
        total = len(node) + len(points)
        if total > most or len(node) == 0:
            break
        if total >= COARSEST:
            found.append((limit, np.concatenate([points, len(hierarchy.cloud) + node]), len(node)))
        limit *= 2 ** (-1 / STEPS)
    if not found:
        return None
    limits, rows, nodes = zip(*found, strict=True)
    count = np.array([len(r) for r in rows])
    cloud = drawn = splats(hierarchy).take(np.concatenate(rows))
    if cloud.normal is not None and cloud.radii is not None and cloud.opacity is None and cloud.extinction is None:
        # Small bodies are what stands apart: surfaces that are closed in the picture would join neighbours.
        small = np.repeat(hierarchy.sphere[0] < SMALL * np.array(limits), count)
        cloud = replace(cloud, apart=small if cloud.apart is None else small | cloud.apart)
        drawn = cloud
        if hierarchy.cloud.apart is None:
            radii, facets = _true_to_size(hierarchy.cloud, cloud, count), _facets(hierarchy, np.concatenate(rows))
            drawn = replace(cloud, radii=radii, facets=facets)
    center = hierarchy.cloud.origin + hierarchy.center[0]
    reach, short = float(hierarchy.sphere[0]), len(hierarchy.cloud) > WHOLE * MOST
    return Levels(cloud, drawn, starts(count), count, np.array(nodes), np.array(limits), center, reach, short)


def _planes() -> list[np.ndarray]:
    """Unit vectors (2, 3) of planes to look at a body in, whose normals lie evenly on half a sphere."""
    k = np.arange(VIEWS)
    z, turn = (k + 0.5) / VIEWS, k * np.pi * (3 - np.sqrt(5))
    across = np.stack([-np.sin(turn), np.cos(turn), 0 * z], axis=1)
    normal = np.stack([np.cos(turn) * np.sqrt(1 - z * z), np.sin(turn) * np.sqrt(1 - z * z), z], axis=1)
    return list(np.stack([across, np.cross(normal, across)], axis=1))


def _true_to_size(points: PointCloud, cloud: PointCloud, count: np.ndarray) -> np.ndarray:
    """Half-axes of the levels' splats (N, 2 or 3), by which coarse levels cover as much of the picture as the points
    that they stand for, in the mean over views: flat splats for what bends leave gaps at the outline. None shrinks."""
    assert cloud.radii is not None
    planes = _planes()
    covered = sum(_silhouette(points, plane) for plane in planes)
    factor, last = np.ones(len(count)), np.cumsum(count)
    coarse = np.flatnonzero(count <= MEASURED)
    for level in coarse:
        normal, axis, radii = frames(cloud, slice(last[level] - count[level], last[level]))
        at = cloud.position[last[level] - count[level] : last[level]].T.astype(np.float64)
        ends = np.stack([axis * radii[0], np.cross(normal, axis, axis=0) * radii[1]])
        for _ in range(ROUNDS):
            found = sum(_shadow(at, factor[level] * ends, plane) for plane in planes)
            factor[level] = np.clip(factor[level] * np.sqrt(covered / max(found, 1e-300)), 1.0, LARGEST)
    finer = count > MEASURED
    factor[finer] = 1 + (factor[coarse[-1]] - 1) * MEASURED / count[finer] if len(coarse) else 1.0
    return cloud.radii * np.repeat(factor, count)[:, None].astype(np.float32)


def _silhouette(cloud: PointCloud, plane: np.ndarray) -> float:
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


def _shadow(at: np.ndarray, ends: np.ndarray, plane: np.ndarray) -> float:
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
    turned = normal @ TURN
    face = np.abs(turned).argmax(axis=1)
    side = 2 * face + (turned[np.arange(len(face)), face] < 0)

    def columns(which: slice) -> np.ndarray:
        weighted = splat_weight(cloud, which) * normal[which].T
        return np.concatenate([np.where(side[which] == k, weighted, 0.0) for k in range(6)])

    sums = sum_up(tree, len(cloud), columns)
    of = rows >= len(cloud)
    vector = sums[:, rows[of] - len(cloud)].T.reshape(-1, 6, 3)
    weight = np.sqrt((vector * vector).sum(axis=2))
    order = np.argsort(-weight, axis=1)[:, :FACETS, None]
    facets = np.zeros((len(rows), FACETS, 3), np.int8)
    share = np.take_along_axis(vector, order, axis=1) / np.maximum(weight.sum(axis=1), 1e-300)[:, None, None]
    facets[of] = np.rint(127 * share)
    return facets if facets[:, 1:].any() else None


@dataclass(frozen=True, eq=False)
class Choice:
    """What each of I instances draws."""

    level: np.ndarray  # (I,) int64: a row of the levels, or OWN, ALL, NONE
    scale: np.ndarray  # (I,) float64: enlarged about the levels' centre; 1 where it is not thinned


def choose(
    levels: Levels,
    view_from_object: np.ndarray,
    row: np.ndarray,
    camera: Camera,
    tolerance: float,
    margin: float = 1.0,
    band: float = 0.0,
) -> Choice:
    """The level for each instance of one geometry, `view_from_object` (I, 4, 4) float64.

    No node of it spans more than `tolerance` pixels anywhere on the instance, as `cut.select` has it. Instances that
    lie outside the camera's window, widened by `margin` pixels, or whose matrix is not finite or zero, draw nothing.
    `row` (I,) are the numbers by which instances are told apart when they are thinned, and by which each keeps a share
    of the `band` of octaves that levels are finer than asked for (`cut.staggered`).
    """
    lens = lens_of(camera, tolerance, margin)
    seen, position, scale = _balls(lens, view_from_object, levels.center, levels.reach)
    reach = levels.reach * scale

    deep = np.zeros(len(seen), bool)
    allowed = np.full(len(seen), lens.limit)  # view-space size
    if lens.perspective:
        near = -position[2] - reach
        deep = (reach > -DEEPEST * position[2]) | (near <= lens.near) | (lens.limit >= 1)
        near = np.maximum(near, 1e-300)
        # `cut.select` has r sqrt(D^2 - r^2) <= limit (z^2 - r^2), with D / z at most the slope of the ball's rim.
        slope = np.hypot(1.0, (np.hypot(position[0], position[1]) + reach) / near)
        allowed = lens.limit * max(1 - lens.limit**2, 0.0) * near / slope
    with np.errstate(all="ignore"):
        finer = np.log2(levels.size[0] * scale / allowed)  # octaves
    finer = np.nan_to_num(np.where(seen, finer, 0.0), nan=0.0, posinf=1e3, neginf=-1e3)
    level = np.searchsorted(-np.log2(levels.size / levels.size[0]), finer + band * number(row) - 1e-9)
    # Beyond the finest level a cut of its own would hardly leave out any points, unless the levels end at MOST.
    level[level >= len(levels.size)] = OWN if levels.cut_short else ALL
    level[deep] = OWN
    factor = area_factor(4.0 ** np.clip(finer - np.log2(THIN), -500, 0), number(row))
    factor[deep] = 1.0
    level[~seen | (factor <= 0)] = NONE
    return Choice(level, np.sqrt(factor))


def visible(
    view_from_object: np.ndarray, center: np.ndarray, reach: float, camera: Camera, margin: float = 1.0
) -> np.ndarray:
    """(I,) bool: which instances of a ball about `center` (3,), in object space, may reach into the camera's window,
    widened by `margin` pixels."""
    return _balls(lens_of(camera, 1.0, margin), view_from_object, center, reach)[0]


def _balls(
    lens: Lens, view_from_object: np.ndarray, center: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of instances of a ball: whether they may be seen (I,), their centres in view space (3, I), their scale (I,)."""
    good = all_finite(view_from_object)
    if not good.all():
        view_from_object = np.where(good[:, None, None], view_from_object, 0.0)
    linear = view_from_object[:, :3, :3]
    scale = largest_singular_value(linear)
    position = (linear.reshape(-1, 3) @ center).reshape(-1, 3).T + view_from_object[:, :3, 3].T
    gone, _ = against_frustum(lens, position, reach * scale, np.zeros(len(scale), bool))
    return good & ~gone & (scale > 0), position, scale


def area_factor(share: np.ndarray, at: np.ndarray) -> np.ndarray:
    """By how much the area of an instance grows that stays with probability `share` (I,) in [0, 1]; 0: it does not.

    `at` (I,) in [0, 1) is the instance's own number. The mean over `at` is 1. Instances shrink to nothing before they
    are left out: with t = share / (1 - FADE), the weight is clip((t - at) / (FADE t), 0, 1) over its mean.
    """
    t = np.maximum(share, 1e-300) / (1 - FADE)
    weight = np.clip((t - at) / (FADE * t), 0.0, 1.0)
    mean = np.where(t <= 1, t * (1 - FADE / 2), 1 - (1 - t * (1 - FADE)) ** 2 / (2 * FADE * t))
    return weight / mean


def enlarged(view_from_object: np.ndarray, center: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Matrices (I, 4, 4) of instances that are `scale` (I,) times as large about `center` (3,) of their object."""
    result = view_from_object.copy()
    result[:, :3, :3] *= scale[:, None, None]
    middle = (view_from_object[:, :3, :3].reshape(-1, 3) @ center).reshape(-1, 3)
    result[:, :3, 3] += middle * (1 - scale[:, None])
    return result


def cut_of(levels: Levels, instance: np.ndarray, level: np.ndarray) -> Cut:
    """One range for each of the instances (I,), rows of all instances, which draw `level` (I,) >= 0."""
    nodes, count = int(levels.nodes[level].sum()), levels.count[level]
    return Cut(instance.astype(np.int32), levels.first[level], count, nodes, int(count.sum()) - nodes)


def joined(cuts: list[Cut]) -> Cut:
    """Cuts of different instances as one."""
    cuts = [cut for cut in cuts if len(cut.count)] or cuts[:1]
    if len(cuts) == 1:
        return cuts[0]
    arrays = (np.concatenate([getattr(cut, name) for cut in cuts]) for name in ("instance", "first", "count"))
    instance, first, count = arrays
    order = np.argsort(instance, kind="stable")
    totals = (sum(getattr(cut, name) for cut in cuts) for name in ("nodes", "points", "culled"))
    return Cut(instance[order], first[order], count[order], *totals)
