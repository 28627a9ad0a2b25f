"""Validates a scene and its camera once, where they enter the renderer: RULES says what must hold of each field.

A single NaN in a sum takes the rest of the sum with it, and squares beyond float32 are infinite. Nothing below
validates again, but for products that can overflow although their factors are valid; these ask `valid_points` and
`drawable_transforms` where they are formed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..numeric.linear import all_finite
from ..numeric.record import record, value_record
from .camera import Aperture, Camera
from .captured import CapturedSplats
from .cloud import FARTHEST, LENGTHS, PointCloud
from .lights import Light
from .materials import CoatTable, HairTable, MaterialTable, default_materials
from .mesh import LARGEST, Mesh
from .scene import Geometry, Instances, PointSize, Scene, StreamedScan
from .strands import Strands
from .valid.captured import valid_captured
from .valid.geometry import DroppedTriangles, valid_meshes, valid_points, valid_strands
from .volume import Medium, Transfer, Volume
from .world import Fog, Mist, World

FLOAT32 = float(np.finfo(np.float32).max)
BRIGHTEST = 65504.0  # of half floats
STRONGEST = 1e30  # of a light's colour; float32 holds it with the factors of a light's formula

# What is done with a value that does not fit.
REMOVE = "the point, triangle or strand is removed"
CLAMP = "it is clamped to the range, and NaN becomes the default"
DEFAULT = "the default takes its place"
LEAVE_OUT = "what it belongs to is left out, and said to be"
WORLD_ONLY = "only the world is seen, and that is said"
LATER = "what is made of it is checked instead"  # the reason why stands beside the rule


@value_record
class Rule:
    """The range that a field's numbers must lie in (NaN lies in none), and what is done where they do not."""

    action: str
    low: float = -np.inf
    high: float = np.inf


_DISTANCE = -FARTHEST, FARTHEST
_VOXELS = Rule(LATER)  # core/volume counts values of grids and media that are no numbers as 0, and names the grid
_CORNER = Rule(LATER)  # evaluation of materials gives finite values; normals without direction become the triangle's

