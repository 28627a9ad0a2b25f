"""Hair and curves to strands: Curves objects, hair of particle systems, and curve objects with a round bevel.

What Blender holds is read as it is (`CurveArrays`), and becomes `core.scene.strands.Strands` by its materials:
evaluated, with the colours of its points where they vary.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import bpy
import numpy as np

from ...core.material.color_models import linear_from_srgb
from ...core.material.evaluation import evaluate_materials
from ...core.material.expression import Part, SampleInputs
from ...core.material.graph import MaterialGraph, Needs, needs
from ...core.material.hair_color import random_of_strands, strand_attribute
from ...core.numeric.segments import offsets, owners
from ...core.scene.strands import Strands
from ...core.strand.curves import AUTO, BEZIER, CATMULL_ROM, MINIMUM_TWIST, NURBS, POLY, Curves, EvaluatedCurves
from ...core.strand.evaluation import evaluate_curves
from ...core.strand.normals import curve_normals
from . import arrays
from .mesh import COLOR_TYPES, as_color
from .pointcloud import CloudMaterial, constants_of, generated_coordinates, unit

DEFAULT_RADIUS = 0.005  # Cycles', for curves without a radius attribute
DEFAULT_RESOLUTION = 12  # Blender's, for curves without one
SURFACE_UV = "surface_uv_coordinate"  # where hair is attached
CUSTOM_KNOTS = 4  # a mode whose knots Python cannot read
VECTOR = 2  # a type of handles
SQUARE = 1  # bevel resolutions up to this one have corners that show
OF_POINTS = ("position", "radius", "handle_left", "handle_right", "vector_left", "vector_right", "weight")
OF_CURVES = ("kind", "cyclic", "resolution", "order", "knots")
READABLE = (*COLOR_TYPES, "FLOAT", "FLOAT_VECTOR")
Lookup = Callable[[str, Callable[[], Any]], Any]


@dataclass(frozen=True, eq=False)
class CurveArrays:
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


@dataclass(frozen=True, eq=False)
class Converted:
    """The strands, and what could not be drawn of them."""

    lines: Strands | None
    messages: tuple[str, ...]


def wanted(materials: tuple[CloudMaterial, ...]) -> Needs:
    """What any of the materials reads."""
    found = [needs(m.graph) for m in materials if m.graph]
    return Needs(
        uv=frozenset().union(*(n.uv for n in found)),
        colors=frozenset().union(*(n.colors for n in found)),
        generated=any(n.generated for n in found),
    )


def convert(strands: CurveArrays, name: str, materials: tuple[CloudMaterial, ...], lookup: Lookup) -> Converted:
    """The lines of strands; made only where what they are made of is not known. materials: one for each slot."""
    # Where some materials vary, the constants of the others are in the same column
    tints = [m.base_color for m in materials] if len(materials) > 1 else []
    key = f"{strands.key} {arrays.digest([m.key for m in materials], tints)}"
    return lookup(key, lambda: _build(key, strands, name, materials))


# Reading


def read_curves(data: bpy.types.Curves, materials: tuple[CloudMaterial, ...], ribbons: bool) -> CurveArrays | None:
    """An evaluated Curves object, in object space; None where it is empty. ribbons: with normals."""
    count, total, asked = len(data.curves), len(data.points), wanted(materials)
    if count == 0 or total == 0:
        return None
    start = arrays.read(data.curve_offset_data, "value", 1, np.int32).astype(np.int64)

    def number(name: str, default: int) -> np.ndarray:
        found = _read(data, name)
        return np.full(count, default) if found is None or len(found) != count else found.astype(np.int64)

    radius = _read(data, "radius")
    radius = np.full(total, DEFAULT_RADIUS, np.float32) if radius is None or len(radius) != total else radius
    kind = number("curve_type", CATMULL_ROM)
    knots = number("knots_mode", 0)
    free = kind == CATMULL_ROM if "resolution" not in data.attributes else np.zeros(count, bool)
    types = [_read(data, f"handle_type_{side}") for side in ("left", "right")]
    curves = Curves(
        arrays.read(data.position_data, "vector", 3, np.float32),
        start,
        kind.astype(np.uint8),
        number("cyclic", 0).astype(bool),
        np.where(free, AUTO, np.maximum(number("resolution", DEFAULT_RESOLUTION), 1)),
        radius,
        _read(data, "handle_left"),
        _read(data, "handle_right"),
        None if types[0] is None else types[0] == VECTOR,
        None if types[1] is None else types[1] == VECTOR,
        number("nurbs_order", 4),
        np.where(knots == CUSTOM_KNOTS, 0, knots),
        _read(data, "nurbs_weight"),
    )
    custom = int(((knots == CUSTOM_KNOTS) & (kind == NURBS)).sum())
    colors, of_strand = _colors(data, asked, total)
    found = CurveArrays(
        curves,
        radius,
        colors=colors,
        of_strand=of_strand,
        uv=_uv(data, asked),
        messages=(f"{custom} curves with knots of their own have uniform ones",) if custom else (),
    )
    if ribbons:
        mode, custom_normal = number("normal_mode", MINIMUM_TWIST), _read(data, "custom_normal")
        found = replace(found, normal_mode=mode, tilt=_read(data, "tilt"), normal=custom_normal)
    return found


def _read(data: bpy.types.Curves, name: str) -> np.ndarray | None:
    """An attribute of numbers or vectors, float32 or int32, None where there is none."""
    attribute = data.attributes.get(name)
    if attribute is None:
        return None
    if attribute.data_type in ("FLOAT_VECTOR", "FLOAT2"):
        return arrays.read(attribute.data, "vector", 3 if attribute.data_type == "FLOAT_VECTOR" else 2, np.float32)
    if attribute.data_type == "BOOLEAN":
        value = np.empty(len(attribute.data), bool)
        attribute.data.foreach_get("value", value)
        return value
    return arrays.read(attribute.data, "value", 1, np.float32 if attribute.data_type == "FLOAT" else np.int32)


def _colors(data: bpy.types.Curves, asked: Needs, total: int) -> tuple[dict[str, np.ndarray], frozenset[str]]:
    """Attributes that the materials read, and which of them are one for each strand."""
    names = [n for n in sorted(n for n in asked.colors if n is not None) if n in data.attributes]
    if None in asked.colors:
        names = [a.name for a in data.attributes if a.data_type in COLOR_TYPES][:1] + names
    found = {n: a for n in names if (a := data.attributes[n]).data_type in READABLE}
    return (
        {name: as_color(attribute) for name, attribute in found.items()},
        frozenset(name for name, attribute in found.items() if attribute.domain == "CURVE"),
    )


def _uv(data: bpy.types.Curves, asked: Needs) -> dict[str, np.ndarray]:
    """Places on the surface: the attachment's, which also goes by the name of the surface's UV map, or the first
    attribute of two numbers, as in Cycles."""
    maps = [a for a in data.attributes if a.data_type == "FLOAT2" and a.domain == "CURVE"]
    maps.sort(key=lambda a: a.name != SURFACE_UV)
    found = {a.name: arrays.read(a.data, "vector", 2, np.float32) for a in maps[:1]}
    found |= {a.name: arrays.read(a.data, "vector", 2, np.float32) for a in maps[1:] if a.name in asked.uv}
    if SURFACE_UV in found and data.surface_uv_map:
        found.setdefault(data.surface_uv_map, found[SURFACE_UV])
    return found


def _sound(strands: CurveArrays) -> CurveArrays | None:
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

    named = taken(curves, OF_POINTS, points) | taken(curves, OF_CURVES, kept)
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


# Curve objects with a bevel


def is_tube(ob: bpy.types.Object) -> bool:
    """Whether a curve object is drawn as tubes along its control points: its bevel is round and nothing else shapes it.

    Where the object does not ask for lines, bars of few sides stay meshes.
    """
    data, primitive = ob.data, ob.pointsplat.primitive
    if primitive not in ("AUTO", "LINES") or data.bevel_mode != "ROUND" or not data.bevel_depth > 0:
        return False
    shaped = data.extrude or data.offset or data.taper_object or data.shape_keys
    partial = (data.bevel_factor_start, data.bevel_factor_end) != (0.0, 1.0)
    flat = data.dimensions != "3D" or data.fill_mode != "FULL"
    if shaped or partial or flat or len(ob.modifiers) or len(data.splines) == 0:
        return False
    return primitive == "LINES" or data.bevel_resolution > SQUARE


def read_tubes(data: bpy.types.Curve) -> CurveArrays | None:
    """The splines of an evaluated curve object, with the bevel's radius times the points' own."""
    splines = [s for s in data.splines if len(s.bezier_points) or len(s.points)]
    if not splines:
        return None
    parts = [_bezier(s) if s.type == "BEZIER" else _points(s) for s in splines]
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
    return CurveArrays(curves, (radius * data.bevel_depth).astype(np.float32), slot=slot)


def _points(spline: bpy.types.Spline) -> tuple[np.ndarray, ...]:
    """Positions, radii, weights, handles (unused), and whether those are vectors."""
    co = arrays.read(spline.points, "co", 4, np.float32)
    radius, zero = arrays.read(spline.points, "radius", 1, np.float32), np.zeros_like(co[:, :3])
    return co[:, :3], radius, co[:, 3], zero, zero, np.zeros((len(co), 2), bool)


def _bezier(spline: bpy.types.Spline) -> tuple[np.ndarray, ...]:
    points = spline.bezier_points
    co, left, right = (arrays.read(points, name, 3, np.float32) for name in ("co", "handle_left", "handle_right"))
    types = [arrays.read(points, f"handle_{side}_type", 1, np.int32) == VECTOR for side in ("left", "right")]
    radius = arrays.read(points, "radius", 1, np.float32)
    return co, radius, np.ones(len(co), np.float32), left, right, np.stack(types, axis=1)


# Hair of particle systems


@dataclass(frozen=True, eq=False)
class Hair:
    """A particle system that is drawn as hair. Its Blender data live as long as the dependency graph's state."""

    ob: bpy.types.Object
    modifier: bpy.types.Modifier
    final: bool  # a final render
    first: int  # strands of the systems before it

    @property
    def system(self) -> bpy.types.ParticleSystem:
        return self.modifier.particle_system

    @property
    def material(self) -> int:
        """The slot; beyond the last one Blender takes the last."""
        return min(self.system.settings.material, len(self.ob.material_slots)) - 1

    @property
    def shown(self) -> range:
        """Numbers of the strands that are drawn: children take the place of their parents."""
        parents, children = len(self.system.particles), len(self.system.child_particles)
        settings = self.system.settings
        if not self.final:
            children = int(children * settings.display_percentage / 100)
        some = settings.child_type != "NONE" and children > 0
        return range(parents if some else 0, parents + children)


