"""Build scenes that mix volumes, translucent surfaces, particles, opaque points and polygons, as .blend files.

    python -m scripts.demos.translucent --list
    python -m scripts.demos.translucent --scene NAME --output out/NAME.blend [--voxels 128]
    python -m scripts.demos.translucent --all --output out/

Volumes are made here and stored as .vdb files in a folder `volumes` beside the .blend file. Models come from assets/.
The cases follow Gunjee, Fujimoto and Chiba 2007, figures 7 and 17.
"""

import argparse
import itertools
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

from scripts.common.process import run
from scripts.common.volume_objects import (
    medium,
    surface,
    volume_object,
    volumes_last,
    write_vdb,
)
from scripts.demos import park as demo

ROOT = Path(__file__).resolve().parents[2]

SHELL_ALPHA = 0.3


@dataclass(frozen=True)
class Maker:
    """Where a scene's files go and how fine its volumes are."""

    folder: Path
    voxels: int  # along a volume's longest side

    def volume(self, name: str, grids: dict[str, np.ndarray], size: float, foot, look) -> bpy.types.Object:
        """A volume `size` metres along x whose lowest voxels lie at the height of `foot`, which is under its middle."""
        shape = np.array(next(iter(grids.values())).shape[:3])
        voxel = size / shape[0]
        path = self.folder / "volumes" / f"{bpy.context.scene.name}_{name}.vdb".replace(" ", "_").lower()
        write_vdb(path, grids, (-shape[0] * voxel / 2, -shape[1] * voxel / 2, 0), voxel)
        made = volume_object(name, path, look)
        made.location = foot
        return made


# ---------------------------------------------------------------------------- matter


def noise(shape: tuple[int, ...], roughness: float, seed: int) -> np.ndarray:
    """A periodic random field of mean 0 and deviation 1 whose amplitude falls with frequency^-roughness."""
    spectrum = np.fft.rfftn(np.random.default_rng(seed).standard_normal(shape))
    axes = [np.fft.fftfreq(n) * n for n in shape[:-1]] + [np.fft.rfftfreq(shape[-1]) * shape[-1]]
    frequency = np.sqrt(sum(np.square(f).reshape([-1 if i == j else 1 for j in range(3)]) for i, f in enumerate(axes)))
    frequency.flat[0] = np.inf
    field = np.fft.irfftn(spectrum * frequency**-roughness, s=shape, axes=(0, 1, 2))
    return field / field.std()


def grid(shape: tuple[int, ...]) -> list[np.ndarray]:
    """Coordinates of voxel centres, open: from -1 to 1 along x, at the same scale along y, from 0 upwards along z."""
    x, y, z = (np.arange(n) + 0.5 for n in shape)
    unit = shape[0] / 2
    return list(np.meshgrid(x / unit - 1, (y - shape[1] / 2) / unit, z / unit, indexing="ij", sparse=True))


def least(*parts: np.ndarray) -> np.ndarray:
    """The least of arrays that are broadcast."""
    return np.minimum.reduce(np.broadcast_arrays(*parts))


