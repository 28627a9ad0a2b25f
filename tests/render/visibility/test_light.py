"""Light on groups of sub-samples: shadows of wide lights are those of many samples."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.settings import Settings
from scripts.scenes import build, cameras, meshes
from scripts.scenes.case import Case
from scripts.scenes.drawing import render

COMBINED = frozenset({"combined"})


def under_a_sun(technique: str, radius: float) -> Case:
    """A cube over a plane; `radius`: angular, of the sun."""
    ground = build.mesh(meshes.plane_mesh("ground of shadows", 6.0, 2), "POLYGONS")
    cube = build.mesh(meshes.cube_mesh("cube of shadows"), "POLYGONS")
    things = (ground, build.moved((0, 0, -1))), (cube, build.moved((0, 0, 0), 0.7))
    eye = cameras.camera((2, -4, 3), (0, 0, -0.5), resolution=(80, 60))
    drawn = build.scene(*things, lights=[replace(build.sun(), radius=radius)])
    return Case(drawn, eye, Settings(technique=technique))


@pytest.mark.parametrize("radius", [0.0, 0.1, 0.3])
def test_shadows_are_those_of_many_samples(radius):
    truth = render(under_a_sun("IMAGE_SPACE", radius), COMBINED, 512).pixels["combined"][..., :3]
    found = render(under_a_sun("VISIBILITY", radius), COMBINED, 16).pixels["combined"][..., :3]
    assert np.sqrt(np.mean((found - truth) ** 2)) < 0.01  # measured 0.0062, 0.0047, 0.0077
    assert abs(found.mean() - truth.mean()) < 0.001  # measured at most 2.7e-4
