"""Passes of light: composed as Cycles composes them they are Combined, and each holds what its name says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.light_passes import Light, light_passes
from pointsplat_addon.render.passes.outputs import OF_LIGHT
from pointsplat_addon.render.passes.shading.terms import Term
from scripts.scenes import build, cameras, meshes
from scripts.scenes.build import moved
from scripts.scenes.case import Case
from scripts.scenes.cases import CASES
from scripts.scenes.drawing import opengl, render
from tests.support.leave_out.scenes import through_a_lens

COMBINED = frozenset({"combined"})
EVERY = COMBINED | OF_LIGHT
SCENES = (
    "mixed", "balls", "emission", "holdout", "environment", "in_a_corner", "among_balls_and_strands", "under_smoke",
    "among_mirrors",
    "smoke", "tinted_smoke", "panes_of_functions", "tinted_panes", "captured_among", "captured_lit", "captured_matte",
    "captured_trained", "in_fog", "in_smoke", "foliage", "strands", "region", "parallel", "empty",
)  # fmt: skip
WORST = 2e-6  # of the brightest pixel; measured 1.22e-6, where colours are so faint that they count as none


def with_settings(name: str, **settings) -> Case:
    case = CASES[name]()
    return replace(case, settings=replace(case.settings, **settings))


def composed(pixels: dict[str, np.ndarray], transparent: bool) -> np.ndarray:
    """What Combined is made of, (H, W, 3) float64."""
    found = {key: pixels[key].astype(np.float64) for key in OF_LIGHT}
    total = found["volume_direct"] + found["volume_indirect"] + found["emission"]
    total += 0 if transparent else found["environment"]
    for kind in ("diffuse", "glossy", "transmission"):
        total += (found[f"{kind}_direct"] + found[f"{kind}_indirect"]) * found[f"{kind}_color"]
    return total


def error(case: Case, samples: int) -> float:
    """The largest difference of what is composed from Combined, over the brightest pixel."""
    pixels = render(case, EVERY, samples).pixels
    assert all(np.isfinite(pixels[key]).all() and pixels[key].shape[2] == 3 for key in OF_LIGHT)
    shown = pixels["combined"][..., :3]
    return float(np.abs(composed(pixels, case.scene.transparent) - shown).max() / max(shown.max(), 1e-3))


@pytest.mark.parametrize("name", SCENES)
def test_all_passes_together_are_combined(name):
    assert error(with_settings(name, technique="VISIBILITY", use_shadows=True), 16) < WORST


@pytest.mark.parametrize("technique", ["EWA", "IMAGE_SPACE", "PAINTER"])
@pytest.mark.parametrize("name", ["mixed", "smoke"])
def test_so_they_are_by_other_techniques(name, technique):
    case = with_settings(name, technique=technique, use_shadows=True, use_adaptive_sampling=True)
    assert error(case, 16) < WORST


@pytest.mark.parametrize("method", ["SPLAT", "LENS_SAMPLES"])
def test_so_they_are_out_of_focus(method):
    assert error(through_a_lens(method), 4) < WORST


def test_so_they_are_darkened_by_depths():
    case = with_settings("mixed", technique="VISIBILITY", use_eye_dome=True)
    assert error(case, 16) < WORST


@pytest.mark.parametrize("name", ["mixed", "tinted_panes"])
def test_a_transparent_film_leaves_only_environment_out_of_combined(name):
    case = with_settings(name, technique="VISIBILITY")
    transparent = replace(case, scene=replace(case.scene, transparent=True))
    assert error(transparent, 16) < WORST
    there, here = (render(one, EVERY, 16).pixels["environment"] for one in (case, transparent))
    np.testing.assert_array_equal(here, there)


@pytest.mark.parametrize("name", ["mixed", "in_a_corner", "tinted_panes"])
def test_combined_is_the_same_whether_passes_are_asked_for_or_not(name):
    case = with_settings(name, technique="VISIBILITY")
    asked, alone = (render(case, passes, 16).pixels["combined"] for passes in (EVERY, COMBINED))
    np.testing.assert_array_equal(asked, alone)


def test_parts_have_the_pixels_of_the_whole():
    case = with_settings("mixed", technique="VISIBILITY")
    whole, request = render(case, EVERY, 16).pixels, case.request(EVERY, 16)
    for index in range(2):
        found = opengl().render(case.scene, replace(request, part=(index, 2)))
        for x, y, right, up in found.drawn or ():
            for key in OF_LIGHT:
                np.testing.assert_array_equal(found.pixels[key][y:up, x:right], whole[key][y:up, x:right])


def test_of_what_has_no_parts_the_first_has_all_pixels():
    """Identities are ranked over the filter's support: only whole pictures have them."""
    case, asked = with_settings("mixed", technique="VISIBILITY"), EVERY | {"crypto_object"}
    whole = render(case, asked, 16).pixels
    found = opengl().render(case.scene, replace(case.request(asked, 16), part=(0, 2))).pixels
    for key in OF_LIGHT:
        np.testing.assert_array_equal(found[key], whole[key])


# What each pass holds

SKY = np.array([0.3, 0.5, 0.7])


def planes(*things, **columns) -> Case:
    """Planes that face the camera, in a world of one colour; columns of their materials."""
    rows = len(next(iter(columns.values())))
    table = build.materials(rows, **{"specular": np.zeros(rows), **columns})
    made = [
        (build.mesh(replace(meshes.plane_mesh(f"plane of light {row}", 4.0), materials=(row,)), "POLYGONS"), at)
        for row, at in things
    ]
    scene = build.scene(*made, lights=(), world=World(SKY), table=table)
    return replace(CASES["cube"](), scene=scene, camera=cameras.camera((0.0, -3.0, 0.0)))