def hair_systems(ob: bpy.types.Object, final: bool) -> Iterator[Hair]:
    """The particle systems of an evaluated object that are hair and drawn as paths."""
    first = 0
    if ob.mode in ("EDIT", "PARTICLE_EDIT"):
        return
    for modifier in ob.modifiers:
        if modifier.type == "PARTICLE_SYSTEM" and (modifier.show_render if final else modifier.show_viewport):
            settings = modifier.particle_system.settings
            if settings.type == "HAIR" and settings.render_type == "PATH":
                hair = Hair(ob, modifier, final, first)
                first += len(hair.shown)
                yield hair


def read_hair(hair: Hair, materials: tuple[CloudMaterial, ...]) -> CurveArrays | None:
    """The strands of a particle system in its object's space, as Cycles reads them; None where there are none."""
    system, settings, shown = hair.system, hair.system.settings, np.array(hair.shown)
    steps = (1 << (settings.render_step if hair.final else settings.display_step)) + 1
    steps += settings.kink_extra_steps if settings.kink == "SPIRAL" else 0
    if len(shown) == 0:
        return None
    # One call for each point: Blender has no other way
    calls = (system.co_hair(hair.ob, particle_no=i, step=k) for i in hair.shown for k in range(steps))
    world = np.fromiter(itertools.chain.from_iterable(calls), np.float64, len(shown) * steps * 3)
    position = _to_object(hair.ob, _without_gaps(world.reshape(len(shown), steps, 3)))
    # The viewport hides a share of the parents: they have no path
    grown = (position != position[:, :1]).any(axis=(1, 2))
    if not grown.any():
        return None
    position, shown = position[grown], shown[grown]
    length = np.cumsum(np.linalg.norm(np.diff(position, axis=1, prepend=position[:, :1]), axis=2), axis=1)
    whole = length[:, -1:]
    radius = _radius(settings, np.divide(length, whole, out=np.zeros_like(length), where=whole > 0))
    count = len(shown)
    curves = Curves(
        position.reshape(-1, 3).astype(np.float32),
        np.arange(count + 1) * steps,
        np.full(count, CATMULL_ROM, np.uint8),
        np.zeros(count, bool),
        np.full(count, AUTO),
        radius.ravel().astype(np.float32),
    )
    uv, colors = _emitter(hair, shown.tolist(), wanted(materials))
    middle, half = (np.array(v, np.float64) for v in (hair.ob.data.texspace_location, hair.ob.data.texspace_size))
    return CurveArrays(curves, radius.ravel().astype(np.float32), colors=colors, of_strand=frozenset(colors), uv=uv,
                   first=hair.first, space=np.stack([middle - half, middle + half]))  # fmt: skip