def cumulus(voxels: int, seed: int = 4, flat: float = 0.6) -> np.ndarray:
    """A heap of round clouds on a level base: density from 0 to 1."""
    shape = (voxels, round(0.75 * voxels), round(flat * voxels))
    x, y, z = grid(shape)
    rng = np.random.default_rng(seed)
    height = 2 * flat
    inside = np.full(shape, -1.0)
    for _ in range(9):
        cx, cy, r = rng.uniform(-0.55, 0.55), rng.uniform(-0.3, 0.3), rng.uniform(0.2, 0.38)
        cz = 0.25 * height + rng.uniform(0, 0.35) * height * (1 - abs(cx))
        ball = 1 - np.sqrt((x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2) / r
        inside = np.maximum(inside, ball)
    inside += 0.13 * noise(shape, 2.2, seed)
    base = np.clip((z - 0.12 * height) / 0.06, 0, 1)
    walls = least(0.97 - np.abs(x), 0.72 - np.abs(y), height - 0.03 - z) * 12
    return (np.clip(inside * 4, 0, 1) * base * np.clip(walls, 0, 1)).astype(np.float32)


def head(voxels: int) -> np.ndarray:
    """Values like those of a CT scan: skin near 0.25, brain 0.4, bone 0.8 of 1."""
    shape = (voxels, round(1.2 * voxels), round(1.3 * voxels))
    x, y, z = grid(shape)
    z = z - 1.45

    def ellipsoid(cx, cy, cz, rx, ry, rz):
        """Signed distance in about units of length, positive inside."""
        return (1 - np.sqrt(((x - cx) / rx) ** 2 + ((y - cy) / ry) ** 2 + ((z - cz) / rz) ** 2)) * min(rx, ry, rz)

    def union(*parts):
        return np.logaddexp.reduce([p / 0.05 for p in np.broadcast_arrays(*parts)]) * 0.05

    cranium = ellipsoid(0, 0.12, 0.3, 0.72, 0.9, 0.72)
    face = ellipsoid(0, -0.35, -0.35, 0.52, 0.5, 0.72)
    neck = ellipsoid(0, 0.2, -1.2, 0.38, 0.38, 0.9)
    nose = ellipsoid(0, -0.88, -0.3, 0.12, 0.2, 0.2)
    ears = ellipsoid(0, 0.08, -0.15, 0.8, 0.1, 0.18)
    skin = union(cranium, face, neck, nose, ears)
    bone = union(cranium - 0.09, ellipsoid(0, -0.35, -0.35, 0.42, 0.42, 0.62))
    brain = cranium - 0.19
    sockets = np.maximum(
        ellipsoid(0.25, -0.75, -0.08, 0.17, 0.25, 0.15), ellipsoid(-0.25, -0.75, -0.08, 0.17, 0.25, 0.15)
    )
    mouth = ellipsoid(0, -0.7, -0.72, 0.25, 0.35, 0.1)
    bone = np.minimum(bone, -np.maximum(sockets, mouth))
    folds = 0.05 * noise(shape, 1.4, 2)

    def soft(distance, width=0.03):
        return np.clip(0.5 + distance / width, 0, 1)

    value = 0.25 * soft(skin)
    value = np.maximum(value, 0.8 * soft(bone))
    hollow = soft(brain)
    value = value * (1 - hollow) + hollow * (0.4 + folds)
    walls = least(1 - np.abs(x), 1.2 - np.abs(y), z + 1.42)
    return (value * np.clip(walls * 20, 0, 1) * (value > 0.02)).astype(np.float32)


def points(name: str, position: np.ndarray, radius: np.ndarray, color: np.ndarray, look) -> bpy.types.Object:
    """A point cloud: positions (N, 3) in metres, radii (N,), colours (N, 3) scene-linear, through geometry nodes."""
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(position))
    mesh.vertices.foreach_set("co", position.astype(np.float32).ravel())
    mesh.attributes.new("size", "FLOAT", "POINT").data.foreach_set("value", radius.astype(np.float32))
    rgba = np.column_stack([color, np.ones(len(color))]).astype(np.float32)
    mesh.attributes.new("Color", "FLOAT_COLOR", "POINT").data.foreach_set("color", rgba.ravel())
    made = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(made)

    tree = bpy.data.node_groups.new(name, "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    names = ("NodeGroupInput", "GeometryNodeMeshToPoints", "GeometryNodeSetMaterial", "NodeGroupOutput")
    chain = [tree.nodes.new(kind) for kind in names]
    for left, right in itertools.pairwise(chain):
        tree.links.new(left.outputs[0], right.inputs[0])
    size = tree.nodes.new("GeometryNodeInputNamedAttribute")
    size.data_type = "FLOAT"
    size.inputs["Name"].default_value = "size"
    tree.links.new(size.outputs["Attribute"], chain[1].inputs["Radius"])
    chain[2].inputs["Material"].default_value = look
    made.modifiers.new("Points", "NODES").node_group = tree
    return made


def colored(name: str, alpha: float = 1.0, glow: float = 0.0) -> bpy.types.Material:
    """A Principled surface in the colour of the points."""
    made = surface(name, Roughness=0.6, Alpha=alpha, Emission_Strength=glow)
    nodes, links = made.node_tree.nodes, made.node_tree.links
    source = nodes.new("ShaderNodeAttribute")
    source.attribute_name = "Color"
    for socket in ("Base Color", "Emission Color"):
        links.new(source.outputs["Color"], nodes["Principled BSDF"].inputs[socket])
    return made


def plane(size: float, look, location=(0, 0, 0), rotation=(0, 0, 0)) -> bpy.types.Object:
    bpy.ops.mesh.primitive_plane_add(size=size, location=location, rotation=rotation)
    bpy.context.object.data.materials.append(look)
    bpy.context.object.pointsplat.primitive = "POLYGONS"
    return bpy.context.object


def sphere(name: str, radius: float, look, location=(0, 0, 0)) -> bpy.types.Object:
    bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32, radius=radius, location=location)
    made = bpy.context.object
    made.name = name
    made.data.shade_smooth()
    made.data.materials.append(look)
    return made


