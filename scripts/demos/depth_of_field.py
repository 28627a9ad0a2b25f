"""Balls on a chequered floor before distant lamps, with depth of field: the strip of docs/notes/depth_of_field.md.

    python -m scripts.demos.depth_of_field --output docs/notes/images/depth_of_field.jpg [--samples 256] [--blend FILE]

From the left: without a lens, 16 samples through it, SAMPLES, and Cycles with as many.
"""

import argparse
import tempfile
from pathlib import Path

import bpy
import numpy as np
from mathutils import Euler
from PIL import Image

import pointsplat_addon
from scripts.common.images import displayed
from scripts.common.process import run
from scripts.demos.park import material

SIZE = 256, 192
GAP = 4  # pixels between pictures
LAMPS = 26
BALLS = (  # place on the floor, radius, colour; the second is in focus
    (-1.0, -3.6, 0.35, (0.8, 0.25, 0.15)),
    (0.1, -1.5, 0.55, (0.85, 0.75, 0.5)),
    (1.35, 1.2, 0.7, (0.15, 0.4, 0.7)),
    (-1.9, 3.5, 0.8, (0.2, 0.55, 0.25)),
)


def floor(cells: int, size: float) -> None:
    """A board of squares of two materials."""
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=cells, y_subdivisions=cells, size=size, location=(0, size / 4, 0))
    mesh = bpy.context.object.data
    for look in (material("light square", (0.5, 0.48, 0.45)), material("dark square", (0.12, 0.1, 0.1))):
        mesh.materials.append(look)
    row, column = np.divmod(np.arange(cells * cells), cells)
    mesh.polygons.foreach_set("material_index", ((row + column) % 2).astype(np.int32))


def ball(location: tuple[float, float, float], radius: float, look: bpy.types.Material, fine: int) -> None:
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=fine, radius=radius, location=location)
    bpy.ops.object.shade_smooth()
    bpy.context.object.data.materials.append(look)


def glowing(name: str, color: tuple[float, float, float]) -> bpy.types.Material:
    look = material(name, color)
    node = next(n for n in look.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    node.inputs["Emission Color"].default_value = (*color, 1)
    node.inputs["Emission Strength"].default_value = 60
    return look


def build() -> bpy.types.Scene:
    """The scene, seen through six blades wide open."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    pointsplat_addon.register()
    scene = bpy.context.scene
    floor(48, 36.0)
    for i, (x, y, radius, color) in enumerate(BALLS):
        ball((x, y, radius), radius, material(f"ball {i}", color, 0.35), 5)
    looks = [glowing(f"lamp {i}", c) for i, c in enumerate(((1, 0.6, 0.25), (1, 0.8, 0.5), (0.5, 0.7, 1)))]
    rng = np.random.default_rng(3)
    for i in range(LAMPS):
        ball((rng.uniform(-6, 6), 14.0, rng.uniform(1.2, 3.6)), 0.06, looks[i % len(looks)], 2)
    sun = bpy.data.lights.new("sun", "SUN")
    sun.energy, sun.angle = 2.5, 0.02
    lamp = bpy.data.objects.new("sun", sun)
    lamp.rotation_euler = (0.7, 0.3, 0.3)
    scene.collection.objects.link(lamp)
    scene.world = bpy.data.worlds.new("dusk")
    if not scene.world.node_tree:
        scene.world.use_nodes = True
    sky = next(n for n in scene.world.node_tree.nodes if n.type == "BACKGROUND")
    sky.inputs["Color"].default_value = (0.03, 0.04, 0.07, 1)
    data = bpy.data.cameras.new("camera")
    scene.camera = bpy.data.objects.new("camera", data)
    scene.camera.location, scene.camera.rotation_euler = (0, -6, 1.3), Euler((1.43, 0, 0))
    scene.collection.objects.link(scene.camera)
    data.lens = 50
    data.dof.use_dof, data.dof.focus_distance, data.dof.aperture_fstop = True, 4.5, 0.18
    data.dof.aperture_blades, data.dof.aperture_rotation = 6, 0.2
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    scene.pointsplat.dof_method, scene.pointsplat.use_indirect = "LENS_SAMPLES", False
    cycles = scene.cycles
    cycles.device, cycles.max_bounces = "CPU", 0
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    return scene


def draw(scene: bpy.types.Scene, engine: str, samples: int, lens: bool) -> np.ndarray:
    """(H, W, 3) scene-linear, bottom row first."""
    scene.camera.data.dof.use_dof, scene.render.engine = lens, engine
    scene.cycles.samples = scene.pointsplat.samples = samples
    with tempfile.TemporaryDirectory() as folder:
        scene.render.filepath = str(Path(folder) / "picture.exr")
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(scene.render.filepath)
        pixels = np.empty(len(image.pixels), np.float32)
        image.pixels.foreach_get(pixels)
        bpy.data.images.remove(image)
    return pixels.reshape(SIZE[1], SIZE[0], -1)[..., :3]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--samples", type=int, default=256)
    parser.add_argument("--blend", type=Path, help="write the scene, too")
    arguments = parser.parse_args()
    scene = build()
    if arguments.blend:
        bpy.ops.wm.save_as_mainfile(filepath=str(arguments.blend.resolve()))
    wanted = (("POINTSPLAT", 64, False), ("POINTSPLAT", 16, True), ("POINTSPLAT", arguments.samples, True),
              ("CYCLES", arguments.samples, True))  # fmt: skip
    pictures = [displayed(draw(scene, *one)) for one in wanted]
    gap = np.ones((SIZE[1], GAP, 3))
    strip = np.hstack([part for picture in pictures for part in (picture, gap)][:-1])
    Image.fromarray((255 * strip[::-1] + 0.5).astype(np.uint8)).save(arguments.output, quality=92)


if __name__ == "__main__":
    run(main)
