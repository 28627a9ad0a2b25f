"""Strands where Cycles draws its curves, and as much of them."""

from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

import pointsplat_addon
from pointsplat_addon.core.strand.curves import FREE
from scripts.common.images import iou
from tests.support.blender.scenes import alpha


@pytest.fixture
def scene():
    """Nothing but a camera that looks along y with parallel rays at a square of side 2."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    pointsplat_addon.register()
    bpy.context.scene.pointsplat.use_indirect = False  # direct light alone
    scene = bpy.context.scene
    data = bpy.data.cameras.new("camera")
    data.type, data.ortho_scale = "ORTHO", 2.0
    scene.camera = bpy.data.objects.new("camera", data)
    scene.camera.location, scene.camera.rotation_euler = (0, -5, 0), (np.pi / 2, 0, 0)
    scene.collection.objects.link(scene.camera)
    render = scene.render
    render.film_transparent = True
    render.resolution_x = render.resolution_y = 512
    render.image_settings.file_format, render.image_settings.color_mode = "OPEN_EXR", "RGBA"
    render.image_settings.color_depth = "32"
    cycles = scene.cycles
    cycles.device, cycles.samples, cycles.max_bounces = "CPU", 4, 0
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    yield scene
    pointsplat_addon.unregister()


def strands(points: np.ndarray, radius: np.ndarray | float):
    """A Curves object of strands (S, K, 3)."""
    data = bpy.data.hair_curves.new("Strands")
    data.add_curves([points.shape[1]] * len(points))
    data.position_data.foreach_set("vector", points.astype(np.float32).ravel())
    width = data.attributes.get("radius") or data.attributes.new("radius", "FLOAT", "POINT")
    width.data.foreach_set("value", np.broadcast_to(radius, points.shape[:2]).astype(np.float32).ravel())
    ob = bpy.data.objects.new("Strands", data)
    bpy.context.collection.objects.link(ob)
    return ob


def coil(points: int = 24) -> np.ndarray:
    u = np.linspace(-1, 1, points)
    return np.stack([0.8 * u, 0.4 * np.sin(4 * u), 0.5 * np.cos(5 * u)], axis=1)[None]


@pytest.mark.parametrize("shape", ["THICK", "RIBBONS"])
def test_a_tapering_tube_is_where_cycles_curves_are(scene, tmp_path, shape):
    strands(coil(), np.geomspace(0.12, 0.03, 24))
    scene.cycles_curves.shape = shape
    truth, ours = alpha(scene, tmp_path, "CYCLES"), alpha(scene, tmp_path, "POINTSPLAT")
    assert np.mean(truth >= 0.5) > 0.05
    assert iou(ours, truth)[0] > 0.97  # measured 0.992 and 0.974, where Cycles has fewer steps


@pytest.mark.parametrize("shape", ["THICK", "RIBBONS"])
def test_thin_strands_cover_what_they_do_in_cycles(scene, tmp_path: Path, shape):
    """0.1 pixels wide, in all directions."""
    scene.render.resolution_x = scene.render.resolution_y = 64
    scene.cycles.samples = 256
    scene.pointsplat.samples = 256
    scene.cycles_curves.shape = shape
    random = np.random.default_rng(3)
    way = random.normal(size=(300, 1, 3))
    way /= np.linalg.norm(way, axis=2, keepdims=True)
    middle = random.uniform(-0.6, 0.6, (300, 1, 3))
    strands(middle + 0.3 * way * np.linspace(-1, 1, 6)[:, None], 0.05 * 2 / 64)
    truth, ours = alpha(scene, tmp_path, "CYCLES"), alpha(scene, tmp_path, "POINTSPLAT")
    assert 0.01 < truth.mean() < 0.2
    assert abs(ours.mean() / truth.mean() - 1) < 0.03  # measured 0.0063 and 0.0042


def test_a_twisted_ribbon_is_where_it_is_as_triangles(scene, tmp_path):
    """Cycles' own ribbons face the camera and have no twist: here it draws one as a mesh."""
    u = np.linspace(-0.8, 0.8, 200)
    turn = 2.5 * u
    middle = np.stack([u, 0 * u, 0.3 * np.sin(2 * u)], axis=1)
    normal = np.stack([0 * u, -np.cos(turn), np.sin(turn)], axis=1).astype(np.float32)
    ob = strands(middle[None], 0.3)
    ob.data.set_types(type="POLY")
    ob.data.attributes.new("normal_mode", "INT8", "CURVE").data.foreach_set("value", [FREE])
    ob.data.attributes.new("custom_normal", "FLOAT_VECTOR", "POINT").data.foreach_set("vector", normal.ravel())
    ob.pointsplat.ribbons = True
    ours = alpha(scene, tmp_path, "POINTSPLAT")
    bpy.data.objects.remove(ob)
    tangent = np.gradient(middle, axis=0)
    side = np.cross(normal, tangent / np.linalg.norm(tangent, axis=1, keepdims=True))
    side *= 0.3 / np.linalg.norm(side, axis=1, keepdims=True)
    mesh = bpy.data.meshes.new("Band")
    low = np.arange(199)
    mesh.from_pydata(
        np.concatenate([middle - side, middle + side]).tolist(),
        [],
        np.stack([low, low + 1, low + 201, low + 200], axis=1).tolist(),
    )
    scene.collection.objects.link(bpy.data.objects.new("Band", mesh))
    truth = alpha(scene, tmp_path, "CYCLES")
    assert np.mean(truth >= 0.5) > 0.1
    assert iou(ours, truth)[0] > 0.97  # measured 0.997
