"""Build the demo scene from the models in assets/: a cow and a bear under red maples.

python -m scripts.demos.park --output out/demo.blend
"""

import argparse
import gzip
import math
import tempfile
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

from scripts.common.process import run

ROOT = Path(__file__).resolve().parents[2]
ASSETS = ROOT / "assets"
GREEN_DARK, GREEN_LIGHT, STRAW = np.array([[0.045, 0.11, 0.02], [0.16, 0.25, 0.045], [0.42, 0.34, 0.12]])


# ---------------------------------------------------------------------------- materials


def material(name, color=(0.8, 0.8, 0.8), roughness=0.5, image=None, attribute=None):
    """A Principled material whose base colour is a constant, an image file or a colour attribute."""
    result = bpy.data.materials.new(name)
    result.use_nodes = True
    nodes, links = result.node_tree.nodes, result.node_tree.links
    surface = nodes["Principled BSDF"]
    surface.inputs["Base Color"].default_value = (*color, 1.0)
    surface.inputs["Roughness"].default_value = roughness
    if image:
        source = nodes.new("ShaderNodeTexImage")
        source.image = bpy.data.images.load(str(ASSETS / image), check_existing=True)
        source.image.pack()
        links.new(source.outputs["Color"], surface.inputs["Base Color"])
    if attribute:
        source = nodes.new("ShaderNodeVertexColor")
        source.layer_name = attribute
        links.new(source.outputs["Color"], surface.inputs["Base Color"])
    return result


# ---------------------------------------------------------------------------- models


def load(path, materials, height, name):
    """Import a compressed OBJ as one mesh that stands on the origin, `height` metres tall.

    materials: by the name that the file uses; a single one replaces whatever the file names.
    """
    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder, Path(path).stem)
        plain.write_bytes(gzip.decompress((ASSETS / path).read_bytes()))
        plain.with_suffix(".mtl").touch()  # the importer complains when the file that it names is missing
        bpy.ops.wm.obj_import(filepath=str(plain))
    parts = list(bpy.context.selected_objects)
    if len(parts) > 1:
        with bpy.context.temp_override(active_object=parts[0], selected_editable_objects=parts):
            bpy.ops.object.join()
    joined = parts[0]
    mesh = joined.data
    mesh.transform(joined.matrix_world)
    joined.matrix_world = Matrix.Identity(4)

    if isinstance(materials, dict):
        for i, old in enumerate(list(mesh.materials)):
            mesh.materials[i] = materials[old.name]
            bpy.data.materials.remove(old)
    else:
        mesh.materials.clear()
        mesh.materials.append(materials)

    position = np.empty(len(mesh.vertices) * 3, np.float32)
    mesh.vertices.foreach_get("co", position)
    position = position.reshape(-1, 3)
    low, high = position.min(0), position.max(0)
    foot = Vector(((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]))
    mesh.transform(Matrix.Scale(height / float(high[2] - low[2]), 4) @ Matrix.Translation(-foot))
    joined.name = mesh.name = name
    return joined


def copy_of(source, name):
    """Another object with the same mesh."""
    result = bpy.data.objects.new(name, source.data)
    bpy.context.scene.collection.objects.link(result)
    return result


def place(item, x, y, turn=0.0, scale=1.0, sink=0.0):
    """Put an object on the meadow, turned by degrees about the vertical."""
    item.location = (x, y, float(ground_height(x, y)) - sink)
    item.rotation_euler = (0.0, 0.0, math.radians(turn))
    item.scale = (scale, scale, scale)


# ---------------------------------------------------------------------------- meadow


def ground_height(x, y):
    """Height of the meadow in metres: flat where the animals stand, hills behind."""
    behind = np.clip((np.asarray(y) - 3.0) / 26.0, 0.0, 1.0)
    hills = 3.2 * behind**2 * (1.1 + np.sin(0.13 * x + 0.8) + 0.35 * np.sin(0.31 * x + 0.2 * y))
    return hills + 0.05 * np.sin(0.9 * x + 0.4 * y) * np.cos(0.7 * y - 0.3 * x)


