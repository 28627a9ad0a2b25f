"""Control points with their materials as strands of core: evaluated curves, and colours where they vary."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ....core.material.evaluation import evaluate_materials
from ....core.material.expression import Part, SampleInputs
from ....core.material.graph import MaterialGraph, Needs
from ....core.material.hair_color import random_of_strands, strand_attribute
from ....core.numeric.record import record
from ....core.numeric.segments import owners
from ....core.scene.strands import Strands
from ....core.strand.curves import EvaluatedCurves
from ....core.strand.evaluation import evaluate_curves
from ....core.strand.normals import curve_normals
from .. import arrays
from ..arrays import unit_or_up
from ..sample_material import SampleMaterial, generated_coordinates, needs_of_materials, surface_constants
from .control_points import ControlPoints, without_invalid_points

Lookup = Callable[[str, Callable[[], Any]], Any]  # the object of a content key, made only if it is not known


@record
class ConvertedStrands:
    """Strands, None if there is nothing to draw, and messages about what is left out, which do not name the object."""

    strands: Strands | None
    messages: tuple[str, ...]


def convert_strands(
    control: ControlPoints, name: str, materials: tuple[SampleMaterial, ...], lookup: Lookup
) -> ConvertedStrands:
    """The strands of an object called `name`, evaluated only if `lookup` does not know their content key.

    materials: one for each material slot.
    """
    # A colour that varies in one material makes a column, which holds the constant colours of the others
    tints = [m.base_color for m in materials] if len(materials) > 1 else []
    key = f"{control.key} {arrays.digest([m.key for m in materials], tints)}"
    return lookup(key, lambda: _evaluate_strands(key, control, name, materials))


def _evaluate_strands(
    key: str, control: ControlPoints, name: str, materials: tuple[SampleMaterial, ...]
) -> ConvertedStrands:
    valid = without_invalid_points(control)
    if valid is None:
        return ConvertedStrands(None, ("all control points are not numbers",))
    control, curves = valid, valid.curves
    evaluated = evaluate_curves(curves)
    radius = np.maximum(evaluated.interpolate(control.radius), 0)
    normal = None
    if control.normal_mode is not None:
        tilt, free_normal = (None if a is None else evaluated.interpolate(a) for a in (control.tilt, control.normal))
        normal = curve_normals(evaluated, curves.cyclic, control.normal_mode, tilt, free_normal).astype(np.float32)
    slot = np.zeros(len(evaluated.start) - 1, np.int64)
    if control.slot is not None:
        slot = np.clip(control.slot, 0, len(materials) - 1).astype(np.int64)
    rows = np.array([m.row for m in materials])[slot]
    strands = Strands(
        key=key,
        name=name,
        position=evaluated.position.astype(np.float32),
        start=evaluated.start,
        radius=radius.astype(np.float32),
        normal=normal,
        uv=next(iter(control.uv.values()), None),
        material=rows.astype(np.uint16) if len(np.unique(rows)) > 1 else None,
        materials=tuple(np.unique(rows).tolist()),
    )
    return ConvertedStrands(_evaluate_materials(strands, control, evaluated, slot, materials), control.messages)


def _evaluate_materials(
    strands: Strands,
    control: ControlPoints,
    evaluated: EvaluatedCurves,
    slot: np.ndarray,
    materials: tuple[SampleMaterial, ...],
) -> Strands:
    """`strands` with the values of the materials' graphs at their points; alpha scales the radius."""
    rows = slot[evaluated.curve]
    graphs = {row: graph for row in np.unique(rows).tolist() if (graph := materials[row].graph) is not None}
    constants = surface_constants(materials)
    wanted = needs_of_materials(tuple(materials[row] for row in graphs))
    inputs = _sample_inputs(strands, control, evaluated, wanted) if graphs else SampleInputs()

    def inputs_of(graph: MaterialGraph, part: Part) -> SampleInputs:
        return inputs.take(part)

    look = evaluate_materials(rows, graphs, inputs_of, constants, None)
    alpha = constants.alpha[rows] if look.alpha is None else look.alpha
    radius = strands.radius if (alpha >= 1).all() else strands.radius * alpha
    return replace(strands, radius=radius, color=look.color, surface=look.surface, emission=look.emission)


def _sample_inputs(strands: Strands, control: ControlPoints, evaluated: EvaluatedCurves, wanted: Needs) -> SampleInputs:
    """What the graphs of materials read at all points of the strands."""
    strand = evaluated.curve
    uv = {name: values[strand] for name, values in control.uv.items()}
    colors = {}
    for name, stored in control.colors.items():
        linear = arrays.scene_linear(stored)
        values = linear[strand] if name in control.strand_colors else evaluated.interpolate(linear)
        colors[name] = values.astype(np.float32)
    active = next(iter(colors), None)
    for name, make in _strand_attributes(strands, control.first_strand).items():
        if strand_attribute(name) in wanted.colors:
            value = np.asarray(make(), np.float32)
            colors[strand_attribute(name)] = np.column_stack([value, value, value, np.ones_like(value)])
    generated = None
    if wanted.generated:
        # As in Cycles: the root of each strand, relative to the emitter's texture space or the bounds of all points
        low, high = _bounds(strands.position) if control.texture_space is None else control.texture_space
        root = strands.position[strands.start[:-1]][strand]
        generated = generated_coordinates(root, low, high)
    normal = None if strands.normal is None else unit_or_up(strands.normal)
    return SampleInputs(uv, next(iter(uv), None), colors, active, strands.position, generated, normal)


def _bounds(position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return position.min(axis=0), position.max(axis=0)


def _strand_attributes(strands: Strands, first: int) -> dict[str, Callable[[], np.ndarray]]:
    """Functions that give the outputs of Blender's Curves Info node at the points, (P,) each.

    first: number of the first strand, on which the random values depend.
    """
    strand = owners(np.diff(strands.start))

    def length_from_root() -> np.ndarray:
        step = np.linalg.norm(
            np.diff(strands.position.astype(np.float64), axis=0, prepend=strands.position[:1]), axis=1
        )
        step[strands.start[:-1]] = 0
        total = np.cumsum(step)
        return total - total[strands.start[:-1]][strand]

    def length() -> np.ndarray:
        return length_from_root()[strands.start[1:] - 1][strand]

    def intercept() -> np.ndarray:
        along, whole = length_from_root(), length()
        return np.divide(along, whole, out=np.zeros_like(along), where=whole > 0)

    return {
        "is_strand": lambda: np.ones(len(strand)),
        "intercept": intercept,
        "length": length,
        "thickness": lambda: 2 * strands.radius,
        "random": lambda: random_of_strands(len(strands), first)[strand],
    }
