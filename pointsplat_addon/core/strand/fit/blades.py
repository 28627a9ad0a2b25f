"""One ribbon for each flat part without lobes, by its widths across its longest axis."""

from __future__ import annotations

import numpy as np

from .flat import FlatParts
from .result import AREA_ERROR, NUDGE, PartStrands, no_strands

BLADE_POINTS = 7  # of its ribbon
LEAST_FILLED = 0.5  # of a leaf's breadth, what lies between its lobes taken off, at least
END_MARGIN = 0.04  # of its length: how far from its ends a leaf is measured for them


def fit_blades(flat: FlatParts, taken: np.ndarray) -> PartStrands:
    """Ribbons of flat parts that are not `taken`: at each of LEAF_POINTS places along the longest axis as wide as what
    a plane across it cuts, through the middle of that, and widened to the part's area."""
    flat = flat.only(~np.isin(flat.part, taken))
    count = len(flat.part)
    if count == 0:
        return no_strands()
    own, corner, height, sideways = flat.own, flat.corner, flat.height, flat.sideways
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(low, own, height.min(axis=1))
    np.maximum.at(high, own, height.max(axis=1))

    points, radius, normal = (np.zeros((count, BLADE_POINTS, *more)) for more in ((3,), (), (3,)))
    filled = np.zeros((2, count))
    for k, fraction in enumerate(np.linspace(0, 1, BLADE_POINTS)):
        measured = np.clip(fraction, END_MARGIN, 1 - END_MARGIN) + NUDGE
        above = height - (low + measured * (high - low))[own][:, None]
        ahead = np.roll(above, -1, axis=1)
        crosses = (above < 0) != (ahead < 0)
        t = np.where(crosses, above / np.where(crosses, above - ahead, 1), 0)
        two = np.argsort(~crosses, axis=1, kind="stable")[:, :2]
        cut = crosses.any(axis=1)
        point, side = (
            np.take_along_axis(v + t.reshape(*t.shape, *[1] * (v.ndim - 2)) * (np.roll(v, -1, axis=1) - v),
                               two.reshape(*two.shape, *[1] * (v.ndim - 2)), axis=1)
            for v in (corner, sideways)
        )  # fmt: skip
        length = np.linalg.norm(point[:, 0] - point[:, 1], axis=1) * cut
        width = flat.total(length)
        weight = (length / np.maximum(width[own], 1e-300))[:, None]
        points[:, k] = flat.total(weight * point.mean(axis=1))
        normal[:, k] = flat.total(weight * flat.facing)
        radius[:, k] = width / 2
        # To the very ends, along the axis
        if measured - NUDGE != fraction:
            points[:, k] += (fraction - measured + NUDGE) * (high - low)[:, None] * flat.axes[:, 0]
        least, most = np.full(count, np.inf), np.full(count, -np.inf)
        np.minimum.at(least, own[cut], side.min(axis=1)[cut])
        np.maximum.at(most, own[cut], side.max(axis=1)[cut])
        filled += np.stack([width, np.where(width > 0, most - least, 0)])
    covered = (np.linalg.norm(np.diff(points, axis=1), axis=2) * (radius[:, 1:] + radius[:, :-1])).sum(axis=1)
    whole = flat.area
    fits = (
        (np.abs(covered - whole) <= AREA_ERROR * whole)
        & (filled[0] >= LEAST_FILLED * filled[1])
        & (radius > 0).any(axis=1)
    )
    radius *= (whole / np.maximum(covered, 1e-300))[:, None]
    normal /= np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-300)
    return PartStrands(points[fits].reshape(-1, 3), radius[fits].ravel(), normal[fits].reshape(-1, 3),
            np.full(int(fits.sum()), BLADE_POINTS), flat.part[fits])  # fmt: skip
