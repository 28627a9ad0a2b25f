"""Scenes with fixed cameras in which much light is indirect, in Blender.

    python -m scripts.studies.indirect.scenes NAME FILE.blend --data DIR [--size 320x180] [--bounces 3]

DIR holds real meshes and scans; .vdb files of clouds are written next to FILE.blend. Light bounces `--bounces` times,
in Cycles without clamps and caustics.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Vector

from scripts.common.process import run
from scripts.common.volume_objects import medium, surface, volume_object, write_vdb
from scripts.demos.translucent import cumulus
from scripts.render import size
from scripts.studies import gallery

Triple = tuple[float, float, float]


def begin(wide: int, high: int) -> bpy.types.Scene:
    """An empty scene with a camera, and a black world."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = wide, high
    scene.view_settings.view_transform = "Raw"
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    camera.data.clip_start, camera.data.clip_end = 0.02, 1000.0
    scene.world = bpy.data.worlds.new("World")
    return scene


def sky(color: Triple, strength: float = 1.0) -> None:
    world = bpy.context.scene.world
    world.use_nodes = True
    node = world.node_tree.nodes["Background"]
    node.inputs["Color"].default_value, node.inputs["Strength"].default_value = (*color, 1.0), strength


def picture_sky(strength: float = 1.0) -> None:
    """An environment picture: bright above, brighter at one side, brown below."""
    width, height = 256, 128
    v, u = np.mgrid[0:height, 0:width]
    up, turn = (v + 0.5) / height * math.pi - math.pi / 2, (u + 0.5) / width * 2 * math.pi
    blue = (
        np.stack([0.35 + 0 * up, 0.5 + 0 * up, 0.8 + 0 * up], axis=2)
        * (0.6 + 0.6 * np.sin(np.maximum(up, 0)))[..., None]
    )
    ground = np.broadcast_to(np.array([0.2, 0.16, 0.12]), blue.shape)
    glow = np.exp(6 * (np.cos(up - 0.6) * np.cos(turn - 2.0) - 1))[..., None] * np.array([3.0, 2.4, 1.6])
    color = np.where((up > 0)[..., None], blue + glow, ground)
    image = bpy.data.images.new("Sky", width, height, float_buffer=True)
    image.colorspace_settings.name = "Linear Rec.709"
    image.pixels.foreach_set(np.dstack([color, np.ones((height, width))]).astype(np.float32).reshape(-1))
    image.pack()
    world = bpy.context.scene.world
    world.use_nodes = True
    tree = world.node_tree
    node = tree.nodes.new("ShaderNodeTexEnvironment")
    node.image = image
    tree.links.new(node.outputs["Color"], tree.nodes["Background"].inputs["Color"])
    tree.nodes["Background"].inputs["Strength"].default_value = strength


def aim(place: Triple, at: Triple, angle: float = 0.9) -> None:
    camera = bpy.context.scene.camera
    camera.location = place
    camera.rotation_euler = (Vector(at) - Vector(place)).to_track_quat("-Z", "Y").to_euler()
    camera.data.angle = angle


def lamp(kind: str, energy: float, place: Triple = (0, 0, 5), turn: Triple = (0, 0, 0), across: float = 0.0) -> Any:
    data = bpy.data.lights.new(kind.title(), kind)
    data.energy = energy
    if kind == "AREA":
        data.size = across
    elif kind == "SUN":
        data.angle = across
    else:
        data.shadow_soft_size = across
    item = bpy.data.objects.new(kind.title(), data)
    item.location, item.rotation_euler = place, turn
    bpy.context.scene.collection.objects.link(item)
    return item


def shown(look: Any) -> Any:
    item = bpy.context.object
    item.data.materials.clear()
    item.data.materials.append(look)
    return item


def matte(name: str, color: Triple) -> Any:
    """A surface that scatters light and mirrors none."""
    return surface(name, color, Roughness=1.0, **{"Specular IOR Level": 0.0})


def box(look: Any, low: Triple, high: Triple, turn: float = 0.0) -> Any:
    bpy.ops.mesh.primitive_cube_add(size=1)
    item = shown(look)
    item.location = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
    item.scale = [b - a for a, b in zip(low, high, strict=True)]
    item.rotation_euler = (0, 0, turn)
    return item


def plane(look: Any, across: float, place: Triple = (0, 0, 0), turn: Triple = (0, 0, 0)) -> Any:
    bpy.ops.mesh.primitive_plane_add(size=across, location=place, rotation=turn)
    return shown(look)


