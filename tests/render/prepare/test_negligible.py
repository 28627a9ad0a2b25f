"""What is left out because it adds nothing measurable: bounds against float64, and pictures with it and without."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.light import light_shapes
from pointsplat_addon.core.scene.camera import Aperture
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.plan import frame_plan
from pointsplat_addon.render.prepare.in_view import CLEAR, OUT_OF_VIEW, ball_of_all_drawn, without_invisible_layers
from pointsplat_addon.render.prepare.negligible import EMISSION, LIGHTS, MEASURABLE, WORLD, reflection
from pointsplat_addon.render.prepare.prepare import prepare
from pointsplat_addon.render.shadow import shadows
from scripts.scenes import build, cameras, cases, clouds, drawing, lit_cases, solid_cases
from scripts.scenes.case import Case
from scripts.scenes.store import STORE
from tests.reference import lighting

KINDS = ("SUN", "POINT", "SPOT", "AREA")
COMBINED = frozenset({"combined"})


def lamp(rng: np.random.Generator, kind: str, away: float) -> Light:
    """A lamp of random size at a distance from the origin, shining there."""
    direction = rng.standard_normal(3)
    direction /= np.linalg.norm(direction)
    u = np.cross(direction, rng.standard_normal(3))
    u *= rng.uniform(0.02, 1) / np.linalg.norm(u)
    v = np.cross(direction, u) * rng.uniform(0.2, 2)
    return Light(
        kind, rng.uniform(0.1, 5, 3), -away * direction, direction,
        radius=rng.uniform(0, 0.5) if rng.random() < 0.7 else 0.0,
        spot_cos=np.cos(rng.uniform(0.1, 1.4)), spot_blend=rng.random(),
        axis_u=u if kind == "AREA" else None, axis_v=v if kind == "AREA" else None, ellipse=bool(rng.random() < 0.5),
        spread=rng.uniform(0.2, np.pi), soft=bool(rng.random() < 0.5),
        diffuse=rng.uniform(0, 2), specular=rng.uniform(0, 2),
    )  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_no_light_adds_more_than_its_bound(kind):
    """In float64, at random places of the unit ball, with random materials; the mirrored ray is among the directions,
    where lobes peak."""
    rng = np.random.default_rng(KINDS.index(kind))
    worst = 0.0
    for _ in range(60):
        table = build.materials(
            base_color=rng.uniform(0, 1.5, (1, 3)), roughness=[rng.random()], metallic=[rng.choice([0, rng.random()])],
            ior=[rng.uniform(0.7, 2.5)], specular=[rng.choice([0.0, 0.5, 1.0])],
        )  # fmt: skip
        case = Case(build.scene((build.points("faint: bounds", clouds.sphere_cloud(200)), np.eye(4)), table=table),
                    cameras.camera())  # fmt: skip
        prepared = prepare(case.scene, case.camera, Settings(technique="IMAGE_SPACE"), 1, STORE)
        light = lamp(rng, kind, rng.uniform(0.0, 8))
        centre, radius = ball_of_all_drawn(case.scene, prepared, STORE)
        middle = np.linalg.inv(case.camera.view_from_world)[:3] @ np.append(centre, 1)
        nearest = max(float(np.linalg.norm(light.position - middle)) - radius, 0.0)
        bound = reflection(case.scene, prepared, STORE).of(light, light_shapes.irradiance_bound(light, nearest))
        position, normal = clouds.sphere_points(200), rng.standard_normal((200, 3))
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        to_light = np.where(kind == "SUN", -light.direction, light.position - position)
        to_light = to_light / np.maximum(np.linalg.norm(to_light, axis=1, keepdims=True), 1e-9)
        normal *= np.sign((normal * to_light).sum(axis=1, keepdims=True))
        mirrored = 2 * (normal * to_light).sum(axis=1, keepdims=True) * normal - to_light
        to_eye = np.where(rng.random((200, 1)) < 0.5, mirrored, rng.standard_normal((200, 3)))
        to_eye /= np.maximum(np.linalg.norm(to_eye, axis=1, keepdims=True), 1e-9)
        surface = lighting.Surface(
            table.base_color[0], np.zeros(3), table.roughness[0], table.metallic[0], table.ior[0], table.specular[0]
        )
        found = lighting.shade(position, normal, to_eye, surface, [light])
        worst = max(worst, float(found.max()) / bound)
    # Measured 0.9995 (a sun on what only scatters diffusely), 0.55, 0.47 and 0.28.
    assert 0.1 < worst <= 1.0


def without_leaving_out(monkeypatch):
    monkeypatch.setattr(frame_plan, "without_negligible", lambda scene, prepared, view, store: (scene, True, ()))
    monkeypatch.setattr(frame_plan, "without_invisible_layers", lambda scene, prepared, camera, store: (prepared, {}))


def both(case: Case, monkeypatch, samples: int = 1):
    """The result as it is, and the picture of everything."""
    result = drawing.render(case, COMBINED, samples)
    with monkeypatch.context() as patched:
        without_leaving_out(patched)
        full = drawing.render(case, COMBINED, samples).pixels["combined"]
    return result, full


def why(result) -> dict[str, str]:
    return {entry["name"]: entry["because"] for entry in result.report["skipped"]}


def with_lights(*lights: Light) -> Case:
    case = solid_cases.plain_sphere()
    return replace(
        case, scene=replace(case.scene, lights=lights), settings=Settings(technique="IMAGE_SPACE", shadow_resolution=64)
    )


def test_a_lamp_far_away_is_left_out_with_its_shadow_and_nobody_sees_it(monkeypatch):
    at = np.array([0.0, -200.0, 0])
    bright = Light("POINT", np.full(3, 20.0), at, np.array([0.0, 1, 0]))
    result, full = both(with_lights(replace(bright, color=np.full(3, 0.2))), monkeypatch)
    assert why(result)["lights"] == "1 of 1: together they add less than 1/1024 of white"
    assert why(result)["shadows"] == "no light casts shadows"
    difference = np.abs(result.pixels["combined"] - full).max()
    assert 0 < difference < MEASURABLE  # measured 1.5e-6: the bound is that of the steepest mirrored ray
    assert "lights" not in why(both(with_lights(bright), monkeypatch)[0])


def test_many_faint_lamps_are_left_out_only_as_long_as_all_of_them_are_faint(monkeypatch):
    case = solid_cases.plain_sphere()
    bounds = reflection(case.scene, prepare(case.scene, case.camera, case.settings, 1, STORE), STORE)
    one = build.sun(LIGHTS / 9.5 / bounds.of(build.sun(1.0), 1.0))
    few, many = (both(with_lights(*[one] * n), monkeypatch) for n in (2, 50))
    assert why(few[0])["lights"].startswith("2 of 2")
    assert why(many[0])["lights"].startswith("9 of 50")
    for result, full in (few, many):
        assert np.abs(result.pixels["combined"] - full).max() < MEASURABLE  # measured 1.9e-6


def test_a_lamp_that_is_off_has_no_table_of_shadows(monkeypatch):
    monkeypatch.setattr(shadows.builder, "build_table", lambda *_: pytest.fail("a table was built"))
    result = drawing.render(with_lights(replace(build.sun(), color=np.zeros(3))), COMBINED)
    assert why(result)["lights"].startswith("1 of 1")


@pytest.mark.parametrize("image", [False, True])
@pytest.mark.parametrize("transparent", [False, True])
def test_a_world_is_left_out_just_below_what_it_may_add(image, transparent, monkeypatch):
    case = solid_cases.plain_sphere()
    for factor in (0.999, 1.001):
        prepared = prepare(case.scene, case.camera, case.settings, 1, STORE)
        radiance = factor * WORLD / reflection(case.scene, prepared, STORE).world
        world = World(np.full(3, radiance))
        if image:
            world = World(np.zeros(3), np.full((64, 128, 3), radiance, np.float32))
        other = replace(case, scene=replace(case.scene, world=world, transparent=transparent))
        result, full = both(other, monkeypatch)
        assert ("world" in why(result)) == (factor < 1)
        difference = np.abs(result.pixels["combined"] - full).max()
        assert difference < WORLD  # measured 0.25 of it
        assert (difference > 0) == (factor < 1)


def test_one_bright_texel_keeps_an_environment_picture():
    image = np.zeros((256, 512, 3), np.float32)
    image[101, 203] = 1000.0
    case = solid_cases.plain_sphere()
    result = drawing.render(replace(case, scene=replace(case.scene, world=World(np.zeros(3), image))), COMBINED)
    assert "world" not in why(result)


@pytest.mark.parametrize("factor", [0.999, 1.001])
def test_emission_is_left_out_just_below_what_it_may_add(factor, monkeypatch):
    case = solid_cases.cube()
    table = build.materials(emission=np.full((1, 3), factor * EMISSION))
    result, full = both(replace(case, scene=replace(case.scene, materials=table)), monkeypatch)
    assert ("emission" in why(result)) == (factor < 1)
    difference = np.abs(result.pixels["combined"] - full).max()
    assert difference <= EMISSION  # measured 0.999 of it
    assert (difference > 0) == (factor < 1)


def test_all_that_may_be_left_out_together_is_not_measurable():
    assert LIGHTS + WORLD + EMISSION <= MEASURABLE


def test_what_reflects_nothing_is_shown_as_if_it_were_lit(monkeypatch):
    case = lit_cases.emission()
    lit = replace(case, scene=replace(case.scene, lights=(build.sun(100.0),), world=World(np.ones(3))))
    black = replace(lit.scene.materials, specular=np.zeros(2, np.float32))
    result, full = both(replace(lit, scene=replace(lit.scene, materials=black)), monkeypatch)
    assert why(result)["lights"] == "1 of 1: nothing that is drawn reflects light"
    assert "world" not in why(result)  # it is seen
    np.testing.assert_array_equal(result.pixels["combined"], full)


def test_materials_that_nothing_has_reflect_nothing():
    """Row 0 is Blender's default material, whether or not anything has it."""
    case = lit_cases.emission()
    table = replace(case.scene.materials, base_color=np.array([[0.8] * 3, [0, 0, 0]], np.float32))
    cloud = replace(clouds.sphere_cloud(), material=np.ones(400, np.uint16))
    scene = build.scene((build.points("faint: second material", cloud), np.eye(4)), table=table)
    assert reflection(scene, prepare(scene, case.camera, case.settings, 1, STORE), STORE).black
    plain = build.scene((build.points("faint: first material", clouds.sphere_cloud()), np.eye(4)), table=table)
    assert not reflection(plain, prepare(plain, case.camera, case.settings, 1, STORE), STORE).black


