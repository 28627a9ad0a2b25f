"""What is out of focus is the same picture on Blender's gpu and on moderngl."""

from dataclasses import replace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
gpu = pytest.importorskip("gpu")

from pointsplat_addon.core.scene.camera import Aperture
from scripts.scenes.cases import CASES
from tests.support.blender.devices import pictures


@pytest.mark.parametrize("name", ["mixed", "parallel", "strands", "smoke", "tinted_smoke", "environment", "holdout"])
def test_blenders_gpu_and_moderngl_agree_on_splats_out_of_focus(blender, opengl, name):
    case = CASES[name]()
    case = replace(case, camera=replace(case.camera, aperture=Aperture(0.3, 2.5)))
    here, there = opengl(case, True), pictures(blender, case)
    assert np.abs(here["combined"] - there["combined"]).max() <= 2 / 255  # measured 0, where both run on one driver


def test_an_error_budget_ends_at_the_same_picture_out_of_focus(blender, opengl):
    """What is in focus is read back on both, and decides with how many samples."""
    case = CASES["mixed"]()
    settings = replace(case.settings, budget="ERROR", error_budget=0.003)
    case = replace(case, camera=replace(case.camera, aperture=Aperture(0.15, 4.0)), settings=settings)
    result = blender.render(case.scene, case.request(samples=2))
    assert result.report["estimate"]["rmse"] <= 0.003  # measured 0.0021
    assert np.abs(opengl(case, True)["combined"] - result.pixels["combined"]).max() <= 2 / 255  # measured 0, as above
