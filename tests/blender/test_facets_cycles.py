"""Flat facets of metal before area lights, beside Cycles: edges are no brighter than what they lie between."""

from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

import pointsplat_addon
from tests.support.blender.scenes import new_material, node, picture

SIDE = 64


@pytest.fixture
def scene(empty_file):
    """A ball of 320 flat facets, one area light, and a black world."""
    pointsplat_addon.register()
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=3, radius=1)
    material = new_material()
    node(material.node_tree, "ShaderNodeOutputMaterial")
    bpy.context.object.data.materials.append(material)

    lamp = bpy.data.lights.new("lamp", "AREA")
    lamp.energy, lamp.size = 100.0, 0.5
    camera = bpy.data.cameras.new("camera")
    camera.type, camera.ortho_scale = "ORTHO", 2.2
    scene.camera = bpy.data.objects.new("camera", camera)
    scene.camera.location, scene.camera.rotation_euler = (0, -5, 0), (np.pi / 2, 0, 0)
    above = bpy.data.objects.new("lamp", lamp)
    above.location, above.rotation_euler = (0, -3, 3), (np.pi / 4, 0, 0)
    for item in (scene.camera, above):
        scene.collection.objects.link(item)

    render, cycles = scene.render, scene.cycles
    render.resolution_x = render.resolution_y = SIDE
    render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR", "32"
    cycles.device, cycles.samples, cycles.max_bounces = "CPU", 256, 0
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.filter_width = render.filter_size
    yield scene
    pointsplat_addon.unregister()


def drawn(scene, engine: str, folder: Path, seed: int = 0) -> np.ndarray:
    """(SIDE, SIDE) float64."""
    scene.render.engine, scene.cycles.seed = engine, seed
    return picture(scene, folder)[..., 0].astype(float)
