"""Blender's lights as core's lights, in radiometric quantities, as Cycles interprets them."""

from __future__ import annotations

import bpy
import numpy as np

from ....core.material.expression import constant
from ....core.scene.lights import Light
from ..material.nodes.table import NODES
from ..material.nodes.tree import NodeReader, Outputs, TreeReader, resolve
from .world_nodes import DIFFUSE, light_path
from .world_surface import radiance


def convert_lights(depsgraph: bpy.types.Depsgraph) -> tuple[list[Light], list[str]]:
    """All lights of an evaluated scene, instances included, and warnings without repetitions."""
    lights, warnings = [], []
    for instance in depsgraph.object_instances:
        if instance.object.type != "LIGHT" or not instance.show_self:
            continue
        light, problems = from_object(instance.object, np.array(instance.matrix_world))
        lights += [light] if light else []
        warnings += problems
    return lights, list(dict.fromkeys(warnings))


def from_object(obj: bpy.types.Object, world_from_object: np.ndarray | None = None) -> tuple[Light | None, list[str]]:
    """An evaluated light object as a Light, and warnings; None if it emits nothing (no size, no strength).

    world_from_object: (4, 4), of an instance; None takes the object's own matrix.
    """
    data = obj.data
    matrix = np.array(obj.matrix_world if world_from_object is None else world_from_object, float)
    factor, warnings = _emission(data, obj.name)
    color = np.array(data.color, float) * data.energy * 2.0**data.exposure * factor
    if data.use_temperature:
        color = color * np.array(data.temperature_color)

    linking = obj.light_linking
    if linking.receiver_collection is not None or linking.blocker_collection is not None:
        warnings.append(
            f'Light "{obj.name}": light and shadow linking is not supported: it lights all, and all cast shadows'
        )

    scale = np.linalg.norm(matrix[:3, :3], axis=0)
    direction = -matrix[:3, 2] / scale[2] if scale[2] > 0 else np.array([0.0, 0.0, -1.0])
    common = {
        "kind": data.type,
        "position": matrix[:3, 3],
        "direction": direction,
        "diffuse": data.diffuse_factor if obj.visible_diffuse else 0.0,
        "specular": data.specular_factor if obj.visible_glossy else 0.0,
        "shadow": data.use_shadow,
        "name": obj.name,
    }
    shape = {"POINT": _point, "SPOT": _spot, "SUN": _sun, "AREA": _area}[data.type](data, matrix)
    if shape is None or not np.isfinite(matrix).all():
        warnings.append(f'Light "{obj.name}": its size or scale is zero or not finite, so it gives no light')
        return None, warnings
    light = Light(**common, **shape, color=color * _radiometric_factor(data, shape))
    return (light if np.any(light.color != 0) else None), warnings


def _point(data: bpy.types.PointLight, matrix: np.ndarray) -> dict:
    return {"radius": data.shadow_soft_size, "soft": data.use_soft_falloff}


def _spot(data: bpy.types.SpotLight, matrix: np.ndarray) -> dict | None:
    # The cone is round in the object's own axes: its scale makes it elliptical or wider.
    if abs(np.linalg.det(matrix[:3, :3])) < 1e-30:
        return None
    rows = np.linalg.inv(matrix[:3, :3])
    rows /= np.linalg.norm(rows[2])
    return {
        **_point(data, matrix),
        "spot_cos": float(np.cos(data.spot_size / 2)),
        "spot_blend": data.spot_blend,
        "axis_u": rows[0],
        "axis_v": rows[1],
    }


def _sun(data: bpy.types.SunLight, matrix: np.ndarray) -> dict:
    return {"radius": data.angle / 2}


def _area(data: bpy.types.AreaLight, matrix: np.ndarray) -> dict | None:
    size_v = data.size_y if data.shape in {"RECTANGLE", "ELLIPSE"} else data.size
    axis_u, axis_v = matrix[:3, 0] * data.size / 2, matrix[:3, 1] * size_v / 2
    if not (np.any(axis_u) and np.any(axis_v)):
        return None
    return {
        "axis_u": axis_u,
        "axis_v": axis_v,
        "ellipse": data.shape in {"DISK", "ELLIPSE"},
        "spread": data.spread,
    }


def _radiometric_factor(data: bpy.types.Light, shape: dict) -> float:
    """Factor from Blender's strength (W, or W/m2 for a sun) to what Light.color holds.

    A light of power P has the radiance P / (pi A) of a Lambertian emitter of area A, the whole sphere for POINT and
    SPOT. Without `normalize` the area is left out: strength / pi is the radiance (of a sun: the strength itself).
    """
    radius = shape.get("radius", 0.0)
    if data.type == "SUN":
        return 1.0 if data.normalize or radius == 0 else float(np.pi * np.sin(radius) ** 2)
    if data.type == "AREA":
        side_u, side_v = 2 * np.linalg.norm(shape["axis_u"]), 2 * np.linalg.norm(shape["axis_v"])
        area = side_u * side_v * (np.pi / 4 if shape["ellipse"] else 1.0)
        return float(1 / (np.pi * area) if data.normalize else 1 / np.pi)
    if data.normalize:
        return 1 / (4 * np.pi)
    # Intensity: the radiance times the area of the disk that the sphere projects to.
    return radius**2 if radius > 0 else 1 / np.pi


def _emission(data: bpy.types.Light, name: str) -> tuple[np.ndarray, list[str]]:
    """Colour times strength (3,) that the light's nodes emit, and warnings; ones without nodes or if they vary."""
    if data.node_tree is None or (bpy.app.version < (5, 0) and not data.use_nodes):
        return np.ones(3), []
    output = data.node_tree.get_output_node("ALL")
    if output is None:
        return np.zeros(3), []
    tree = _LightReader(name, NODES | {"ShaderNodeLightFalloff": _falloff, "ShaderNodeLightPath": light_path(DIFFUSE)})
    found = constant(radiance(tree, output.inputs["Surface"]))
    if found is None:
        source = resolve(output.inputs["Surface"], ())
        node = output if source is None else source[0].node
        return np.ones(3), [f'Light "{name}": node "{node.label or node.name}" varies and is taken as white']
    return np.broadcast_to(found[:3], (3,)).astype(float), tree.warnings


class _LightReader(TreeReader):
    """A reader whose warnings name a light."""

    kind = "Light"


def _falloff(node: NodeReader) -> Outputs:
    """The strength by the square of the distance, as light falls off by itself; other ways are not there."""
    smooth = constant(node["Smooth"])
    if any(node.used(name) for name in ("Linear", "Constant")) or smooth is None or smooth[0] > 0:
        node.warn("makes light fall off otherwise than by the square of the distance, which is how it is drawn")
    return dict.fromkeys(("Quadratic", "Linear", "Constant"), node["Strength"])
