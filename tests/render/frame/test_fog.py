"""Fog that fills the world, against Beer's law and float64 integrals of what it scatters once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.light.fog import without_far_light
from pointsplat_addon.core.light.light_shapes import blend_range
from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import Fog, World
from pointsplat_addon.render.plan.request import Request
from scripts.scenes import build, drawing, meshes
from scripts.scenes.build import moved
from scripts.scenes.cameras import camera
from tests.reference import fog as reference

FOG = Fog(np.array([0.10, 0.15, 0.20]), np.array([0.08, 0.10, 0.05]), anisotropy=0.3)
DOWN = np.array([0.0, 0.0, -1.0])
LAMP = Light("POINT", np.array([30.0, 20.0, 10.0]), np.array([0.7, 0.3, 0.9]), DOWN)
SPOT = replace(LAMP, kind="SPOT", spot_cos=np.cos(0.5), spot_blend=0.4)
CAMERAS = {"perspective": camera(near=0.5), "parallel": camera(parallel=4.0, near=0.5)}


def draw(*things, fog: Fog | None = FOG, lights=(), eye: Camera = CAMERAS["perspective"], **more) -> np.ndarray:
    more.setdefault("world", World(fog=fog))
    scene = build.scene(*things, lights=lights, **more)
    settings = Settings(technique="VISIBILITY", adaptive_threshold=0.0, filter_size=0.01)
    request = Request(eye, settings, frozenset({"combined"}), 1)
    return drawing.opengl().render(without_far_light(scene), request).pixels["combined"].astype(np.float64)


def rays(eye: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Origins (N, 3), on the near plane, and unit directions of the rays through pixels' centres, in world space."""
    fx, fy, cx, cy = eye.pixel_from_view()
    _, _, width, height = eye.window
    y, x = np.indices((height, width)).reshape(2, -1) + 0.5
    slope = np.stack([(x - cx) / fx, (y - cy) / fy], axis=1)
    ahead = np.column_stack([slope if eye.perspective else 0 * slope, np.full(len(x), -1.0)])
    origin = ahead * eye.near if eye.perspective else np.column_stack([slope, np.full(len(x), -eye.near)])
    world_from_view = np.linalg.inv(eye.view_from_world)
    origin = origin @ world_from_view[:3, :3].T + world_from_view[:3, 3]
    return origin, ahead @ world_from_view[:3, :3].T / np.linalg.norm(ahead, axis=1, keepdims=True)


def shaped(values: np.ndarray, eye: Camera) -> np.ndarray:
    return values.reshape(eye.window[3], eye.window[2], -1)


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("light", [LAMP, SPOT], ids=["point", "spot"])
def test_a_lamp_alone_in_fog_is_its_airlight(name, light):
    eye = CAMERAS[name]
    seen = draw(lights=[light], eye=eye)
    # The reference's blend is that of the shader's range.
    known = replace(light, spot_blend=blend_range(light) / (1 - light.spot_cos)) if light.kind == "SPOT" else light
    truth = shaped(reference.airlight(FOG, known, *rays(eye)), eye)
    error = np.abs(seen[..., :3] - truth) / truth.max(axis=(0, 1))
    assert (seen[..., 3] == 1).all()
    assert error.max() < 3e-3  # measured 3.0e-4 of a point lamp, 1.4e-3 of a spot, next to them
    assert np.sqrt((error**2).mean()) < 1e-4  # measured 6.4e-6 and 4.0e-5


@pytest.mark.parametrize("name", CAMERAS)
def test_what_is_seen_through_fog_is_dimmed_and_veiled(name):
    eye = CAMERAS[name]
    table = build.materials(base_color=[[0, 0, 0]], specular=[0], emission=[[1.0, 2.0, 3.0]])
    wall = build.mesh(meshes.plane_mesh("wall in fog", 40.0), "POLYGONS"), moved((0, 3.0, 0))
    glow = replace(FOG, emission=np.array([0.02, 0.01, 0.03]))
    seen = draw(wall, lights=[LAMP], eye=eye, table=table, fog=glow)
    origins, directions = rays(eye)
    far = (3.0 - origins[:, 1]) / directions[:, 1]
    left = reference.transmittance(FOG, far)
    truth = left * [1.0, 2.0, 3.0] + reference.airlight(FOG, LAMP, origins, directions, far)
    truth += (1 - left) * glow.emission / FOG.extinction
    error = np.abs(seen[..., :3] / shaped(truth, eye) - 1).max()
    assert error < 3e-4  # measured 6.8e-5


