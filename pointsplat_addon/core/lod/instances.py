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

from dataclasses import dataclass

import numpy as np

from ..numeric.linear import all_finite, largest_singular_value
from ..numeric.vectors import number
from ..scene.camera import Camera
from .criteria import Criteria, against_frustum, criteria_of
from .cut import Cut
from .levels import Levels

MAX_RELATIVE_RADIUS = (
    0.3  # reach over depth: of nearer instances a cut of their own leaves out more than it costs to find
)
THINNING_TOLERANCE = 0.25  # of the tolerance: where the coarsest nodes are smaller than that, instances are thinned
FADE = 0.5  # share of the instances that stay which are not at their full size
# Instead of a level: a cut of its own; all points; nothing, since it is out of view or thinned away.
OWN_CUT, ALL_POINTS, NOTHING = -1, -2, -3


@dataclass(frozen=True, eq=False)
class LevelChoice:
    """What each of I instances draws."""

    level: np.ndarray  # (I,) int64: a row of the levels, or OWN, ALL, NONE
    scale: np.ndarray  # (I,) float64: enlarged about the levels' centre; 1 where it is not thinned


def choose_levels(
    levels: Levels,
    view_from_object: np.ndarray,
    row: np.ndarray,
    camera: Camera,
    tolerance: float,
    margin: float = 1.0,
    band: float = 0.0,
) -> LevelChoice:
    """The level for each instance of one geometry, `view_from_object` (I, 4, 4) float64.

    No node of it spans more than `tolerance` pixels anywhere on the instance, as `cut.select` has it. Instances that
    lie outside the camera's window, widened by `margin` pixels, or whose matrix is not finite or zero, draw nothing.
    `row` (I,) are the numbers by which instances are told apart when they are thinned, and by which each keeps a share
    of the `band` of octaves that levels are finer than asked for (`cut.staggered`).
    """
    criteria = criteria_of(camera, tolerance, margin)
    seen, position, scale = _bounding_balls(criteria, view_from_object, levels.center, levels.reach)
    reach = levels.reach * scale

    deep = np.zeros(len(seen), bool)
    allowed = np.full(len(seen), criteria.limit)  # view-space size
    if criteria.perspective:
        near = -position[2] - reach
        deep = (reach > -MAX_RELATIVE_RADIUS * position[2]) | (near <= criteria.near) | (criteria.limit >= 1)
        near = np.maximum(near, 1e-300)
        # `cut.select` has r sqrt(D^2 - r^2) <= limit (z^2 - r^2), with D / z at most the slope of the ball's rim.
        slope = np.hypot(1.0, (np.hypot(position[0], position[1]) + reach) / near)
        allowed = criteria.limit * max(1 - criteria.limit**2, 0.0) * near / slope
    with np.errstate(all="ignore"):
        finer = np.log2(levels.size[0] * scale / allowed)  # octaves
    finer = np.nan_to_num(np.where(seen, finer, 0.0), nan=0.0, posinf=1e3, neginf=-1e3)
    level = np.searchsorted(-np.log2(levels.size / levels.size[0]), finer + band * number(row) - 1e-9)
    # Beyond the finest level a cut of its own would hardly leave out any points, unless the levels end at MOST.
    level[level >= len(levels.size)] = OWN_CUT if levels.cut_short else ALL_POINTS
    level[deep] = OWN_CUT
    factor = area_factor(4.0 ** np.clip(finer - np.log2(THINNING_TOLERANCE), -500, 0), number(row))
    factor[deep] = 1.0
    level[~seen | (factor <= 0)] = NOTHING
    return LevelChoice(level, np.sqrt(factor))


def visible_instances(
    view_from_object: np.ndarray, center: np.ndarray, reach: float, camera: Camera, margin: float = 1.0
) -> np.ndarray:
    """(I,) bool: which instances of a ball about `center` (3,), in object space, may reach into the camera's window,
    widened by `margin` pixels."""
    return _bounding_balls(criteria_of(camera, 1.0, margin), view_from_object, center, reach)[0]


def _bounding_balls(
    criteria: Criteria, view_from_object: np.ndarray, center: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of instances of a ball: whether they may be seen (I,), their centres in view space (3, I), their scale (I,)."""
    good = all_finite(view_from_object)
    if not good.all():
        view_from_object = np.where(good[:, None, None], view_from_object, 0.0)
    linear = view_from_object[:, :3, :3]
    scale = largest_singular_value(linear)
    position = (linear.reshape(-1, 3) @ center).reshape(-1, 3).T + view_from_object[:, :3, 3].T
    gone, _ = against_frustum(criteria, position, reach * scale, np.zeros(len(scale), bool))
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


def scaled_about(view_from_object: np.ndarray, center: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Matrices (I, 4, 4) of instances that are `scale` (I,) times as large about `center` (3,) of their object."""
    result = view_from_object.copy()
    result[:, :3, :3] *= scale[:, None, None]
    middle = (view_from_object[:, :3, :3].reshape(-1, 3) @ center).reshape(-1, 3)
    result[:, :3, 3] += middle * (1 - scale[:, None])
    return result


def cut_from_levels(levels: Levels, instance: np.ndarray, level: np.ndarray) -> Cut:
    """One range for each of the instances (I,), rows of all instances, which draw `level` (I,) >= 0."""
    nodes, count = int(levels.nodes[level].sum()), levels.count[level]
    return Cut(instance.astype(np.int32), levels.first[level], count, nodes, int(count.sum()) - nodes)


def joined_cuts(cuts: list[Cut]) -> Cut:
    """Cuts of different instances as one."""
    cuts = [cut for cut in cuts if len(cut.count)] or cuts[:1]
    if len(cuts) == 1:
        return cuts[0]
    arrays = (np.concatenate([getattr(cut, name) for cut in cuts]) for name in ("instance", "first", "count"))
    instance, first, count = arrays
    order = np.argsort(instance, kind="stable")
    totals = (sum(getattr(cut, name) for cut in cuts) for name in ("nodes", "points", "culled"))
    return Cut(instance[order], first[order], count[order], *totals)
