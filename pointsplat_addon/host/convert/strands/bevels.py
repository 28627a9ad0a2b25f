"""Control points of Blender's curve objects whose round bevels are drawn as tubes."""

from __future__ import annotations

import bpy
import numpy as np

from ....core.numeric.segments import offsets
from ....core.strand.curves import BEZIER, NURBS, POLY, Curves
from .. import arrays
from .control_points import VECTOR_HANDLE, ControlPoints

MAX_ANGULAR_BEVEL = 1  # bevels up to this resolution have visible corners


def has_round_bevel(ob: bpy.types.Object) -> bool:
    """Whether a curve object is drawn as tubes along its curves: it has a round bevel and nothing else shapes it.

    Bevels of few sides become meshes unless the object's primitive is LINES.
    """
    data, primitive = ob.data, ob.pointsplat.primitive
    if primitive not in ("AUTO", "LINES") or data.bevel_mode != "ROUND" or not data.bevel_depth > 0:
        return False
    shaped = data.extrude or data.offset or data.taper_object or data.shape_keys
    partial = (data.bevel_factor_start, data.bevel_factor_end) != (0.0, 1.0)
    flat = data.dimensions != "3D" or data.fill_mode != "FULL"
    if shaped or partial or flat or len(ob.modifiers) or len(data.splines) == 0:
        return False
    return primitive == "LINES" or data.bevel_resolution > MAX_ANGULAR_BEVEL


def read_splines(data: bpy.types.Curve) -> ControlPoints | None:
    """The control points of an evaluated curve object, in object space; None if it has none.

    Radii are the bevel's depth times those of the points.
    """
    splines = [s for s in data.splines if len(s.bezier_points) or len(s.points)]
    if not splines:
        return None
    parts = [_read_bezier(s) if s.type == "BEZIER" else _read_points(s) for s in splines]
    position, radius, weight, left, right, vector = (np.concatenate(p) for p in zip(*parts, strict=True))
    kinds = {"POLY": POLY, "BEZIER": BEZIER}
    curves = Curves(
        position,
        offsets([len(p[0]) for p in parts]),
        np.array([kinds.get(s.type, NURBS) for s in splines], np.uint8),
        np.array([s.use_cyclic_u for s in splines]),
        np.array([s.resolution_u for s in splines]),
        None,
        left,
        right,
        vector[:, 0],
        vector[:, 1],
        np.array([s.order_u for s in splines]),
        np.array([s.use_endpoint_u + 2 * s.use_bezier_u for s in splines]),
        weight,
    )
    slot = np.array([s.material_index for s in splines], np.int32)
    return ControlPoints(curves, (radius * data.bevel_depth).astype(np.float32), slot=slot)


def _read_points(spline: bpy.types.Spline) -> tuple[np.ndarray, ...]:
    """Arrays of a NURBS or poly spline in the order of `_read_bezier`, with handles that are not used."""
    co = arrays.read(spline.points, "co", 4, np.float32)
    radius, zero = arrays.read(spline.points, "radius", 1, np.float32), np.zeros_like(co[:, :3])
    return co[:, :3], radius, co[:, 3], zero, zero, np.zeros((len(co), 2), bool)


def _read_bezier(spline: bpy.types.Spline) -> tuple[np.ndarray, ...]:
    """Position (P, 3), radius (P,), weight (P,), left and right handle (P, 3), and whether they are vectors (P, 2)."""
    points = spline.bezier_points
    co, left, right = (arrays.read(points, name, 3, np.float32) for name in ("co", "handle_left", "handle_right"))
    types = [arrays.read(points, f"handle_{side}_type", 1, np.int32) == VECTOR_HANDLE for side in ("left", "right")]
    radius = arrays.read(points, "radius", 1, np.float32)
    return co, radius, np.ones(len(co), np.float32), left, right, np.stack(types, axis=1)
