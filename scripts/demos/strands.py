"""Build scenes of strands, as .blend files: a bevelled curve, a few strands, many hairs, and hair of particles.

    python -m scripts.demos.strands --output out/

`python -m scripts.studies.sheet out/*.blend` draws them beside Cycles.
"""

import argparse
from pathlib import Path

import bpy
import numpy as np

import pointsplat_addon
from scripts.common.process import run
from scripts.demos.park import material

SIZE = 256, 192
HAIRS = 5_000


def knot(rng: np.random.Generator) -> None:
    """A curve of two turns, bevelled to a tube."""
    u = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    place = np.stack([(2 + np.cos(3 * u)) * np.cos(2 * u), (2 + np.cos(3 * u)) * np.sin(2 * u), np.sin(3 * u)], axis=1)
    data = bpy.data.curves.new("knot", "CURVE")
    data.dimensions, data.bevel_depth, data.resolution_u, data.bevel_resolution = "3D", 0.12, 12, 8
    spline = data.splines.new("NURBS")
    spline.points.add(len(u) - 1)
    spline.points.foreach_set("co", np.column_stack([0.38 * place, np.ones(len(u))]).astype(np.float32).ravel())
    spline.use_cyclic_u, spline.order_u = True, 4
    linked("knot", data, (0.1, 0.35, 0.7))


def blades(rng: np.random.Generator) -> None:
    """50 strands, thin at their ends, that bend over."""
    root = np.stack([rng.uniform(-1, 1, 50), rng.uniform(-0.6, 0.6, 50), np.full(50, -0.9)], axis=1)
    lean = rng.normal(0, 0.5, (50, 2))
    u = np.linspace(0, 1, 9)
    place = root[:, None] + np.stack(
        [*(lean[:, i, None] * u**2 for i in (0, 1)), np.broadcast_to(1.7 * u, (50, 9))], axis=2
    )
    strands("blades", place, np.broadcast_to(0.05 * (1 - u) + 0.002, (50, 9)), (0.2, 0.5, 0.1))


def fur(rng: np.random.Generator) -> None:
    """A ball of brown hairs."""
    way = rng.normal(size=(HAIRS, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    u = np.linspace(0, 1, 7)[:, None]
    place = way[:, None] * (0.6 + 0.4 * u) - np.array([0, 0, 0.25]) * u**2 + 0.05 * u * rng.normal(size=(HAIRS, 1, 3))
    strands("fur", place, np.broadcast_to(0.006 * (1 - 0.8 * u[:, 0]), (HAIRS, 7)), (0.25, 0.12, 0.05))


def particles(rng: np.random.Generator) -> None:
    """Hair of a particle system on a ball, which is shown."""
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.6, segments=48, ring_count=24)
    bpy.ops.object.shade_smooth()
    item = bpy.context.object
    item.data.materials.append(material("skin", (0.7, 0.5, 0.4)))
    item.modifiers.new("hair", "PARTICLE_SYSTEM")
    made = item.particle_systems[0].settings
    made.type, made.count, made.hair_length = "HAIR", 1000, 0.35
    made.root_radius, made.tip_radius, made.radius_scale = 1.0, 0.2, 0.02


def strands(name: str, place: np.ndarray, radius: np.ndarray, color: tuple[float, float, float]) -> None:
    """A Curves object of (S, K, 3) with radii (S, K)."""
    data = bpy.data.hair_curves.new(name)
    data.add_curves([place.shape[1]] * len(place))
    data.position_data.foreach_set("vector", place.astype(np.float32).ravel())
    width = data.attributes.get("radius") or data.attributes.new("radius", "FLOAT", "POINT")
    width.data.foreach_set("value", radius.astype(np.float32).ravel())
    linked(name, data, color)


def linked(name: str, data: bpy.types.ID, color: tuple[float, float, float]) -> None:
    data.materials.append(material(name, color, 0.4))
    bpy.context.collection.objects.link(bpy.data.objects.new(name, data))


def stage() -> None:
    """A camera, a sun, a lamp and a dim world."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    data = bpy.data.cameras.new("camera")
    scene.camera = bpy.data.objects.new("camera", data)
    scene.camera.location, scene.camera.rotation_euler = (0, -5, 0), (np.pi / 2, 0, 0)
    scene.collection.objects.link(scene.camera)
    data.lens, data.sensor_fit, data.sensor_height = 50, "VERTICAL", 24
    for kind, energy, angles in (("SUN", 3.0, (0.6, 0.4, 0)), ("SUN", 0.6, (1.2, -0.9, 0))):
        light = bpy.data.lights.new("sun", kind)
        light.energy, light.angle = energy, 0.01
        item = bpy.data.objects.new("sun", light)
        item.rotation_euler = angles
        scene.collection.objects.link(item)
    scene.world = bpy.data.worlds.new("black")
    scene.world.color = (0, 0, 0)
    scene.render.film_transparent = True
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_mode, scene.render.image_settings.color_depth = "RGBA", "32"
    scene.cycles_curves.shape = "THICK"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, required=True)
    folder = parser.parse_args().output.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    pointsplat_addon.register()
    for make in (knot, blades, fur, particles):
        stage()
        make(np.random.default_rng(3))
        bpy.ops.wm.save_as_mainfile(filepath=str(folder / f"{make.__name__}.blend"))


if __name__ == "__main__":
    run(main)
