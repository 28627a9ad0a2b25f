"""Samples through the lens are the same picture on Blender's gpu and on moderngl."""

from dataclasses import replace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
gpu = pytest.importorskip("gpu")

from pointsplat_addon.core.scene.camera import Aperture
from scripts.scenes.cases import CASES
from tests.support.blender.devices import pictures


@pytest.mark.parametrize("technique", ["IMAGE_SPACE", "EWA", "PAINTER"])
@pytest.mark.parametrize("name", ["mixed", "parallel", "strands", "smoke", "environment", "many_towers"])
def test_blenders_gpu_and_moderngl_agree_on_what_is_blurred(blender, opengl, name, technique):
    case = CASES[name]()
    camera = replace(case.camera, aperture=Aperture(0.15, 4.0, 5, 0.3))
    settings = replace(case.settings, technique=technique, dof_method="LENS_SAMPLES")
    case = replace(case, camera=camera, settings=settings)
    here, there = opengl(case, True), pictures(blender, case)
    assert np.abs(here["combined"] - there["combined"]).max() <= 2 / 255  # measured 0, where both run on one driver


@pytest.mark.parametrize("name", ["mixed", "parallel", "strands", "smoke", "environment", "balls"])
def test_blenders_gpu_and_moderngl_agree_on_splats_over_the_visibility_buffer(blender, opengl, name):
    """Parts are in focus, and drawn by the visibility buffer; the rest is gathered over it."""
    case = CASES[name]()
    camera = replace(case.camera, aperture=Aperture(0.02 if case.camera.perspective else 0.1, 4.0))
    case = replace(case, camera=camera, settings=replace(case.settings, technique="VISIBILITY"))
    here, there = opengl(case, True), pictures(blender, case)
    assert np.abs(here["combined"] - there["combined"]).max() <= 2 / 255  # measured 0, where both run on one driver