def middle(case: Case, **settings) -> dict[str, np.ndarray]:
    """Passes at the middle of the picture, (3,)."""
    settings = {"technique": "VISIBILITY", **settings}
    pixels = render(replace(case, settings=replace(case.settings, **settings)), EVERY).pixels
    height, width = pixels["combined"].shape[:2]
    return {key: pixels[key][height // 2, width // 2, :3] for key in EVERY}


def test_a_dull_surface_has_its_colour_and_the_light_of_the_world():
    found = middle(planes((0, moved()), base_color=[[0.8, 0.4, 0.2]], emission=[[0.1, 0.2, 0.3]]))
    np.testing.assert_allclose(found["diffuse_color"], (0.8, 0.4, 0.2), rtol=1e-6)
    np.testing.assert_allclose(found["diffuse_direct"], SKY, rtol=1e-6)
    np.testing.assert_allclose(found["emission"], (0.1, 0.2, 0.3), rtol=1e-6)
    rest = OF_LIGHT - {"diffuse_color", "diffuse_direct", "emission", "ambient_occlusion"}
    assert not any(found[key].any() for key in rest)


def test_a_metal_is_glossy_alone():
    found = middle(planes((0, moved()), base_color=[[0.8, 0.4, 0.2]], metallic=[1.0]))
    np.testing.assert_allclose(found["glossy_direct"], SKY, rtol=1e-5)
    np.testing.assert_allclose(found["combined"], found["glossy_color"] * SKY, rtol=1e-5)
    assert not any(found[key].any() for key in ("diffuse_color", "diffuse_direct", "emission", "environment"))


@pytest.mark.parametrize("glass", [True, False])
def test_what_shows_through_glass_is_transmitted_and_through_alpha_itself(glass):
    """A pane before a surface that shines and reflects."""
    tint = np.array([0.9, 0.5, 0.2])
    case = planes(
        (0, moved((0, 0.5, 0))), (1, moved()),
        base_color=[[0.5, 0.5, 0.5], [0, 0, 0]], emission=[[1, 2, 3], [0, 0, 0]], alpha=[1.0, 0.0],
        translucent=np.array([False, True]), transmission_color=np.array([[1, 1, 1], tint], np.float32),
        glass=np.array([False, True]) if glass else None,
    )  # fmt: skip
    found = middle(case)
    emitted, reflected = tint * (1, 2, 3), tint * 0.5 * SKY
    if glass:
        np.testing.assert_allclose(found["transmission_color"], tint, rtol=1e-5)
        np.testing.assert_allclose(found["transmission_direct"] * tint, emitted, rtol=1e-5)
        np.testing.assert_allclose(found["transmission_indirect"] * tint, reflected, rtol=1e-4)
        assert not any(found[key].any() for key in ("diffuse_color", "diffuse_direct"))
        assert np.abs(found["emission"]).max() < 1e-6  # measured 2.4e-7
    else:
        np.testing.assert_allclose(found["emission"], emitted, rtol=1e-5)
        np.testing.assert_allclose(found["diffuse_direct"] * found["diffuse_color"], reflected, rtol=1e-5)
        assert not any(found[key].any() for key in OF_LIGHT if key.startswith("transmission"))


def test_light_that_has_bounced_is_indirect():
    """In a corner, direct light is that of a picture without bounces, and what bounces is the rest."""
    found, none = (
        render(with_settings("in_a_corner", technique="VISIBILITY", bounces=bounces), EVERY, 16).pixels
        for bounces in (3, 0)
    )
    for kind in ("diffuse", "glossy"):
        np.testing.assert_array_equal(found[f"{kind}_direct"], none[f"{kind}_direct"])
        assert found[f"{kind}_indirect"].mean() > 0.05
        assert not none[f"{kind}_indirect"].any()


# What is drawn for them


def drawn(*asked: str, **light: bool) -> list[tuple[Term, bool]]:
    """The terms that are drawn for passes, each whether without bounces."""
    terms: list[tuple[Term, bool]] = []

    def draw(term: Term, direct: bool) -> np.ndarray:
        terms.append((term, direct))
        return np.ones((1, 1, 3), np.float32)

    kinds = {"bounces": False, "transmits": False, "media": False, "emits": False, "trained": False, **light}
    found = light_passes(frozenset(asked), Light(**kinds), np.ones((1, 1, 4), np.float32), False, draw)
    assert found.keys() == set(asked)
    return terms


def test_each_term_is_drawn_once_and_only_if_it_is_needed():
    assert drawn("environment") == [(Term("ENVIRONMENT"), False)]
    assert drawn("diffuse_color") == [(Term("DIFFUSE", color=True), False)]
    assert len(drawn("diffuse_direct", "diffuse_indirect", "diffuse_color")) == 2
    assert len(drawn("diffuse_direct", "diffuse_indirect", "diffuse_color", bounces=True)) == 3
    assert drawn("volume_direct", "volume_indirect", "transmission_direct", "transmission_color") == []
    assert drawn("emission") == []
    assert len(drawn("volume_direct", "volume_indirect", media=True)) == 1
    assert len(drawn("volume_direct", "volume_indirect", media=True, bounces=True)) == 2
    assert drawn("ambient_occlusion") == [(Term("OCCLUSION"), True)]
    assert len(drawn(*OF_LIGHT)) == 6
    every = drawn(*OF_LIGHT, bounces=True, transmits=True, media=True, emits=True)
    assert len(every) == len(set(every)) == 14
