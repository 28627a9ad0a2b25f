"""Silhouettes by points and by polygons where Cycles draws them, for every kind of camera."""

import numpy as np
import pytest

from tests.support.blender.scenes import alpha

bpy = pytest.importorskip("bpy")

from mathutils import Euler

import pointsplat_addon
from scripts.common.images import COVERED, eroded, iou


@pytest.fixture
def scene():
    """A monkey's head that fills most of the picture, and nothing behind."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    pointsplat_addon.register()
    bpy.context.scene.pointsplat.use_indirect = False  # direct light alone
    scene = bpy.context.scene
    data = bpy.data.cameras.new("camera")
    data.lens = 40
    scene.camera = bpy.data.objects.new("camera", data)
    scene.camera.location, scene.camera.rotation_euler = (2.4, -2.2, 1.1), Euler((1.25, 0.1, 0.82))
    scene.collection.objects.link(scene.camera)
    bpy.ops.mesh.primitive_monkey_add(size=2.0)
    modifier = bpy.context.object.modifiers.new("Subdivision", "SUBSURF")
    modifier.levels = modifier.render_levels = 2
    render = scene.render
    render.film_transparent = True
    render.resolution_x = render.resolution_y = 256
    render.image_settings.file_format, render.image_settings.color_mode = "OPEN_EXR", "RGBA"
    render.image_settings.color_depth = "32"
    cycles = scene.cycles
    cycles.device, cycles.samples, cycles.max_bounces = "CPU", 64, 0
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    yield scene
    pointsplat_addon.unregister()


def perspective(scene, camera):
    pass


def orthographic(scene, camera):
    camera.type, camera.ortho_scale = "ORTHO", 3.2


def shifted(scene, camera):
    camera.shift_x, camera.shift_y = 0.12, -0.1


def portrait(scene, camera):
    scene.render.resolution_x, scene.render.resolution_y = 200, 300


@pytest.mark.parametrize("set_up", [perspective, orthographic, shifted, portrait])
def test_silhouettes_are_those_of_cycles(scene, tmp_path, set_up):
    set_up(scene, scene.camera.data)
    truth = alpha(scene, tmp_path, "CYCLES")
    assert 0.2 < np.mean(truth >= 0.5) < 0.8
    for primitive in ("POINTS", "POLYGONS"):
        bpy.data.objects["Suzanne"].pointsplat.primitive = primitive
        ours = alpha(scene, tmp_path, "POINTSPLAT")
        assert iou(ours, truth)[0] > 0.99, primitive  # measured 0.9973
        # No holes.
        assert ours[eroded(truth >= COVERED)].min() >= COVERED, primitive


@pytest.mark.parametrize("size", [1.5, 3.0])
def test_edges_are_filtered_as_cycles_filters_them(scene, tmp_path, size):
    """Cycles, too, calls half of what its Blackman-Harris window is wide the filter's width."""
    scene.render.resolution_x = scene.render.resolution_y = 128
    scene.render.filter_size = scene.cycles.filter_width = size
    scene.cycles.samples = 1024
    truth = alpha(scene, tmp_path, "CYCLES")
    scene.cycles.samples, scene.cycles.seed = 16, 1
    theirs = np.mean((alpha(scene, tmp_path, "CYCLES") - truth) ** 2)
    for technique in ("VISIBILITY", "IMAGE_SPACE"):
        scene.pointsplat.technique = technique
        ours = np.mean((alpha(scene, tmp_path, "POINTSPLAT") - truth) ** 2)
        # Measured 1.01 (image space) and 0.11 (visibility buffer)
        assert ours < 1.1 * theirs, technique