def _without_gaps(world: np.ndarray) -> np.ndarray:
    """Strands that end early have zeros from there on: they stay at their last point."""
    step = np.arange(world.shape[1])
    known = np.where(world.any(axis=2) | (step == 0), step, 0)
    return np.take_along_axis(world, np.maximum.accumulate(known, axis=1)[..., None], axis=1)


def _to_object(ob: bpy.types.Object, world: np.ndarray) -> np.ndarray:
    matrix = np.array(ob.matrix_world.inverted_safe(), np.float64)
    return world @ matrix[:3, :3].T + matrix[:3, 3]


def _radius(settings: bpy.types.ParticleSettings, along: np.ndarray) -> np.ndarray:
    """(S, K) radii at shares (S, K) of the length, Cycles' shape."""
    root, tip = (settings.radius_scale * 0.5 * r for r in (settings.root_radius, settings.tip_radius))
    shape, left = settings.shape, np.clip(1 - along, 0, 1)
    if shape < 0:
        left = left ** (1 + shape)
    elif shape > 0:
        left = left ** (1 / (1 - shape)) if shape < 1 else (left >= 1).astype(float)
    radius = left * (root - tip) + tip
    if settings.use_close_tip:
        radius[:, -1] = 0
    return radius


def _emitter(hair: Hair, shown: list[int], asked: Needs) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """UV maps and colours of the emitter's surface where strands of these numbers grow, those that materials read:
    (S, 2) and (S, 4)."""
    mesh, system = hair.ob.data, hair.system
    parents = system.particles
    uv, colors = {}, {}
    layers = sorted(enumerate(mesh.uv_layers), key=lambda item: not item[1].active_render)
    for index, layer in layers:
        if layer.name in asked.uv or (None in asked.uv and layer.active_render):
            places = (
                system.uv_on_emitter(hair.modifier, particle=_parent(parents, i), particle_no=i, uv_no=index)
                for i in shown
            )
            uv[layer.name] = np.array([tuple(p) for p in places], np.float32).reshape(-1, 2)
    corner = [a for a in mesh.color_attributes if a.domain == "CORNER" and a.data_type == "BYTE_COLOR"]
    for index, layer in enumerate(corner):
        if layer.name in asked.colors or (
            None in asked.colors and layer.name == mesh.color_attributes.default_color_name
        ):
            tints = (
                system.mcol_on_emitter(hair.modifier, _parent(parents, i), particle_no=i, vcol_no=index) for i in shown
            )
            stored = np.array([tuple(c)[:3] for c in tints], np.float32).reshape(-1, 3)
            colors[layer.name] = np.concatenate([linear_from_srgb(stored), np.ones((len(stored), 1))], axis=1)
    return uv, colors


