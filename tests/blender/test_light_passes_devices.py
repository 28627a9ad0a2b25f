"""Passes of light on Blender's gpu: their shaders compile there, too, and compose to the same picture."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("bpy")

from pointsplat_addon.render.passes.outputs import OF_LIGHT
from scripts.scenes.cases import CASES

# Meshes and points; indirect light and strands; media that emit; coloured glass; fog; captured splats.
SCENES = ("mixed", "among_balls_and_strands", "under_smoke", "tinted_smoke", "tinted_panes", "in_smoke", "captured_lit")


@pytest.mark.parametrize("name", SCENES)
def test_passes_compose_to_combined_on_blenders_gpu(blender, name):
    case = CASES[name]()
    case = replace(case, settings=replace(case.settings, technique="VISIBILITY"))
    pixels = blender.render(case.scene, case.request(OF_LIGHT | {"combined"}, 16)).pixels
    total = sum(pixels[key] for key in ("volume_direct", "volume_indirect", "emission", "environment"))
    for kind in ("diffuse", "glossy", "transmission"):
        total = total + (pixels[f"{kind}_direct"] + pixels[f"{kind}_indirect"]) * pixels[f"{kind}_color"]
    shown = pixels["combined"][..., :3]
    assert shown.max() > 0.1
    assert np.abs(total - shown).max() < 2e-6 * shown.max()  # measured 9e-7
