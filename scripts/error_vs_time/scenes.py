"""The scenes of scripts/error_vs_time/measure.py."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any, cast

import numpy as np

from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.materials import default_materials
from pointsplat_addon.core.scene.scene import Geometry, Instances, Scene
from pointsplat_addon.core.scene.world import World
from scripts.benchmarks import frame
from scripts.error_vs_time.truths import (
    EXTINCTION,
    TRUTH,
    VOXELS,
    balls_truth,
    pattern,
    smoke_truth,
    sphere_truth,
    voxel_truth,
    voxels_of,
)

ROOT = Path(__file__).resolve().parents[2]
CLOUD = 200_000  # points of the sphere whose error is told over time
SMOKE = 96, 48  # pixels and voxels of the ball of smoke
PLUME_FILE, BRAIN_FILE = "../volume/gaffer_smoke.vdb", "../volume/inia19_t1_macaque.nii.gz"  # of DIR
SCAN_FILE, HAIR_FILE = "../points/cgal_building.ply", "../hair/hair_curves_cyhair_tressfx.blend"
TISSUE = 0.15, 0.7  # of nearly the greatest value in the brain: where density begins, and where it comes to DENSEST
DENSEST = 0.6
SCAN_RADIUS = 0.009  # of the scan's points, which lie in the unit ball: about one pixel
FUR = "bear_fur"  # the Curves object of HAIR_FILE


@dataclass(frozen=True)
class Subject:
    """A scene, how it is seen, what there is to choose about it, and the seconds that it took to read from Blender."""

    scene: Scene
    camera: Camera
    shadows: bool = False
    lens: bool = False
    strands: bool = False
    truth: Callable[[], np.ndarray] | None = None  # scene-linear; None: by what it consists of
    converted: float = 0.0

    def drawn_as(self, primitive: str) -> Scene:
        geometries = tuple(replace(geometry, primitive=primitive) for geometry in self.scene.geometries)
        return replace(self.scene, geometries=geometries)


# ---------------------------------------------------------------------------- points


def sphere(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions, which are the normals too, and colours (count, 3) float32: a spiral of nearly equal spacing."""
    i = np.arange(count) + 0.5
    polar, around = np.arccos(1 - 2 * i / count), np.pi * (1 + 5**0.5) * i
    position = np.stack([np.cos(around) * np.sin(polar), np.sin(around) * np.sin(polar), np.cos(polar)], axis=1)
    return position.astype(np.float32), pattern(position).astype(np.float32)


def disk_radius(count: int) -> float:
    """At which disks of that many points cover the sphere."""
    return 1.5 * (4 / count) ** 0.5


def sphere_subject(count: int, size: int) -> Subject:
    """Points that glow, in the view of scripts/benchmarks/frame.py."""
    position, color = sphere(count)
    table = default_materials()
    table = replace(table, base_color=np.zeros((1, 3), np.float32), specular=np.zeros(1, np.float32))
    radii = np.full((count, 1), disk_radius(count), np.float32)
    cloud = PointCloud(position, normal=position, radii=radii, emission=color)
    geometry = Geometry(f"error over time {count}", "Sphere", cloud=cloud)
    scene = Scene((geometry,), Instances(np.zeros(1, np.int32), np.eye(4)[None]), table, (), World())
    camera = frame.camera(0.0, size)
    return Subject(scene, camera, truth=lambda: sphere_truth(camera))


