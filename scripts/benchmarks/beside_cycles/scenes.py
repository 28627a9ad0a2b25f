"""The scenes of scripts/benchmarks/beside_cycles: each becomes a .blend file that both engines render.

    python -m scripts.benchmarks.beside_cycles.scenes NAME FILE.blend --data DIR [--shading lambert|glow|own] ...

Both engines mean the same by what is in them: no bounces, a black world, a transparent film, one pixel filter, and
materials that are Lambert's. The camera orbits about the cursor.
"""

from __future__ import annotations

import argparse
import importlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from scripts.benchmarks.beside_cycles import survey
from scripts.benchmarks.beside_cycles.everything import everything
from scripts.benchmarks.beside_cycles.landscape import landscape
from scripts.benchmarks.beside_cycles.room import room
from scripts.common.point_objects import point_cloud_object
from scripts.common.process import run
from scripts.common.volume_objects import surface
from scripts.studies import gallery

models = importlib.import_module("scripts.error_vs_time.scenes")  # which names things of the tests' data
LAMBERT, GLOW, OWN = SHADINGS = ("lambert", "glow", "own")
TRANSPARENT = 256  # surfaces that a ray of Cycles passes: as many as there may be


@dataclass(frozen=True)
class Look:
    """What may be changed about a scene, to see what a difference comes from."""

    shading: str = LAMBERT  # or radiance without light (GLOW), or the materials that the files have (OWN)
    shadows: bool = True
    sun_angle: float = 0.0  # radians
    flat: bool = False  # no smooth normals

    def suffix(self) -> str:
        """Of names of files: nothing for the default."""
        angle = f"-sun{self.sun_angle:g}" if self.sun_angle else ""
        shading = f"-{self.shading}" if self.shading != LAMBERT else ""
        return shading + "-unshadowed" * (not self.shadows) + angle + "-flat" * self.flat


@dataclass(frozen=True)
class Kind:
    """Who builds a scene, of a square picture's size and the folder of data; pixels; a file that it needs of DATA."""

    build: Callable[[int, Path], None]
    size: tuple[int, int] = (512, 512)
    needs: str = ""


# ---------------------------------------------------------------------------- points


def hills(count: int, among: bool, size: int, data: Path) -> None:
    """Balls of radius half their spacing over 100 m of hills and boxes, from a scanner's height or among the boxes."""
    scene = gallery.studio(size)
    position, color, spacing = landscape(count)
    cloud = point_cloud_object("Scan", position, spacing / 2, color)
    cloud.data.materials.append(painted("Scan"))
    camera = scene.camera
    camera.data.angle, camera.data.clip_end = math.radians(50), 500.0
    aim(camera, *(((3.0, 2.0, 14.0), (13.0, 5.0, 10.5)) if among else ((34.0, -62.0, 34.0), (0.0, 2.0, -2.0))))
    scene.objects["Sun"].rotation_euler = (math.radians(40), math.radians(25), 0.0)


def scan(spacings: float, size: int, data: Path) -> None:
    """A scanned building as balls, their radius in median spacings of its points."""
    from scipy.spatial import KDTree

    models.before_camera(size, True)
    position, color = models.scan((data / models.SCAN_FILE).resolve())
    apart = float(np.median(KDTree(position).query(position, 2)[0][:, 1]))
    cloud = point_cloud_object("Scan", position, spacings * apart, color)
    cloud.data.materials.append(painted("Scan"))
    aim(bpy.context.scene.camera, (0.0, 0.0, 3.5), (0.0, 0.0, 0.0))
    bpy.context.scene.objects["Sun"].rotation_euler = (math.radians(-35), math.radians(30), 0.0)


def from_the_air(count: int, size: int, data: Path) -> None:
    """A real tile of a survey, repeated, as balls as large as imports make them."""
    from pointsplat_addon.core.surface.nearest import scan_spacing

    scene = gallery.studio(size)
    position, color = survey.survey((data / survey.FILE).resolve(), count)
    cloud = point_cloud_object("Scan", position, 0.5 * scan_spacing(position), color)
    cloud.data.materials.append(painted("Scan"))
    scene.camera.data.angle, scene.camera.data.clip_end = math.radians(50), 3000.0
    aim(scene.camera, (-150.0, -620.0, 260.0), (0.0, -120.0, 0.0))
    scene.objects["Sun"].rotation_euler = (math.radians(40), math.radians(25), 0.0)


def painted(name: str) -> bpy.types.Material:
    """A material of the attribute "Color"."""
    made = surface(name)
    nodes = made.node_tree.nodes
    source = nodes.new("ShaderNodeAttribute")
    source.attribute_name = "Color"
    made.node_tree.links.new(source.outputs["Color"], nodes["Principled BSDF"].inputs["Base Color"])
    return made