def stand(item: Any, place: tuple[float, float], height: float, turn: float = 0.0) -> None:
    from scripts.benchmarks.beside_cycles.everything import stand as stand_on

    stand_on(item, place, height, turn)


# ---------------------------------------------------------------------------- scenes


def room(data: Path) -> None:
    """A room with a window, lit through it by a sun and a sky."""
    wall, floor, red = (
        matte("Wall", (0.75, 0.72, 0.68)),
        matte("Floor", (0.4, 0.28, 0.18)),
        matte("Red", (0.6, 0.1, 0.08)),
    )
    box(floor, (-2.5, -2.5, -0.2), (2.5, 2.5, 0.0))
    box(wall, (-2.5, -2.5, 2.6), (2.5, 2.5, 2.8))
    box(wall, (-2.7, -2.7, -0.2), (-2.5, 2.7, 2.8))
    box(wall, (-2.7, 2.5, -0.2), (2.7, 2.7, 2.8))
    box(wall, (-2.7, -2.7, -0.2), (2.7, -2.5, 2.8))
    for low, high in (((2.5, -2.7, -0.2), (2.7, 2.7, 0.9)), ((2.5, -2.7, 2.1), (2.7, 2.7, 2.8)),
                      ((2.5, -2.7, 0.9), (2.7, -1.0, 2.1)), ((2.5, 1.0, 0.9), (2.7, 2.7, 2.1))):  # fmt: skip
        box(wall, low, high)
    box(red, (-1.6, 0.4, 0.0), (-0.6, 1.4, 1.0), 0.4)
    box(wall, (-0.2, -0.6, 0.0), (0.5, 0.1, 0.6), -0.3)
    lamp("SUN", 12.0, turn=(0.0, math.radians(62), math.radians(14)), across=0.01)
    sky((0.6, 0.75, 1.0), 2.5)
    aim((-1.2, -2.2, 1.5), (0.3, 1.2, 0.9), 1.3)


def walls(data: Path) -> None:
    """A box of coloured walls with an area lamp."""
    white, red, green = (
        matte("White", (0.73, 0.73, 0.73)),
        matte("Red", (0.63, 0.06, 0.05)),
        matte("Green", (0.14, 0.45, 0.09)),
    )
    plane(white, 2.0)
    plane(white, 2.0, (0, 0, 2), (math.pi, 0, 0))
    plane(white, 2.0, (0, 1, 1), (math.pi / 2, 0, 0))
    plane(red, 2.0, (-1, 0, 1), (0, math.pi / 2, 0))
    plane(green, 2.0, (1, 0, 1), (0, -math.pi / 2, 0))
    box(white, (-0.65, -0.1, 0.0), (-0.05, 0.5, 1.2), 0.3)
    box(white, (0.1, -0.65, 0.0), (0.7, -0.05, 0.6), -0.3)
    lamp("AREA", 22.0, (0, 0, 1.98), across=0.5)
    aim((0, -3.4, 1.0), (0, 0, 1.0), 0.72)


def dragon(data: Path) -> None:
    """A scanned figure on a floor under a sky and a sun."""
    plane(matte("Floor", (0.5, 0.48, 0.45)), 40)
    item = gallery.read(data / "mesh/dragon_vrip_res2.ply.gz")
    item.data.materials.clear()
    item.data.materials.append(surface("Dragon", (0.5, 0.32, 0.12), Roughness=0.4))
    stand(item, (0, 0), 1.2, 0.5)
    box(matte("Red", (0.6, 0.1, 0.08)), (0.9, 0.2, 0.0), (1.5, 0.8, 0.9), 0.3)
    lamp("SUN", 2.0, turn=(0.7, 0.3, 0.4), across=0.01)
    sky((0.45, 0.55, 0.75), 0.8)
    aim((0.6, -3.4, 1.5), (0.15, 0, 0.5), 0.75)


def truck(data: Path) -> None:
    """A lorry under an environment picture."""
    plane(matte("Ground", (0.3, 0.3, 0.3)), 60)
    item = gallery.read(data / "mesh/peterbilt/peterbilt.obj")
    stand(item, (0, 0), 1.4, 0.8)
    picture_sky(0.8)
    aim((2.6, -3.6, 1.5), (0, 0, 0.6), 0.85)


