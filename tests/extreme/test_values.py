"""Denormals, NaN, infinities and numbers that float32 cannot square, in every attribute of all that is drawn.

Everything stays finite, nothing is darker than black or more than opaque, and what is wrong in one thing stays in it:
the rest of the picture is as without that thing. Media: tests/render/passes/test_translucent_extremes.py.
"""

from __future__ import annotations

import warnings
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pointsplat_addon.core.material.graph import MaterialGraph
from pointsplat_addon.core.material.nodes import color_nodes, input_nodes, texture_nodes
from pointsplat_addon.core.scene.camera import Aperture
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.scene import Geometry
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.device.protocol import to_half
from scripts.scenes import build, drawing, lit_cases, meshes
from scripts.scenes.build import materials, mesh, moved, points, scene
from scripts.scenes.cameras import camera
from scripts.scenes.case import Case
from scripts.scenes.clouds import plane_cloud, sphere_cloud
from tests.support.extremes import (
    FEW,
    SHADOWED,
    TECHNIQUES,
    all_kinds,
    every_pass,
    lamp,
    picture,
    without,
)

ODD = (np.nan, np.inf, -np.inf, 1e-42, -1e30, 3e38)
PLAIN = Settings(use_shadows=False)
EYE = camera((0, -4, 0.5), resolution=(48, 32))
GOOD = (points("good ball", sphere_cloud(600)), moved((-0.9, 0, 0), 0.6))
AT = moved((0.9, 0, 0), 0.6)
LEFT = slice(0, 18)  # columns that show the good ball and nothing else


