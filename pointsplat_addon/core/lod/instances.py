"""Chooses a level of detail for each of many instances of one hierarchy, for all of them at once.

Instances that are small on the screen share the fixed levels of detail of `levels.py`. Each takes the coarsest level
that is fine enough all over it: one range of splats, whatever the level holds. Near instances, whose parts differ much
in depth, get a cut of their own.

Instances on which even the coarsest level is much finer than the tolerance are thinned out (the randomised z-buffer of
Wand et al. 2001, described by Křivánek 2003): where they project to a share p of the area at which thinning begins, a
share p of them is drawn, enlarged by 1 / p in area. The expected area of the field, and with it its mean colour and
optical mass, stay as they are. Which instances stay depends on their number alone, and each fades in from no area, so
that nothing jumps as the camera moves.
"""

from __future__ import annotations

import numpy as np

from ..numeric.linear import all_finite, largest_singular_value
from ..numeric.record import record, value_record
from ..numeric.vectors import golden_ratio_sequence
from ..scene.camera import Camera
from .criteria import Criteria, against_frustum, criteria_of
from .cut import Cut
from .levels import Levels

# Radius over depth; for nearer instances, a cut of their own leaves out more than it costs to find.
MAX_RELATIVE_RADIUS = 0.3
THINNING_TOLERANCE = 0.25  # of the tolerance: instances are thinned out where the coarsest nodes are smaller than that
FADE = 0.5  # share of the remaining instances that are not at their full size
# Instead of a level: a cut of its own; all points; nothing, since it is out of view or thinned out.
OWN_CUT, ALL_POINTS, NOTHING = -1, -2, -3


@record
class LevelChoice:
    """What each of I instances draws (a level, its own cut, all points or nothing), and how much it is enlarged."""

    level: np.ndarray  # (I,) int64: a row of the levels, or OWN_CUT, ALL_POINTS, NOTHING
    scale: np.ndarray  # (I,) float64: factor of its size about the levels' centre; 1 where instances are not thinned


def choose_levels(
    levels: Levels,
    view_from_object: np.ndarray,
    row: np.ndarray,
    camera: Camera,
    tolerance: float,
    margin: float = 1.0,
    band: float = 0.0,
) -> LevelChoice:
    """Chooses the level of each instance of one geometry, `view_from_object` (I, 4, 4) float64.

    No node of the level spans more than `tolerance` pixels anywhere on the instance, by the measure of
    `cut.select_cut`. Near instances get OWN_CUT; those that need more than the finest level ALL_POINTS, or OWN_CUT if
    the levels were cut short. Instances outside the camera's window, widened by `margin` pixels, and those whose
    matrix is not finite, or zero, draw NOTHING. `row` (I,): persistent numbers of the instances, which decide which of
    them thinning leaves out, and at which share of the `band` (octaves, `criteria.transition_band`) each one changes
    its level.
    """
    criteria = criteria_of(camera, tolerance, margin)
    balls = _bounding_balls(criteria, view_from_object, levels.center, levels.radius)
    seen, position, scale = balls.visible, balls.position, balls.scale
    radius = levels.radius * scale

    deep = np.zeros(len(seen), bool)
    allowed = np.full(len(seen), criteria.limit)  # view-space size
    if criteria.perspective:
        near = -position[2] - radius
        deep = (radius > -MAX_RELATIVE_RADIUS * position[2]) | (near <= criteria.near) | (criteria.limit >= 1)
        near = np.maximum(near, 1e-300)
        # `cut.select_cut` has r sqrt(D^2 - r^2) <= limit (z^2 - r^2), with D / z at most the slope of the ball's rim.
        slope = np.hypot(1.0, (np.hypot(position[0], position[1]) + radius) / near)
        allowed = criteria.limit * max(1 - criteria.limit**2, 0.0) * near / slope
    with np.errstate(all="ignore"):
        finer = np.log2(levels.size[0] * scale / allowed)  # octaves
    finer = np.nan_to_num(np.where(seen, finer, 0.0), nan=0.0, posinf=1e3, neginf=-1e3)
    level = np.searchsorted(-np.log2(levels.size / levels.size[0]), finer + band * golden_ratio_sequence(row) - 1e-9)
    # Beyond the finest level a cut of its own would hardly leave out any points, unless the levels end at
    # MAX_LEVEL_SPLATS.
    level[level >= len(levels.size)] = OWN_CUT if levels.cut_short else ALL_POINTS
    level[deep] = OWN_CUT
    factor = area_factor(4.0 ** np.clip(finer - np.log2(THINNING_TOLERANCE), -500, 0), golden_ratio_sequence(row))
    factor[deep] = 1.0
    level[~seen | (factor <= 0)] = NOTHING
    return LevelChoice(level, np.sqrt(factor))


