"""Final renders through bpy.ops.render.render: passes, borders, errors, cancelling."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
import pytest

import pointsplat_addon
from pointsplat_addon.host.device import gl_thread
from tests.support import files

NEW_NAMES = bpy.app.version >= (5, 0, 0)


@pytest.fixture(autouse=True)
def empty_file():
    pointsplat_addon.register()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.pointsplat.use_indirect = False  # direct light alone
    yield
    pointsplat_addon.unregister()


def scene_with(*, camera=True, cube=True, light=True, size=(40, 30)) -> Any:
    scene = bpy.context.scene
    scene.render.engine = "POINTSPLAT"
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.render.resolution_percentage = 100
    scene.pointsplat.samples = 1
    if camera:
        data = bpy.data.cameras.new("Camera")
        scene.camera = bpy.data.objects.new("Camera", data)
        scene.camera.location = (0, 0, 10)
        bpy.context.collection.objects.link(scene.camera)
    if cube:
        bpy.ops.mesh.primitive_cube_add()
        bpy.context.object.name = "Cube"
        bpy.context.object.pass_index = 3
    if light:
        bpy.ops.object.light_add(type="SUN", location=(0, 0, 5))
    return scene


def layers(scene, tmp_path) -> dict[str, np.ndarray]:
    """Render and read all passes back, (H, W, C), bottom row first, by Layer.Pass."""
    image = scene.render.image_settings
    if hasattr(image, "media_type"):
        image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format = "OPEN_EXR_MULTILAYER"
    image.color_depth = "32"
    image.exr_codec = "NONE"
    scene.render.filepath = str(tmp_path / "out.exr")
    bpy.ops.render.render(write_still=True)
    return files.read_exr(tmp_path / "out.exr")


def passes(scene, tmp_path) -> dict[str, np.ndarray]:
    """The same of a scene with one view layer, by the pass's name alone."""
    return {name.rpartition(".")[2]: array for name, array in layers(scene, tmp_path).items()}


def report() -> dict[str, Any]:
    from pointsplat_addon.host import engine

    return engine.last_report


def device() -> str:
    return report()["device"].partition(":")[0]


SWITCHES = {
    "use_pass_z": ("Depth", "Depth", 1),
    "use_pass_mist": ("Mist", "Mist", 1),
    "use_pass_position": ("Position", "Position", 3),
    "use_pass_normal": ("Normal", "Normal", 3),
    "use_pass_vector": ("Vector", "Vector", 4),
    "use_pass_diffuse_color": ("DiffCol", "Diffuse Color", 3),
    "use_pass_object_index": ("IndexOB", "Object Index", 1),
    "use_pass_material_index": ("IndexMA", "Material Index", 1),
}


def test_passes_that_are_switched_on_are_there_with_cycles_names(tmp_path):
    scene = scene_with()
    layer = bpy.context.view_layer
    for switch in SWITCHES:
        setattr(layer, switch, True)
    layer.use_pass_cryptomatte_object = layer.use_pass_cryptomatte_material = True
    layer.pass_cryptomatte_depth = 4
    found = passes(scene, tmp_path)
    expected = {names[NEW_NAMES]: names[2] for names in SWITCHES.values()}
    expected |= {f"Crypto{kind}{level:02d}": 4 for kind in ("Object", "Material") for level in (0, 1)}
    assert {n: a.shape[2] for n, a in found.items() if n != "Combined"} == expected
    assert {a.shape[:2] for a in found.values()} == {(30, 40)}
    assert all(np.isfinite(a).all() for a in found.values())


def test_without_switches_only_combined_is_made(tmp_path):
    scene = scene_with()
    bpy.context.view_layer.use_pass_z = False
    assert list(passes(scene, tmp_path)) == ["Combined"]


