"""Build a scene of an airborne scan with a truck on its path, under sun and sky.

python -m scripts.demos.scan SCAN.laz TRUCK.obj --output out/scan.blend [--at X Y] [--heading DEGREES]

--at: map coordinates at which the truck stands, the middle of the scan by default. Render it by
`python scripts/render.py out/scan.blend --output out/scan.png`.
"""

import argparse
import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Euler, Vector

import pointsplat_addon
from pointsplat_addon.host.convert.selection.filters import ORIGIN
from scripts.common.process import run

LENGTH = 21.0  # metres, of the truck with its trailer
NEAR = 4.0  # metres around the truck whose lowest points are its ground
AIM = Vector((3.0, 7.0, 3.4))  # what the camera looks at, seen from the truck
EYE = Vector((-15.0, -19.0, 6.0))


def scan_object(path: Path) -> tuple[bpy.types.Object, np.ndarray]:
    """The scan as an object around the origin of the scene, and its points (N, 3) in world space."""
    bpy.ops.pointsplat.import_points(filepath=str(path))
    ob = bpy.context.object
    ob.location = (0, 0, 0)
    found = np.empty(3 * len(ob.data.points), np.float32)
    ob.data.attributes["position"].data.foreach_get("vector", found)
    return ob, found.reshape(-1, 3) * np.array(ob.scale)


def truck_object(path: Path, at: Vector, heading: float) -> None:
    """The truck, whose wheels stand at a point."""
    before = set(bpy.data.objects)
    bpy.ops.wm.obj_import(filepath=str(path))
    parts = [ob for ob in bpy.data.objects if ob not in before]
    bpy.context.view_layer.update()
    corners = np.array([ob.matrix_world @ Vector(corner) for ob in parts for corner in ob.bound_box])
    low, high = corners.min(axis=0), corners.max(axis=0)
    scale = LENGTH / float((high - low).max())
    parent = bpy.data.objects.new("Truck", None)
    bpy.context.scene.collection.objects.link(parent)
    for ob in parts:
        ob.parent = parent
    parent.rotation_euler = (0, 0, np.radians(heading))
    parent.scale = (scale,) * 3
    middle = Vector(((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2])) * scale
    parent.location = at - Euler(parent.rotation_euler).to_matrix() @ middle


def light(scene: bpy.types.Scene) -> None:
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.data.energy, sun.data.angle, sun.data.color = 4.0, np.radians(0.5), (1.0, 0.93, 0.82)
    sun.rotation_euler = (np.radians(52), 0.0, np.radians(-20))
    scene.collection.objects.link(sun)
    world = scene.world = bpy.data.worlds.new("Sky")
    if not world.node_tree:
        world.use_nodes = True
    background = world.node_tree.nodes["Background"]
    background.inputs["Color"].default_value = (0.25, 0.5, 1.0, 1.0)
    background.inputs["Strength"].default_value = 0.45


def build(scan: Path, truck: Path, at: list[float] | None, heading: float) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    pointsplat_addon.register()
    scene = bpy.context.scene
    ob, points = scan_object(scan)
    place = points.mean(axis=0)[:2] if at is None else (np.array(at) - np.array(ob[ORIGIN])[:2]) * ob.scale[0]
    around = np.linalg.norm(points[:, :2] - place, axis=1) < NEAR
    foot = Vector((*place, float(np.quantile(points[around, 2], 0.2)) if around.any() else 0.0))
    truck_object(truck, foot, heading)
    light(scene)
    camera = scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location = foot + EYE
    camera.rotation_euler = (AIM - EYE).to_track_quat("-Z", "Y").to_euler()
    camera.data.lens, camera.data.clip_end = 26.0, 2000.0
    scene.collection.objects.link(camera)
    scene.view_settings.view_transform = "Standard"
    scene.render.engine = "POINTSPLAT"
    scene.render.resolution_x, scene.render.resolution_y = 800, 450


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scan", type=Path)
    parser.add_argument("truck", type=Path)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--at", type=float, nargs=2)
    parser.add_argument("--heading", type=float, default=0.0)
    arguments = parser.parse_args(sys.argv[1:])
    build(arguments.scan, arguments.truck, arguments.at, arguments.heading)
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(arguments.output.resolve()))


if __name__ == "__main__":
    run(main)
