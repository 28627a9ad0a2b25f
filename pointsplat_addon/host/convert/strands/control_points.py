"""Control points of curves as Blender has them, and their validation."""

from __future__ import annotations

from dataclasses import field, replace
from typing import Any

import numpy as np

from ....core.numeric.record import record
from ....core.numeric.segments import offsets, owners
from ....core.strand.curves import Curves
from .. import arrays

VECTOR_HANDLE = 2  # a type of handles
POINT_FIELDS = ("position", "radius", "handle_left", "handle_right", "vector_left", "vector_right", "weight")
CURVE_FIELDS = ("kind", "cyclic", "resolution", "order", "knots")


@record
class ControlPoints:
    """Arrays of P control points of S strands as Blender has them, in object units."""

    curves: Curves
    radius: np.ndarray  # (P,) float32
    slot: np.ndarray | None = None  # (S,) int32, of materials; None: all use the first
    normal_mode: np.ndarray | None = None  # (S,) int32; None: strands are tubes, without normals
    tilt: np.ndarray | None = None  # (P,) float32
    normal: np.ndarray | None = None  # (P, 3) float32, for the mode of free normals
    colors: dict[str, np.ndarray] = field(default_factory=dict)  # by name, (P, 4) or (S, 4) as stored
    strand_colors: frozenset[str] = frozenset()  # names of the colours that are (S, 4)
    uv: dict[str, np.ndarray] = field(default_factory=dict)  # by name, (S, 2) float32, the active one first
    first_strand: int = 0  # number of the first strand, on which random values depend
    texture_space: np.ndarray | None = None  # (2, 3) float64, corners for Generated; None: the bounds of the points
    messages: tuple[str, ...] = ()  # about what is read differently; they do not name the object

    @property
    def key(self) -> str:
        """Content key of all arrays."""
        named = [part for group in (self.colors, self.uv) for item in group.items() for part in item]
        shape = (getattr(self.curves, f) for f in Curves.__dataclass_fields__)
        other = self.slot, self.normal_mode, self.tilt, self.normal, self.first_strand, self.texture_space
        return arrays.digest("strands", *shape, self.radius, *other, *named)


def without_invalid_points(strands: ControlPoints) -> ControlPoints | None:
    """`strands` without control points that are NaN or infinite and strands without points; None if none is left.

    A message says how many points are left out.
    """
    curves, start = strands.curves, strands.curves.start
    checked = (curves.position, curves.handle_left, curves.handle_right, curves.weight, strands.radius, strands.normal)
    finite = np.ones(len(curves.position), bool)
    for array in checked:
        if array is not None:
            finite &= np.isfinite(array.reshape(len(finite), -1)).all(axis=1)
    points = np.flatnonzero(finite)
    count = np.bincount(owners(np.diff(start))[points], minlength=len(start) - 1)
    nonempty = np.flatnonzero(count > 0)
    if len(points) == len(finite) and len(nonempty) == len(count):
        return strands
    if len(nonempty) == 0:
        return None
    lost = len(finite) - len(points)
    message = (
        f"{lost} control points are not numbers and are left out"
        if lost > 1
        else ("1 control point is not a number and is left out")
    )

    def select(holder: Any, names: tuple[str, ...], rows: np.ndarray) -> dict[str, np.ndarray]:
        return {n: a[rows] for n in names if (a := getattr(holder, n)) is not None}

    named = select(curves, POINT_FIELDS, points) | select(curves, CURVE_FIELDS, nonempty)
    named |= {"start": offsets(count[nonempty])}
    return replace(
        strands,
        curves=replace(curves, **named),
        messages=(*strands.messages, *([message] if lost else [])),
        colors={n: a[nonempty if n in strands.strand_colors else points] for n, a in strands.colors.items()},
        uv={n: a[nonempty] for n, a in strands.uv.items()},
        **select(strands, ("radius", "tilt", "normal"), points),
        **select(strands, ("slot", "normal_mode"), nonempty),
    )