def test_the_cube_is_where_the_camera_sees_it_and_as_far_away(tmp_path):
    scene = scene_with(size=(64, 64))
    scene.render.film_transparent = True
    layer = bpy.context.view_layer
    layer.use_pass_z = layer.use_pass_object_index = True
    scene.pointsplat.samples = 16
    found = passes(scene, tmp_path)
    # A 50 mm lens on a 36 mm sensor: the cube's top, 9 units away, is 50/36/9 of the picture for each unit.
    side = 2 * 50 / 36 / 9 * 64
    assert found["Combined"][..., 3].sum() == pytest.approx(side**2, rel=0.02)
    assert found["Depth"][32, 32, 0] == pytest.approx(9, rel=1e-3)
    index = found["Object Index" if NEW_NAMES else "IndexOB"]
    assert index[32, 32, 0] == 3
    assert index[1, 1, 0] == 0


def test_a_border_has_the_size_that_blender_gives_it(tmp_path):
    """Blender multiplies in float32: 0.92 of 1,800 is 1,656 there, 0.78 is 1,404, where float64 has 1,403.99995."""
    scene = bpy.data.scenes.new("Border")
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(camera)
    scene.camera, scene.render.engine, scene.pointsplat.samples = camera, "POINTSPLAT", 1
    render = scene.render
    render.use_border = render.use_crop_to_border = True
    render.resolution_x, render.resolution_y, render.resolution_percentage = 3200, 1800, 100
    render.border_min_x, render.border_max_x = 0.4, 0.4025
    render.border_min_y, render.border_max_y = 0.78, 0.92
    render.filepath = str(tmp_path / "border.png")
    bpy.ops.render.render(write_still=True, scene=scene.name)
    assert tuple(bpy.data.images.load(render.filepath).size) == (8, 1656 - 1404)
    bpy.data.scenes.remove(scene)


def test_a_border_is_the_same_part_of_the_whole_picture(tmp_path):
    scene = scene_with(size=(64, 64))
    whole = passes(scene, tmp_path)["Combined"]
    render = scene.render
    render.use_border = render.use_crop_to_border = True
    render.border_min_x, render.border_max_x = 0.25, 0.75
    render.border_min_y, render.border_max_y = 0.125, 0.5
    part = passes(scene, tmp_path)["Combined"]
    assert part.shape == (24, 32, 4)
    assert np.abs(part - whole[8:32, 16:48]).max() <= 1 / 255


def test_resolution_percentage_scales_the_picture(tmp_path):
    scene = scene_with(size=(64, 48))
    scene.render.resolution_percentage = 50
    assert passes(scene, tmp_path)["Combined"].shape == (24, 32, 4)


def test_a_transparent_film_shows_no_world(tmp_path):
    scene = scene_with(cube=False, light=False)
    scene.world = bpy.data.worlds.new("World")
    scene.world.color = (0.5, 0.25, 0.125)
    opaque = passes(scene, tmp_path)["Combined"]
    assert np.all(opaque[..., 3] == 1)
    assert opaque[..., :3].max() > 0
    scene.render.film_transparent = True
    assert np.all(passes(scene, tmp_path)["Combined"] == 0)


def test_an_empty_scene_and_one_without_a_light_render_without_complaint(tmp_path):
    assert np.isfinite(passes(scene_with(cube=False, light=False), tmp_path)["Combined"]).all()
    assert report()["warnings"] == []
    bpy.ops.mesh.primitive_cube_add()
    assert np.isfinite(passes(bpy.context.scene, tmp_path)["Combined"]).all()
    assert report()["warnings"] == []


def test_no_camera_is_an_error_that_says_so():
    scene_with(camera=False)
    with pytest.raises(RuntimeError, match=r"[Cc]amera"):
        bpy.ops.render.render()


def test_the_report_says_what_was_done():
    scene_with()
    bpy.ops.render.render()
    assert device() == "opengl"
    assert report()["seconds"] > 0
    assert report()["warnings"] == []


def test_each_view_layer_is_rendered_with_its_own_collections(tmp_path):
    scene = scene_with(size=(32, 32))
    scene.render.film_transparent = True
    other = scene.view_layers.new("Other")
    collection = bpy.data.collections.new("Only first")
    scene.collection.children.link(collection)
    cube = bpy.data.objects["Cube"]
    collection.objects.link(cube)
    scene.collection.objects.unlink(cube)
    other.layer_collection.children["Only first"].exclude = True
    found = layers(scene, tmp_path)
    assert found[f"{bpy.context.view_layer.name}.Combined"][16, 16, 3] == 1
    assert np.all(found["Other.Combined"] == 0)


