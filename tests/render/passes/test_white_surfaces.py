"""Rough diffuse surfaces: energy is kept."""

import numpy as np
import pytest

from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from scripts.scenes import build, cameras, clouds, meshes
from scripts.scenes.case import Case
from scripts.scenes.drawing import render


@pytest.mark.parametrize("technique", ["VISIBILITY", "IMAGE_SPACE", "EWA", "PAINTER"])
def test_a_white_rough_surface_is_as_white_as_its_world(technique):
    """What it scatters once and more often is all that arrives, whatever the angle."""
    scene = build.scene(
        (build.mesh(meshes.sphere_mesh("rough", 24), "POLYGONS"), build.moved((-0.8, 0, 0), 0.7)),
        (build.points("rough splats", clouds.sphere_cloud(4000)), build.moved((0.8, 0, 0), 0.7)),
        lights=[],
        world=World(np.ones(3)),
        table=build.materials(base_color=np.ones((1, 3)), diffuse_roughness=np.full(1, 0.8, np.float32)),
        transparent=True,
    )
    case = Case(scene, cameras.camera((0.0, -3.0, 0.5), resolution=(96, 64)), Settings(technique=technique))
    pixels = render(case, frozenset({"combined"}), 16).pixels["combined"]
    found = pixels[pixels[..., 3] > 0.9999][:, :3].astype(float)
    assert len(found) > 800
    worst = np.abs(found - 1).max()
    assert worst < 1e-3  # measured 9.3e-5