def fur(data: Path) -> None:
    """A ball of fur under a sky."""
    plane(matte("Floor", (0.5, 0.48, 0.45)), 20)
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.5, location=(0, 0, 0.62), segments=48, ring_count=24)
    shown(matte("Skin", (0.3, 0.18, 0.1)))
    rng = np.random.default_rng(3)
    count, points = 6000, 6
    z, turn = rng.uniform(-1, 1, count), rng.uniform(0, 2 * np.pi, count)
    root = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1)
    bend = rng.normal(0, 0.25, (count, 3)) + np.array([0, 0, -0.4])
    steps = np.linspace(0, 1, points)[None, :, None]
    place = 0.5 * root[:, None] + 0.14 * steps * (root[:, None] + steps * bend[:, None]) + np.array([0, 0, 0.62])
    curves = bpy.data.hair_curves.new("Fur")
    curves.add_curves([points] * count)
    curves.attributes["position"].data.foreach_set("vector", place.astype(np.float32).reshape(-1))
    radius = curves.attributes.new("radius", "FLOAT", "POINT")
    radius.data.foreach_set("value", np.tile(np.linspace(0.003, 0.0006, points), count).astype(np.float32))
    item = bpy.data.objects.new("Fur", curves)
    bpy.context.scene.collection.objects.link(item)
    curves.materials.append(surface("Fur", (0.4, 0.24, 0.12), Roughness=0.6))
    lamp("SUN", 1.5, turn=(0.8, 0.2, 0.4), across=0.01)
    sky((0.5, 0.6, 0.8), 0.9)
    aim((0.0, -2.6, 1.1), (0, 0, 0.55), 0.75)


def scan(data: Path) -> None:
    """A scanned building as balls, under a sky and a sun."""
    from scripts.benchmarks.beside_cycles import everything
    from scripts.common.point_objects import point_cloud_object

    plane(matte("Ground", (0.4, 0.36, 0.3)), 30)
    position, color = everything.models.scan((data / "mesh" / everything.models.SCAN_FILE).resolve())
    low, cosine = everything.LOOKS_DOWN, math.sqrt(1 - everything.LOOKS_DOWN**2)
    up, toward = position[:, 1] * cosine + position[:, 2] * low, position[:, 2] * cosine - position[:, 1] * low
    upright = np.stack([position[:, 0], -toward, up], axis=1)
    cloud = point_cloud_object("Scan", 1.5 * upright, 1.5 * 0.008, color)
    look = surface("Scan", (0.5, 0.5, 0.5), Roughness=1.0, **{"Specular IOR Level": 0.0})
    tree = look.node_tree
    node = tree.nodes.new("ShaderNodeAttribute")
    node.attribute_name = cloud.data.attributes[-1].name if "Col" not in cloud.data.attributes else "Col"
    tree.links.new(
        node.outputs["Color"], next(n for n in tree.nodes if n.type == "BSDF_PRINCIPLED").inputs["Base Color"]
    )
    cloud.data.materials.append(look)
    cloud.location = 0, 0, 1.5 * -float(upright[:, 2].min())
    lamp("SUN", 2.0, turn=(0.7, 0.3, 0.4), across=0.01)
    sky((0.5, 0.6, 0.8), 1.0)
    aim((0.3, -3.6, 1.6), (0, 0, 0.5), 0.75)


def foliage(data: Path) -> None:
    """A tree under a sky and a sun."""
    plane(matte("Ground", (0.3, 0.36, 0.2)), 40)
    stand(gallery.read(data / "mesh/japaneseMaple/japaneseMaple.obj"), (0, 0), 2.4)
    for item in bpy.data.materials:
        tree = item.node_tree
        image = next((n for n in tree.nodes if n.type == "TEX_IMAGE"), None) if tree else None
        base = next((n for n in tree.nodes if n.type == "BSDF_PRINCIPLED"), None) if tree else None
        if image and base:
            tree.links.new(image.outputs["Alpha"], base.inputs["Alpha"])
    lamp("SUN", 2.5, turn=(0.7, 0.3, 0.4), across=0.01)
    sky((0.5, 0.6, 0.8), 1.0)
    aim((0.3, -4.6, 1.6), (0, 0, 1.1), 0.75)


def street(data: Path) -> None:
    """A street between two tall walls under a sky and a sun."""
    plane(matte("Street", (0.35, 0.35, 0.36)), 60)
    left, right = matte("Left", (0.7, 0.5, 0.3)), matte("Right", (0.6, 0.6, 0.62))
    box(left, (-6, -12, 0), (-2, 25, 9))
    box(right, (2, -12, 0), (6, 25, 9))
    for i in range(6):
        box(matte("Crate", (0.5, 0.2, 0.1)), (-1.9, 1.0 + 3 * i, 0), (-1.2, 1.7 + 3 * i, 0.7))
    lamp("SUN", 4.0, turn=(0.1, math.radians(35), 0.3), across=0.01)
    sky((0.45, 0.6, 0.9), 1.2)
    aim((0.4, -3.5, 1.6), (-0.1, 6, 1.8), 1.1)