def ripples(x, y, scale, seed):
    """A smooth random field with values in about [-1, 1]: waves of random directions."""
    rng = np.random.default_rng(seed)
    angle, phase = rng.uniform(0, 2 * np.pi, (2, 12))
    frequency = scale * rng.uniform(0.6, 1.8, 12)
    waves = frequency[:, None] * (np.cos(angle)[:, None] * x + np.sin(angle)[:, None] * y) + phase[:, None]
    return np.sin(waves).mean(0) * 2.0


def meadow():
    """A grid with colours at its vertices, finer near the camera."""
    columns, rows = 320, 360
    u, v = np.meshgrid(np.linspace(-1, 1, columns), np.linspace(0, 1, rows))
    y = -8.0 + 12.0 * v + 46.0 * v**3
    x = u * (9.0 + 0.9 * (y + 8.0))
    x, y = x.ravel(), y.ravel()
    position = np.stack([x, y, ground_height(x, y) + 0.012 * ripples(x, y, 9.0, 3)], 1)

    corner = np.arange(columns * (rows - 1)).reshape(rows - 1, columns)[:, :-1].ravel()
    faces = np.stack([corner, corner + 1, corner + columns + 1, corner + columns], 1)
    mesh = bpy.data.meshes.new("Meadow")
    mesh.from_pydata(position, [], faces)
    mesh.shade_smooth()

    light = np.clip(0.45 + 0.35 * ripples(x, y, 0.5, 1) + 0.45 * ripples(x, y, 6.0, 2), 0, 1)[:, None]
    straw = np.clip(0.8 * ripples(x, y, 0.35, 5) - 0.1, 0, 0.8)[:, None]
    color = (GREEN_DARK * (1 - light) + GREEN_LIGHT * light) * (1 - straw) + STRAW * straw
    layer = mesh.color_attributes.new("Color", "FLOAT_COLOR", "POINT")
    layer.data.foreach_set("color", np.concatenate([color, np.ones_like(light)], 1).astype(np.float32).ravel())
    mesh.materials.append(material("Grass", roughness=0.9, attribute="Color"))
    return bpy.data.objects.new("Meadow", mesh)


def fallen_leaves(x, y, radius, count, look):
    """Small red quadrilaterals that lie around (x, y)."""
    rng = np.random.default_rng(7)
    angle, turn = rng.uniform(0, 2 * np.pi, (2, count))
    distance = radius * np.sqrt(rng.uniform(0, 1, count))
    cx, cy = x + distance * np.cos(angle), y + distance * np.sin(angle)
    size = rng.uniform(0.02, 0.05, count)[:, None]
    across = size * np.stack([np.cos(turn), np.sin(turn), rng.uniform(-0.3, 0.3, count)], 1)
    along = size * np.stack([-np.sin(turn), np.cos(turn), rng.uniform(-0.3, 0.3, count)], 1)
    centre = np.stack([cx, cy, ground_height(cx, cy) + 0.03], 1)
    corners = np.stack([centre - across, centre - 0.8 * along, centre + across, centre + 1.2 * along], 1)
    mesh = bpy.data.meshes.new("Fallen leaves")
    mesh.from_pydata(corners.reshape(-1, 3), [], np.arange(4 * count).reshape(-1, 4))
    mesh.materials.append(look)
    return bpy.data.objects.new("Fallen leaves", mesh)


# ---------------------------------------------------------------------------- scene