def _parent(particles: Any, number: int) -> bpy.types.Particle:
    """Children are found by their number alone, and then the particle is not looked at."""
    return particles[min(number, len(particles) - 1)]


# Strands


def _build(key: str, strands: CurveArrays, name: str, materials: tuple[CloudMaterial, ...]) -> Converted:
    sound = _sound(strands)
    if sound is None:
        return Converted(None, ("all control points are not numbers",))
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
    return Converted(_shaded(lines, strands, evaluated, slot, materials), strands.messages)


def _shaded(
    lines: Strands,
    strands: CurveArrays,
    evaluated: EvaluatedCurves,
    slot: np.ndarray,
    materials: tuple[CloudMaterial, ...],
) -> Strands:
    """The strands with what their materials' graphs give at the points. Less than opaque ones are thinner instead."""
    rows = slot[evaluated.curve]
    graphs = {row: graph for row in np.unique(rows).tolist() if (graph := materials[row].graph) is not None}
    constants = constants_of(materials)
    asked = wanted(tuple(materials[row] for row in graphs))
    inputs = _inputs(lines, strands, evaluated, asked) if graphs else SampleInputs()

    def some(graph: MaterialGraph, part: Part) -> SampleInputs:
        return inputs.take(part)

    look = evaluate_materials(rows, graphs, some, constants, None)
    alpha = constants.alpha[rows] if look.alpha is None else look.alpha
    radius = lines.radius if (alpha >= 1).all() else lines.radius * alpha
    return replace(lines, radius=radius, color=look.color, surface=look.surface, emission=look.emission)


