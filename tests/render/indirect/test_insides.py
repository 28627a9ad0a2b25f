"""Closed meshes that are seen from within, as rooms, and such whose fronts look inwards; corners of rooms."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.indirect.closed import is_closed
from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.frame.indirect.receivers import Groups, sites_of
from pointsplat_addon.render.passes.uniforms import SampleView
from scripts.scenes import drawing
from scripts.scenes.build import materials, mesh, moved, scene
from scripts.scenes.cameras import camera
from scripts.scenes.case import Case
from scripts.scenes.indirect_cases import LAID, SETTINGS
from scripts.scenes.meshes import cube_mesh, flat_mesh, plane_mesh, sphere_mesh

SIZE = (96, 54)


def turned(of: Mesh, inwards: bool) -> Mesh:
    if not inwards:
        return of
    return flat_mesh(f"{of.key}, inwards", of.position, of.triangles[:, ::-1].copy())


def closed_room(inwards: bool, seen: Camera) -> np.ndarray:
    """(H, W): a room that shines, under a sky five times as bright. Emission 0.5, albedo 0.5: E / (1 - albedo) is 1."""
    room = mesh(turned(cube_mesh("room", 1.0), inwards), "POLYGONS"), moved((0, 0, 0), (6, 6, 3))
    table = materials(1, base_color=[[0.5] * 3], specular=[0.0], roughness=[1.0], emission=[[0.5] * 3])
    lit = scene(room, lights=(), world=World(np.full(3, 5.0)), table=table)
    case = Case(lit, seen, replace(SETTINGS, bounces=12))
    return drawing.render(case, frozenset({"combined"}), 17).pixels["combined"][..., 0]


@pytest.mark.parametrize("inwards", [False, True])
def test_a_closed_room_that_shines_is_even(inwards):
    """Next to its corners as well, a line of a pixel excepted."""
    off = np.abs(closed_room(inwards, camera((-0.8, -0.8, 0.2), (1, 2, 0), (320, 180))) - 1)
    # RMSE; as long as nobody saw insides and receivers lay behind walls. Worst; the share that is more than 0.05 off.
    assert np.sqrt((off**2).mean()) < 0.025  # 0.0223 outwards, 0.0071 inwards; 0.25, 0.038
    assert (off > 0.05).mean() < 0.0015  # 0.0007, 0.0010; 0.99, 0.016


@pytest.mark.parametrize("inwards", [False, True])
def test_a_room_is_even_where_the_camera_clips_its_front(inwards):
    """The camera is outside, and sees what lies behind the room's middle."""
    seen = camera((-0.8, -9.0, 0.2), (0, 0, 0), SIZE)
    seen = replace(seen, near=9.0, clip_from_view=nearer(seen.clip_from_view, 9.0))
    shown = closed_room(inwards, seen)[20:34, 40:56]  # of the far wall
    assert np.abs(shown - 1).max() < 0.03  # 0.024, 0.005; outwards 0.25 where nobody saw insides


def nearer(clip_from_view: np.ndarray, near: float, far: float = 1000.0) -> np.ndarray:
    """With another clip start."""
    found = clip_from_view.copy()
    found[2, 2:] = (far + near) / (near - far), 2 * far * near / (near - far)
    return found


@pytest.mark.parametrize("inwards", [False, True])
def test_a_white_ball_on_a_white_floor_is_as_bright_as_the_sky(inwards):
    """Whichever way its fronts look; but for where both touch, which is too dark."""
    ball = sphere_mesh("white ball", 48)
    ball = turned(replace(ball, position=np.where(np.abs(ball.position) < 1e-6, 0, ball.position)), inwards)
    assert is_closed(ball)
    floor = mesh(plane_mesh("white floor", 30.0), "POLYGONS"), LAID
    table = materials(1, base_color=[[1.0] * 3], specular=[0.0], roughness=[1.0])
    things = floor, (mesh(ball, "POLYGONS"), moved((0, 0, 0), 0.8))
    white = scene(*things, lights=(), world=World(np.ones(3)), table=table)
    seen = camera((0.0, -6.0, 3.5), (0, 0, -0.2), (320, 180))
    shown = drawing.render(Case(white, seen, replace(SETTINGS, bounces=12)), frozenset({"combined"})).pixels["combined"]
    off = shown[..., 0] - 1
    assert np.sqrt((off**2).mean()) < 0.02  # 0.0151; inwards 0.056, where its outside was as black as insides are


def test_places_between_surfaces_that_face_each_other_are_finite():
    """Two pixels show a floor and what lies above it, turned downwards: no step in its plane leads away from that."""
    seen = camera((0.0, -3.0, 0.5), (0, 0, 0), (2, 1))
    position = np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.02]])
    normal = np.array([[0, 0, 1], [0, 0, -1]], np.float32)
    groups = Groups(np.array([0.0, -3.0, 0.5]), position, normal, np.full(2, 3.0, np.float32), np.arange(2))
    with np.errstate(all="raise"):
        found = sites_of(groups, np.arange(2), np.zeros(2), SampleView(seen, 0.1, 100.0), None)
    assert np.isfinite(found.position).all()
    np.testing.assert_array_equal(found.normal, normal)