def letters(data: Path) -> None:
    """Letters that shine in a dark room."""
    grey = matte("Grey", (0.6, 0.6, 0.6))
    plane(grey, 8)
    plane(grey, 8, (0, 2, 4), (math.pi / 2, 0, 0))
    for look, text, place, color in (("Warm", "POINT", (-1.6, 0.9, 0.9), (6.0, 3.0, 1.0)),
                                     ("Cold", "SPLAT", (-1.5, 0.3, 0.15), (1.0, 2.5, 6.0))):  # fmt: skip
        bpy.ops.object.text_add(location=place, rotation=(math.pi / 2, 0, 0))
        item = bpy.context.object
        item.data.body, item.data.extrude, item.data.size = text, 0.08, 0.95
        bpy.ops.object.convert(target="MESH")
        material = surface(look, (0.0, 0.0, 0.0))
        base = next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
        base.inputs["Emission Color"].default_value, base.inputs["Emission Strength"].default_value = (*color, 1.0), 1.0
        shown(material)
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.3, location=(0.9, -0.9, 0.3), segments=48, ring_count=24)
    shown(grey).data.shade_smooth()
    aim((0.3, -4.2, 1.4), (0, 0.5, 0.8), 0.9)


def heap(look: Any, across: float, place: Triple, seed: int = 7) -> Any:
    """A cloud `across` wide, whose level base is at a place."""
    density = cumulus(96, seed)
    edge = across / len(density)
    path = Path(bpy.data.filepath).parent / f"heap-{seed}-{across:g}.vdb"
    write_vdb(path, {"density": density}, (-0.5 * across, -0.375 * across, 0.0), edge)
    item = volume_object("Cloud", path, look)
    item.location = place
    return item


def cloud(data: Path) -> None:
    """A cloud over a landscape under a sky and a sun."""
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=160, y_subdivisions=160, size=60)
    land = shown(matte("Land", (0.25, 0.3, 0.12)))
    place = np.empty(3 * len(land.data.vertices), np.float32)
    land.data.vertices.foreach_get("co", place)
    x, y, _ = place.reshape(-1, 3).T
    away = np.hypot(x, y)
    hills = 0.5 * np.sin(0.55 * x + 1.0) * np.cos(0.4 * y) + 0.25 * np.sin(1.3 * x - 0.7 * y) + 0.03 * away
    place.reshape(-1, 3)[:, 2] = hills + 0.02 * np.maximum(away - 10, 0) ** 2
    land.data.vertices.foreach_set("co", place)
    land.data.shade_smooth()
    heap(medium("Cloud", 3.0, (0.99, 0.99, 0.99)), 9.0, (0.0, 3.0, 3.2))
    lamp("SUN", 2.5, turn=(0.5, -0.35, 0.4), across=0.01)
    sky((0.45, 0.6, 0.9), 1.0)
    aim((0.5, -13.0, 2.6), (0, 2.0, 3.2), 0.95)


def smoke(data: Path) -> None:
    """A column of smoke beside a coloured wall."""
    plane(matte("Floor", (0.5, 0.48, 0.45)), 20)
    box(matte("Red", (0.7, 0.08, 0.05)), (-1.5, -1.2, 0.0), (-1.3, 1.6, 2.4))
    bpy.ops.mesh.primitive_cylinder_add(radius=0.5, depth=2.2, location=(-0.45, 0.2, 1.11), vertices=64)
    shown(medium("Smoke", 4.0, (0.8, 0.8, 0.8)))
    lamp("SUN", 3.0, turn=(0.3, math.radians(50), -0.2), across=0.01)
    sky((0.5, 0.6, 0.8), 0.6)
    aim((0.7, -4.4, 1.6), (-0.45, 0.2, 1.0), 0.75)


def alone(data: Path) -> None:
    """A cloud alone in a sky, under a sun."""
    heap(medium("Cloud", 4.0, (1.0, 1.0, 1.0)), 6.0, (0.0, 0.0, 0.0), 4)
    lamp("SUN", 2.5, turn=(0.5, -0.35, 0.4), across=0.01)
    sky((0.45, 0.6, 0.9), 1.0)
    aim((0.5, -8.0, 0.4), (0, 0, 1.5), 0.75)


