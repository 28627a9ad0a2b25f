"""One scene with all that PointSplat draws: scan, meshes, smoke, hair, glass, foliage as geometry and as cards."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import bpy
import numpy as np
from mathutils import Matrix, Vector

from scripts.common.point_objects import point_cloud_object
from scripts.common.volume_objects import medium, surface, volume_object, volumes_last
from scripts.studies import gallery

models = importlib.import_module("scripts.error_vs_time.scenes")  # which names things of the tests' data
SCAN_SPACING = 0.006  # of the scanned building's points in the unit ball, roughly
LOOKS_DOWN = 0.4 / math.hypot(0.8, 0.45, 0.4)  # sine of the angle by which it is seen from above there
SMOKE_DENSITY = 6.0  # per metre of the file's unit of density


def everything(size: int, data: Path, aim: Callable, add_alpha: Callable[[], None], painted: Callable) -> None:
    """`aim` points the camera, `add_alpha` links images' alpha to materials, `painted` makes a material of colours."""
    scene = gallery.studio(size)
    sun = scene.objects["Sun"]
    sun.data.energy, sun.rotation_euler = 3.0, (math.radians(42), math.radians(18), math.radians(20))
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    lamp.data.energy, lamp.data.shadow_soft_size, lamp.location = 150.0, 0.25, (-2.2, -2.6, 2.6)
    scene.collection.objects.link(lamp)
    bpy.ops.mesh.primitive_plane_add(size=16)
    shown(surface("Floor", (0.45, 0.43, 0.4)))

    scan(data, painted)
    bonsai = gallery.read(data / "bonsai-tree/bonsai-tree.obj")
    stand(bonsai, (-0.75, -1.35), 0.9)
    add_alpha()
    stand(gallery.read(data / "japaneseMaple/japaneseMaple.obj"), (2.5, 1.6), 2.6)
    stand(gallery.read(data / "decorativePlant/decorativePlant.obj"), (-2.0, -0.3), 1.1)
    dragon = gallery.load(data / "dragon_vrip_res2.ply.gz", None)
    stand(dragon, (0.35, -0.75), 0.75, turn=0.5)
    cow = gallery.load(
        models.ROOT / "assets/spot/spot_triangulated.obj.gz", models.ROOT / "assets/spot/spot_texture.png"
    )
    stand(cow, (1.55, -1.15), 0.7, turn=2.3)
    fur(data)
    smoke(data)
    panes()
    volumes_last(scene)
    scene.camera.data.angle, scene.camera.data.clip_end = math.radians(48), 100.0
    aim(scene.camera, (0.5, -5.6, 2.0), (0.1, 0.0, 0.7))


def shown(look: bpy.types.Material) -> bpy.types.Object:
    item = bpy.context.object
    item.data.materials.clear()
    item.data.materials.append(look)
    return item


def stand(item: bpy.types.Object, place: tuple[float, float], height: float, turn: float = 0.0) -> None:
    """Put an object on the floor, so many metres high, its foot's middle there."""
    bpy.context.view_layer.update()
    corners = np.array([list(corner) for corner in item.bound_box])
    low, high = corners.min(axis=0), corners.max(axis=0)
    foot = Vector((*((low + high) / 2)[:2], low[2]))
    to = Matrix.Translation((*place, 0.0)) @ Matrix.Rotation(turn, 4, "Z")
    item.matrix_world = to @ Matrix.Scale(height / float(high[2] - low[2]), 4) @ Matrix.Translation(-foot)


def scan(data: Path, painted: Callable) -> None:
    """The scanned building as balls that touch."""
    position, color = models.scan((data / models.SCAN_FILE).resolve())
    # As a camera sees it that looks down by LOOKS_DOWN: turned back, what points up there points up here.
    sine, cosine = LOOKS_DOWN, math.sqrt(1 - LOOKS_DOWN**2)
    up, toward = position[:, 1] * cosine + position[:, 2] * sine, position[:, 2] * cosine - position[:, 1] * sine
    upright = np.stack([position[:, 0], -toward, up], axis=1)
    scale = 1.5
    cloud = point_cloud_object("Scan", scale * upright, scale * SCAN_SPACING, color)
    cloud.data.materials.append(painted("Scan"))
    cloud.location = -1.1, 1.8, scale * -float(upright[:, 2].min())


def fur(data: Path) -> None:
    """A bear's."""
    with bpy.data.libraries.load(str((data / models.HAIR_FILE).resolve())) as (_, wanted):
        wanted.objects = [models.FUR]
    [item] = cast(list[Any], wanted.objects)
    bpy.context.scene.collection.objects.link(item)
    item.data.materials.clear()
    item.data.materials.append(surface("Fur", (0.35, 0.2, 0.1), Roughness=0.5))
    stand(item, (0.95, 0.7), 1.3, turn=2.6)


def smoke(data: Path) -> None:
    """Over the floor at the left. In the file y points up."""
    item = volume_object("Smoke", (data / models.PLUME_FILE).resolve(), medium("Smoke", SMOKE_DENSITY, (0.7, 0.7, 0.7)))
    item.matrix_world = Matrix.Rotation(math.pi / 2, 4, "X")
    bpy.context.view_layer.update()
    corners = np.array([item.matrix_world @ Vector(corner) for corner in item.bound_box])
    low, high = corners.min(axis=0), corners.max(axis=0)
    scale = 2.0 / float(high[2] - low[2])
    middle = Vector((*((low + high) / 2)[:2], low[2]))
    turned = Matrix.Scale(scale, 4) @ Matrix.Translation(-middle) @ item.matrix_world
    item.matrix_world = Matrix.Translation((-2.6, 1.0, 0.0)) @ turned


def panes() -> None:
    """Two tinted panes, one before the other."""
    for x, color in ((0.05, (0.1, 0.35, 0.6)), (0.45, (0.6, 0.25, 0.1))):
        bpy.ops.mesh.primitive_plane_add(size=1.0, location=(x, 0.05 + 0.3 * x, 0.5), rotation=(math.pi / 2, 0, 0.35))
        shown(surface("Pane", color, Alpha=0.35, Roughness=0.1))
