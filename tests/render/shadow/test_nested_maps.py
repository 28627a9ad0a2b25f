"""Nested maps of suns: what they add to a picture, where their texels lie, and when there are none."""

# pyright: reportOptionalMemberAccess=false, reportArgumentType=false, reportOptionalIterable=false
# Lights may have no views; those that are asked for have some.
from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.numeric.pixel_filter import blackman_harris
from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.render.cache.store import Store
from pointsplat_addon.render.plan import frame_plan
from pointsplat_addon.render.shadow.light_points import light_shape
from pointsplat_addon.render.shadow.map_views import MapView
from pointsplat_addon.render.shadow.maps import ShadowMaps
from pointsplat_addon.render.shadow.nested import with_nested
from pointsplat_addon.render.shadow.shadows import make_shadows
from scripts.scenes import build, cameras, meshes
from scripts.scenes.case import Case
from scripts.scenes.drawing import render

COMBINED = frozenset({"combined"})
LAID = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])  # planes stand upright
SPACING, SIDE, HEIGHT = 0.4, 0.2, 0.15  # of cards, each in the middle of its cell
PATCH = 20  # cards along a side
SUN = replace(build.sun(3.0, (0.3, 0.4, -1.0)), radius=0.0)
SUNS = {"point": SUN, "disk": replace(SUN, radius=0.02)}
NEAR = cameras.camera((0.3, -3.0, 1.6), (0.1, 0.2, 0), resolution=(96, 72))
VIEWS = {
    "perspective": NEAR,
    "parallel": cameras.camera((0.3, -3.0, 1.6), (0.1, 0.2, 0), resolution=(96, 72), parallel=2.5),
    "a part": replace(NEAR, region=(24, 8, 40, 40)),
}


def patch():
    at = (np.arange(PATCH) - PATCH / 2 + 0.5) * SPACING
    middle = np.stack([*(axis.ravel() for axis in np.meshgrid(at, at)), np.full(PATCH**2, HEIGHT)], axis=1)
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * SIDE / 2
    corners = (middle[:, None] + square).reshape(-1, 3).astype(np.float32)
    triangles = (4 * np.arange(PATCH**2)[:, None, None] + [[0, 1, 2], [0, 2, 3]]).reshape(-1, 3)
    return build.mesh(meshes.flat_mesh("patch of cards", corners, triangles), "POLYGONS")


def field(light, camera: Camera) -> Case:
    """Patches of cards all over a plane of 200 m."""
    apart = np.arange(-96.0, 97.0, 48.0)
    cards = [(patch(), build.moved((x, y, 0))) for x in apart for y in apart]
    plane = build.mesh(meshes.plane_mesh("plane of 200", 200.0), "POLYGONS"), LAID
    settings = Settings(technique="VISIBILITY", use_adaptive_sampling=False)
    return Case(build.scene(plane, *cards, lights=[light]), camera, settings)


def maps_of(case: Case) -> ShadowMaps:
    store = Store()
    shadows, _ = make_shadows(case.scene, case.settings, store)
    return with_nested(shadows.maps, case.scene, case.camera, store, 16384)


def in_card(place: np.ndarray) -> np.ndarray:
    """Tells which places (..., 2) lie in a card's square."""
    within = np.abs(np.abs(place) % SPACING - SPACING / 2) < SIDE / 2
    return np.logical_and(within.all(axis=-1), (np.abs(place) < PATCH * SPACING / 2).all(axis=-1))


