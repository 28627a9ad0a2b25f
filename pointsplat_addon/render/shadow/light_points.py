"""Points of lights with a size: from some of them depth maps are drawn, and from all of them receivers are looked at.

A light's outline, a disk or a rectangle, is divided into cells of equal area. From one point of each the light sees
what casts; rays to other points of the cell are told by that view's map, where they pass it at the depth of what
casts the shadow. Views of outer cells are from their outlines, so that these agree where no part of the light is
hidden, or none shines.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from ...core.numeric.record import record
from ...core.scene.lights import Light
from ...core.shadow.grid import rotation_to

POINTS_OF_CELL = 8
WIDENED = 1.2  # outlines of lights that face receivers, in views that do not face all of them
NARROW = 0.02  # radians that a light extends to each side
# Views of a light, as many as cells of its outline, and for how many primitives at most that each shows; fewer
# are enough for narrow ones.
VIEWS: tuple[tuple[int, int | None], ...] = ((32, 1 << 17), (16, 1 << 18), (8, 1 << 20), (4, None))
VIEWS_OF_NARROW: tuple[tuple[int, int | None], ...] = ((8, 1 << 16), (4, None))
GOLDEN = 5**0.5 / 2 - 0.5  # of Vogel's spiral (1979)
# Additive recurrence in two dimensions (Roberts 2018).
PLASTIC = np.array([0.7548776662466927, 0.5698402909980532])


@record
class LightShape:
    """The outline of a light, seen from what it shines on."""

    axes: np.ndarray  # (2, 3) float64, world: half-axes; of suns per unit of length
    facing: bool  # towards each receiver: half-axes are as long as the first, whichever way it looks
    rectangle: bool  # else an ellipse

    @property
    def reach(self) -> float:
        """How far from its middle the light extends."""
        return float(np.linalg.norm(self.axes, axis=1).max()) * (2**0.5 if self.rectangle else 1.0)

    def bounds(self, across: np.ndarray) -> np.ndarray:
        """Returns (2,): how far the outline extends to either side, given its half-axes as columns."""
        return np.abs(across).sum(axis=1) if self.rectangle else np.linalg.norm(across, axis=1)

    def across(self, axes: np.ndarray, parallel: bool, place: np.ndarray) -> np.ndarray:
        """Returns (2, 2): the half-axes as columns, where rays from them to a `place` (2,) of a view with the rows
        `axes` (3, 3) meet the plane of its origin."""
        if parallel:
            return (self.axes @ axes.T)[:, :2].T
        half = self.axes @ axes.T
        if self.facing:
            ray = np.append(place, 1.0)
            ray /= np.linalg.norm(ray)
            first = np.array([1.0, 0, 0]) - ray[0] * ray
            first /= np.linalg.norm(first)
            half = WIDENED * self.reach * np.stack([first, np.cross(ray, first)])
        return (half[:, :2] - half[:, 2:] * place).T


def light_shape(light: Light) -> LightShape | None:
    """Returns the outline of a light; None where it has no size."""
    if light.kind == "AREA":
        if light.axis_u is None or light.axis_v is None:
            return None
        return LightShape(np.stack([light.axis_u, light.axis_v]).astype(float), False, not light.ellipse)
    radius = float(np.tan(min(light.radius, 1.5))) if light.kind == "SUN" else light.radius
    if radius <= 0:
        return None
    _, right, up = rotation_to(light.direction)
    return LightShape(radius * np.stack([up, right]), light.kind != "SUN", False)


def views_of_light(reach: float, drawn: int) -> int:
    """Returns from how many points of a light with a size depth maps are drawn.

    reach: radians that it extends to each side, as what casts sees it; `drawn`: primitives that one view of each such
    light of the scene draws, together.
    """
    choices = VIEWS_OF_NARROW if reach <= NARROW else VIEWS
    return next(count for count, most in choices if most is None or drawn <= most)


@cache
def cell_points(views: int, rectangle: bool) -> tuple[np.ndarray, np.ndarray]:
    """Returns from where each cell sees, (N, 2) float64, and POINTS_OF_CELL points of each, (N, K, 2): of the unit
    disk, or of the square from -1 to 1. The first half of the cells are spread all over it."""
    rows = (
        {4: (2, 2), 8: (4, 4), 16: (4, 4, 4, 4), 32: (8, 8, 8, 8)}
        if rectangle
        else {4: (4,), 8: (2, 6), 16: (4, 12), 32: (4, 12, 16)}
    )
    total = views * POINTS_OF_CELL
    number = np.arange(total) + 0.5
    lattice = np.stack([number / total, number * GOLDEN % 1], axis=1)
    seen, places, start = [], [], 0
    for row, count in enumerate(rows[views]):
        here = lattice[start : start + count * POINTS_OF_CELL]
        places.append(here[np.argsort(here[:, 1], kind="stable")].reshape(count, POINTS_OF_CELL, 2))
        start += len(here)
        along = np.arange(count)
        if rectangle:
            last = len(rows[views]) - 1
            seen += [(row / last, k / (count - 1)) for k in along]
        else:
            # The outermost ones see from the outline.
            outer = start == total
            seen += [(1.0 if outer else (start - len(here) / 2) / total, (k + 0.5) / count) for k in along]
    order = np.argsort(np.arange(views) * GOLDEN % 1, kind="stable")
    return (
        place_in_shape(np.array(seen)[order], rectangle),
        place_in_shape(np.concatenate(places)[order], rectangle),
    )


def grid_shifts(views: int) -> np.ndarray:
    """Returns (N, 2) float64, in [-0.5, 0.5): by how much of a texel the texels of each view lie further on, so that
    edges that fall on texels of one fall between those of others."""
    return (0.5 + (1 + np.arange(views)[:, None]) * PLASTIC[::-1]) % 1 - 0.5


def place_in_shape(place: np.ndarray, rectangle: bool) -> np.ndarray:
    """Returns (..., 2) of a unit disk or square, for (..., 2) in the unit square that keeps areas."""
    if rectangle:
        return 2 * place - 1
    radius, angle = np.sqrt(place[..., 0]), 2 * np.pi * place[..., 1]
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
