"""Light on one hair, of which Cycles' pixels show all the width, against the model of Chiang et al. in float64.

What PointSplat draws is a mean over the width; tests/core/light/test_hair.py compares it with that model."""

from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Vector

from tests.reference.hair import scattered
from tests.reference.hair_lighting import Fibre
from tests.support.blender.scenes import new_material, node

pytestmark = pytest.mark.usefixtures("empty_file")
COLOR = np.array([[0.5, 0.3, 0.15]])
SIZE = 32  # pixels


@pytest.fixture
def sun(empty_file):
    """A camera along y that sees the width of one hair, which grows along z."""
    scene = bpy.context.scene

    def linked(data):
        ob = bpy.data.objects.new("", data)
        scene.collection.objects.link(ob)
        return ob

    data = bpy.data.hair_curves.new("Hair")
    data.add_curves([4])
    data.position_data.foreach_set("vector", np.array([[0, 0, z] for z in (-2, -0.5, 0.5, 2)], np.float32).ravel())
    width = data.attributes.get("radius") or data.attributes.new("radius", "FLOAT", "POINT")
    width.data.foreach_set("value", np.full(4, 0.5, np.float32))
    linked(data).data.materials.append(new_material("Hair"))
    scene.camera = linked(bpy.data.cameras.new("Camera"))
    scene.camera.location, scene.camera.rotation_euler = (0, -5, 0), (np.pi / 2, 0, 0)
    scene.camera.data.type, scene.camera.data.ortho_scale = "ORTHO", 1.0
    light = bpy.data.lights.new("Sun", "SUN")
    light.energy, light.angle = 1.0, 0.0
    render, cycles = scene.render, scene.cycles
    render.engine, render.resolution_x, render.resolution_y = "CYCLES", SIZE, SIZE
    render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR", "32"
    cycles.device, cycles.samples, cycles.max_bounces, cycles.filter_width = "CPU", 64, 0, 0.01
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    return linked(light)


def seen_by_cycles(folder: Path) -> np.ndarray:
    """(3,) radiance, the mean over the hair's width."""
    scene = bpy.context.scene
    scene.render.filepath = str(folder / "hair.exr")
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(SIZE, SIZE, 4)[8:24, :, :3].mean(axis=(0, 1))


@pytest.mark.parametrize("offset", [0.0, 0.3])
@pytest.mark.parametrize("phi", [0.0, 0.25 * np.pi, 0.5 * np.pi, np.pi])
def test_a_hair_scatters_as_cycles_does(sun, tmp_path, phi, offset):
    """The sun from phi off the eye, from below, straight, and from above: scales lean towards one end."""
    tree = bpy.data.materials["Hair"].node_tree
    settings = {"Color": (*COLOR[0], 1), "Roughness": 0.3, "Radial Roughness": 0.3, "IOR": 1.55, "Offset": offset}
    shader = node(tree, "ShaderNodeBsdfHairPrincipled", settings, parametrization="COLOR", model="CHIANG")
    node(tree, "ShaderNodeOutputMaterial", {"Surface": shader.outputs[0]})
    fibre = Fibre(COLOR, np.array([0.3]), np.array([0.3]), np.array([1.55]), np.array([offset]))
    for z in (-0.4, 0.0, 0.4):
        direction = np.array([np.sin(phi), -np.cos(phi), z])
        direction /= np.linalg.norm(direction)
        sun.rotation_euler = Vector(direction).to_track_quat("Z", "Y").to_euler()
        truth = seen_by_cycles(tmp_path)
        # One offset for each column of pixels, of which Cycles samples the middle.
        ours = scattered(np.arcsin(direction[2]), 0.0, phi, fibre, SIZE)
        assert np.abs(ours / truth - 1).max() < 0.02, (z, ours, truth)  # measured 0.016
