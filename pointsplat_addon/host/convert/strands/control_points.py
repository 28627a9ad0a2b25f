"""TODO: say what this module is."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ....core.numeric.segments import offsets, owners
from ....core.strand.curves import Curves
from .. import arrays

VECTOR_HANDLE = 2  # a type of handles
POINT_FIELDS = ("position", "radius", "handle_left", "handle_right", "vector_left", "vector_right", "weight")
CURVE_FIELDS = ("kind", "cyclic", "resolution", "order", "knots")


@dataclass(frozen=True, eq=False)
class ControlPoints:
    """Arrays of S strands of P control points as Blender has them."""

    curves: Curves
    radius: np.ndarray  # (P,) float32
    slot: np.ndarray | None = None  # (S,) int32, material slots; None: all the first
    normal_mode: np.ndarray | None = None  # (S,) int32; None: tubes
    tilt: np.ndarray | None = None  # (P,) float32
    normal: np.ndarray | None = None  # (P, 3) float32, of free normals
    colors: dict[str, np.ndarray] = field(default_factory=dict)  # name to (P, 4) or (S, 4) as stored
    of_strand: frozenset[str] = frozenset()  # the names of those that are one for each strand
    uv: dict[str, np.ndarray] = field(default_factory=dict)  # name to (S, 2) float32, the active one first
    first: int = 0  # strands before these that count for random numbers
    space: np.ndarray | None = None  # (2, 3) float64: corners of the box of Generated; None: that of the strands
    messages: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        named = [part for group in (self.colors, self.uv) for item in group.items() for part in item]
        held = (getattr(self.curves, f) for f in Curves.__dataclass_fields__)
        own = self.slot, self.normal_mode, self.tilt, self.normal, self.first, self.space
        return arrays.digest("strands", *held, self.radius, *own, *named)


def without_invalid_points(strands: ControlPoints) -> ControlPoints | None:
    """Without control points that are no numbers and curves without points; None where nothing is left."""
    curves, start = strands.curves, strands.curves.start
    held = (curves.position, curves.handle_left, curves.handle_right, curves.weight, strands.radius, strands.normal)
    sound = np.ones(len(curves.position), bool)
    for array in held:
        if array is not None:
            sound &= np.isfinite(array.reshape(len(sound), -1)).all(axis=1)
    points = np.flatnonzero(sound)
    count = np.bincount(owners(np.diff(start))[points], minlength=len(start) - 1)
    kept = np.flatnonzero(count > 0)
    if len(points) == len(sound) and len(kept) == len(count):
        return strands
    if len(kept) == 0:
        return None
    lost = len(sound) - len(points)
    message = (
        f"{lost} control points are not numbers and are left out"
        if lost > 1
        else ("1 control point is not a number and is left out")
    )

    def taken(holder: Any, names: tuple[str, ...], part: np.ndarray) -> dict[str, np.ndarray]:
        return {n: a[part] for n in names if (a := getattr(holder, n)) is not None}

    named = taken(curves, POINT_FIELDS, points) | taken(curves, CURVE_FIELDS, kept)
    named |= {"start": offsets(count[kept])}
    return replace(
        strands,
        curves=replace(curves, **named),
        messages=(*strands.messages, *([message] if lost else [])),
        colors={n: a[kept if n in strands.of_strand else points] for n, a in strands.colors.items()},
        uv={n: a[kept] for n, a in strands.uv.items()},
        **taken(strands, ("radius", "tilt", "normal"), points),
        **taken(strands, ("slot", "normal_mode"), kept),
    )