def test_the_second_frame_after_a_camera_move_reuses_the_geometry():
    from pointsplat_addon.host.final import FinalRender

    scene = scene_with()
    bpy.ops.render.render()
    assert FinalRender.last_scene is not None
    first = FinalRender.last_scene.geometries[0]
    scene.camera.location.x += 1
    bpy.ops.render.render()
    assert FinalRender.last_scene.geometries[0] is first


def test_blenders_gpu_gives_the_same_picture(tmp_path):
    scene = scene_with(size=(64, 64))
    first = passes(scene, tmp_path)["Combined"]
    scene.pointsplat.device = "BLENDER_GPU"
    second = passes(scene, tmp_path)["Combined"]
    if device() != "blender_gpu":
        pytest.skip("Blender has no graphics context here: " + "; ".join(report()["warnings"]))
    assert np.abs(first - second).max() <= 1 / 255


# When something goes wrong


@pytest.fixture
def failing(monkeypatch):
    """Make a device fail with a message."""

    def fail(*names):
        from pointsplat_addon.host.device import main_gpu
        from pointsplat_addon.render.device.protocol import DeviceError

        def raising(*_arguments):
            raise DeviceError("taken away by the test")

        if "opengl" in names:
            gl_thread.THREAD.release()
            monkeypatch.setattr(gl_thread, "_make_device", raising)
        if "blender_gpu" in names:
            main_gpu.MAIN_GPU.release()
            monkeypatch.setattr(main_gpu, "BlenderDevice", raising)

    return fail


def test_where_both_devices_are_missing_the_render_says_what_is_missing(failing):
    scene_with()
    failing("opengl", "blender_gpu")
    with pytest.raises(RuntimeError, match=r"moderngl.*taken away.*Blender's GPU.*taken away"):
        bpy.ops.render.render()


@pytest.mark.skipif(not NEW_NAMES, reason="a background process of Blender 4.5 has a context only if asked in advance")
def test_where_opengl_is_missing_blenders_gpu_takes_over(failing):
    scene_with()
    failing("opengl")
    bpy.ops.render.render()
    assert device() == "blender_gpu"
    assert report()["warnings"] == []


def test_a_device_that_was_asked_for_and_is_missing_gives_a_warning(failing):
    scene = scene_with()
    scene.pointsplat.device = "BLENDER_GPU"
    failing("blender_gpu")
    bpy.ops.render.render()
    assert device() == "opengl"
    assert "taken away by the test" in report()["warnings"][0]


def test_an_unexpected_exception_becomes_an_error_report(monkeypatch):
    from pointsplat_addon.host import final

    scene_with()

    def broken(*_arguments):
        raise ZeroDivisionError("of the test")

    monkeypatch.setattr(final, "_draw", broken)
    with pytest.raises(RuntimeError, match="ZeroDivisionError: of the test"):
        bpy.ops.render.render()
    monkeypatch.undo()
    assert bpy.ops.render.render() == {"FINISHED"}


def test_a_render_that_is_cancelled_ends_without_an_error(monkeypatch):
    from pointsplat_addon.host.engine import PointSplatEngine

    scene = scene_with()
    scene.pointsplat.samples = 4096  # minutes, were it not cancelled
    monkeypatch.setattr(PointSplatEngine, "test_break", lambda _self: True, raising=False)
    bpy.ops.render.render()
    monkeypatch.undo()
    scene.pointsplat.samples = 1
    assert bpy.ops.render.render() == {"FINISHED"}


def test_an_unsupported_camera_is_a_warning_that_names_it():
    scene = scene_with()
    scene.camera.data.type = "PANO"
    bpy.ops.render.render()
    assert any('"Camera"' in warning for warning in report()["warnings"])