def by_rays(light, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Returns the share of the light on the plane and whether nothing hides it, (H, W), by the pixel filter."""
    fine, size = 8, 1.5
    (width, height), reach = camera.window[2:], 1
    sub = (np.arange((max(width, height) + 2 * reach) * fine) + 0.5) / fine - reach
    fx, fy, cx, cy = camera.pixel_from_view()
    x, y = np.meshgrid(sub[: (width + 2 * reach) * fine], sub[: (height + 2 * reach) * fine])
    slope = np.stack([(x - cx) / fx, (y - cy) / fy], axis=-1)
    back = np.linalg.inv(camera.view_from_world)
    one = np.ones_like(x)[..., None]
    if camera.perspective:
        start, ahead = back[:3, 3], np.concatenate([slope, -one], axis=-1) @ back[:3, :3].T
    else:
        start, ahead = np.concatenate([slope, 0 * one], axis=-1) @ back[:3, :3].T + back[:3, 3], -back[:3, 2]
    ahead = np.broadcast_to(ahead, (*x.shape, 3))
    start = np.broadcast_to(start, ahead.shape)

    def at(z: float) -> np.ndarray:
        return (start + ((z - start[..., 2]) / ahead[..., 2])[..., None] * ahead)[..., :2]

    ground, hidden = at(0.0), in_card(at(HEIGHT))
    shape = light_shape(light)
    number = np.arange(64) + 0.5
    disk = np.sqrt(number / 64)[:, None] * np.stack([np.cos(2.4 * number), np.sin(2.4 * number)], axis=1)
    toward = [-light.direction] if shape is None else -light.direction + disk @ shape.axes
    lit = np.mean([~in_card(ground + HEIGHT * ray[:2] / ray[2]) for ray in toward], axis=0)
    weight = blackman_harris((np.arange((1 + 2 * reach) * fine) + 0.5) / fine - reach - 0.5, size)
    weight /= weight.sum()

    def filtered(values: np.ndarray) -> np.ndarray:
        windows = np.lib.stride_tricks.sliding_window_view(values, (len(weight),) * 2)[::fine, ::fine]
        return np.einsum("hwab,a,b->hw", windows, weight, weight)

    near = np.abs(ground[fine::fine, fine::fine][:height, :width]).max(axis=-1) < PATCH * SPACING / 2 - 0.5
    return filtered(lit.astype(float)), (filtered(hidden.astype(float)) == 0) & near


def share(case: Case) -> np.ndarray:
    def red(settings: Settings) -> np.ndarray:
        return render(replace(case, settings=settings), COMBINED, 68).pixels["combined"][..., 0].astype(float)

    ambient = render(replace(case, scene=replace(case.scene, lights=())), COMBINED, 68).pixels["combined"][..., 0]
    lit = red(replace(case.settings, use_shadows=False)) - ambient
    return (red(case.settings) - ambient) / lit


@pytest.mark.parametrize("sun", SUNS)
@pytest.mark.parametrize("view", VIEWS)
def test_shadows_of_small_cards_on_a_wide_plane_are_those_of_rays(sun, view, monkeypatch):
    case = field(SUNS[sun], VIEWS[view])
    expected, free = by_rays(SUNS[sun], case.camera)
    assert free.mean() > 0.3
    error = np.sqrt(((share(case) - expected)[free] ** 2).mean())
    monkeypatch.setattr(frame_plan, "with_nested", lambda maps, *_: maps)
    without = np.sqrt(((share(case) - expected)[free] ** 2).mean())
    assert error < 0.05  # measured at most 0.0436, along edges
    assert without > 0.15  # measured 0.210 at least


def levels(maps: ShadowMaps) -> list[MapView]:
    return [view for light in maps.lights for view in light.views if view is not None]


@pytest.mark.parametrize("sun", SUNS)
def test_texels_stay_where_they_are_when_the_camera_moves(sun):
    """Along the light's axes they lie on lattices that the scene's map has, too."""
    first = levels(maps_of(field(SUNS[sun], NEAR)))
    moved = replace(NEAR, view_from_world=cameras.look_at((0.35, -2.9, 1.6), (0.15, 0.3, 0)))
    second = levels(maps_of(field(SUNS[sun], moved)))
    assert len(first) == len(second) > 1
    for one, other in zip(first, second, strict=True):
        assert one.step == other.step
        apart = (one.low - other.low) / one.step
        np.testing.assert_allclose(apart, np.round(apart), atol=1e-6)
    assert any((one.low != other.low).any() for one, other in zip(first, second, strict=True))


def test_each_view_shows_what_receives_in_the_middle_of_its_depths():
    """From all points of the light, at the same texels but for the parts of one by which they are moved."""
    nested = levels(maps_of(field(SUNS["disk"], NEAR)))[1]
    middle = np.array([*(nested.nested.low + nested.nested.high) / 2, -nested.nested.lift])
    place = nested.origin + middle @ nested.axes
    for view in nested.each:
        camera = view.camera
        clip = camera.clip_from_view @ camera.view_from_world @ np.append(place, 1.0)
        np.testing.assert_allclose((clip[:2] + 1) / 2 * view.size, np.array(view.size) / 2, atol=0.51)


def test_maps_with_texels_as_fine_as_pixels_hold_no_others():
    case = field(SUN, NEAR)
    ball = build.mesh(meshes.sphere_mesh("ball over a patch", 24), "POLYGONS"), build.moved((0, 0, 1.0), 0.5)
    shown = build.scene((patch(), build.moved()), ball, lights=[SUN])
    store = Store()
    maps = make_shadows(shown, case.settings, store)[0].maps
    assert with_nested(maps, shown, cameras.camera((0.3, -12.0, 6.0), resolution=(96, 72)), store, 16384) is maps
    assert maps_of(case).nested


def test_what_light_reaches_is_the_same_for_all_cameras():
    """The key of what all views share tells of the scene's maps alone."""
    store = Store()
    keys = []
    for eye in ((0.3, -3.0, 1.6), (0.5, -2.0, 1.0)):
        case = field(SUN, replace(NEAR, view_from_world=cameras.look_at(eye, (0, 0, 0))))
        shadows, _ = make_shadows(case.scene, case.settings, store)
        nested = with_nested(shadows.maps, case.scene, case.camera, store, 16384)
        assert nested.key != shadows.maps.key
        keys.append(replace(shadows, maps=nested).key)
    assert keys[0] == keys[1] == shadows.key