# ---------------------------------------------------------------------------- meshes


def of_error_vs_time(name: str, size: int, data: Path) -> None:
    """A scene of scripts/error_vs_time."""
    getattr(models, name)(size, data, Path())


def subdivided_dragon(size: int, data: Path) -> None:
    """3,216,496 triangles: each of the dragon's became sixteen."""
    models.dragon(size, data, Path())
    model = bpy.context.selected_objects[0]
    modifier = model.modifiers.new("Subdivision", "SUBSURF")
    modifier.subdivision_type, modifier.levels, modifier.quality = "SIMPLE", 2, 1
    # Quads of triangles would be other triangles in each engine.
    model.modifiers.new("Triangles", "TRIANGULATE")
    with bpy.context.temp_override(object=model, active_object=model):
        for each in list(model.modifiers):
            bpy.ops.object.modifier_apply(modifier=each.name)


def cards(size: int, data: Path) -> None:
    """A small tree whose leaves are pictures with alpha."""
    models.model(data / "bonsai-tree/bonsai-tree.obj", size, shadows=True)
    add_alpha()


def add_alpha() -> None:
    """Give the materials of images with alpha that alpha."""
    for material in bpy.data.materials:
        for node in [n for n in material.node_tree.nodes if n.type == "TEX_IMAGE"] if material.node_tree else []:
            if node.image.depth == 32:
                principled = material.node_tree.nodes["Principled BSDF"]
                material.node_tree.links.new(node.outputs["Alpha"], principled.inputs["Alpha"])


def grove(size: int, data: Path) -> None:
    """Sixteen maples of one mesh on a floor."""
    models.maple(size, data, Path())
    scene, [tree] = bpy.context.scene, bpy.context.selected_objects
    bpy.context.view_layer.update()  # bounds are those of the file until then
    foot = min(corner[2] for corner in tree.bound_box)
    rng = np.random.default_rng(2)
    for i in range(16):
        item = tree if i == 0 else tree.copy()
        if i:
            scene.collection.objects.link(item)
        item.location = (*(1.1 * np.array(divmod(i, 4)) + rng.uniform(-0.2, 0.2, 2)), -foot)
        item.rotation_euler = 0.0, 0.0, rng.uniform(0, 2 * np.pi)
    bpy.ops.mesh.primitive_plane_add(size=12, location=(1.6, 1.6, 0))
    scene.camera.data.clip_end = 100.0
    aim(scene.camera, (5.5, -4.5, 3.0), (1.5, 1.5, 0.5))


def cube(size: int, data: Path) -> None:
    """Blender's own first scene, with its light of 0.1 m."""
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=False)
    bpy.context.scene.cursor.location = 0.0, 0.0, 0.0


# ---------------------------------------------------------------------------- what all have in common


def aim(camera: Any, eye: tuple[float, float, float], target: tuple[float, float, float]) -> None:
    """Put the camera there, and let it look at the target."""
    from mathutils import Vector

    camera.location = eye
    camera.rotation_euler = (Vector(target) - Vector(eye)).to_track_quat("-Z", "Y").to_euler()
    camera.data.clip_start = 0.05
    bpy.context.scene.cursor.location = target


def make_alike(scene: Any, look: Look) -> None:
    """Leave what both engines define in the same way, and set what `look` says."""
    if scene.world is None:
        scene.world = bpy.data.worlds.new("World")
    if not scene.world.node_tree:
        scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0)
    scene.render.film_transparent = True
    cycles = scene.cycles
    cycles.device, cycles.max_bounces, cycles.transparent_max_bounces = "CPU", 0, TRANSPARENT
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.pixel_filter_type, cycles.filter_width = "BLACKMAN_HARRIS", scene.render.filter_size
    image = scene.render.image_settings
    if hasattr(image, "media_type"):
        image.media_type = "IMAGE"
    image.file_format, image.color_mode, image.color_depth, image.exr_codec = "OPEN_EXR", "RGBA", "32", "NONE"
    scene.render.use_file_extension = False
    for light in (item for item in scene.objects if item.type == "LIGHT"):
        light.visible_camera = False
        light.data.use_shadow = look.shadows
        if hasattr(light.data.cycles, "cast_shadow"):  # until Blender 4.5 Cycles had a switch of its own
            light.data.cycles.cast_shadow = look.shadows
        if light.data.type == "SUN":
            light.data.angle = look.sun_angle
    for item in (item for item in scene.objects if item.type in ("MESH", "POINTCLOUD", "CURVES")):
        if not item.data.materials:
            item.data.materials.append(surface("Grey"))
        if look.flat and item.type == "MESH":
            item.data.shade_flat()
    for material in bpy.data.materials:
        tree = material.node_tree
        shown = tree and "Principled BSDF" in tree.nodes and tree.get_output_node("ALL")
        if look.shading != OWN and shown:  # Blender's first file has a material without an output
            simplify(material.node_tree, look.shading == GLOW)


