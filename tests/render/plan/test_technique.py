"""Which technique AUTO takes, and that the report says so."""

from dataclasses import replace
from unittest import mock

import numpy as np
import pytest

from pointsplat_addon.core.scene.camera import Aperture
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.devices.null import LIMITS, NullDevice
from pointsplat_addon.render.plan import technique
from pointsplat_addon.render.plan.technique import TechniqueInput, decide_technique
from pointsplat_addon.render.prepare.layers import MANY_INSTANCES
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes import build, cameras, cases, clouds
from scripts.scenes.case import Case
from scripts.scenes.store import STORE

COMBINED = frozenset({"combined"})
EWA = {"splats", "visibility", "blend", "normalise"}
IMAGE_SPACE = {"project", "identify", "resolve", "pull", "push"}


def case(key: str, color=None, asked: str = "AUTO", instances: int = 1, cloud=None) -> Case:
    cloud = clouds.sphere_cloud(500) if cloud is None else cloud
    cloud = cloud if color is None else replace(cloud, color=np.full((len(cloud), 3), color, np.float32))
    ball = build.points(key, cloud)
    placed = ((ball, build.moved((0.1 * i, 0, 0))) for i in range(instances))
    # Each sample sees through another point on the lens, for which AUTO leaves the visibility buffer.
    eye = replace(cameras.camera(), aperture=Aperture(0.1, 4.0))
    settings = Settings(technique=asked, use_shadows=False, dof_method="LENS_SAMPLES")
    return Case(build.scene(*placed), eye, settings)


def drawn(case: Case, samples: int, interactive: bool = False, float_blend: bool = True) -> tuple[str, set[str], dict]:
    """What the report calls the technique, the programs that were compiled, and the report."""
    device = NullDevice(replace(LIMITS, float_blend=float_blend))
    request = replace(case.request(COMBINED, samples), interactive=interactive)
    report = Renderer(device, STORE).render(case.scene, request).report
    return report["technique"]["name"], {interface.name for interface in device.interfaces}, report


@pytest.mark.parametrize(
    ("color", "samples", "more", "expected"),
    [
        (0.5, 16, {}, "EWA"),
        (0.5, 4, {}, "EWA"),
        (0.5, 3, {}, "IMAGE_SPACE"),
        (None, 16, {}, "IMAGE_SPACE"),
        (0.5, 16, {"interactive": True}, "IMAGE_SPACE"),
        (0.5, 16, {"float_blend": False}, "IMAGE_SPACE"),
    ],
)
def test_final_pictures_of_coloured_points_are_drawn_by_ewa(color, samples, more, expected):
    name, programs, _ = drawn(case(f"coloured {color}", color), samples, **more)
    assert name == expected
    assert not programs & (IMAGE_SPACE if expected == "EWA" else EWA)
    assert programs & (EWA if expected == "EWA" else IMAGE_SPACE)


def test_instances_that_share_nodes_are_drawn_in_image_space():
    assert drawn(case("alone", 0.5, instances=15), 16)[0] == "EWA"
    assert drawn(case("in company", 0.5, instances=16), 16)[0] == "IMAGE_SPACE"


def test_leaves_are_drawn_in_image_space():
    name, programs, report = drawn(case("leaves in colour", 0.5, cloud=clouds.leaves(2000, 0.7)), 16)
    assert name == "IMAGE_SPACE"
    assert "disconnected" in report["technique"]["because"]
    assert not programs & EWA


@pytest.mark.parametrize("asked", ["IMAGE_SPACE", "EWA", "PAINTER"])
def test_what_is_asked_for_is_done(asked):
    name, _, report = drawn(case("asked for", asked=asked), 1)
    assert name == asked
    assert report["warnings"] == []


@pytest.mark.parametrize("asked", ["EWA", "PAINTER"])
def test_what_cannot_be_done_is_said(asked):
    name, programs, report = drawn(case("asked in vain", asked=asked), 16, float_blend=False)
    assert name == "IMAGE_SPACE"
    assert not programs & EWA
    assert len(report["warnings"]) == 1
    assert "needs blending of floats" in report["warnings"][0]


def given(scene, samples: int = 16, lens: bool = False, float_blend: bool = True, **settings) -> TechniqueInput:
    return TechniqueInput(Settings(**settings), scene, samples, interactive=False, lens=lens, float_blend=float_blend)


def test_textured_meshes_count_as_coloured_and_polygons_do_not():
    textured = cases.CASES["textured"]().scene
    assert decide_technique(given(textured, budget="ERROR")).name == "EWA"
    solid = replace(textured, geometries=tuple(replace(g, primitive="POLYGONS") for g in textured.geometries))
    assert decide_technique(given(solid, budget="ERROR")).name == "IMAGE_SPACE"


@pytest.mark.parametrize(
    "name", ["cube", "sphere", "balls", "wide_balls", "split_mesh", "strands", "panes", "tinted_smoke"]
)
def test_what_the_visibility_buffer_draws_exactly_is_drawn_by_it(name):
    scene = cases.CASES[name]().scene
    for interactive in (False, True):
        assert decide_technique(replace(given(scene), interactive=interactive)).name == "VISIBILITY"


@pytest.mark.parametrize(
    ("name", "more", "because"),
    [
        ("cube", {"lens": True}, "point on the lens"),
        ("cube", {"budget": "TIME"}, "budget"),
    ],
)
def test_auto_leaves_the_visibility_buffer_where_another_draws_better(name, more, because):
    found = decide_technique(given(cases.CASES[name]().scene, **more))
    assert found.name != "VISIBILITY"
    assert because in found.because


@pytest.mark.parametrize(("name", "more"), [("cube", {"lens": True}), ("panes", {"budget": "ERROR"})])
def test_the_visibility_buffer_is_not_taken_where_it_cannot_draw(name, more):
    found = decide_technique(given(cases.CASES[name]().scene, technique="VISIBILITY", **more))
    assert found.name == "IMAGE_SPACE"
    assert found.warning


def surfels(count: int, instances: int = 1):
    """A scene of points with normals, and of as many instances."""
    ball = build.points(f"{count} surfels", clouds.sphere_cloud(count))
    return build.scene(*((ball, build.moved((0.1 * i, 0, 0))) for i in range(instances)))


def test_points_with_normals_take_no_passes_of_other_techniques():
    sphere = case("a surface", 0.5)
    sphere = replace(sphere, settings=replace(sphere.settings, dof_method="SPLAT"))
    name, programs, _ = drawn(replace(sphere, camera=replace(sphere.camera, aperture=None)), 16)
    assert name == "VISIBILITY"
    assert not programs & (EWA | IMAGE_SPACE)
    name, programs, _ = drawn(sphere, 16)
    assert name == "VISIBILITY"
    assert "defocus" in programs
    assert not programs & (EWA | IMAGE_SPACE)


def test_surfels_that_nodes_draw_faster_are_left_to_nodes():
    """Many instances share nodes; views that move draw few points."""
    assert decide_technique(given(surfels(500, MANY_INSTANCES - 1))).name == "VISIBILITY"
    assert decide_technique(given(surfels(500, MANY_INSTANCES))).name != "VISIBILITY"
    with mock.patch.object(technique, "MOST_SURFELS_AT_ONCE", 999):
        few, many = given(surfels(499, 2)), given(surfels(500, 2))
        assert [decide_technique(replace(one, interactive=True)).name for one in (few, many)] == [
            "VISIBILITY",
            "IMAGE_SPACE",
        ]
        assert decide_technique(many).name == "VISIBILITY"