def statue(name: str, height: float, x: float, y: float, turn: float) -> bpy.types.Object:
    """The bear or the cow, drawn as points as a scan would be."""
    if name == "Bear":
        looks = {
            "teddy": demo.material("Burlap", roughness=0.9, image="teddy_bear/teddy.jpg"),
            "eyes": demo.material("Eyes", color=(0.02, 0.02, 0.025), roughness=0.15),
        }
        made = demo.load("teddy_bear/teddyBear.obj.gz", looks, height, name)
    else:
        skin = demo.material("Cow", roughness=0.45, image="spot/spot_texture.png")
        made = demo.load("spot/spot_triangulated.obj.gz", skin, height, name)
        made.data.shade_smooth()
    made.location = (x, y, 0)
    made.rotation_euler = (0, 0, math.radians(turn))
    made.pointsplat.primitive = "POINTS"
    return made


# ---------------------------------------------------------------------------- light and camera


def stage(name: str, eye, target, lens: float = 40, sky=(0.02, 0.025, 0.04)) -> bpy.types.Scene:
    """An empty scene with a camera and an even sky."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.name = name
    scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(scene.camera)
    aim(scene.camera, eye, target)
    scene.camera.data.lens = lens
    scene.camera.data.clip_end = 400
    scene.world = bpy.data.worlds.new("Sky")
    if not scene.world.node_tree:
        scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (*sky, 1.0)
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 960, 640, 100
    cycles = scene.cycles
    cycles.device, cycles.max_bounces, cycles.volume_bounces, cycles.transparent_max_bounces = "CPU", 0, 0, 32
    return scene


def aim(item: bpy.types.Object, location, target) -> None:
    item.location = location
    item.rotation_euler = (Vector(target) - Vector(location)).to_track_quat("-Z", "Y").to_euler()


def lamp(energy: float, location, color=(1.0, 0.85, 0.65), radius: float = 0.05) -> None:
    demo.light("POINT", "Lamp", energy, color, location, (0, 0, 0)).shadow_soft_size = radius


def sun(energy: float, location, angle: float = 1.0, color=(1.0, 0.95, 0.88)) -> None:
    demo.light("SUN", "Sun", energy, color, location, (0, 0, 0)).angle = math.radians(angle)


# ---------------------------------------------------------------------------- scenes


def glow(maker: Maker) -> None:
    """A lamp in a cloud, a tinted shell, a statue drawn as points and a polygon floor."""
    stage("glow", (0.2, -6.6, 2.2), (0.1, 0, 1.15), 42)
    plane(14, surface("Floor", (0.55, 0.53, 0.5), Roughness=0.8))
    statue("Bear", 1.5, 1.55, -0.35, 12)
    sphere("Shell", 0.75, surface("Glass", (0.15, 0.55, 0.75), Roughness=0.1, Alpha=SHELL_ALPHA), (0.55, -1.7, 0.75))
    lamp(1500, (-0.85, 0.2, 1.7))
    demo.light("AREA", "Fill", 60, (0.7, 0.8, 1.0), (-4, -5, 5), (0, 0, 0.8)).size = 3.0
    smoke = medium("Cloud", 3.0, (0.92, 0.9, 0.88), Absorption_Color=(0.6, 0.35, 0.2), Anisotropy=0.2)
    maker.volume("Cloud", {"density": cumulus(maker.voxels)}, 3.6, (-1.1, 0.3, 0.7), smoke)


def cloud_light(maker: Maker) -> None:
    """A light above a cloud, whose shadow lies on the floor."""
    stage("cloud_light", (0, -8.5, 3.6), (0, 0, 1.3))
    plane(16, surface("Floor", (0.6, 0.58, 0.55), Roughness=0.9))
    statue("Spot", 1.0, 0.4, -1.2, 205)
    lamp(1600, (0.5, -0.3, 4.6), (1.0, 0.95, 0.85), 0.15)
    maker.volume("Cloud", {"density": cumulus(maker.voxels, 7)}, 4.2, (0, 0, 1.35), medium("Cloud", 5.0, (0.95,) * 3))


def fountain(maker: Maker) -> None:
    """A light inside a fountain of particles."""
    stage("fountain", (0, -5.6, 2.1), (0, 0, 0.85))
    plane(14, surface("Floor", (0.35, 0.35, 0.38), Roughness=0.5))
    rng = np.random.default_rng(1)
    count = 24000
    age, turn = rng.uniform(0, 1.15, count), rng.uniform(0, 2 * np.pi, count)
    outward, up = rng.normal(1.15, 0.16, count), rng.normal(5.2, 0.25, count)
    where = np.stack(
        [outward * age * np.cos(turn), outward * age * np.sin(turn), 0.2 + up * age - 4.905 * age**2], axis=1
    )
    where += rng.normal(0, 0.02, where.shape)
    kept = where[:, 2] > 0.02
    color = np.array([0.25, 0.55, 0.95]) * (1 - age[:, None] / 1.6) + np.array([0.9, 0.95, 1.0]) * age[:, None] / 1.6
    radius = rng.uniform(0.008, 0.022, count)
    points("Fountain", where[kept], radius[kept], color[kept], colored("Drops", alpha=0.6))
    lamp(900, (0, 0, 0.75))
    demo.light("AREA", "Fill", 40, (0.6, 0.7, 1.0), (4, -4, 5), (0, 0, 1)).size = 2.0


def order(maker: Maker, name: str, veil: bool, veil_y: float, lamp_at) -> None:
    """A statue and a round veil of alpha 0.45 in front of it, behind it or around the lamp."""
    stage(name, (2.4, -6.0, 2.6), (0, 0, 0.95))
    plane(12, surface("Floor", (0.6, 0.58, 0.55), Roughness=0.9))
    statue("Spot", 1.5, 0, 0, 205)
    if veil:
        glass = surface("Veil", (0.85, 0.25, 0.12), Roughness=0.4, Alpha=0.45)
        sphere("Veil", 0.8, glass, (0.0 if veil_y < 0 else 0.15, veil_y, 0.85))
    lamp(650, lamp_at, (1.0, 0.95, 0.88))
    sun(0.4, (3, -4, 6))


def opaque(maker: Maker) -> None:
    """Opaque matter only: what the other orders are compared with."""
    order(maker, "opaque", False, 0, (-2.2, -2.0, 3.6))


def translucent_first(maker: Maker) -> None:
    """A translucent object before an opaque one, as the lamp sees them."""
    order(maker, "translucent_first", True, -1.5, (0.0, -4.2, 2.6))


def opaque_first(maker: Maker) -> None:
    """An opaque object before a translucent one, as the lamp sees them."""
    order(maker, "opaque_first", True, 1.7, (0.0, -3.6, 2.4))


def light_inside(maker: Maker) -> None:
    """The lamp inside the translucent object."""
    order(maker, "light_inside", True, -1.5, (0.0, -1.5, 0.85))


def eye(maker: Maker) -> None:
    """An eye of translucent and opaque shells, from the cornea to the retina."""
    stage("eye", (3.4, -5.0, 1.9), (0, -0.05, 0), 62)
    shells = (
        ("Sclera", 1.0, 0.0, surface("Sclera", (0.9, 0.86, 0.82), Roughness=0.4, Alpha=0.35)),
        ("Choroid", 0.93, 0.0, surface("Choroid", (0.55, 0.06, 0.04), Roughness=0.7, Alpha=0.55)),
        ("Vitreous", 0.86, 0.0, surface("Vitreous", (0.6, 0.8, 0.9), Roughness=0.2, Alpha=0.12)),
        ("Lens", 0.36, -0.62, surface("Lens", (0.95, 0.85, 0.45), Roughness=0.1, Alpha=0.5)),
        ("Cornea", 0.58, -0.58, surface("Cornea", (0.75, 0.88, 0.95), Roughness=0.05, Alpha=0.2)),
    )
    for name, radius, y, look in shells:
        made = sphere(name, radius, look, (0, y, 0))
        made.scale.y = {"Lens": 0.5}.get(name, 1.0)
    bpy.ops.mesh.primitive_torus_add(
        major_radius=0.36, minor_radius=0.16, major_segments=96, minor_segments=32, location=(0, -0.86, 0)
    )
    iris = bpy.context.object
    iris.name, iris.rotation_euler, iris.scale = "Iris", (math.pi / 2, 0, 0), (1, 1, 0.25)
    iris.data.shade_smooth()
    iris.data.materials.append(surface("Iris", (0.08, 0.22, 0.45), Roughness=0.6))
    sphere("Optic nerve", 0.16, surface("Nerve", (0.95, 0.75, 0.3), Roughness=0.6), (0.25, 0.95, 0))
    lamp(420, (-2.2, -3.0, 2.6), (1, 1, 1), 0.1)
    sun(1.2, (3, -2, 3))


def ct_head(maker: Maker) -> None:
    """A head's CT values through a transfer function: skin as a veil over the bone's isosurface."""
    stage("ct_head", (2.3, -4.4, 0.6), (0, 0, 0.05), 50)
    stops = ((0.0, (0, 0, 0, 0)), (0.16, (0.85, 0.5, 0.38, 0.0)), (0.22, (0.85, 0.5, 0.38, 0.03)),
             (0.3, (0.85, 0.5, 0.38, 0.02)), (0.36, (0.9, 0.35, 0.3, 0.06)), (0.5, (0.9, 0.4, 0.3, 0.05)),
             (0.6, (0.95, 0.92, 0.85, 0.1)), (0.68, (0.97, 0.94, 0.86, 1.0)), (1.0, (1, 0.97, 0.9, 1.0)))  # fmt: skip
    density = 60.0
    look = medium("Head", 1.0, (0.8, 0.7, 0.6))
    nodes, links = look.node_tree.nodes, look.node_tree.links
    ramp, value, times = (nodes.new(f"ShaderNode{kind}") for kind in ("ValToRGB", "Attribute", "Math"))
    value.attribute_name = "density"
    fill_ramp(ramp.color_ramp, stops)
    times.operation, times.inputs[1].default_value = "MULTIPLY", density
    volume = nodes["Principled Volume"]
    volume.inputs["Density Attribute"].default_value = ""
    links.new(value.outputs["Fac"], ramp.inputs["Fac"])
    links.new(ramp.outputs["Color"], volume.inputs["Color"])
    links.new(ramp.outputs["Alpha"], times.inputs[0])
    links.new(times.outputs["Value"], volume.inputs["Density"])
    lamp(900, (-1.8, -3.0, 2.2), (1, 0.96, 0.9), 0.1)
    sun(1.5, (3, -3, 2.5))
    made = maker.volume("Head", {"density": head(maker.voxels)}, 1.8, (0, 0, -1.15), look)
    transfer(made, stops, density)


def outdoor(maker: Maker) -> None:
    """A cloud over a meadow with grass, a maple, a scan of points and a polygon model."""
    scene = stage("outdoor", (1.2, -8.6, 1.9), (0.4, 1.0, 2.35), 32, (0.22, 0.42, 0.85))
    scene.collection.objects.link(demo.meadow())
    bark = "japanese_maple/japaneseMapleTexture.jpg"
    looks = {
        "Trunk": demo.material("Maple bark", roughness=0.9, image=bark),
        "Twig": demo.material("Maple leaves", roughness=0.6, image=bark),
    }
    maple = demo.load("japanese_maple/japaneseMaple.obj.gz", looks, 4.6, "Maple")
    demo.place(maple, -2.6, 2.0, turn=20, sink=0.05)
    maple.pointsplat.primitive = "POINTS"
    bear = statue("Bear", 1.25, 0, 0, 0)
    demo.place(bear, 1.0, -1.6, turn=8, sink=0.03)
    bear.pointsplat.primitive = "POLYGONS"
    grass(4200)
    scan(2.9, 1.4)
    sun(4.5, (-5, -6, 8))
    cloud = medium("Cloud", 1.0, (0.99,) * 3)
    maker.volume("Cloud", {"density": cumulus(maker.voxels, 11, 0.45)}, 9.0, (2.0, 9.0, 3.6), cloud)


def grass(count: int) -> None:
    """Blades, triangles of two sides, where the meadow is near."""
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-4.5, 4.5, count), rng.uniform(-5.5, 3.0, count)
    foot = np.stack([x, y, demo.ground_height(x, y)], axis=1)
    turn, tall = rng.uniform(0, np.pi, count), rng.uniform(0.08, 0.26, count)
    side = 0.011 * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    lean = rng.normal(0, 0.25, (count, 2)) * tall[:, None]
    tip = foot + np.column_stack([lean, tall])
    mesh = bpy.data.meshes.new("Grass")
    mesh.from_pydata(
        np.stack([foot - side, foot + side, tip], axis=1).reshape(-1, 3), [], np.arange(3 * count).reshape(-1, 3)
    )
    mesh.materials.append(surface("Blades", (0.12, 0.28, 0.04), Roughness=0.7))
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("Grass", mesh))


def scan(x: float, y: float) -> None:
    """The cow as a laser scanner would give it: coloured points with errors, on its triangles."""
    cow = demo.load("spot/spot_triangulated.obj.gz", surface("Scanned"), 1.9, "Scanned cow")
    mesh = cow.data
    mesh.calc_loop_triangles()
    rows = np.empty(3 * len(mesh.loop_triangles), np.int32)
    mesh.loop_triangles.foreach_get("vertices", rows)
    corner = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", corner)
    corner = corner.reshape(-1, 3)[rows.reshape(-1, 3)]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    rng = np.random.default_rng(5)
    chosen = corner[rng.choice(len(area), 60000, p=area / area.sum())]
    weight = rng.dirichlet((1, 1, 1), len(chosen))
    where = np.einsum("nk,nki->ni", weight, chosen) + rng.normal(0, 0.003, (len(chosen), 3))
    shade = 0.35 + 0.3 * (np.sin(9 * where[:, 2:]) * np.cos(7 * where[:, 1:2]) > 0.1) + rng.normal(0, 0.03, (60000, 1))
    bpy.data.objects.remove(cow)
    made = points("Scan", where, np.full(60000, 0.008), np.clip(shade * [1.0, 0.9, 0.78], 0, 1), colored("Scan"))
    made.location = (x, y, float(demo.ground_height(x, y)))
    made.rotation_euler = (0, 0, math.radians(215))


def fill_ramp(ramp: bpy.types.ColorRamp, stops) -> None:
    while len(ramp.elements) > 1:
        ramp.elements.remove(ramp.elements[-1])
    ramp.elements[0].position, ramp.elements[0].color = stops[0]
    for position, color in stops[1:]:
        ramp.elements.new(position).color = color


def transfer(volume: bpy.types.Object, stops, density: float) -> None:
    """The same transfer function in the object's own settings."""
    texture = bpy.data.textures.new("Transfer", "BLEND")
    texture.use_color_ramp = True
    fill_ramp(texture.color_ramp, stops)
    own = volume.pointsplat
    own.use_transfer, own.transfer_grid, own.transfer_texture = True, "density", texture
    own.transfer_low, own.transfer_high, own.transfer_density = 0.0, 1.0, density


