"""Meshes whose material has a volume: Beer's law along chords, and Cycles with single scattering."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from scripts.common.volume_objects import medium, surface
from scripts.studies import media

SIZE = 48


pytestmark = pytest.mark.usefixtures("empty_file")


def studio() -> bpy.types.Scene:
    scene = media.studio(SIZE)
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BLACKMAN_HARRIS", 1.5
    media.look(scene.camera, (3, -3, 2.5), (0, 0, 0))
    scene.camera.data.angle = math.radians(32)
    return scene


def cube(look: bpy.types.Material, scale=(1.0, 1.0, 1.0)) -> bpy.types.Object:
    bpy.ops.mesh.primitive_cube_add(size=2)
    bpy.context.object.scale = scale
    bpy.context.object.data.materials.append(look)
    return bpy.context.object


def ball(look: bpy.types.Material) -> bpy.types.Object:
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=6, radius=1)
    bpy.context.object.data.materials.append(look)
    return bpy.context.object


def scene_warnings() -> list[str]:
    from pointsplat_addon.host.sync import Synchronizer

    return list(scene_of(Synchronizer()).warnings)


def scene_of(synchronizer) -> Any:
    depsgraph = bpy.context.evaluated_depsgraph_get()
    depsgraph.update()
    return synchronizer.scene(depsgraph)


def box_chords(origins: np.ndarray, directions: np.ndarray, half: np.ndarray) -> np.ndarray:
    """(R,) lengths of rays within a box about the origin with half-sides (3,)."""
    with np.errstate(divide="ignore"):
        ends = np.sort(np.stack([(-half - origins) / directions, (half - origins) / directions]), axis=0)
    return np.maximum(ends[1].min(axis=1) - ends[0].max(axis=1), 0)


def ball_chords(origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(R,) lengths of rays within the ball of radius 1 about the origin."""
    past = np.linalg.norm(np.cross(origins, directions), axis=1)
    return 2 * np.sqrt(np.maximum(1 - past**2, 0))


RAYS = 4  # along a side of a pixel


def filtered(values: np.ndarray) -> np.ndarray:
    """(SIZE, SIZE) of values of RAYS x RAYS rays in each pixel, by the Blackman-Harris filter, 3 pixels wide."""
    at = 2 * np.pi * (np.arange(3 * RAYS) + 0.5) / (3 * RAYS)
    weight = 0.35875 - 0.48829 * np.cos(at) + 0.14128 * np.cos(2 * at) - 0.01168 * np.cos(3 * at)
    image = np.pad(values.reshape(SIZE, SIZE, RAYS, RAYS).swapaxes(1, 2).reshape(SIZE * RAYS, -1), RAYS, mode="edge")
    for _ in range(2):
        image = np.stack([image[i * RAYS : (i + 3) * RAYS].T @ weight for i in range(SIZE)], axis=1) / weight.sum()
    return image


def errors(scene: bpy.types.Scene, folder, chords: np.ndarray) -> tuple[float, float]:
    """Greatest errors of T against Beer's law for `chords` (R,) of rays: where all nearby are longer than half of the
    longest, and anywhere."""
    seen = media.draw(scene, folder, "POINTSPLAT", 64)[..., 0]
    error = np.abs(seen - filtered(np.exp(-chords)))
    inside = filtered((chords < 0.5 * chords.max()).astype(float)) == 0
    assert inside.sum() > 100
    return float(error[inside].max()), float(error.max())


def test_a_box_of_any_scale_lets_through_what_beers_law_says(tmp_path):
    scene = studio()
    media.sky(scene, 1.0)
    half = np.array([1.0, 0.7, 0.5])
    cube(medium("Fog", 1.0, (0.0, 0.0, 0.0)), half)
    inside, anywhere = errors(scene, tmp_path, box_chords(*media.rays(scene, RAYS), half))
    assert inside < 1e-3  # measured 1.7e-4
    assert anywhere < 3e-3  # measured 8.6e-4


def test_a_ball_lets_through_what_beers_law_says(tmp_path):
    """Its rim, where T falls as steeply as a root, is as soft as half a voxel."""
    scene = studio()
    media.sky(scene, 1.0)
    ball(medium("Fog", 1.0, (0.0, 0.0, 0.0)))
    inside, anywhere = errors(scene, tmp_path, ball_chords(*media.rays(scene, RAYS)))
    assert inside < 1e-3  # measured 5.1e-4
    assert anywhere < 0.04  # measured 0.024


