"""Strands that cannot be drawn as they are: from Blender's data to a picture that is whole, and says what is wrong."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest

pytestmark = pytest.mark.usefixtures("empty_file")
Z = np.linspace(0, 1.5, 6)
GOOD = np.stack([0 * Z, 0 * Z, Z], axis=1)
BESIDE = GOOD + np.array([0.7, 0, 0])
WIDTH = 0.2


def curves(points, sizes=None, radius=WIDTH / 2, kind="CATMULL_ROM"):
    data = bpy.data.hair_curves.new("Mop")
    data.add_curves(sizes or [len(points)])
    data.position_data.foreach_set("vector", np.asarray(points, np.float32).ravel())
    widths = data.attributes.get("radius") or data.attributes.new("radius", "FLOAT", "POINT")
    widths.data.foreach_set("value", np.broadcast_to(radius, len(points)).astype(np.float32).copy())
    data.set_types(type=kind)
    ob = bpy.data.objects.new("Mop", data)
    bpy.context.collection.objects.link(ob)
    return ob


def tube(points, radius=1.0):
    data = bpy.data.curves.new("Pipe", "CURVE")
    data.dimensions, data.bevel_depth = "3D", WIDTH / 2
    spline = data.splines.new("POLY")
    spline.points.add(len(points) - 1)
    for point, at in zip(spline.points, points, strict=True):
        point.co, point.radius = (*at, 1), radius
    bpy.context.collection.objects.link(bpy.data.objects.new("Pipe", data))


def fur(**settings):
    bpy.ops.mesh.primitive_plane_add()
    ob = bpy.context.object
    ob.name, ob.show_instancer_for_render = "Fur", False
    ob.modifiers.new("Fur", "PARTICLE_SYSTEM")
    made = ob.particle_systems[0].settings
    made.type, made.count, made.hair_length, made.radius_scale = "HAIR", 20, 1.5, 0.1
    for name, value in settings.items():
        setattr(made, name, value)
    return ob


def drawn(folder: Path) -> tuple[float, list[str]]:
    """World units^2 that are covered, as the camera along y sees them, and the warnings."""
    from pointsplat_addon.host.engine import last_report

    scene = bpy.context.scene
    data = bpy.data.cameras.new("camera")
    data.type, data.ortho_scale = "ORTHO", 4.0
    scene.camera = bpy.data.objects.new("camera", data)
    scene.camera.location, scene.camera.rotation_euler = (0, -5, 0.8), (np.pi / 2, 0, 0)
    scene.collection.objects.link(scene.camera)
    render = scene.render
    render.engine, render.film_transparent, render.filepath = "POINTSPLAT", True, str(folder / "a.exr")
    # Edges lie at some phase of the pixel filter, which counts what is near the middles of pixels more.
    render.resolution_x = render.resolution_y = 256
    render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR", "32"
    scene.pointsplat.samples = 16
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(render.filepath)
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    assert np.isfinite(pixels).all()
    return float(pixels[3::4].mean() * 16), last_report["warnings"]


def with_nan(points, row):
    points = points.copy()
    points[row] = np.nan
    return points


THROUGH = pytest.mark.parametrize("kind", ["CATMULL_ROM", "POLY", "BEZIER"])  # their points; NURBS curves end before
KINDS = pytest.mark.parametrize("kind", ["CATMULL_ROM", "POLY", "BEZIER", "NURBS"])
AREA = 1.5 * WIDTH  # of a whole strand; measured within 0.6 %


@THROUGH
def test_strands_of_one_point_are_counted_and_the_others_drawn(tmp_path, kind):
    curves(np.concatenate([GOOD, [[-1, 0, 1]], BESIDE]), [6, 1, 6], kind=kind)
    area, warnings = drawn(tmp_path)
    assert area == pytest.approx(2 * AREA, rel=0.1)
    assert warnings == ["Mop: 1 strand has less than two positions and is left out"]


@THROUGH
def test_a_point_that_is_no_number_costs_its_strand_no_more_than_itself(tmp_path, kind):
    curves(np.concatenate([with_nan(GOOD, 2), BESIDE]), [6, 6], kind=kind)
    area, warnings = drawn(tmp_path)
    assert area == pytest.approx(2 * AREA, rel=0.1)
    assert warnings == ["Mop: 1 control point is not a number and is left out"]


@KINDS
@pytest.mark.parametrize("radius", [0.0, -0.1])
def test_strands_without_a_radius_are_counted(tmp_path, kind, radius):
    curves(GOOD, radius=radius, kind=kind)
    assert drawn(tmp_path) == (0, ["Mop: 1 strand has no radius and is left out"])


@pytest.mark.parametrize("noise", [0.0, 1e-5])
@pytest.mark.parametrize("times", [2, 3])
@KINDS
def test_points_in_one_place_cut_nothing_off(tmp_path, kind, times, noise):
    """Splines go back and forth about them, also at the ends."""
    points = np.repeat(GOOD, times, axis=0)
    curves(points + noise * np.random.default_rng(0).normal(size=points.shape), kind=kind)
    area, warnings = drawn(tmp_path)
    assert area == pytest.approx(AREA, rel=0.1)  # two thirds, when the way back at an end was taken for its direction
    assert warnings == []


@KINDS
def test_strands_of_one_place_are_counted(tmp_path, kind):
    curves(np.ones((5, 3)), kind=kind)
    assert drawn(tmp_path) == (0, ["Mop: 1 strand has less than two positions and is left out"])


@pytest.mark.parametrize("kind", ["CATMULL_ROM", "POLY"])  # Blender itself takes minutes for such a NURBS curve
def test_a_strand_of_a_million_points_without_a_surface(tmp_path, kind):
    from pointsplat_addon.host.engine import last_report

    t = np.linspace(-1, 1, 1_000_000)
    ob = curves(np.stack([1.5 * t, 0 * t, 0.8 + 0 * t], axis=1), kind=kind)
    assert ob.data.surface is None
    area, warnings = drawn(tmp_path)
    assert area == pytest.approx(3 * WIDTH, rel=0.1)
    assert warnings == []
    assert last_report["lines"]["segments"] < 1000  # measured 2


def test_bad_tubes_and_bad_fur_are_named(tmp_path):
    tube([(1, 0, 0)])
    tube([(1, 0, 0)] * 3)
    tube([(0, 0, 0), (0, 0, 1)], radius=0.0)
    fur(radius_scale=0.0)
    fur(hair_length=0.0)
    fur(count=0)
    fur().data.vertices[0].co = (np.nan,) * 3
    area, warnings = drawn(tmp_path)
    assert area == 0
    assert sorted(warnings) == [
        "Fur.003: all control points are not numbers",
        "Fur: 20 strands have no radius and are left out",
        "Pipe.001: 1 strand has less than two positions and is left out",
        "Pipe.002: 1 strand has no radius and is left out",
        "Pipe: 1 strand has less than two positions and is left out",
    ]