RULES: dict[type, dict[str, Rule]] = {
    Light: {
        **dict.fromkeys(
            ("position", "direction", "radius", "spot_cos", "spot_blend", "axis_u", "axis_v", "spread", "diffuse",
             "specular"), Rule(LEAVE_OUT, *_DISTANCE)),
        "color": Rule(LEAVE_OUT, -STRONGEST, STRONGEST),
    },
    MaterialTable: {
        "base_color": Rule(CLAMP, -BRIGHTEST, BRIGHTEST),
        "roughness": Rule(CLAMP, 0, 1),
        "metallic": Rule(CLAMP, 0, 1),
        "ior": Rule(CLAMP, 0, 1e6),
        "specular": Rule(CLAMP, 0, 1e6),
        "emission": Rule(CLAMP, -1e9, 1e9),
        "alpha": Rule(CLAMP, 0, 1),
        "transmission_color": Rule(CLAMP, 0, 1),
        "backlit": Rule(CLAMP, 0, 1),
        "tint": Rule(CLAMP, 0, BRIGHTEST),
        "gloss": Rule(CLAMP, -1, 1),
        "diffuse_roughness": Rule(CLAMP, 0, 1),
        "sheen": Rule(CLAMP, 0, 1),
        "toon": Rule(CLAMP, -1, 1),
        "holdout": Rule(CLAMP, 0, 1),
        "anisotropy": Rule(CLAMP, -1, 1),
    },
    HairTable: {
        "radial": Rule(CLAMP, 0, 1),
        "coat": Rule(CLAMP, 0, 1),
        "tilt": Rule(CLAMP, -np.pi, np.pi),
        "lobes": Rule(CLAMP, 0, BRIGHTEST),
    },
    CoatTable: {
        "weight": Rule(CLAMP, 0, 1),
        "roughness": Rule(CLAMP, 0, 1),
        "ior": Rule(CLAMP, 0, 1e6),
        "tint": Rule(CLAMP, 0, 1),
    },
    World: {
        "color": Rule(CLAMP, *_DISTANCE),  # -inf becomes 0
        "image": Rule(LATER),  # the environment's importance ignores texels that are no numbers
        "mirrored": Rule(LATER),
        "world_rotation": Rule(DEFAULT, -1.01, 1.01),  # float32's rounding, and no more
        "occlusion_distance": Rule(LATER),  # render/frame/indirect/kept.py takes what is no number as no bound
    },
    Fog: {
        "extinction": Rule(CLAMP, 0, STRONGEST),
        "scattering": Rule(CLAMP, 0, STRONGEST),
        "emission": Rule(CLAMP, 0, STRONGEST),
        "anisotropy": Rule(CLAMP, -1, 1),
    },
    Mist: dict.fromkeys(("start", "depth"), Rule(LATER)),  # it changes a pass of its own alone
    Camera: {
        "view_from_world": Rule(WORLD_ONLY, *_DISTANCE),  # and it must be rigid
        "clip_from_view": Rule(WORLD_ONLY, *_DISTANCE),  # and both scales must not be 0
        "near": Rule(LATER),  # comparisons with it are false
        "far": Rule(LATER),
        "previous_view_from_world": Rule(DEFAULT, *_DISTANCE),  # without them nothing moves
        "previous_clip_from_view": Rule(DEFAULT, *_DISTANCE),
        "coarseness": Rule(DEFAULT, 1, 1e6),
    },
    # A lens without a size blurs nothing; focus is as good as at infinity where it is farther than all else.
    Aperture: {
        "radius": Rule(LEAVE_OUT, -np.inf, FARTHEST),
        "focus": Rule(LEAVE_OUT, 1e-30, np.inf),
        "ratio": Rule(LEAVE_OUT, 1e-9, 1e9),
        "rotation": Rule(LEAVE_OUT, -1e6, 1e6),
    },
    Instances: {
        "world_from_object": Rule(LATER),  # its product with the view can overflow, too: `drawable_transforms`
        "previous": Rule(DEFAULT, *_DISTANCE),  # the instance has not moved
        "objects": _CORNER,
    },
    Geometry: {
        "spacing": Rule(DEFAULT, 0, FARTHEST),
        "extinction": Rule(DEFAULT, 0, FLOAT32),
        "pixel_radius": Rule(LATER),  # radii of points are checked
        "cells": Rule(LATER),  # whole numbers
        "node_shape": Rule(LATER),  # nodes of pages are made of half-axes that are numbers
    },
    PointCloud: {
        "origin": Rule(REMOVE, *_DISTANCE),
        **{name: Rule(REMOVE, *_DISTANCE) for name in LENGTHS},
        "velocity": Rule(DEFAULT, *_DISTANCE),  # the point has not moved
        **dict.fromkeys(
            ("color", "opacity", "surface", "emission", "extinction", "shaded", "value", "share", "span"),
            Rule(REMOVE, -FLOAT32, FLOAT32),
        ),
    },
    Mesh: {
        "position": Rule(REMOVE, -LARGEST, LARGEST),
        **dict.fromkeys(("vertex_normal", "corner_normal", "uv", "colors", "generated", "objects"), _CORNER),
    },
    Strands: {
        "position": Rule(REMOVE, *_DISTANCE),
        "origin": Rule(REMOVE, *_DISTANCE),
        "radius": Rule(REMOVE, *_DISTANCE),  # negative ones are 0
        **dict.fromkeys(("color", "surface", "emission"), Rule(REMOVE, -FLOAT32, FLOAT32)),
        "normal": Rule(LATER),  # what is no direction becomes some side of the strand
        "uv": Rule(LATER),  # only read when materials are evaluated
    },
    CapturedSplats: {
        **{name: Rule(REMOVE, *_DISTANCE) for name in ("position", "scale", "rotation", "origin")},
        **dict.fromkeys(("base", "sh"), Rule(REMOVE, -FLOAT32, FLOAT32)),
        "opacity": Rule(REMOVE, -FLOAT32, FLOAT32),  # below 0 it is 0, and above 1 it is 1
    },
    PointSize: {"radius": Rule(LATER)},  # radii of points are checked
    StreamedScan: {"box_from_object": Rule(LATER)},  # comparisons with what is no number are false
    Volume: {"object_from_index": Rule(LATER), **dict.fromkeys(("grids", "share", "scale"), _VOXELS)},  # `valid_points`
    Transfer: dict.fromkeys(("low", "high", "ramp", "density"), _VOXELS),
    Medium: dict.fromkeys(
        ("density", "color", "absorption", "anisotropy", "emission", "blackbody", "blackbody_tint", "temperature"),
        _VOXELS),
}  # fmt: skip

# What is kept for content keys; what is not is made, by the rows of its keys, all at once
Lookup = Callable[[Sequence[str], Callable[[list[int]], Sequence[Any]]], list[Any]]


def _not_kept(keys: Sequence[str], make: Callable[[list[int]], Sequence[Any]]) -> list[Any]:
    return list(make(list(range(len(keys)))))