def visible_instances(
    view_from_object: np.ndarray,
    center: np.ndarray,
    radius: np.ndarray | float,
    camera: Camera,
    margin: float = 1.0,
) -> np.ndarray:
    """Which instances of a ball may extend into the camera's window, widened by `margin` pixels: (I,) bool.

    `view_from_object` (I, 4, 4); `center` (3,) and `radius` of the ball in object space, or (I, 3) and (I,).
    """
    return _bounding_balls(criteria_of(camera, 1.0, margin), view_from_object, center, radius).visible


@value_record
class _Balls:
    """Balls around I instances."""

    visible: np.ndarray  # (I,) bool: whether they may be seen
    position: np.ndarray  # (3, I) float64: their centres in view space
    scale: np.ndarray  # (I,) float64: by how much the instances are enlarged


def _bounding_balls(
    criteria: Criteria, view_from_object: np.ndarray, center: np.ndarray, radius: np.ndarray | float
) -> _Balls:
    """The images of a ball in object space under the instances' matrices (I, 4, 4)."""
    good = all_finite(view_from_object)
    if not good.all():
        view_from_object = np.where(good[:, None, None], view_from_object, 0.0)
    linear = view_from_object[:, :3, :3]
    scale = largest_singular_value(linear)
    if center.ndim == 1:  # a million instances of one ball: ten times as fast
        moved = (linear.reshape(-1, 3) @ center).reshape(-1, 3)
    else:
        moved = np.einsum("iab,ib->ia", linear, center)
    position = moved.T + view_from_object[:, :3, 3].T
    gone, _ = against_frustum(criteria, position, radius * scale, np.zeros(len(scale), bool))
    return _Balls(good & ~gone & (scale > 0), position, scale)


def area_factor(share: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The factor by which thinning enlarges the area of each instance, 0 for those that are left out: (I,) float64.

    `share` (I,) in [0, 1]: the probability that an instance stays; `at` (I,) in [0, 1): a persistent quasi-random
    number of each instance. The mean over `at` is 1. Instances shrink to nothing before they are left out: with
    t = share / (1 - FADE), the factor is clip((t - at) / (FADE t), 0, 1) over its mean.
    """
    t = np.maximum(share, 1e-300) / (1 - FADE)
    weight = np.clip((t - at) / (FADE * t), 0.0, 1.0)
    mean = np.where(t <= 1, t * (1 - FADE / 2), 1 - (1 - t * (1 - FADE)) ** 2 / (2 * FADE * t))
    return weight / mean


def scaled_about(view_from_object: np.ndarray, center: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """The matrices (I, 4, 4) of instances enlarged by `scale` (I,) about the point `center` (3,) of their object."""
    result = view_from_object.copy()
    result[:, :3, :3] *= scale[:, None, None]
    middle = (view_from_object[:, :3, :3].reshape(-1, 3) @ center).reshape(-1, 3)
    result[:, :3, 3] += middle * (1 - scale[:, None])
    return result


def cut_from_levels(levels: Levels, instance: np.ndarray, level: np.ndarray) -> Cut:
    """The cut of instances (I,) that draw `level` (I,), rows of the levels: one range of splats for each."""
    nodes, count = int(levels.nodes[level].sum()), levels.count[level]
    return Cut(instance.astype(np.int32), levels.first[level], count, nodes, int(count.sum()) - nodes)


def joined_cuts(cuts: list[Cut]) -> Cut:
    """Joins cuts that have no instance in common into one, sorted by instance. There must be at least one cut."""
    cuts = [cut for cut in cuts if len(cut.count)] or cuts[:1]
    if len(cuts) == 1:
        return cuts[0]
    arrays = (np.concatenate([getattr(cut, name) for cut in cuts]) for name in ("instance", "first", "count"))
    instance, first, count = arrays
    order = np.argsort(instance, kind="stable")
    totals = (sum(getattr(cut, name) for cut in cuts) for name in ("nodes", "points", "culled"))
    return Cut(instance[order], first[order], count[order], *totals)