def light(kind, name, energy, color, location, target):
    """A lamp at a place, shining at a target."""
    data = bpy.data.lights.new(name, kind)
    data.energy, data.color = energy, color
    result = bpy.data.objects.new(name, data)
    result.location = location
    result.rotation_euler = (Vector(target) - Vector(location)).to_track_quat("-Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(result)
    return data


def build():
    """Fill an empty file; the scene."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    link = scene.collection.objects.link

    cow = load(
        "spot/spot_triangulated.obj.gz",
        material("Cow", roughness=0.45, image="spot/spot_texture.png"),
        1.7,
        "Spot",
    )
    cow.data.shade_smooth()  # the file holds no normals
    bear = load(
        "teddy_bear/teddyBear.obj.gz",
        {
            "teddy": material("Burlap", roughness=0.9, image="teddy_bear/teddy.jpg"),
            "eyes": material("Eyes", color=(0.02, 0.02, 0.025), roughness=0.15),
        },
        1.25,
        "Bear",
    )
    bark = "japanese_maple/japaneseMapleTexture.jpg"
    maple = load(
        "japanese_maple/japaneseMaple.obj.gz",
        {
            "Trunk": material("Maple bark", roughness=0.9, image=bark),
            "Twig": material("Maple leaves", roughness=0.6, image=bark),
        },
        5.2,
        "Maple",
    )
    plant = load(
        "decorative_plant/decorativePlant.obj.gz",
        {
            "Branches": material("Plant branches", color=(0.11, 0.10, 0.05), roughness=0.8),
            "GroundMat": material("Soil", color=(0.05, 0.043, 0.04), roughness=1.0),
            "Leaves": material("Plant leaves", color=(0.13, 0.24, 0.06), roughness=0.5),
            "PotMat": material("Pot", color=(0.45, 0.20, 0.11), roughness=0.55),
            "Wood": material("Plant stem", color=(0.08, 0.055, 0.04), roughness=0.9),
        },
        1.45,
        "Plant",
    )
    place(cow, -1.0, -0.1, turn=205)
    place(bear, 0.85, -0.75, turn=12, sink=0.03)
    place(plant, 2.6, 0.35)
    place(maple, -0.2, 2.4, turn=20, sink=0.05)
    # One mesh, many trees: the renderer keeps a single hierarchy for all of them.
    for i, (x, y, turn, size) in enumerate(
        [
            (-6.5, 8.5, 130, 1.05),
            (6.8, 9.5, 250, 0.95),
            (-12.5, 17.0, 60, 1.2),
            (1.8, 19.0, 310, 1.1),
            (14.0, 21.0, 180, 1.25),
        ]
    ):
        place(copy_of(maple, f"Maple {i + 2}"), x, y, turn, size, sink=0.1)
    link(meadow())
    link(fallen_leaves(0.3, 1.2, 4.2, 1800, material("Fallen leaf", color=(0.32, 0.02, 0.012), roughness=0.7)))

    light("SUN", "Sun", 3.6, (1.0, 0.93, 0.82), (-6, -7, 9), (0, 0, 0)).angle = math.radians(1.0)
    fill = light("AREA", "Sky light", 260, (0.75, 0.86, 1.0), (5, -5, 5), (0.3, 0, 0.8))
    fill.shape, fill.size = "DISK", 4.0
    world = bpy.data.worlds.new("Sky")
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.30, 0.55, 1.0, 1.0)
    world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.9
    scene.world = world

    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location = (0.9, -7.4, 1.75)
    camera.rotation_euler = (Vector((0.35, 0.6, 1.42)) - camera.location).to_track_quat("-Z", "Y").to_euler()
    camera.data.lens = 35
    camera.data.clip_end = 200
    link(camera)
    scene.camera = camera
    scene.view_settings.look = "AgX - Medium High Contrast"
    scene.view_settings.exposure = 0.25
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 1280, 720, 100
    return scene


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=ROOT / "out" / "demo.blend")
    args = parser.parse_args()

    import pointsplat_addon

    scene = build()
    pointsplat_addon.register()
    scene.render.engine = "POINTSPLAT"
    for name in ("Spot", "Bear"):  # what has leaves chooses for itself
        scene.objects[name].pointsplat.primitive = "POINTS"
    args.output.parent.mkdir(parents=True, exist_ok=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(args.output.resolve()))


if __name__ == "__main__":
    run(main)