def validate(scene: Scene, camera: Camera, lookup: Lookup = _not_kept) -> tuple[Scene, Camera]:
    """Returns a scene and a camera all of whose values can be drawn, by RULES; warnings are in the scene's.

    What is valid is returned itself, not copied, and a scene that was validated before is not looked at again.
    `lookup`: keeps what was found of each geometry by its content key.
    """
    warnings: list[str] = []
    camera, visible = _valid_camera(camera, warnings)
    if not visible:
        nothing = Instances(np.zeros(0, np.int32), np.zeros((0, 4, 4)))
        scene = replace(scene, geometries=(), instances=nothing, lights=())
    changed: dict[str, Any] = {}
    if not scene.validated:
        fields = {
            "geometries": _valid_geometries(scene.geometries, warnings, lookup),
            "instances": _valid_instances(scene.instances),
            "materials": _valid_materials(scene.materials, warnings),
            "lights": tuple(light for light in scene.lights if _valid_light(light, warnings)),
            "world": _valid_world(scene.world),
        }
        changed = {name: value for name, value in fields.items() if not _same(value, getattr(scene, name))}
        changed["validated"] = True
    if warnings:
        changed["warnings"] = (*scene.warnings, *warnings)
    return (replace(scene, **changed) if changed else scene), camera


def drawable_transforms(view_from_object: np.ndarray) -> np.ndarray:
    """Finds which transforms (I, 4, 4) float32 can hold, (I,) bool: instances with others draw nothing."""
    with np.errstate(over="ignore", invalid="ignore"):
        return all_finite(view_from_object.astype(np.float32))


def _same(a: Any, b: Any) -> bool:
    return a is b or (isinstance(a, tuple) and len(a) == len(b) and all(x is y for x, y in zip(a, b, strict=True)))


def _within(value: np.ndarray | float, rule: Rule) -> bool:
    """Whether all numbers lie within the rule's range; NaN lies in none."""
    if isinstance(value, float):
        return rule.low <= value <= rule.high
    array = np.asarray(value)
    return array.size == 0 or bool(array.min() >= rule.low and array.max() <= rule.high)


def _wrong(owner: Any, action: str) -> list[str]:
    """Names of the fields whose values call for this action."""
    return [
        name
        for name, rule in RULES[type(owner)].items()
        if rule.action == action and (value := getattr(owner, name)) is not None and not _within(value, rule)
    ]


def _valid_geometries(geometries: tuple[Geometry, ...], warnings: list[str], lookup: Lookup) -> tuple[Geometry, ...]:
    """The geometries without what of them cannot be drawn."""
    found = [
        replace(geometry, **dict.fromkeys(wrong, 0.0)) if (wrong := _wrong(geometry, DEFAULT)) else geometry
        for geometry in geometries
    ]
    kinds = ((one.mesh, one.cloud, one.strands, one.captured) for one in geometries)
    data = {
        row: next(kind for kind in some if kind is not None)
        for row, some in enumerate(kinds)
        if any(kind is not None for kind in some)
    }
    held = list(data.values())
    looked_at = lookup([geometries[row].key for row in data], lambda rows: _valid_data([held[row] for row in rows]))
    for row, (changed, messages) in zip(data, looked_at, strict=True):
        warnings += [f"{geometries[row].name}: {message}" for message in messages]
        if changed is not None:
            found[row] = replace(found[row], **{changed.name: changed.data})
    return tuple(found)


_Data = Mesh | PointCloud | Strands | CapturedSplats


@record
class _Changed:
    """Data of a geometry that had to be changed, and the name of its field."""

    name: str
    data: _Data

    @property
    def nbytes(self) -> int:
        return self.data.nbytes


def _valid_data(data: list[_Data]) -> list[tuple[_Changed | None, tuple[str, ...]]]:
    """What takes the place of geometries' data, None where these are valid, and messages."""
    meshes = [one for one in data if isinstance(one, Mesh)]
    valid = iter(valid_meshes(meshes))
    return [_valid_mesh(one, *next(valid)) if isinstance(one, Mesh) else _valid_others(one) for one in data]


def _valid_mesh(mesh: Mesh, found: Mesh, dropped: DroppedTriangles) -> tuple[_Changed | None, tuple[str, ...]]:
    return None if found is mesh else _Changed("mesh", found), (dropped.message,) if dropped.total else ()