def test_a_lamp_lights_surfaces_through_fog():
    table = build.materials(base_color=[[0.8, 0.8, 0.8]], specular=[0], roughness=[1.0])
    wall = build.mesh(meshes.plane_mesh("lit wall in fog", 40.0), "POLYGONS"), moved((0, 3.0, 0))
    thin = replace(FOG, scattering=np.zeros(3))
    eye = CAMERAS["perspective"]
    seen = draw(wall, lights=[LAMP], eye=eye, table=table, fog=thin)
    clear = draw(wall, lights=[LAMP], eye=eye, table=table, world=World())
    origins, directions = rays(eye)
    far = (3.0 - origins[:, 1]) / directions[:, 1]
    way = np.linalg.norm(origins + far[:, None] * directions - LAMP.position, axis=1)
    error = np.abs(seen[..., :3] / clear[..., :3] - shaped(reference.transmittance(thin, far + way), eye)).max()
    assert error < 1e-5  # measured 2.0e-7


def test_what_stands_before_a_lamp_shades_the_fog():
    """A black card: behind it the ray's places that the lamp does not see are dark."""
    eye = camera((0, -6, 0), resolution=(64, 48), near=0.5)
    lamp = replace(LAMP, position=np.array([0.0, 0.0, 3.0]))
    half = 0.5
    table = build.materials(base_color=[[0, 0, 0]], specular=[0])
    corners = half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
    card = (
        build.mesh(meshes.flat_mesh("card in fog", corners, np.array([[0, 1, 2], [0, 2, 3]])), "POLYGONS"),
        moved((0, 0, 1)),
    )
    seen = draw(card, lights=[lamp], eye=eye, table=table)

    def visible(place: np.ndarray) -> np.ndarray:
        toward = lamp.position - place
        t = (1.0 - place[..., 2]) / np.where(toward[..., 2] == 0, 1e-9, toward[..., 2])
        met = np.abs(place + t[..., None] * toward)[..., :2].max(axis=-1) < half
        return 1.0 - (met & (t > 0) & (t < 1))

    truth = shaped(reference.airlight(FOG, lamp, *rays(eye), visible=visible), eye)
    unshaded = shaped(reference.airlight(FOG, lamp, *rays(eye)), eye)
    below = np.arange(48) < 20  # where no ray meets the card
    error = (seen[..., :3] - truth)[below] / unshaded[below]
    assert (truth / unshaded)[below].min() < 0.9
    # Single rays, of 32 places each: the pixel filter makes means of some.
    assert np.sqrt((error**2).mean()) < 0.012  # measured 0.0096
    assert np.abs(error).max() < 0.04  # measured 0.031
    assert abs(error.mean()) < 5e-4  # measured 4.2e-5


def test_suns_and_the_world_are_too_far_to_be_seen_through_fog():
    eye = CAMERAS["perspective"]
    cube = build.mesh(meshes.cube_mesh("cube in fog", 1.0), "POLYGONS"), moved()
    seen = draw(cube, lights=[build.sun()], world=World(np.ones(3), fog=FOG), eye=eye)
    assert not seen[..., :3].any()
    red = Fog(np.array([0.0, 0.1, 0.1]), np.zeros(3))
    seen = draw(cube, lights=[build.sun()], world=World(np.ones(3), fog=red), eye=eye)
    clear = draw(cube, lights=[build.sun()], world=World(np.ones(3)), eye=eye)
    np.testing.assert_allclose(seen[..., 0], clear[..., 0], atol=1e-6)
    assert not seen[..., 1:3].any()
    # A transparent film shows neither, but for how much of them passes.
    hidden = draw(lights=[], world=World(np.ones(3), fog=red), eye=eye, transparent=True)
    np.testing.assert_allclose(hidden, np.broadcast_to([0, 0, 0, 2 / 3], hidden.shape), atol=1e-6)