@pytest.mark.parametrize("where", ["outside", "inside"])
def test_light_that_a_filled_mesh_scatters_is_cycles(tmp_path, where):
    scene = studio()
    ball(medium("Smoke", 1.5, (0.9, 0.6, 0.3), Anisotropy=0.3))
    media.plane(6.0, -1.2, surface("Floor", (0.8,) * 3, Roughness=1.0, Specular_IOR_Level=0.0))
    if where == "outside":
        media.lamp(scene, "SUN", 3.0, media.LAMPS["outside"])
    else:
        media.lamp(scene, "POINT", 60.0, media.LAMPS["inside"])
    seen = media.draw(scene, tmp_path, "POINTSPLAT", 16)
    cycles = media.draw(scene, tmp_path, "CYCLES", 1024)
    rmse, mean = media.difference(seen, cycles)
    assert rmse < 0.02  # measured 0.0122 (outside: the rim of the shadow), 0.0030
    assert abs(mean) < 0.01  # measured 0.0053, 0.0069


def test_a_tinted_glass_absorbs_inside(tmp_path):
    scene = studio()
    media.sky(scene, 1.0)
    look = medium("Tint", 1.0, (0.0, 0.0, 0.0), Absorption_Color=(0.7, 0.2, 0.05))
    clear = look.node_tree.nodes.new("ShaderNodeBsdfTransparent")
    look.node_tree.links.new(clear.outputs[0], look.node_tree.nodes["Material Output"].inputs["Surface"])
    cube(look)
    seen = media.draw(scene, tmp_path, "POINTSPLAT", 16)
    cycles = media.draw(scene, tmp_path, "CYCLES", 256)
    assert np.abs(seen - cycles).max() < 5e-3  # measured 1.7e-3


def test_what_glows_does_so_by_the_length_of_the_ray(tmp_path):
    scene = studio()
    look = medium("Glow", 0.0, (0.0, 0.0, 0.0), Emission_Strength=0.3, Emission_Color=(1.0, 0.5, 0.1))
    cube(look, (1.0, 0.7, 0.5))
    seen = media.draw(scene, tmp_path, "POINTSPLAT", 16)
    cycles = media.draw(scene, tmp_path, "CYCLES", 256)
    assert np.abs(seen - cycles)[..., :3].max() < 2e-3  # measured 4.1e-4


def test_a_mesh_that_is_not_closed_is_named():
    look = medium("Fog")
    bpy.ops.mesh.primitive_plane_add()
    bpy.context.object.data.materials.append(look)
    assert any("Plane" in w and "cannot be filled" in w for w in scene_warnings())
    cube(look).name = "Open"
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="DESELECT")
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.context.object.data.polygons[5].select = True
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.delete(type="FACE")
    bpy.ops.object.mode_set(mode="OBJECT")
    assert any(w.startswith("Open: ") for w in scene_warnings())


def test_what_is_drawn_follows_surface_and_volume():
    """A volume alone replaces the surface; an opaque surface hides the volume; instances of one size share voxels."""
    from pointsplat_addon.host.sync import Synchronizer

    synchronizer = Synchronizer()
    look = medium("Fog")
    first = cube(look)
    kinds = [(g.mesh is not None, g.volume is not None) for g in scene_of(synchronizer).geometries]
    assert kinds == [(False, True)]
    for x, scale in ((3.0, 1.0), (6.0, 2.0)):
        again = bpy.data.objects.new("Again", first.data)
        again.location, again.scale = (x, 0, 0), (scale,) * 3
        bpy.context.collection.objects.link(again)
    found = scene_of(synchronizer)
    assert sorted(np.bincount(found.instances.geometry)) == [1, 2]
    opaque = look.node_tree.nodes.new("ShaderNodeBsdfDiffuse")
    link = look.node_tree.links.new(opaque.outputs[0], look.node_tree.nodes["Material Output"].inputs["Surface"])
    assert [g.volume for g in scene_of(synchronizer).geometries] == [None]
    look.node_tree.links.remove(link)
    assert all(g.volume is not None for g in scene_of(synchronizer).geometries)
