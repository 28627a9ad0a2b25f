"""Motion blur of final renders: against a closed form, beside Cycles, and that it costs nothing where nothing moves."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from mathutils import Vector

from pointsplat_addon.host import motion_blur
from pointsplat_addon.host.engine import last_report
from pointsplat_addon.render.plan.request import Result
from tests.support.blender.scenes import draw_beside_cycles, new_material, node, picture

SIZE = 96, 64


def keyed(ob, path, *values):
    """Makes a property of an object pass these values at frames 0, 2, ... along straight lines."""
    for frame, value in enumerate(values):
        setattr(ob, path, value)
        ob.keyframe_insert(path, frame=2 * frame)
    action = ob.animation_data.action
    curves = action.layers[0].strips[0].channelbags[0].fcurves if action.layers else action.fcurves
    for curve in curves:
        for point in curve.keyframe_points:
            point.interpolation = "LINEAR"


def filmed(location, target, scene, **lens):
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.location = location
    camera.rotation_euler = (Vector(target) - Vector(location)).to_track_quat("-Z", "Y").to_euler()
    for name, value in lens.items():
        setattr(camera.data, name, value)
    scene.collection.objects.link(camera)
    scene.camera = camera
    return camera


def shining(ob):
    material = new_material()
    shown = node(material.node_tree, "ShaderNodeEmission")
    node(material.node_tree, "ShaderNodeOutputMaterial", {"Surface": shown.outputs[0]})
    ob.data.materials.append(material)


def bodies(scene):
    """A floor, a ball and a cube under a sun."""
    bpy.ops.mesh.primitive_plane_add(size=12)
    bpy.ops.mesh.primitive_cube_add(size=1, location=(1.6, 0, 0.5))
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.8, location=(-0.5, 0, 0.8))
    ball = bpy.context.object
    ball.data.shade_smooth()
    bpy.ops.object.light_add(type="SUN", rotation=(0.6, 0.3, 0))
    bpy.context.object.data.energy = 3
    filmed((0, -6, 3.5), (0, 0, 0.6), scene)
    return ball


def both(scene, folder):
    found = []
    for engine in ("CYCLES", "POINTSPLAT"):
        scene.render.engine = engine
        found.append(picture(scene, folder).astype(float))
    return found


@pytest.mark.parametrize(
    ("position", "shutter", "begin"), [("START", 0.5, 0.0), ("CENTER", 0.5, -0.25), ("END", 1.5, -1.5)]
)
def test_moments_are_even_where_the_shutter_is(empty_file, position, shutter, begin):
    render = bpy.context.scene.render
    assert motion_blur.moments(render, 8).size == 0
    render.use_motion_blur, render.motion_blur_position, render.motion_blur_shutter = True, position, shutter
    expected = begin + shutter * (np.arange(8) + 0.5) / 8
    np.testing.assert_allclose(motion_blur.moments(render, 8), expected, atol=1e-7)  # 6e-9 at most
    render.motion_blur_shutter_curve.curves[0].points[0].location = 0, 0  # opens until half of the time
    render.motion_blur_shutter_curve.update()
    found = (motion_blur.moments(render, 64) - begin) / shutter
    assert (np.diff(found) > 0).all()
    assert found.mean() > 0.52
    assert np.diff(found)[0] > 2 * np.diff(found)[-1]


def test_a_moving_square_is_the_trapezoid_of_its_way(empty_file, tmp_path):
    """A square of 16 pixels that passes 24 while the shutter is open: alpha over x is the convolution of both boxes."""
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_plane_add(size=1.6)
    ob = bpy.context.object
    shining(ob)
    keyed(ob, "location", (-2.4, 0, 0), (2.4, 0, 0))
    filmed((0, 0, 5), (0, 0, 0), scene, type="ORTHO", ortho_scale=9.6)
    draw_beside_cycles(scene, SIZE, 32)
    scene.frame_set(1)
    scene.render.film_transparent = scene.render.use_motion_blur = True
    scene.render.motion_blur_shutter = 1.0
    scene.render.engine = "POINTSPLAT"
    scene.pointsplat.samples = 32
    found = picture(scene, tmp_path)[32, :, 3].astype(float)
    x = np.arange(96) - 47.5
    truth = np.clip((20 - np.abs(x)) / 24, 0, 16 / 24)
    # A moment is 0.75 pixels from the next: 0.0046 at the worst, where the pixel's filter rounds the corners.
    assert np.abs(found - truth).max() < 0.006
    np.testing.assert_allclose(found.sum(), truth.sum(), rtol=1e-5)  # 7e-9
    assert scene.frame_current == 1
    assert scene.frame_subframe == 0


@pytest.mark.either
@pytest.mark.parametrize("what", ["object", "camera", "lens", "deformed"])
def test_what_moves_is_as_blurred_as_in_cycles(empty_file, tmp_path, what):
    scene = bpy.context.scene
    ball = bodies(scene)
    if what == "object":
        keyed(ball, "location", ball.location, ball.location + Vector((1, 0, 0)))
    elif what == "deformed":
        wave = ball.modifiers.new("cast", "CAST")
        wave.factor = 0
        wave.keyframe_insert("factor", frame=0)
        wave.cast_type, wave.factor = "CUBOID", 1
        wave.keyframe_insert("factor", frame=2)
    else:
        keyed(scene.camera, "location", scene.camera.location, scene.camera.location + Vector((0.6, 0, 0.2)))
        scene.camera.data.dof.use_dof = what == "lens"
        scene.camera.data.dof.focus_distance, scene.camera.data.dof.aperture_fstop = 5, 0.4
    scene.frame_set(1)
    draw_beside_cycles(scene, SIZE, 256)
    scene.render.use_motion_blur = True
    theirs, ours = both(scene, tmp_path)
    scene.render.use_motion_blur = False
    still = picture(scene, tmp_path).astype(float)
    error, without = (float(np.sqrt(np.square((one - theirs)[..., :3]).mean())) for one in (ours, still))
    assert error < 0.007, error  # object 0.0039, camera 0.0042, lens 0.0057, deformed 0.0045, Cycles' noise included
    assert without > 2 * error, (without, error)


def test_pictures_of_what_stands_still_are_the_same(empty_file, tmp_path):
    scene = bpy.context.scene
    bodies(scene)
    draw_beside_cycles(scene, SIZE, 16)
    scene.render.engine = "POINTSPLAT"
    still = picture(scene, tmp_path)
    samples = last_report["samples"]
    scene.render.use_motion_blur = True
    np.testing.assert_array_equal(picture(scene, tmp_path), still)
    assert last_report["samples"] == samples


def test_passes_without_averages_are_of_the_frame(monkeypatch):
    """Of three moments: means of the averages; depth of the picture at the frame, which is drawn beside them."""
    from pointsplat_addon.core.scene.camera import Camera
    from pointsplat_addon.core.scene.lights import Light
    from pointsplat_addon.core.scene.materials import default_materials
    from pointsplat_addon.core.scene.scene import Instances, Scene
    from pointsplat_addon.core.scene.settings import Settings
    from pointsplat_addon.core.scene.world import World
    from pointsplat_addon.render.plan.request import Request

    def scene_with(x):
        light = Light("POINT", np.ones(3), np.array([x, 0.0, 0.0]), np.array([0.0, 0.0, -1.0]))
        return Scene((), Instances(np.zeros(0, np.int32), np.zeros((0, 4, 4))), default_materials(), (light,), World())

    camera = Camera(np.eye(4), np.eye(4), (1, 1))
    drawn = []

    def draw_one(scene, request):
        x = scene.lights[0].position[0]
        drawn.append((x, request.moment, request.passes, request.samples))
        pixels = {key: np.full((1, 1, 4), x, np.float32) for key in {"combined", *request.passes}}
        told = {"passes": [{"name": "shade", "ms": 1.0}], "samples": 5, "warnings": [f"at {x}"]}
        return Result(pixels, told), []

    passes = frozenset({"combined", "depth", "normal"})
    request = Request(camera, Settings(), passes, 3)
    times = np.array([1.0, 2.0, 6.0])
    result, _ = motion_blur.draw(times, lambda t: (scene_with(t), camera), draw_one, scene_with(9.0), request)
    assert {key: float(pixels[0, 0, 0]) for key, pixels in result.pixels.items()} == {
        "combined": 3.0, "normal": 3.0, "depth": 9.0,
    }  # fmt: skip
    averages = passes - {"depth"}
    assert sorted(drawn) == [
        (1.0, (0, 3), averages, 3), (2.0, (1, 3), averages, 3), (6.0, (2, 3), averages, 3),
        (9.0, (0, 1), frozenset({"depth"}), 3),
    ]  # fmt: skip
    assert result.report["passes"] == [{"name": "shade", "ms": 4.0}]
    assert result.report["samples"] == 20
    assert len(result.report["warnings"]) == 4


@pytest.mark.either
@pytest.mark.parametrize("technique", ["IMAGE_SPACE", "EWA", "PAINTER"])
def test_other_techniques_blur_too(empty_file, tmp_path, technique):
    scene = bpy.context.scene
    ball = bodies(scene)
    keyed(ball, "location", ball.location, ball.location + Vector((1, 0, 0)))
    scene.frame_set(1)
    draw_beside_cycles(scene, SIZE, 16)
    scene.render.engine, scene.render.use_motion_blur = "POINTSPLAT", True
    expected = picture(scene, tmp_path).astype(float)
    scene.pointsplat.technique = technique
    found = picture(scene, tmp_path).astype(float)
    scene.render.use_motion_blur = False
    still = picture(scene, tmp_path).astype(float)
    error, without = (float(np.sqrt(np.square((one - expected)[..., :3]).mean())) for one in (found, still))
    assert error < 0.01, error  # 0.0082 each
    assert without > 2 * error, (without, error)
