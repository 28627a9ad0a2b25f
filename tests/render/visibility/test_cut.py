"""Surfaces that an alpha cuts out: samples are covered with that probability, and transmittances multiply."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.material.graph import MaterialGraph
from pointsplat_addon.core.material.image import Image
from pointsplat_addon.core.material.nodes import color_nodes, input_nodes, texture_nodes
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from scripts.scenes import build, cameras, meshes
from scripts.scenes.case import Case
from scripts.scenes.drawing import render

COMBINED = frozenset({"combined"})
LAID = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])  # planes stand upright
SIDE = 48  # pixels of a picture


def table(alpha: float):
    """Row 0 is opaque, row 1 has an alpha, that of an image of one texel."""
    texel = np.array([[[1, 1, 1, alpha]]], np.float32)
    image = texture_nodes.ImageTexture(input_nodes.UV(), Image(texel), straight=True)
    return build.materials(2, graphs=(None, MaterialGraph(alpha=color_nodes.Component(image, 3))))


def card(i: int, across: cameras.Vector, cells: int):
    """A square of 2 cells^2 triangles across the view of `covered`, a mesh of its own."""
    mesh = replace(meshes.plane_mesh(f"card {i} of {cells}", 8.0, cells), materials=(1,))
    return build.mesh(mesh, "POLYGONS"), build.moved(across)


def covered(alpha: float, cards: int, samples: int, technique: str, cells: int = 1) -> np.ndarray:
    """(H, W): alpha of so many cards, one behind another."""
    things = [card(i, (0.0, 0.3 * i, 0.0), cells) for i in range(cards)]
    scene = build.scene(*things, lights=[], world=World(np.zeros(3)), table=table(alpha), transparent=True)
    settings = Settings(technique=technique, use_adaptive_sampling=False, use_shadows=False)
    case = Case(scene, cameras.camera((0.3, -4.0, 0.2), resolution=(SIDE, SIDE)), settings)
    return render(case, COMBINED, samples).pixels["combined"][..., 3].astype(float)


@pytest.mark.parametrize("technique", ["VISIBILITY", "IMAGE_SPACE"])
@pytest.mark.parametrize("samples", [1, 5, 17, 68])
@pytest.mark.parametrize("alpha", [0.02, 0.3, 0.5, 0.9])
def test_a_surface_covers_as_many_samples_as_its_alpha_says(alpha, samples, technique):
    found = covered(alpha, 1, samples, technique)
    # measured at most 0.041, 0.027, 0.0081, 0.0009: two triangles, whose thresholds differ by 1/17 of a sample's share
    assert found.mean() == pytest.approx(alpha, abs={1: 0.05, 5: 0.04, 17: 0.012, 68: 0.003}[samples])
    if technique == "VISIBILITY" and samples > 5:
        # measured at most 0.55 of that of independent samples
        assert found.std() < 0.65 * (alpha * (1 - alpha) / samples) ** 0.5


@pytest.mark.parametrize("technique", ["VISIBILITY", "IMAGE_SPACE"])
@pytest.mark.parametrize("samples", [1, 5, 17, 68])
@pytest.mark.parametrize(("alpha", "cards"), [(0.5, 2), (0.3, 3), (0.2, 8)])
def test_transmittances_of_surfaces_behind_each_other_multiply(alpha, cards, samples, technique):
    truth, found = 1 - (1 - alpha) ** cards, covered(alpha, cards, samples, technique, cells=64)
    # Pairs of triangles have thresholds as if by chance: of few in view, which pairs there are would decide.
    # measured at most 0.0086, 0.0051, 0.0029, 0.0023
    assert found.mean() == pytest.approx(truth, abs={1: 0.012, 5: 0.008, 17: 0.005, 68: 0.004}[samples])
    if technique == "VISIBILITY":
        # measured at most 0.81 of that of independent samples
        assert found.std() < 0.9 * (truth * (1 - truth) / samples) ** 0.5


def test_light_passes_by_probability():
    """Under a sun without size a card of alpha 0.3 leaves 0.7 of the light."""
    sun = Light("SUN", np.full(3, 3.0), np.zeros(3), np.array([0.0, 0.0, -1.0]))
    floor = build.mesh(meshes.plane_mesh("floor", 4.0), "POLYGONS"), LAID
    mesh = replace(meshes.plane_mesh("shade", 8.0, 4), materials=(1,))
    shade = build.mesh(mesh, "POLYGONS"), build.moved((0.0, 0.0, 3.0)) @ LAID
    found = {}
    for shadows in (True, False):
        scene = build.scene(floor, shade, lights=[sun], world=World(np.zeros(3)), table=table(0.3))
        camera = cameras.camera((0.0, -1.5, 1.5), resolution=(SIDE, SIDE))
        settings = Settings(technique="VISIBILITY", use_shadows=shadows)
        found[shadows] = render(Case(scene, camera, settings), COMBINED, 17).pixels["combined"][..., 0].astype(float)
    # measured 0.721: 32 triangles, whose thresholds have steps of 1/17
    assert (found[True] / found[False]).mean() == pytest.approx(0.7, abs=0.04)