def simplify(tree: Any, glows: bool) -> None:
    """Lambert's material, or radiance, of a Principled one's colour and alpha."""
    nodes, links = tree.nodes, tree.links
    principled = nodes["Principled BSDF"]
    plain = nodes.new("ShaderNodeEmission" if glows else "ShaderNodeBsdfDiffuse")
    color, alpha = principled.inputs["Base Color"], principled.inputs["Alpha"]
    plain.inputs["Color"].default_value = color.default_value
    if color.links:
        links.new(color.links[0].from_socket, plain.inputs["Color"])
    shader = plain.outputs[0]
    if alpha.links or alpha.default_value < 1:
        mix = nodes.new("ShaderNodeMixShader")
        mix.inputs["Fac"].default_value = alpha.default_value
        if alpha.links:
            links.new(alpha.links[0].from_socket, mix.inputs["Fac"])
        links.new(nodes.new("ShaderNodeBsdfTransparent").outputs[0], mix.inputs[1])
        links.new(shader, mix.inputs[2])
        shader = mix.outputs[0]
    links.new(shader, tree.get_output_node("ALL").inputs["Surface"])
    nodes.remove(principled)


KINDS = {
    "hills-1M": Kind(partial(hills, 1_000_000, False), (960, 540)),
    "hills-10M": Kind(partial(hills, 10_000_000, False), (960, 540)),
    "hills-inside": Kind(partial(hills, 1_000_000, True), (960, 540)),
    "scan-sparse": Kind(partial(scan, 0.25), needs=models.SCAN_FILE),
    "scan-touching": Kind(partial(scan, 0.5), needs=models.SCAN_FILE),
    "scan-dense": Kind(partial(scan, 1.5), needs=models.SCAN_FILE),
    "scan-10M": Kind(partial(from_the_air, 10_000_000), (960, 540), survey.FILE),
    "bunny": Kind(partial(of_error_vs_time, "bunny"), needs="bunny_bun_zipper.ply"),
    "dragon": Kind(partial(of_error_vs_time, "dragon"), needs="dragon_vrip_res2.ply.gz"),
    "truck": Kind(partial(of_error_vs_time, "truck"), needs="peterbilt"),
    "plant": Kind(partial(of_error_vs_time, "plant"), needs="decorativePlant"),
    "maple": Kind(partial(of_error_vs_time, "maple"), needs="japaneseMaple"),
    "railing": Kind(partial(of_error_vs_time, "railing"), needs="pedestrianRailing1"),
    "dragon-3M": Kind(subdivided_dragon, needs="dragon_vrip_res2.ply.gz"),
    "cards": Kind(cards, needs="bonsai-tree"),
    "grove": Kind(grove, needs="japaneseMaple"),
    "hair": Kind(partial(of_error_vs_time, "hair"), needs=models.HAIR_FILE),
    "room": Kind(lambda size, data: room(0.3, size, aim), (640, 360)),
    "room-flush": Kind(lambda size, data: room(0.02, size, aim), (640, 360)),
    "cube": Kind(cube, (640, 360)),
    "everything": Kind(lambda size, data: everything(size, data, aim, add_alpha, painted), (960, 540), "peterbilt"),
}


def make(name: str, path: Path, data: Path, look: Look, size: tuple[int, int]) -> None:
    """Build a scene and save it. Images are packed."""
    kind = KINDS[name]
    kind.build(max(size), data)
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.render.resolution_percentage = 100
    make_alike(scene, look)
    path.parent.mkdir(parents=True, exist_ok=True)
    bpy.ops.file.pack_all()
    bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=False)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("name", choices=KINDS)
    parser.add_argument("path", type=Path)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--size", type=int, nargs=2, required=True)
    add_look(parser)
    options = parser.parse_args()
    make(options.name, options.path.resolve(), options.data.resolve(), look_of(options), tuple(options.size))


def add_look(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--shading", choices=SHADINGS, default=LAMBERT)
    parser.add_argument("--no-shadows", dest="shadows", action="store_false")
    parser.add_argument("--sun-angle", type=float, default=0.0, metavar="RADIANS")
    parser.add_argument("--flat", action="store_true", help="no smooth normals")


def look_of(options: argparse.Namespace) -> Look:
    return Look(options.shading, options.shadows, options.sun_angle, options.flat)


if __name__ == "__main__":
    import pointsplat_addon

    pointsplat_addon.register()  # scenes of scripts/error_vs_time choose some of its settings
    run(main)
