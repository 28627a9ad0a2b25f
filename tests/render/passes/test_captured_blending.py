"""Captured splats blended in display values, as training did, against the formula in float64."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.camera import Aperture
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.plan.request import Request
from scripts.scenes import build, drawing, meshes
from scripts.scenes.build import captured, moved
from scripts.scenes.cameras import camera
from scripts.scenes.captured_cases import SHEARED, captured_sphere, one_splat, random_splats
from scripts.scenes.clouds import smoke_cloud
from tests.reference import captured as reference

SIZE = (96, 72)
EYE = camera((0, -6, 0), resolution=SIZE, field_of_view=50)
WORLD = np.array([0.02, 0.3, 1.7])
TABLE = build.materials(base_color=np.zeros((1, 3)), specular=[0], emission=np.array([[0.2, 0.5, 0.8]]))
LINEAR = "Captured splats are blended in linear light, not as trained: "


def drawn(*things, eye=EYE, samples=1, trained=True, renderer=None, **more):
    """Combined (H, W, 4) float64, and the report."""
    made = build.scene(*things, lights=(), table=TABLE, **{"world": World(WORLD), "transparent": True, **more})
    table = Settings(use_shadows=False, captured_blending="TRAINED" if trained else "LINEAR")
    request = Request(eye, table, frozenset({"combined"}), samples)
    result = (renderer or drawing.opengl()).render(made, request)
    return result.pixels["combined"].astype(np.float64), result.report


@pytest.mark.parametrize("transparent", [True, False])
@pytest.mark.parametrize("passes", [frozenset({"combined"}), frozenset({"combined", "depth", "mist"})])
def test_display_values_are_blended_over_those_of_the_world(transparent, passes):
    """Also where Depth asks for splats, so that their picture is not kept."""
    splats = random_splats(700, 8)
    name = f"trained {transparent} {len(passes)}"
    made = build.scene((captured(name, splats), SHEARED), (captured(name, splats), moved()), lights=(),
                       world=World(WORLD), transparent=transparent)  # fmt: skip
    request = Request(EYE, Settings(use_shadows=False, captured_blending="TRAINED"), passes, 16)
    result = drawing.opengl().render(made, request)
    found = result.pixels["combined"].astype(np.float64)
    assert not result.report["warnings"]
    shown = reference.picture([(splats, SHEARED), (splats, moved())], EYE, trained=True)
    expected = reference.linear_over(shown, None if transparent else WORLD)
    print(reference.psnr(found, expected), np.abs(found - expected).max())
    assert reference.psnr(found, expected) > 80