def _valid_others(data: PointCloud | Strands | CapturedSplats) -> tuple[_Changed | None, tuple[str, ...]]:
    if isinstance(data, PointCloud):
        name = "cloud"
        found, count = valid_points(data)
        messages = (f"{count} points that are not finite were left out",) if count else ()
    elif isinstance(data, CapturedSplats):
        name = "captured"
        found, count = valid_captured(data)
        messages = (
            (f"{count} splats are left out: numbers of theirs are not finite, or they have no rotation",)
            if count
            else ()
        )
    else:
        name = "strands"
        found, messages = valid_strands(data)
    return (None if found is data else _Changed(name, found)), messages


def _valid_instances(instances: Instances) -> Instances:
    """The instances; those with a transform a frame before that is none have not moved."""
    before, rule = instances.previous, RULES[Instances]["previous"]
    if before is None or _within(before, rule):
        return instances
    good = (np.abs(before) <= rule.high).all(axis=(1, 2), keepdims=True)
    return replace(instances, previous=np.where(good, before, instances.world_from_object))


def _valid_light(light: Light, warnings: list[str]) -> bool:
    wrong = _wrong(light, LEAVE_OUT)
    if wrong:
        warnings.append(f'Light "{light.name}": its {" and ".join(wrong)} cannot be drawn, so it gives no light')
    return not wrong


def _valid_materials(table: MaterialTable, warnings: list[str]) -> MaterialTable:
    changed: dict[str, Any] = _clamped(table, default_materials())
    if table.hair is not None and (hair := _clamped(table.hair, None)):
        changed["hair"] = replace(table.hair, **hair)
    if table.coat is not None and (coat := _clamped(table.coat, None)):
        changed["coat"] = replace(table.coat, **coat)
    if changed:
        warnings.append(f"Materials: values of {', '.join(changed)} that cannot be drawn were put into their range")
    return replace(table, **changed) if changed else table


def _clamped(owner: Any, default: Any) -> dict[str, Any]:
    """The columns (M, ...) of a table that have to change, clamped; NaN becomes the default's first row, else 0."""
    changed = {}
    for name in _wrong(owner, CLAMP):
        column, rule = np.asarray(getattr(owner, name)), RULES[type(owner)][name]
        other = getattr(default, name, None)
        missing = 0.0 if other is None else other[:1]
        changed[name] = np.clip(np.where(np.isnan(column), missing, column), rule.low, rule.high).astype(column.dtype)
    return changed


def _valid_world(world: World) -> World:
    if world.seen is not None:
        world = replace(world, seen=_valid_world(world.seen))
    if _wrong(world, CLAMP):
        color = np.nan_to_num(world.color, nan=0.0, posinf=FARTHEST, neginf=0.0)
        world = replace(world, color=np.clip(color, -FARTHEST, FARTHEST))
    if world.fog is not None and (fog := _clamped(world.fog, None)):
        world = replace(world, fog=replace(world.fog, **fog))
    return replace(world, world_rotation=np.eye(3)) if _wrong(world, DEFAULT) else world


def _valid_camera(camera: Camera, warnings: list[str]) -> tuple[Camera, bool]:
    """The camera, and whether it sees objects. One that is nowhere, has no directions or projects all onto a line sees
    the world alone, as in Cycles: its rays are no numbers and meet nothing."""
    changed: dict[str, Any] = {}
    wrong = _wrong(camera, WORLD_ONLY)
    rigid = "view_from_world" not in wrong and abs(np.linalg.det(camera.view_from_world[:3, :3])) > 0.5
    projects = "clip_from_view" not in wrong and np.diag(camera.clip_from_view)[:2].all()
    unseen = [] if rigid else ["position or directions"]
    unseen += [] if projects else ["projection"]
    if unseen:
        warnings.append(f"Camera: its {' and '.join(unseen)} cannot be drawn, so only the world is seen")
        plain = np.diag([1.0, 1.0, -1.0, 1.0])
        changed |= {"view_from_world": np.eye(4), "clip_from_view": plain, "aperture": None}
    elif camera.aperture is not None and (lens := _wrong(camera.aperture, LEAVE_OUT)):
        changed["aperture"] = None
        warnings.append(f"Camera: its lens's {' and '.join(lens)} cannot be drawn, so nothing is out of focus")
    wrong = _wrong(camera, DEFAULT)
    if "coarseness" in wrong:
        changed["coarseness"] = 1.0
    if set(wrong) - {"coarseness"}:
        changed |= {"previous_view_from_world": None, "previous_clip_from_view": None}
    return (replace(camera, **changed) if changed else camera), not unseen
