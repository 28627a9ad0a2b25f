"""Catmull-Rom, poly, Bezier and NURBS curves by their control points, and their points where Blender evaluates them.

Control points stay where they are in memory; each evaluated point is a weighted sum of a few of them, for
positions, radii and attributes alike. Cyclic curves end with a copy of their first point.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ..numeric.record import record
from ..numeric.segments import owners

CATMULL_ROM, POLY, BEZIER, NURBS = range(4)  # Blender's numbers for kinds of curves
MINIMUM_TWIST, Z_UP, FREE = range(3)  # and for normals
AUTO = 0  # a resolution of Catmull-Rom curves: as many steps as their radius requires


@record
class Curves:
    """C curves of P control points, one curve after another, none of them empty.

    Attributes that no curve's kind needs are None. Knots follow Blender's modes: 0 uniform, 1 endpoint, 2 Bezier,
    3 both. Orders and numbers of points that fit no knots make a curve the polyline of its control points, as in
    Blender.
    """

    position: np.ndarray  # (P, 3)
    start: np.ndarray  # (C + 1,) int64: the points of curve c are start[c] .. start[c + 1] - 1
    kind: np.ndarray  # (C,) uint8: CATMULL_ROM, POLY, BEZIER or NURBS
    cyclic: np.ndarray  # (C,) bool
    resolution: np.ndarray  # (C,) int: evaluated points in a segment or span; AUTO
    radius: np.ndarray | None = None  # (P,): the radius that AUTO uses
    handle_left: np.ndarray | None = None  # (P, 3)
    handle_right: np.ndarray | None = None  # (P, 3)
    vector_left: np.ndarray | None = None  # (P,) bool: handles of type VECTOR, between which a segment is straight
    vector_right: np.ndarray | None = None  # (P,) bool
    order: np.ndarray | None = None  # (C,) int
    knots: np.ndarray | None = None  # (C,) int, modes
    weight: np.ndarray | None = None  # (P,)

    @cached_property
    def count(self) -> np.ndarray:
        """(C,) int64 control points of each curve."""
        return np.diff(self.start)


@record
class EvaluatedCurves:
    """E evaluated points on C curves, as weighted sums of control points."""

    start: np.ndarray  # (C + 1,) int64
    position: np.ndarray  # (E, 3) float64
    parts: tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...]  # rows (e,), control points (e, K), weights (e, K)
    rows: np.ndarray | None  # (E,) int64: the point, before closing, that each one copies; None: each itself
    open: np.ndarray  # (C + 1,) int64: `start` before closing

    def __len__(self) -> int:
        return int(self.start[-1])

    def interpolate(self, values: np.ndarray) -> np.ndarray:
        """(E, ...) float64 of an attribute (P, ...) of the control points, as Blender interpolates it."""
        values = np.asarray(values)
        out = np.empty((int(self.open[-1]), *values.shape[1:]))
        for rows, index, weight in self.parts:
            found = values[index[:, 0]] * _like(weight[:, 0], values)
            for column in range(1, index.shape[1]):
                found += values[index[:, column]] * _like(weight[:, column], values)
            out[rows] = found
        return out if self.rows is None else out[self.rows]

    @cached_property
    def curve(self) -> np.ndarray:
        """(E,) int64 curve of each point."""
        return owners(np.diff(self.start))


def _like(weight: np.ndarray, values: np.ndarray) -> np.ndarray:
    return weight.reshape(-1, *[1] * (values.ndim - 1))


# Normals
