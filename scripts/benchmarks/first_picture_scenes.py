"""The scenes of scripts/benchmarks/first_picture.py, built in Blender."""

from __future__ import annotations

import gzip
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Vector

from scripts.benchmarks.blender import link

SIZE = 512  # pixels
ELEVATION = 0.35  # of the camera over the object, in distances
LENS = 50.0  # millimetres
SCANNED = "dragon_vrip_res2.ply.gz"
TRUCK = "peterbilt"


def default_cube(_data: Path | None) -> None:
    """Blender's own default scene."""
    bpy.ops.wm.read_factory_settings()
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 640, 360, 100


def empty() -> Any:
    """An empty scene with a sun and a dim world."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    world = scene.world = bpy.data.worlds.new("World")
    if bpy.app.version < (5, 0, 0):
        world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.05, 0.05, 0.05, 1)
    sun = link(bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN")))
    sun.data.energy, sun.rotation_euler = 3.0, (0.6, 0.4, 0.0)
    return scene


def look_at_all(scene: Any) -> None:
    """Add a camera that sees all objects."""
    bpy.context.view_layer.update()
    corners = [ob.matrix_world @ Vector(c) for ob in scene.objects if ob.type != "LIGHT" for c in ob.bound_box]
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    middle, radius = Vector((low + high) / 2), float(np.linalg.norm(high - low)) / 2
    camera = bpy.data.cameras.new("Camera")
    camera.lens = LENS
    distance = radius / np.sin(camera.angle / 2)
    ob = scene.camera = link(bpy.data.objects.new("Camera", camera))
    direction = Vector((0.5, -1.0, ELEVATION)).normalized()
    ob.location = middle + direction * distance
    ob.rotation_euler = direction.to_track_quat("Z", "Y").to_euler()
    camera.clip_start, camera.clip_end = distance / 1000, 10 * distance


def add_material(ob: Any) -> None:
    material = bpy.data.materials.new("Material")
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    ob.data.materials.append(material)


def dragon(subdivided: bool) -> Callable[[Path | None], None]:
    """The scanned dragon, smooth, upright; four triangles for each of its own where it is subdivided."""

    def build(data: Path | None) -> None:
        scene = empty()
        if data is None:
            raise FileNotFoundError("--data names no folder")
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "dragon.ply"
            with gzip.open(data / SCANNED) as packed, path.open("wb") as plain:
                shutil.copyfileobj(packed, plain)
            bpy.ops.wm.ply_import(filepath=str(path))
        ob = bpy.context.object
        ob.rotation_euler = np.pi / 2, 0.0, 0.0
        if subdivided:
            modifier = ob.modifiers.new("Subdivided", "SUBSURF")
            modifier.subdivision_type, modifier.levels = "SIMPLE", 1
            bpy.ops.object.modifier_apply(modifier=modifier.name)
        ob.data.shade_smooth()
        add_material(ob)
        look_at_all(scene)

    return build


def truck(data: Path | None) -> None:
    """A truck of many objects and materials."""
    scene = empty()
    found = sorted((data / TRUCK).rglob("*.obj")) if data is not None else []
    if not found:
        raise FileNotFoundError(f"there is no {TRUCK}/*.obj")
    bpy.ops.wm.obj_import(filepath=str(found[0]))
    look_at_all(scene)


def points(count: int) -> Callable[[Path | None], None]:
    """Coloured points in random order over hills, as a PointCloud object; their radius is half the spacing."""

    def build(_data: Path | None) -> None:
        scene = empty()
        rng = np.random.default_rng(0)
        position = np.empty((count, 3), np.float32)
        position[:, :2] = rng.random((count, 2), np.float32) * 100
        x, y = position[:, 0], position[:, 1]
        position[:, 2] = 4 * np.sin(0.13 * x) * np.cos(0.17 * y) + 1.5 * np.sin(0.5 * x + 0.3 * y)
        color = np.ones((count, 4), np.float32)
        color[:, :3] = 0.2 + 0.6 * rng.random((count, 3), np.float32)
        ob = add_points(position, np.full(count, 50 / np.sqrt(count), np.float32), color)
        add_material(ob)
        nodes = ob.data.materials[0].node_tree
        attribute = nodes.nodes.new("ShaderNodeAttribute")
        attribute.attribute_name = "Col"
        shader = next(node for node in nodes.nodes if node.type == "BSDF_PRINCIPLED")
        nodes.links.new(attribute.outputs["Color"], shader.inputs["Base Color"])
        look_at_all(scene)

    return build


def add_points(position: np.ndarray, radius: np.ndarray, color: np.ndarray) -> Any:
    """A PointCloud object of positions (N, 3), radii (N,) and colours (N, 4), all float32."""
    modern = hasattr(bpy.types.PointCloud, "resize")
    if modern:
        data = bpy.data.pointclouds.new("Points")
        data.resize(len(position))
        data.attributes["position"].data.foreach_set("vector", position.ravel())
    else:
        data = bpy.data.meshes.new("Points")
        data.vertices.add(len(position))
        data.vertices.foreach_set("co", position.ravel())
    made = data.attributes.get("radius") or data.attributes.new("radius", "FLOAT", "POINT")
    made.data.foreach_set("value", radius)
    data.attributes.new("Col", "FLOAT_COLOR", "POINT").data.foreach_set("color", color.ravel())
    ob = link(bpy.data.objects.new("Points", data))
    if modern:
        return ob
    bpy.context.view_layer.objects.active = ob
    ob.select_set(True)
    bpy.ops.object.convert(target="POINTCLOUD")
    return bpy.context.object


SCENES: dict[str, Callable[[Path | None], None]] = {
    "cube": default_cube,
    "dragon": dragon(subdivided=False),
    "dragon_fine": dragon(subdivided=True),
    "truck": truck,
    "points_1m": points(1_000_000),
    "points_10m": points(10_000_000),
}
