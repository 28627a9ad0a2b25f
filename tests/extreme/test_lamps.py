"""Lamps as near as 1e-9 and as far as 1e9, against closed forms and the float64 reference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from scripts.scenes.build import materials, mesh, moved, scene
from scripts.scenes.cameras import camera
from scripts.scenes.case import Case
from scripts.scenes.meshes import plane_mesh
from tests.reference import lighting, opaque
from tests.support.extremes import TECHNIQUES, lamp, picture

KINDS = ("POINT", "SPOT", "AREA")
MATTE = {"base_color": [[1.0, 1, 1]], "roughness": [1.0], "specular": [0.0]}
DISTANCES = 10.0 ** np.arange(-9, 10)


def plain() -> lighting.Surface:
    zero = np.array(0.0)
    return lighting.Surface(np.ones(3), np.zeros(3), np.array(1.0), zero, np.array(1.0), zero)


def test_the_inverse_square_law_from_1e_9_to_1e9(within):
    """tests/reference/lighting.py: the radiance of a white surface under a lamp at each distance."""
    up = np.array([[0.0, 0, 1]])
    for distance in DISTANCES:
        light = Light("POINT", np.full(3, 7.0), np.array([0, 0, distance]), np.array([0.0, 0, -1]))
        found = lighting.shade(np.zeros((1, 3)), up, up, plain(), [light])[0, 0]
        error = abs(found / (7 / np.pi / distance**2) - 1)
        within("a lamp at 1e-9 to 1e9 from a surface", "relative error in float64", error, 1e-12)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("distance", DISTANCES[::2])
def test_lamps_at_any_distance_shade_as_the_reference(kind, distance, within):
    """The camera is as near as the lamp, and the lamp as strong as makes the same light."""
    strength = 3.0 if kind == "AREA" else 3 * distance**2
    light = lamp(kind, np.array([0.3, -1, 0.5]) * distance, strength, 0.2 * distance)
    light = replace(light, direction=np.array([0.0, 0.6, -0.8]))
    wall = mesh(plane_mesh(f"lit from {distance}", distance), "POLYGONS"), moved()
    made = scene(wall, lights=[light], world=World(), table=materials(**MATTE))
    eye = camera((0, -2 * distance, 0.2 * distance), resolution=(12, 9), near=0.1 * distance, far=10 * distance)
    case = Case(made, eye, Settings(use_shadows=False))
    found, exact = picture(case), opaque.picture(made, eye).combined
    assert exact[..., :3].max() > 0.05
    error = np.abs(found - exact)[..., :3].max() / exact[..., :3].max()
    within("lamps at 1e-9 to 1e9, whose pictures are as large", "error over the brightest", error, 5e-4)


@pytest.mark.parametrize("technique", TECHNIQUES)
def test_a_lamp_at_1e9_is_a_sun(technique, within):
    far, towards = 1e9, np.array([0.4, -0.7, 0.5]) / np.linalg.norm([0.4, -0.7, 0.5])
    point = Light("POINT", np.full(3, 3.0) * far**2, towards * far, -towards)
    sun = Light("SUN", np.full(3, 3.0), np.zeros(3), -towards)
    wall = mesh(plane_mesh("by a far lamp", 1.0, 4), "POINTS"), moved()
    pictures = [
        picture(Case(scene(wall, lights=[light]), camera(), Settings(shadow_resolution=256)), technique)
        for light in (point, sun)
    ]
    within("a lamp at 1e9 against a sun", "mean difference", np.abs(pictures[0] - pictures[1]).mean(), 1e-6)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("height", [1e-9, 1e-6, 1e-3, 0.0, -1e-9])
@pytest.mark.parametrize("size", [0.0, 1e-9, 0.1])
def test_a_lamp_upon_a_surface_lights_no_more_than_it_sends(kind, height, size, within):
    """1e-9 before a white wall of 2 units, which sends back no more than half of the lamp's flux, 2 pi of its 4 pi I:
    its mean radiance, times its 4 units^2 and pi, is at most that. But for the pixels about the lamp, whose middles
    stand for light that rises without end."""
    if kind == "AREA" and size == 0:
        pytest.skip("an area without size shines nowhere, and the host converts none")
    light = replace(lamp(kind, (0.0, -height, 0.0), 1.0, size), direction=np.array([0.0, 1, 0]))
    wall = mesh(plane_mesh("under a lamp", 1.0), "POLYGONS"), moved()
    made = scene(wall, lights=[light], world=World(), table=materials(**MATTE))
    found = picture(Case(made, camera(resolution=(32, 32), parallel=2.0, far=10), Settings(shadow_resolution=64)))
    assert np.count_nonzero(found[..., 0]) > 0 or height <= 0 or kind != "POINT"
    mean = np.sort(found[..., 0].ravel())[:-4].mean()
    within(
        "a lamp within 1e-3 of a wall",
        "what is sent back over half of what is sent",
        mean * 4 * np.pi / (2 * np.pi),
        1.0,
    )


@given(
    kind=st.sampled_from(KINDS),
    place=st.tuples(*[st.floats(-1e9, 1e9)] * 3),
    exponent=st.floats(-9, 9),
    strength=st.floats(0, 1e20),
    soft=st.booleans(),
)
def test_any_lamp_leaves_a_finite_picture(kind, place, exponent, strength, soft):
    """Beside a sun, whose light stays where the lamp's cannot be told from none."""
    light = replace(lamp(kind, place, strength, 10.0**exponent), soft=soft)
    wall = mesh(plane_mesh("under any lamp", 1.0, 2), "POLYGONS"), moved()
    away = Light("SUN", np.ones(3), np.zeros(3), np.array([0.0, 1, 0]))
    found, alone = (
        picture(
            Case(scene(wall, lights=lights, world=World()), camera(resolution=(8, 6)), Settings(shadow_resolution=64))
        )
        for lights in ([light, away], [away])
    )
    assert (found >= alone - 1e-3).all()