def checked(name: str, first: Triple, second: Triple, scale: float) -> Any:
    """A surface with squares of two colours over its UV map."""
    made = matte(name, first)
    tree = made.node_tree
    checker, uv = tree.nodes.new("ShaderNodeTexChecker"), tree.nodes.new("ShaderNodeUVMap")
    checker.inputs["Color1"].default_value, checker.inputs["Color2"].default_value = (*first, 1.0), (*second, 1.0)
    checker.inputs["Scale"].default_value = scale
    tree.links.new(uv.outputs["UV"], checker.inputs["Vector"])
    tree.links.new(checker.outputs["Color"], tree.nodes["Principled BSDF"].inputs["Base Color"])
    return made


def mirrors(roughness: float) -> None:
    """A ball of metal on a polished floor among blocks, under a sky and a sun."""
    plane(surface("Floor", (0.12, 0.1, 0.09), Roughness=roughness), 30)
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.6, location=(0.1, 0.1, 0.6), segments=96, ring_count=48)
    shown(surface("Chrome", (0.9, 0.9, 0.9), Roughness=roughness, Metallic=1.0)).data.shade_smooth()
    box(matte("Red", (0.6, 0.06, 0.05)), (-1.7, 0.3, 0.0), (-1.0, 1.0, 1.1), 0.4)
    box(checked("Checked", (0.8, 0.75, 0.6), (0.05, 0.1, 0.25), 6.0), (1.0, -0.2, 0.0), (1.6, 0.4, 0.6), -0.3)
    box(matte("Green", (0.1, 0.4, 0.08)), (-1.2, -1.3, 0.0), (-0.8, -0.9, 0.35), 0.2)
    plane(checked("Wall", (0.7, 0.3, 0.1), (0.7, 0.65, 0.6), 8.0), 3.0, (0.4, 2.4, 1.5), (math.pi / 2, 0, 0))
    glow = surface("Glow", (0.0, 0.0, 0.0))
    base = glow.node_tree.nodes["Principled BSDF"]
    base.inputs["Emission Color"].default_value, base.inputs["Emission Strength"].default_value = (
        (1.0, 0.6, 0.2, 1),
        3.0,
    )
    box(glow, (0.9, -1.2, 0.0), (1.1, -1.0, 0.5))
    # Its own mirror image, thousands of times as bright, would decide all errors.
    lamp("SUN", 2.5, turn=(0.7, 0.3, 0.4), across=0.01).visible_glossy = False
    sky((0.45, 0.55, 0.75), 0.8)
    aim((0.2, -4.2, 1.5), (0.05, 0, 0.55), 0.75)
    bpy.context.scene["glossy_bounces"] = 4


def chrome(data: Path) -> None:
    mirrors(0.0)


def polished(data: Path) -> None:
    mirrors(0.1)


def brushed(data: Path) -> None:
    mirrors(0.2)


SCENES: dict[str, Callable[[Path], None]] = {
    scene.__name__: scene
    for scene in (
        *(room, walls, dragon, truck, fur, scan, foliage, street, letters),
        *(cloud, smoke, alone),
        *(chrome, polished, brushed),
    )
}
BOUNCES = 3


def cycles_like(scene: Any, bounces: int) -> None:
    """What Cycles is to leave out as PointSplat does: caustics, clamps, and further bounces."""
    own = scene.cycles
    glossy = scene.get("glossy_bounces", min(bounces, 1))
    own.max_bounces, own.glossy_bounces = max(bounces, glossy), glossy
    own.diffuse_bounces = own.volume_bounces = bounces
    own.transmission_bounces, own.transparent_max_bounces = 0, 32
    own.caustics_reflective = own.caustics_refractive = False
    own.blur_glossy, own.sample_clamp_direct, own.sample_clamp_indirect = 0.0, 0.0, 0.0
    own.use_denoising = False
    own.use_adaptive_sampling = False


def make(name: str, file: Path, data: Path, wide: int, high: int, bounces: int) -> None:
    """Writes a scene's .blend file."""
    scene = begin(wide, high)
    bpy.ops.wm.save_as_mainfile(filepath=str(file.resolve()), compress=False)  # scenes ask where it is
    SCENES[name](data)
    cycles_like(scene, bounces)
    bpy.ops.wm.save_as_mainfile(filepath=str(file.resolve()), compress=False)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", choices=list(SCENES))
    parser.add_argument("file", type=Path)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--size", type=size, default=(320, 180), metavar="WxH")
    parser.add_argument("--bounces", type=int, default=BOUNCES)
    options = parser.parse_args()
    wide, high = options.size
    make(options.name, options.file, options.data.resolve(), wide, high, options.bounces)


if __name__ == "__main__":
    run(main)