MAKERS: tuple[Callable[[Maker], None], ...] = (
    glow, cloud_light, fountain, opaque, translucent_first, opaque_first, light_inside, eye, ct_head, outdoor,
)  # fmt: skip
SCENES = {maker.__name__: maker for maker in MAKERS}


def build(name: str, path: Path, voxels: int) -> bpy.types.Scene:
    """One scene of SCENES in the open file, to be saved at `path`."""
    SCENES[name](Maker(path.resolve().parent, voxels))
    scene = bpy.context.scene
    volumes_last(scene)
    scene.render.engine = "POINTSPLAT"
    return scene


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--list", action="store_true", help="name the scenes")
    parser.add_argument("--scene", choices=list(SCENES))
    parser.add_argument("--all", action="store_true", help="every scene; --output is a folder")
    parser.add_argument("--output", type=Path, default=ROOT / "out")
    parser.add_argument("--voxels", type=int, default=128, help="along a volume's longest side")
    args = parser.parse_args()
    if args.list or not (args.scene or args.all):
        sys.stdout.writelines(f"{name:18} {maker.__doc__}\n" for name, maker in SCENES.items())
        return

    import pointsplat_addon

    pointsplat_addon.register()
    for name in SCENES if args.all else [args.scene]:
        path = args.output / f"{name}.blend" if args.all or args.output.suffix != ".blend" else args.output
        path.parent.mkdir(parents=True, exist_ok=True)
        build(name, path, args.voxels)
        bpy.ops.wm.save_as_mainfile(filepath=str(path.resolve()))


if __name__ == "__main__":
    run(main)