@cache
def scan(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Places in the unit ball, as bench_frame's camera sees them from the front and a little above, and colours that
    tell how the surface is turned, (N, 3) float32: a scanned building."""
    rows = np.loadtxt(path, skiprows=12, usecols=range(6))
    position, turned = rows[:, :3], np.abs(rows[:, 3:])
    position = position - (position.min(axis=0) + position.max(axis=0)) / 2
    position /= np.linalg.norm(position, axis=1).max()
    back = np.array([0.8, -0.45, 0.4]) / np.linalg.norm([0.8, -0.45, 0.4])
    right = np.cross([0, 0, 1], back) / np.linalg.norm(back[:2])
    view = np.stack([right, np.cross(back, right), back])
    return (position @ view.T).astype(np.float32), (0.2 + 0.6 * turned).astype(np.float32)


def scan_truth(camera: Camera, data: Path, samples: int = TRUTH) -> np.ndarray:
    """The scan's points as balls that glow, each met by the rays of the pixels about it, (H, W, 3): the pixel's filter
    by as many places."""
    position, color = scan((data / SCAN_FILE).resolve())
    return balls_truth(camera, position, np.full(len(position), SCAN_RADIUS), color, samples)


# ---------------------------------------------------------------------------- scenes of Blender's


def spot(size: int, data: Path, folder: Path) -> None:
    model(ROOT / "assets/spot/spot_triangulated.obj.gz", size, ROOT / "assets/spot/spot_texture.png")


def maple(size: int, data: Path, folder: Path) -> None:
    model(data / "japaneseMaple/japaneseMaple.obj", size, shadows=True)


def dragon(size: int, data: Path, folder: Path) -> None:
    model(data / "dragon_vrip_res2.ply.gz", size, smooth=True)


def railing(size: int, data: Path, folder: Path) -> None:
    model(data / "pedestrianRailing1/pedestrianRailing1.obj", size)


def bunny(size: int, data: Path, folder: Path) -> None:
    model(data / "bunny_bun_zipper.ply", size, smooth=True)


def plant(size: int, data: Path, folder: Path) -> None:
    model(data / "decorativePlant/decorativePlant.obj", size, shadows=True)


def model(path: Path, size: int, picture: Path | None = None, shadows: bool = False, smooth: bool = False) -> None:
    """A file before a camera, lit by one sun. With a picture, or smooth, it has a material of its own."""
    before_camera(size, shadows)
    gallery = importlib.import_module("scripts.studies.gallery")
    _ = gallery.load(path, picture) if picture is not None or smooth else gallery.read(path)


def before_camera(size: int, shadows: bool = False, direction: tuple[float, ...] = (0.5, -1.0, 0.45)) -> None:
    """An empty scene, a camera in that direction which sees the unit ball, and one sun."""
    gallery = importlib.import_module("scripts.studies.gallery")
    scene = gallery.studio(size)
    gallery.look_from(scene, np.array(direction) / np.linalg.norm(direction))
    sun = scene.objects["Sun"].data
    sun.angle, sun.use_shadow = 0.0, shadows
    if hasattr(sun.cycles, "cast_shadow"):
        sun.cycles.cast_shadow = shadows


def truck(size: int, data: Path, folder: Path) -> None:
    """In all its objects, some of glass."""
    import bpy
    from mathutils import Matrix, Vector

    before_camera(size, direction=(1.0, -0.6, 0.4))
    bpy.ops.wm.obj_import(filepath=str(data / "peterbilt/peterbilt.obj"), forward_axis="NEGATIVE_Z", up_axis="Y")
    parts = bpy.context.selected_objects
    bpy.context.view_layer.update()
    corners = np.array([part.matrix_world @ Vector(corner) for part in parts for corner in part.bound_box])
    low, high = corners.min(axis=0), corners.max(axis=0)
    scale = 2 / float(np.linalg.norm(high - low))
    for part in parts:
        place = Matrix.Translation((-scale * (low + high) / 2).tolist()) @ Matrix.Scale(scale, 4)
        part.matrix_world = place @ part.matrix_world


def demo(size: int, data: Path, folder: Path) -> None:
    """scripts/demos/park.py, without anything chosen for its objects."""
    render = importlib.import_module("scripts.demos.park").build().render
    render.resolution_x, render.resolution_y = size, 9 * size // 16
    render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR", "32"


def hair(size: int, data: Path, folder: Path) -> None:
    """The fur of a bear, all 48,113 strands."""
    import bpy

    before_camera(size)
    with bpy.data.libraries.load(str((data / HAIR_FILE).resolve())) as (_, wanted):
        wanted.objects = [FUR]
    [item] = cast(list[Any], wanted.objects)
    bpy.context.scene.collection.objects.link(item)
    item.location = 0.0, 0.0, 0.0
    strands, count = item.data, len(item.data.points)
    position, radius = np.empty((count, 3), np.float32), np.empty(count, np.float32)
    strands.position_data.foreach_get("vector", position.reshape(-1))
    strands.attributes["radius"].data.foreach_get("value", radius)
    middle = (position.min(axis=0) + position.max(axis=0)) / 2
    scale = 1 / np.linalg.norm(position - middle, axis=1).max()
    strands.position_data.foreach_set("vector", (scale * (position - middle)).reshape(-1))
    strands.attributes["radius"].data.foreach_set("value", scale * radius)
    volumes = importlib.import_module("scripts.common.volume_objects")
    strands.materials.append(volumes.surface("Fur", (0.35, 0.2, 0.1), Roughness=0.5))


def building(size: int, data: Path, folder: Path) -> None:
    """The scan as a point cloud of balls that glow."""
    import bpy

    gallery, points, volumes = (
        importlib.import_module("scripts.studies.gallery"),
        importlib.import_module("scripts.common.point_objects"),
        importlib.import_module("scripts.common.volume_objects"),
    )
    scene = gallery.studio(size)
    bpy.data.objects.remove(scene.objects["Sun"])
    scene.camera.location = 0.0, 0.0, frame.DISTANCE
    scene.camera.data.angle = 2 * np.arctan(1 / frame.FOCAL)
    position, color = scan((data / SCAN_FILE).resolve())
    cloud = points.point_cloud_object("Scan", position, SCAN_RADIUS, color, "FLOAT_COLOR")
    look = volumes.surface("Glow", (0.0, 0.0, 0.0), Specular_IOR_Level=0.0, Emission_Strength=1.0)
    nodes = look.node_tree.nodes
    source = nodes.new("ShaderNodeAttribute")
    source.attribute_name = "Color"
    look.node_tree.links.new(source.outputs["Color"], nodes["Principled BSDF"].inputs["Emission Color"])
    cloud.data.materials.append(look)


def balls(size: int, data: Path, folder: Path) -> None:
    """With a round aperture, the only one that splats are blurred by."""
    scene = importlib.import_module("scripts.demos.depth_of_field").build()
    scene.camera.data.dof.aperture_blades = 0
    scene.render.resolution_x, scene.render.resolution_y = size, 3 * size // 4


def smoke(size: int, data: Path, folder: Path) -> None:
    media = importlib.import_module("scripts.studies.media")
    media.volumes_last(media.sphere_scene(folder, "absorbing", "outside", SMOKE[0], SMOKE[1]))


def plume(size: int, data: Path, folder: Path) -> None:
    """Smoke of a file. Its y points up; the picture shows where most of it is."""
    item = before_sky((data / PLUME_FILE).resolve())
    values, object_from_index = voxels_of(item)
    heights = values.sum(axis=(0, 2), dtype=float)
    ends = np.searchsorted(np.cumsum(heights) / heights.sum(), (0.02, 0.98))
    middle = (np.array(values.shape) - 1) / 2
    middle[1] = ends.mean()
    scale = 2 / float(np.linalg.norm(object_from_index[:3, 1]) * (ends[1] - ends[0]))
    put(item, scale, np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), object_from_index @ np.append(middle, 1.0))


def brain(size: int, data: Path, folder: Path) -> None:
    """The density of tissue in a scanned brain; its z points up, its y to the front."""
    dense = importlib.import_module("pointsplat_addon.formats.volumes.dense")
    value = dense.read((data / BRAIN_FILE).resolve()).value
    begin, end = (share * float(np.quantile(value, 0.999)) for share in TISSUE)
    path = folder / "brain.vdb"
    grids = {"density": DENSEST * np.clip((value - begin) / (end - begin), 0, 1)}
    importlib.import_module("scripts.common.volume_objects").write_vdb(path, grids, (0, 0, 0), 1.0)
    item = before_sky(path)
    values, object_from_index = voxels_of(item)
    middle = object_from_index @ np.append((np.array(values.shape) - 1) / 2, 1.0)
    put(item, 2 / max(values.shape), np.eye(3), middle)


def before_sky(path: Path) -> Any:
    """A volume object of a file, which absorbs, before a sky of radiance 1, and a camera."""
    media, volumes = (
        importlib.import_module("scripts.studies.media"),
        importlib.import_module("scripts.common.volume_objects"),
    )
    scene = media.studio(VOXELS)
    media.sky(scene, 1.0)
    media.look(scene.camera, (1.8, -3.6, 0.2), (0.0, 0.0, -0.35))
    scene.camera.data.angle = np.radians(34)
    return volumes.volume_object("Voxels", path, volumes.medium("Voxels", 1.0, (0.0, 0.0, 0.0)))


def put(item: Any, scale: float, turn: np.ndarray, middle: np.ndarray) -> None:
    """Turn a volume by (3, 3), scale it, and put `middle` (3 or 4,) of its own space to the centre."""
    import mathutils

    world = np.eye(4)
    world[:3, :3] = scale * turn
    world[:3, 3] = -world[:3, :3] @ middle[:3]
    item.matrix_world = mathutils.Matrix(world.tolist())  # of lists alone, Blender takes columns
    # A volume's density is that of its own units, whatever its scale.
    volume = item.data.materials[0].node_tree.nodes["Principled Volume"]
    volume.inputs["Density"].default_value = EXTINCTION * scale


@dataclass(frozen=True)
class Kind:
    """Of scenes: who builds it in Blender (None: a sphere of points), what there is to choose about it, what is true of
    it (None: its polygons or strands, with many samples), and which other programs do the same work."""

    build: Callable[[int, Path, Path], None] | None
    needs: str = ""  # of DIR
    shadows: bool = False
    lens: bool = False
    strands: bool = False
    truth: Callable[[Camera, Path], np.ndarray] | None = None
    eevee: bool = False
    vtk: str = ""  # "points" or "voxels"


KINDS = {
    "Spot": Kind(spot, eevee=True),
    "bunny": Kind(bunny, "bunny_bun_zipper.ply", eevee=True),
    "dragon": Kind(dragon, "dragon_vrip_res2.ply.gz", eevee=True),
    "railing": Kind(railing, "pedestrianRailing1", eevee=True),
    "truck": Kind(truck, "peterbilt", eevee=True),
    "plant, shadows": Kind(plant, "decorativePlant", shadows=True, eevee=True),
    "maple, shadows": Kind(maple, "japaneseMaple", shadows=True, eevee=True),
    "demo scene": Kind(demo, shadows=True, eevee=True),
    "balls, depth of field": Kind(balls, lens=True),
    "fur": Kind(hair, HAIR_FILE, strands=True),
    "smoke, shadows": Kind(smoke, shadows=True, truth=lambda camera, data: smoke_truth()),
    "plume of voxels": Kind(plume, PLUME_FILE, truth=lambda camera, data: voxel_truth(), vtk="voxels"),
    "brain of voxels": Kind(brain, BRAIN_FILE, truth=lambda camera, data: voxel_truth(), vtk="voxels"),
    "scan of points": Kind(building, SCAN_FILE, truth=scan_truth, vtk="points"),
    "sphere of points": Kind(None, truth=lambda camera, data: sphere_truth(camera), vtk="points"),
}


def subject(name: str, size: int, data: Path, folder: Path) -> Subject:
    """What is drawn, read from Blender where it is built there."""
    kind = KINDS[name]
    if kind.build is None:
        return sphere_subject(CLOUD, size)
    import bpy

    import pointsplat_addon
    from pointsplat_addon.host.convert.camera import from_camera_object
    from pointsplat_addon.host.sync import Synchronizer

    if not hasattr(bpy.types.Scene, "pointsplat"):
        pointsplat_addon.register()
    kind.build(size, data, folder)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    depsgraph.update()
    seen = bpy.context.scene
    before = time.process_time()
    scene = Synchronizer().scene(depsgraph)
    camera = from_camera_object(seen.camera, depsgraph, seen.render.resolution_x, seen.render.resolution_y)
    converted = time.process_time() - before
    truth = None if kind.truth is None else partial(kind.truth, camera, data)
    return Subject(scene, camera, kind.shadows, kind.lens, kind.strands, truth, converted)
