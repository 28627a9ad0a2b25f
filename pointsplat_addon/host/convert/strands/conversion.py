"""TODO: say what this module is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ....core.material.evaluation import evaluate_samples
from ....core.material.expression import SampleInputs
from ....core.material.graph import Needs
from ....core.material.hair_color import random_of_strands, strand_attribute
from ....core.numeric.segments import owners
from ....core.scene.strands import Strands
from ....core.strand.curves import EvaluatedCurves
from ....core.strand.evaluation import evaluate_curves
from ....core.strand.normals import curve_normals
from .. import arrays
from ..arrays import contiguous_float32, unit_or_up
from ..sample_material import SampleMaterial, needs_of_materials, roughness_and_metallic
from .control_points import ControlPoints, without_invalid_points

Lookup = Callable[[str, Callable[[], Any]], Any]


@dataclass(frozen=True, eq=False)
class ConvertedStrands:
    """The strands, and what could not be drawn of them."""

    lines: Strands | None
    messages: tuple[str, ...]


def convert_strands(
    strands: ControlPoints, name: str, materials: tuple[SampleMaterial, ...], lookup: Lookup
) -> ConvertedStrands:
    """The lines of strands; made only where what they are made of is not known. materials: one for each slot."""
    # Where some materials vary, the constants of the others are in the same column
    tints = [m.base_color for m in materials] if len(materials) > 1 else []
    key = f"{strands.key} {arrays.digest([m.key for m in materials], tints)}"
    return lookup(key, lambda: _evaluate_strands(key, strands, name, materials))


def _evaluate_strands(
    key: str, strands: ControlPoints, name: str, materials: tuple[SampleMaterial, ...]
) -> ConvertedStrands:
    sound = without_invalid_points(strands)
    if sound is None:
        return ConvertedStrands(None, ("all control points are not numbers",))
    strands, curves = sound, sound.curves
    evaluated = evaluate_curves(curves)
    width = np.maximum(evaluated.interpolate(strands.radius), 0)
    normal = None
    if strands.normal_mode is not None:
        tilt, free = (None if a is None else evaluated.interpolate(a) for a in (strands.tilt, strands.normal))
        normal = curve_normals(evaluated, curves.cyclic, strands.normal_mode, tilt, free).astype(np.float32)
    slot = np.zeros(len(evaluated.start) - 1, np.int64)
    if strands.slot is not None:
        slot = np.clip(strands.slot, 0, len(materials) - 1).astype(np.int64)
    rows = np.array([m.row for m in materials])[slot]
    lines = Strands(
        key=key,
        name=name,
        position=evaluated.position.astype(np.float32),
        start=evaluated.start,
        radius=width.astype(np.float32),
        normal=normal,
        uv=next(iter(strands.uv.values()), None),
        material=rows.astype(np.uint16) if len(np.unique(rows)) > 1 else None,
        materials=tuple(np.unique(rows).tolist()),
    )
    return ConvertedStrands(_evaluate_materials(lines, strands, evaluated, slot, materials), strands.messages)


def _evaluate_materials(
    lines: Strands,
    strands: ControlPoints,
    evaluated: EvaluatedCurves,
    slot: np.ndarray,
    materials: tuple[SampleMaterial, ...],
) -> Strands:
    """With what the materials' graphs give at the points. What is less than opaque is thinner instead."""
    count, strand = len(lines.position), evaluated.curve
    columns: dict[str, np.ndarray] = {}
    alpha = np.ones(count)
    for index, material in enumerate(materials):
        points = np.flatnonzero(slot[strand] == index)
        if len(points) == 0:
            continue
        varying: dict[str, np.ndarray] = {}
        if material.graph is not None:
            inputs = _sample_inputs(lines, strands, evaluated, needs_of_materials((material,)))
            varying = evaluate_samples(material.graph, _select_samples(inputs, points))
        alpha[points] = varying.get("alpha", material.alpha)
        made = {
            "color": varying.get("base_color"),
            "surface": roughness_and_metallic(varying, material, len(points)),
            "emission": varying.get("emission"),
        }
        for name, values in made.items():
            if values is not None:
                columns.setdefault(name, _material_constants(name, slot, strand, materials))[points] = values
    radius = lines.radius if (alpha >= 1).all() else (lines.radius * alpha).astype(np.float32)
    return replace(lines, radius=radius, **{name: contiguous_float32(values) for name, values in columns.items()})


def _material_constants(
    name: str, slot: np.ndarray, strand: np.ndarray, materials: tuple[SampleMaterial, ...]
) -> np.ndarray:
    """A column of points, with the constants of those materials whose values do not vary."""
    each = {
        "color": [m.base_color for m in materials],
        "surface": [(m.roughness, m.metallic) for m in materials],
        "emission": [m.emission for m in materials],
    }[name]
    return np.array(each, np.float32)[slot[strand]]


def _sample_inputs(lines: Strands, strands: ControlPoints, evaluated: EvaluatedCurves, asked: Needs) -> SampleInputs:
    """What graphs read at all points."""
    strand = evaluated.curve
    uv = {name: values[strand] for name, values in strands.uv.items()}
    colors = {}
    for name, stored in strands.colors.items():
        linear = arrays.scene_linear(stored)
        colors[name] = (linear[strand] if name in strands.of_strand else evaluated.interpolate(linear)).astype(
            np.float32
        )
    active = next(iter(colors), None)
    own = _strand_attributes(lines, strands.first)
    for name, make in own.items():
        if strand_attribute(name) in asked.colors:
            value = np.asarray(make(), np.float32)
            colors[strand_attribute(name)] = np.column_stack([value, value, value, np.ones_like(value)])
    generated = None
    if asked.generated:
        # As in Cycles: where a strand begins, in the emitter's texture space or the bounds of all
        low, high = strands.space if strands.space is not None else _bounds(lines.position)
        root = lines.position[lines.start[:-1]][strand]
        generated = (root - low) / np.where(high > low, high - low, 1)
    normal = None if lines.normal is None else unit_or_up(lines.normal)
    return SampleInputs(uv, next(iter(uv), None), colors, active, lines.position, generated, normal)


def _bounds(position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return position.min(axis=0), position.max(axis=0)


def _strand_attributes(lines: Strands, first: int) -> dict[str, Callable[[], np.ndarray]]:
    """What strands tell of themselves (Blender's Curves Info), each (P,) when called."""
    strand = owners(np.diff(lines.start))

    def reached() -> np.ndarray:
        step = np.linalg.norm(np.diff(lines.position.astype(np.float64), axis=0, prepend=lines.position[:1]), axis=1)
        step[lines.start[:-1]] = 0
        total = np.cumsum(step)
        return total - total[lines.start[:-1]][strand]

    def length() -> np.ndarray:
        return reached()[lines.start[1:] - 1][strand]

    def intercept() -> np.ndarray:
        along, whole = reached(), length()
        return np.divide(along, whole, out=np.zeros_like(along), where=whole > 0)

    return {
        "is_strand": lambda: np.ones(len(strand)),
        "intercept": intercept,
        "length": length,
        "thickness": lambda: 2 * lines.radius,
        "random": lambda: random_of_strands(len(lines), first)[strand],
    }


def _select_samples(inputs: SampleInputs, points: np.ndarray) -> SampleInputs:
    if len(points) == len(inputs):
        return inputs
    return replace(
        inputs,
        uv={n: a[points] for n, a in inputs.uv.items()},
        colors={n: a[points] for n, a in inputs.colors.items()},
        **{n: a[points] for n in SampleInputs.ARRAYS if (a := getattr(inputs, n)) is not None},
    )
