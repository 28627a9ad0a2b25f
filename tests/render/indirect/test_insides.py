"""Closed meshes that are seen from within, as rooms, and such whose fronts look inwards."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.scene.world import World
from scripts.scenes import drawing
from scripts.scenes.build import materials, mesh, moved, scene
from scripts.scenes.cameras import camera
from scripts.scenes.case import Case
from scripts.scenes.indirect_cases import LAID, SETTINGS
from scripts.scenes.meshes import cube_mesh, flat_mesh, plane_mesh, sphere_mesh
from tests.support.indirect_light import SceneLight

SIZE = (96, 54)
BALL = np.array([0.3, 0.0, 0.8])


def turned(of: Mesh, inwards: bool) -> Mesh:
    if not inwards:
        return of
    return flat_mesh(f"{of.key}, inwards", of.position, of.triangles[:, ::-1].copy())


@pytest.mark.parametrize("inwards", [False, True])
@pytest.mark.parametrize("clipped", [False, True])
def test_a_closed_room_that_shines_is_even(inwards, clipped):
    """Emission 0.5, albedo 0.5: E / (1 - albedo) is 1. Also where the camera is outside, and clips what lies before
    the room's middle. Worst: 0.010; with insides that nobody sees 0.50, where fronts look outwards."""
    room = mesh(turned(cube_mesh("room", 1.0), inwards), "POLYGONS"), moved((0, 0, 0), (6, 6, 3))
    table = materials(1, base_color=[[0.5] * 3], specular=[0.0], roughness=[1.0], emission=[[0.5] * 3])
    seen = camera((-0.8, -9.0, 0.2), (0, 0, 0), SIZE) if clipped else camera((-0.8, -0.8, 0.2), (1, 2, 0), SIZE)
    seen = replace(seen, near=9.0, clip_from_view=nearer(seen.clip_from_view, 9.0)) if clipped else seen
    lit = scene(room, lights=(), world=World(np.full(3, 5.0)), table=table)
    case = Case(lit, seen, replace(SETTINGS, bounces=12, samples=1))
    shown = drawing.render(case, frozenset({"combined"})).pixels["combined"][..., 0]
    if clipped:
        shown = shown[20:34, 40:56]  # of the far wall
    print(np.abs(shown - 1).max(), shown.mean())
    assert np.abs(shown - 1).max() < 0.02


def nearer(clip_from_view: np.ndarray, near: float, far: float = 1000.0) -> np.ndarray:
    """With another clip start."""
    found = clip_from_view.copy()
    found[2, 2:] = (far + near) / (near - far), 2 * far * near / (near - far)
    return found


@pytest.mark.parametrize("inwards", [False, True])
def test_a_ball_that_shines_lights_a_floor_whichever_way_its_fronts_look(inwards):
    """A ball of the radius R that touches a floor gives (R / d)^3 of its radiance at the distance d from its middle.
    Worst: MEASURED; 1 where nothing is seen of a ball that is inside out."""
    ball = mesh(replace(turned(sphere_mesh("ball", 48), inwards), materials=(1,), material=None), "POLYGONS")
    floor = mesh(plane_mesh("floor", 30.0), "POLYGONS"), LAID
    table = materials(
        2, base_color=[[0.0] * 3] * 2, specular=[0.0] * 2, roughness=[1.0] * 2, emission=[[0.0] * 3, [1.0] * 3]
    )
    of_scene = scene(floor, (ball, moved(BALL, BALL[2])), lights=(), world=World(np.zeros(3)), table=table)
    light = SceneLight(of_scene, camera((0.0, -6.0, 3.5), (0, 0, 0.6), SIZE))
    x = np.linspace(-3.0, 3.0, 61)
    place = np.column_stack([x, np.full(61, -0.8), np.full(61, 1e-3)])
    found = light.at(place, np.array([0.0, 0, 1]))[:, 0]
    light.release()
    away = np.linalg.norm(place - BALL, axis=1)
    print(np.abs(found - (BALL[2] / away) ** 3).max())
    assert np.abs(found - (BALL[2] / away) ** 3).max() < 0.05