def _inputs(lines: Strands, strands: CurveArrays, evaluated: EvaluatedCurves, asked: Needs) -> SampleInputs:
    """What materials that ask for this read at all points."""
    strand = evaluated.curve
    uv = {name: values[strand] for name, values in strands.uv.items()}
    colors = {}
    for name, stored in strands.colors.items():
        linear = arrays.scene_linear(stored)
        colors[name] = (linear[strand] if name in strands.of_strand else evaluated.interpolate(linear)).astype(
            np.float32
        )
    active = next(iter(colors), None)
    own = _own(lines, strands.first)
    for name, make in own.items():
        if strand_attribute(name) in asked.colors:
            value = np.asarray(make(), np.float32)
            colors[strand_attribute(name)] = np.column_stack([value, value, value, np.ones_like(value)])
    generated = None
    if asked.generated:
        # As in Cycles: where a strand begins, in the emitter's texture space or the bounds of all
        low, high = strands.space if strands.space is not None else _bounds(lines.position)
        root = lines.position[lines.start[:-1]][strand]
        generated = generated_coordinates(root, low, high)
    normal = None if lines.normal is None else unit(lines.normal)
    return SampleInputs(uv, next(iter(uv), None), colors, active, lines.position, generated, normal)


def _bounds(position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return position.min(axis=0), position.max(axis=0)


def _own(lines: Strands, first: int) -> dict[str, Callable[[], np.ndarray]]:
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
