"""Each technique is the same picture on Blender's gpu and on moderngl."""

from dataclasses import replace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
gpu = pytest.importorskip("gpu")

from pointsplat_addon.render.frame.visibility import occlusion
from scripts.scenes.cases import CASES
from scripts.scenes.solid_cases import cut_out_cards, many_balls, many_small_meshes, many_triangles
from tests.support.blender.devices import (
    COLORS,
    EDGES,
    differences,
    pictures,
)

AGREE = 2 / 255


@pytest.mark.parametrize("technique", ["VISIBILITY", "EWA", "PAINTER"])
@pytest.mark.parametrize("name", CASES)
def test_blenders_gpu_and_moderngl_agree(blender, opengl, name, technique):
    case = CASES[name]()
    case = replace(case, settings=replace(case.settings, technique=technique))
    here, there = opengl(case, True), pictures(blender, case)
    found = differences(here, there)
    assert found["edges"] <= EDGES  # measured 0, where both run on one driver
    for key in COLORS:
        assert found[key] <= AGREE, key  # measured 0, where both run on one driver
    assert np.abs(here["combined"] - there["combined"]).max() <= AGREE  # edges are soft; measured 0
    assert found["depth"] <= 1e-5
    assert found["position"] <= 1e-5


def test_nodes_over_balls_agree(blender, opengl):
    case = many_balls()
    case = replace(case, settings=replace(case.settings, technique="VISIBILITY"))
    here, there = opengl(case, True), pictures(blender, case)
    assert differences(here, there)["edges"] <= EDGES  # measured 0, where both run on one driver
    assert np.abs(here["combined"] - there["combined"]).max() <= AGREE  # measured 0


def test_small_triangles_agree(blender, opengl):
    case = many_triangles()
    case = replace(case, settings=replace(case.settings, technique="VISIBILITY"))
    here, there = opengl(case, True), pictures(blender, case)
    assert differences(here, there)["edges"] <= EDGES  # measured 0, where both run on one driver
    assert np.abs(here["combined"] - there["combined"]).max() <= AGREE  # measured 0


def test_pages_of_small_triangles_agree_without_what_others_hide(blender, opengl, monkeypatch):
    for name, value in {"FEWEST_TRIANGLES": 0, "LEAST_PROMISE": 0.0, "MOST_WORK": 1.0}.items():
        monkeypatch.setattr(occlusion, name, value)
    case = many_small_meshes()
    case = replace(case, settings=replace(case.settings, technique="VISIBILITY"))
    here, there = opengl(case, True), pictures(blender, case)
    assert differences(here, there)["edges"] <= EDGES  # measured 0, where both run on one driver
    assert np.abs(here["combined"] - there["combined"]).max() <= AGREE  # measured 0
    rasterised = opengl(case, False)
    assert differences(here, rasterised)["edges"] <= EDGES  # measured 0


@pytest.mark.parametrize("name", ["wide_balls", "parallel"])
def test_eye_dome_lighting_agrees(blender, opengl, name):
    case = CASES[name]()
    case = replace(case, settings=replace(case.settings, technique="VISIBILITY", use_eye_dome=True, eye_dome_radius=2))
    here, there = opengl(case, True), pictures(blender, case)
    assert np.abs(here["combined"] - there["combined"]).max() <= AGREE  # measured 0, where both run on one driver
    plain = opengl(replace(case, settings=replace(case.settings, use_eye_dome=False)), True)
    assert (here["combined"][..., :3] < 0.8 * plain["combined"][..., :3]).any()


@pytest.mark.parametrize("technique", ["VISIBILITY", "IMAGE_SPACE"])
def test_surfaces_that_alpha_cuts_out_agree(blender, opengl, technique):
    case = cut_out_cards()
    case = replace(case, settings=replace(case.settings, technique=technique))
    here, there = opengl(case, True), pictures(blender, case)
    assert differences(here, there)["edges"] <= EDGES  # measured 0, where both run on one driver
    assert np.abs(here["combined"] - there["combined"]).max() <= AGREE  # measured 0


@pytest.mark.parametrize("name", ["mixed", "balls", "wide_balls", "parallel_balls", "instances", "scales"])
def test_the_visibility_buffer_needs_no_image_atomics(opengl, name):
    """Without them splats are rasterised that compute shaders would draw."""
    case = CASES[name]()
    case = replace(case, settings=replace(case.settings, technique="VISIBILITY"))
    found = differences(opengl(case, True), opengl(case, False))
    assert found["edges"] <= EDGES
    for key in COLORS:
        assert found[key] <= AGREE, key