@pytest.mark.parametrize("name", ["mixed", "wide_balls", "smoke", "panes", "foliage", "strands", "many_towers"])
def test_turning_away_changes_no_pixel(name, monkeypatch):
    """Cameras that turn until nothing is in view: pictures are the same as with all that is beside them."""
    case = cases.CASES[name]()
    left = 0
    for angle in np.linspace(0, np.pi, 7):
        turn = np.array(
            [[np.cos(angle), 0, np.sin(angle), 0], [0, 1, 0, 0], [-np.sin(angle), 0, np.cos(angle), 0], [0, 0, 0, 1.0]]
        )
        turned = replace(case, camera=replace(case.camera, view_from_world=turn @ case.camera.view_from_world))
        result, full = both(turned, monkeypatch)
        np.testing.assert_array_equal(result.pixels["combined"], full)
        left += OUT_OF_VIEW in why(result).values() or not result.report["passes"]
    assert left > 0


def test_with_an_aperture_nothing_is_out_of_view():
    case = solid_cases.mixed()
    away = cameras.camera((0, -8, 0), (0, -16, 0))
    prepared = prepare(case.scene, away, case.settings, 1, STORE)
    left, gone = without_invisible_layers(case.scene, prepared, away, STORE)
    assert gone["polygons"] == OUT_OF_VIEW
    assert left.cut.splats == len(left.polygons) == 0
    assert without_invisible_layers(case.scene, prepared, replace(away, aperture=Aperture(0.1, 4.0)), STORE)[1] == {}


def test_clear_matter_is_left_out_and_what_glows_in_it_is_not(monkeypatch):
    smoke = clouds.smoke_cloud(8, 0.0)
    glow = replace(smoke, emission=np.full((len(smoke), 3), 0.1, np.float32))
    ball = build.points("faint: behind", clouds.sphere_cloud())
    for key, cloud, clear in (("faint: clear", smoke, True), ("faint: glows", glow, False)):
        things = ((build.points(key, cloud), build.moved((0, -2, 0))), (ball, build.moved()))
        result, full = both(Case(build.scene(*things), cameras.camera((0, -6, 0))), monkeypatch)
        assert (why(result).get("light") == CLEAR) == clear
        np.testing.assert_array_equal(result.pixels["combined"], full)