@pytest.fixture(autouse=True)
def silent():
    """NumPy has nothing to warn of: what is odd is found before it is reckoned with."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        yield


def assert_rest_is_right(
    within, what: str, *things: tuple[Geometry, np.ndarray], technique="IMAGE_SPACE", **more
) -> None:
    found = every_pass(Case(scene(GOOD, *things, **more), EYE, PLAIN), technique)
    bare = every_pass(Case(scene(GOOD, **more), EYE, PLAIN), technique)
    # Splats that are wider than those of the rest give its holes a coarser level to be filled from.
    for name, bound in (("combined", 5e-3), ("normal", 2e-2)):
        apart = np.abs(found[name] - bare[name])[:, LEFT]
        within(f"odd values in {what}", f"mean difference of the rest of the picture, {name}", apart.mean(), bound)


CLOUD = {
    "normal": plane_cloud(12, 0.8).normal,
    "axis": np.tile(np.array([1, 0, 0], np.float32), (144, 1)),
    "radii": np.full((144, 2), 0.1, np.float32),
    "color": np.full((144, 3), 0.5, np.float32),
    "surface": np.full((144, 2), 0.5, np.float32),
    "emission": np.full((144, 3), 0.1, np.float32),
    "shading_normal": plane_cloud(12, 0.8).normal,
    "velocity": np.full((144, 3), 0.1, np.float32),
    "value": np.ones(144, np.float32),
}


def whole_cloud() -> PointCloud:
    return replace(plane_cloud(12, 0.8), **CLOUD)


@pytest.mark.parametrize("technique", TECHNIQUES)
@pytest.mark.parametrize("odd", ODD)
@pytest.mark.parametrize("name", ["position", *CLOUD])
def test_attributes_of_points(name, odd, technique, within):
    values = whole_cloud().arrays()[name].copy()
    values[::3] = odd
    cloud = replace(whole_cloud(), **{name: values})
    assert_rest_is_right(within, "attributes of points", (points(f"odd {name} {odd}", cloud), AT), technique=technique)


@pytest.mark.parametrize("place", [1e19, 1e30, 3.5e38, 1e300])
@pytest.mark.parametrize("primitive", ["POINTS", "POLYGONS"])
def test_transforms_that_float32_cannot_hold(place, primitive, within):
    for matrix in (moved((place, 0, 0)), moved((0, -place, 0)), moved(scale=place)):
        matrix[:3, :3] += AT[:3, :3]
        of = mesh(meshes.plane_mesh(f"lost {place} {primitive}", 0.8, 4), primitive)
        every_pass(Case(scene(GOOD, (of, matrix)), EYE, PLAIN))
    assert_rest_is_right(
        within, "transforms", (mesh(meshes.plane_mesh("lost", 0.8, 4), primitive), moved((place, 0, 0)))
    )


@given(data=st.data())
def test_any_values_in_any_attributes(data, within):
    """Of several attributes and points at once, and with transforms that are odd themselves."""
    cloud, chosen = whole_cloud(), {}
    number = st.floats(width=32, allow_subnormal=True) | st.sampled_from(ODD)
    for name in data.draw(st.lists(st.sampled_from(["position", *CLOUD]), min_size=1, max_size=4, unique=True)):
        values = cloud.arrays()[name].copy()
        rows = data.draw(st.lists(st.integers(0, 143), min_size=1, max_size=8))
        values[rows] = np.float32(data.draw(number))
        chosen[name] = values
    matrix = AT.copy()
    if data.draw(st.booleans()):
        matrix[data.draw(st.integers(0, 2)), data.draw(st.integers(0, 2))] = data.draw(
            st.floats() | st.sampled_from(ODD)
        )
    odd = replace(cloud, **chosen)
    key = f"any {hash(tuple(array.tobytes() for array in odd.arrays().values()))}"
    every_pass(Case(scene(GOOD, (points(key, odd), matrix)), EYE, PLAIN))


TRANSLUCENT = {
    "opacity": np.full(144, 0.5, np.float32),
    "extinction": np.full(144, 0.5, np.float32),
    "extinction of each channel": np.full((144, 3), 0.5, np.float32),
}


@pytest.mark.parametrize("technique", TECHNIQUES)
@pytest.mark.parametrize("odd", [*ODD, -1.0])
@pytest.mark.parametrize("name", TRANSLUCENT)
def test_attributes_of_translucent_points(name, odd, technique, within):
    values = TRANSLUCENT[name].copy()
    values[::3] = odd
    cloud = replace(plane_cloud(12, 0.8), **{name.split()[0]: values})
    thing = points(f"odd {name} {odd}", cloud), AT
    assert_rest_is_right(within, "attributes of translucent points", thing, technique=technique)


@pytest.mark.parametrize("technique", TECHNIQUES)
@pytest.mark.parametrize("name", ["material", "kernel"])
def test_points_of_rows_that_no_table_has(name, technique, within):
    last = {"material": np.uint16(65535), "kernel": np.uint8(255)}[name]
    values = np.zeros(144, last.dtype)
    values[::3] = last
    thing = points(f"beyond {name}", replace(plane_cloud(12, 0.8), **{name: values})), AT
    assert_rest_is_right(within, "rows of points that no table has", thing, technique=technique)


def test_nodes_of_points_of_rows_that_no_table_has():
    """So many, so far away, that they are drawn by nodes."""
    cloud = sphere_cloud(40_000)
    beyond = points("nodes beyond", replace(cloud, material=np.full(len(cloud), 65535, np.uint16)))
    settings = replace(PLAIN, technique="IMAGE_SPACE")
    case = Case(scene((beyond, moved())), camera((0, -40, 0), resolution=(32, 32)), settings)
    every_pass(case, samples=128)  # so many that a hierarchy pays
    assert 0 < drawing.render(case, samples=128).report["points"]["cut"] < len(cloud) / 4


PICTURE = materials(
    graphs=(MaterialGraph(base_color=color_nodes.Color(texture_nodes.ImageTexture(input_nodes.UV(), build.picture()))),)
)


@pytest.mark.parametrize("primitive", ["POINTS", "POLYGONS"])
@pytest.mark.parametrize("odd", ODD)
@pytest.mark.parametrize("name", ["position", "corner_normal", "vertex_normal", "uv"])
def test_attributes_of_meshes(name, odd, primitive, within):
    of = meshes.plane_mesh(f"odd mesh {name} {odd} {primitive}", 0.8, 6)
    if name == "vertex_normal":
        up = np.tile(np.array([0, -1, 0], np.float32), (len(of.position), 1))
        of = replace(of, vertex_normal=up, corner_normal=None)
    values = (of.uv["UV"] if name == "uv" else getattr(of, name)).copy()
    values[5::7] = odd
    changed = replace(of, **{name: {"UV": values} if name == "uv" else values})
    table = PICTURE if name == "uv" else None
    assert_rest_is_right(within, "attributes of meshes", (mesh(changed, primitive), AT), table=table)


@pytest.mark.parametrize("ribbon", [False, True])
@pytest.mark.parametrize("odd", ODD)
@pytest.mark.parametrize("name", ["position", "radius", "normal", "color", "surface", "emission"])
def test_attributes_of_strands(name, odd, ribbon, within):
    u = np.linspace(-1, 1, 9)
    strands = [np.stack([u, 0 * u, 0 * u + z], axis=1) for z in (-0.5, 0, 0.5)]
    shape = {"position": (27, 3), "radius": (27,), "surface": (27, 2)}.get(name, (27, 3))
    given = {} if name in ("position", "radius") else {name: np.full(shape, 0.5, np.float32)}
    if ribbon:
        given.setdefault("normal", np.tile(np.array([0, -1, 0], np.float32), (27, 1)))
    thing = build.strand_lines(f"odd strands {name} {odd} {ribbon}", strands, 0.05, **given)
    assert thing.strands is not None
    values = getattr(thing.strands, name).copy()
    values[4:20:5] = odd
    changed = replace(thing, strands=replace(thing.strands, **{name: values}))
    assert_rest_is_right(within, "attributes of strands", (changed, AT))


# What was a frame before, lenses, mist


@pytest.mark.parametrize("odd", [*ODD[:3], -1e30, 3e38])
def test_what_was_nowhere_a_frame_before_has_not_moved(odd):
    made = scene(GOOD, (points("came from nowhere", whole_cloud()), AT))
    still = made.instances.world_from_object
    before = still.copy()
    before[1, 0, 0] = odd
    view = EYE.view_from_world.copy()
    view[0, 3] = odd
    alone = every_pass(Case(replace(made, instances=replace(made.instances, previous=still)), EYE, PLAIN))["vector"]
    for instances, eye in (
        (replace(made.instances, previous=before), EYE),
        (made.instances, replace(EYE, previous_view_from_world=view)),
    ):
        found = every_pass(Case(replace(made, instances=instances), eye, PLAIN))["vector"]
        np.testing.assert_array_equal(found, alone)


@pytest.mark.parametrize("method", ["SPLAT", "LENS_SAMPLES"])
@pytest.mark.parametrize(
    "odd",
    [{name: value} for name in ("radius", "focus", "ratio", "rotation") for value in (np.nan, np.inf, -np.inf)]
    + [{"focus": 0.0}, {"focus": -1.0}, {"ratio": 0.0}, {"ratio": -1.0}, {"radius": 3e38}],
)
def test_a_lens_that_is_none_leaves_all_in_focus(odd, method):
    eye = replace(EYE, aperture=Aperture(**{"radius": 0.2, "focus": 3.0, "blades": 5, **odd}))
    case = Case(scene(GOOD), eye, replace(PLAIN, dof_method=method))
    if odd == {"focus": np.inf}:  # which is a lens
        every_pass(case, samples=3)
        return
    found, sharp = (picture(replace(case, camera=camera), samples=3) for camera in (eye, EYE))
    np.testing.assert_array_equal(found, sharp)
    told = drawing.render(case, samples=3).report["warnings"]
    assert any("lens" in text for text in told) == (odd != {"radius": -np.inf})


@pytest.mark.parametrize("technique", TECHNIQUES)
@pytest.mark.parametrize("matrix", ["view_from_world", "clip_from_view"])
@pytest.mark.parametrize("odd", [0.0, *ODD[:3], -1e30, 3e38])
def test_a_camera_that_is_none_shows_the_world_alone(odd, matrix, technique):
    """Where one axis, or one scale of the projection, is that number. As in Cycles, whose rays then meet nothing."""
    wrong = getattr(EYE, matrix).copy()
    wrong[:3, 0] *= 0
    wrong[0, 0] = odd
    nowhere = replace(all_kinds("nowhere"), camera=replace(EYE, **{matrix: wrong}, aperture=Aperture(0.2, 3.0)))
    alone = replace(without(nowhere, list(range(len(nowhere.scene.instances)))), camera=EYE)
    found, there = every_pass(nowhere, technique), every_pass(alone, technique)
    assert {name: array.tobytes() for name, array in found.items()} == {k: a.tobytes() for k, a in there.items()}
    assert any("Camera" in text for text in drawing.render(nowhere).report["warnings"])


@pytest.mark.parametrize("method", ["SPLAT", "LENS_SAMPLES"])
@pytest.mark.parametrize("radius", [0.0, 1e-12, 1e-9, 1e3, 1e9])
@pytest.mark.parametrize("focus", [1e-9, 4.0, 1e9, 1e30])
def test_lenses_of_any_size_and_focus(radius, focus, method, within):
    """Without a size, as a pinhole, and at the other end still as bright as something between all that is seen."""
    eye = replace(EYE, aperture=Aperture(radius, focus))
    case = Case(scene(GOOD), eye, replace(PLAIN, dof_method=method))
    found, sharp = (picture(replace(case, camera=camera), samples=3) for camera in (eye, EYE))
    if max(radius, radius / focus) < 1e-8:
        within("lenses of 0 to 1e-9", "difference of a pixel from a pinhole's", np.abs(found - sharp).max(), 1e-5)
    beyond = max(found.max() - sharp.max(), sharp.min() - found.min())
    within("lenses of 0 to 1e9, in focus at 1e-9 to 1e30", "beyond what is seen in focus", beyond, 1e-3)


@pytest.mark.parametrize("odd", ODD)
@pytest.mark.parametrize("name", ["start", "depth"])
def test_mist_that_is_no_number(name, odd):
    made = scene(GOOD)
    every_pass(Case(replace(made, mist=replace(made.mist, **{name: odd})), EYE, PLAIN))


# Lamps, materials, worlds


def lit(lights, table=None, world=None) -> Case:
    thing = (mesh(meshes.plane_mesh("lit by odd lamps", 0.8, 4), "POLYGONS"), moved((0.8, 0, 0)))
    return Case(scene(GOOD, thing, lights=lights, table=table, world=world), EYE, SHADOWED)


LIGHT_FIELDS = ("color", "position", "direction", "radius", "spot_cos", "spot_blend", "axis_u", "axis_v", "spread",
                "diffuse", "specular")  # fmt: skip


@pytest.mark.parametrize("kind", ["POINT", "SUN", "SPOT", "AREA"])
@pytest.mark.parametrize("name", LIGHT_FIELDS)
def test_a_lamp_that_is_no_number_puts_out_no_other(kind, name):
    light = lamp(kind, (-2, -3, 2), 30)
    if getattr(light, name) is None:
        return
    alone = picture(lit([build.sun()]))
    for odd in (np.nan, np.inf, -np.inf, 3e38):
        value = np.full(3, odd) if isinstance(getattr(light, name), np.ndarray) else odd
        case = lit([replace(light, name="odd one", **{name: value}), build.sun()])
        np.testing.assert_array_equal(picture(case), alone)
        told = drawing.render(case).report["warnings"]
        assert any('"odd one"' in text for text in told)


@pytest.mark.parametrize("odd", [*ODD, -1.0, 0.0])
@pytest.mark.parametrize("name", ["base_color", "roughness", "metallic", "ior", "specular", "emission", "alpha"])
def test_materials_that_are_no_numbers_leave_the_others(name, odd, within):
    table = materials(2)
    values = getattr(table, name).copy()
    values[1] = odd
    of = replace(meshes.plane_mesh("of an odd material", 0.8, 4), materials=(1,))
    cloud = replace(plane_cloud(8, 0.4), material=np.ones(64, np.uint16))
    things = ((mesh(of, "POLYGONS"), AT), (points("of it too", cloud), moved((0.9, -0.5, 0))))
    assert_rest_is_right(within, "materials", *things, table=replace(table, **{name: values}))


@pytest.mark.parametrize("odd", [*ODD, -1.0])
@pytest.mark.parametrize("picture_of_it", [False, True])
def test_worlds_that_are_no_numbers(odd, picture_of_it):
    world = World(np.full(3, odd))
    if picture_of_it:
        image = np.full((8, 16, 3), 0.5, np.float32)
        image[3, 4] = odd
        world = World(np.zeros(3), image)
        turned = replace(world, image=np.full((8, 16, 3), 0.5, np.float32), world_rotation=np.full((3, 3), odd))
        every_pass(lit([build.sun()], world=turned))
    every_pass(lit([build.sun()], world=world))


@pytest.mark.parametrize("technique", TECHNIQUES)
@pytest.mark.parametrize("strength", [1e4, 1e6, 1e30])
@pytest.mark.parametrize("primitive", ["POINTS", "POLYGONS"])
def test_what_shines_brighter_than_half_floats_is_white_and_not_black(strength, primitive, technique):
    table = materials(emission=np.full((1, 3), strength))
    thing = mesh(meshes.plane_mesh("too bright", 1.5, 4), primitive), moved()
    found = picture(Case(scene(thing, table=table), camera(resolution=FEW), PLAIN), technique)
    assert found[12, 16, :3].min() >= min(strength, 65504) * 0.9


def test_half_floats_hold_the_nearest_of_what_they_can():
    given_values = np.array([0, 1, -65504, 65519, 7e4, -1e30, np.inf, -np.inf, np.nan, 1e-8], np.float32)
    expected = [0, 1, -65504, 65504, 65504, -65504, 65504, -65504, 0, 0]
    np.testing.assert_array_equal(to_half(given_values), expected)


def test_what_is_valid_is_not_copied():
    """Neither scenes, nor clouds, that have nothing odd in them are copied."""
    from pointsplat_addon.core.scene.valid.geometry import valid_points
    from pointsplat_addon.core.scene.validation import validate

    case = lit_cases.lights()
    scene, camera = validate(case.scene, case.camera)
    assert camera is case.camera
    assert validate(scene, camera)[0] is scene
    for name in ("geometries", "instances", "materials", "lights", "world", "warnings"):
        assert getattr(scene, name) is getattr(case.scene, name)
    cloud = whole_cloud()
    assert valid_points(cloud)[0] is cloud
    assert {f.name for f in fields(cloud)} >= set(CLOUD)
