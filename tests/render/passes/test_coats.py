"""Coats: energy is kept."""

import numpy as np
import pytest

from pointsplat_addon.core.scene.materials import CoatTable
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from scripts.scenes import build, cameras, clouds, meshes
from scripts.scenes.case import Case
from scripts.scenes.drawing import render

WEIGHT, ROUGHNESS, IOR = np.array([[0.7], [0.3], [1.8]], np.float32)


def shown(tint: float, technique: str) -> np.ndarray:
    """Luminances (N,) of a white mesh and white splats with a coat, in a white world, where nothing else is seen."""
    coat = CoatTable(WEIGHT, ROUGHNESS, IOR, np.full((1, 3), tint, np.float32))
    scene = build.scene(
        (build.mesh(meshes.sphere_mesh("coated", 24), "POLYGONS"), build.moved((-0.8, 0, 0), 0.7)),
        (build.points("coated splats", clouds.sphere_cloud(4000)), build.moved((0.8, 0, 0), 0.7)),
        lights=[],
        world=World(np.ones(3)),
        table=build.materials(base_color=np.ones((1, 3)), coat=coat),
        transparent=True,
    )
    case = Case(scene, cameras.camera((0.0, -3.0, 0.5), resolution=(96, 64)), Settings(technique=technique))
    pixels = render(case, frozenset({"combined"}), 16).pixels["combined"]
    return pixels[pixels[..., 3] > 0.9999][:, :3].astype(float).mean(axis=1)


@pytest.mark.parametrize("technique", ["VISIBILITY", "IMAGE_SPACE", "EWA", "PAINTER"])
def test_a_white_surface_below_a_clear_coat_is_as_white_as_its_world(technique):
    found = shown(1.0, technique)
    assert len(found) > 800
    worst = np.abs(found - 1).max()
    assert worst < 1e-3  # measured 9e-5


def test_a_tint_absorbs_by_the_way_through_the_layer():
    """Most passes where the way is shortest, and no way is longer than that of light from the horizon."""
    found = shown(0.5, "VISIBILITY")
    reflected = WEIGHT[0] * ((IOR[0] - 1) / (IOR[0] + 1)) ** 2
    facing = reflected + (1 - reflected) * (1 - WEIGHT[0] * (1 - 0.5))
    assert abs(np.percentile(found, 99) - facing) < 0.003  # measured 0.0004
    assert found.min() > 1 - WEIGHT[0] * (1 - 0.5 ** (1 / np.sqrt(1 - 1 / IOR[0] ** 2)))
