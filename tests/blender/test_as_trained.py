"""Saved pictures of captured splats that are blended as trained, against the formula in float64; and the panel."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from pointsplat_addon.formats.splats.opening import open_splats
from pointsplat_addon.host import engine
from pointsplat_addon.host.convert import camera as cameras
from pointsplat_addon.host.splats.pictures import read_picture
from pointsplat_addon.host.ui import panels
from tests.reference import captured as reference
from tests.support import splat_files as files
from tests.support.blender.scenes import pointcloud

pytestmark = pytest.mark.usefixtures("empty_file")
SIZE = (60, 44)
WORLD = (0.02, 0.3, 0.7)
STEP = 0.502 / 255  # half of one of the file; measured 0.5002


@pytest.fixture
def seen(tmp_path):
    """A scene of 400 imported splats, and what training saw of them, (H, W, 4) display values, premultiplied."""
    columns = files.splat_columns(400, 3)
    for name in ("scale_0", "scale_1", "scale_2"):
        columns[name] = [value - 2 for value in columns[name]]
    columns["f_dc_1"] = [value + 1.5 for value in columns["f_dc_1"]]
    files.write_splat_ply(tmp_path / "a.ply", columns)
    with open_splats(tmp_path / "a.ply") as reader:
        splats = files.read_all(reader)
    bpy.ops.pointsplat.import_splats(filepath=str(tmp_path / "a.ply"), axes="RFU")
    scene = bpy.context.scene
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location = (-1, -1, 4)
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.world = bpy.data.worlds.new("World")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (*WORLD, 1)
    scene.render.engine = "POINTSPLAT"
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.render.resolution_percentage, scene.render.dither_intensity = 100, 0
    scene.view_settings.view_transform = "Standard"
    scene.render.image_settings.file_format, scene.render.image_settings.color_mode = "PNG", "RGBA"
    scene.pointsplat.captured_blending = "TRAINED"
    bpy.context.view_layer.update()
    view = cameras.from_camera_object(camera, bpy.context.evaluated_depsgraph_get(), *SIZE)
    ob = bpy.data.objects["a"]
    return scene, reference.picture([(splats, np.array(ob.matrix_world))], view, trained=True)


def saved(scene, folder) -> np.ndarray:
    """(H, W, 4) float64 of a file of 8 bits, straight alpha, bottom row first."""
    scene.render.filepath = str(folder / "picture.png")
    bpy.ops.render.render(write_still=True)
    return read_picture((folder / "picture.png").read_bytes(), "picture")[::-1] / 255


@pytest.mark.parametrize("device", ["OPENGL", "BLENDER_GPU"])
def test_the_saved_picture_is_the_one_that_training_saw(seen, tmp_path, device):
    scene, shown = seen
    scene.pointsplat.device = device
    alpha = shown[..., 3:]
    found = saved(scene, tmp_path)
    expected = shown[..., :3] + (1 - alpha) * reference.display_from_linear(np.array(WORLD))
    assert (found[..., 3] == 1).all()
    assert np.abs(found[..., :3] - np.clip(expected, 0, 1)).max() < STEP
    assert engine.last_report["device"].startswith(device.lower())
    scene.render.film_transparent = True
    found = saved(scene, tmp_path)
    assert 0.1 < alpha.mean() < 0.9
    assert np.abs(found[..., 3:] - alpha).max() < STEP
    straight = np.clip(shown[..., :3] / np.maximum(alpha, 1e-9), 0, 1)
    assert np.abs((found[..., :3] - straight) * alpha).max() < STEP


def test_the_panel_is_there_where_there_are_captured_splats(seen):
    scene, _ = seen
    context = SimpleNamespace(engine="POINTSPLAT", scene=scene)
    panel = panels.POINTSPLAT_RENDER_PT_captured
    assert panel.poll(context)
    found: list[str] = []
    layout = SimpleNamespace(prop=lambda _, name: found.append(name))
    given: Any = SimpleNamespace(split_layout=lambda: layout)
    panel.draw(given, context)
    assert found == ["captured_blending"]
    bpy.data.pointclouds.remove(bpy.data.objects["a"].data)
    pointcloud("Scan", [(0, 0, 0)])
    assert not panel.poll(context)
