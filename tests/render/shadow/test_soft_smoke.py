"""Shadows of smoke while a scene changes: soft ones at once, and the sharp ones once it stands still."""

from dataclasses import replace

import numpy as np

from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.render.cache.store import Store
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.shadow.shadows import make_shadows
from scripts.scenes import build, drawing, meshes
from scripts.scenes.build import moved, points
from scripts.scenes.cameras import camera
from tests.support.transmittance import voxels

SETTINGS = Settings(use_shadows=True)


def lit(direction):
    """A slab of smoke over a floor, under a sun."""
    floor = build.mesh(meshes.plane_mesh("floor", 4.0, 8), "POLYGONS")
    things = (points("smoke", voxels(1.0, 0.5, 8, 2.0)), moved((0, 0, 1))), (floor, moved((0, 0, 0)))
    return build.scene(*things, lights=(build.sun(direction=direction),))


def packed(scene, store, quick):
    shadows, _ = make_shadows(scene, SETTINGS, store, quick=quick)
    assert shadows is not None
    assert shadows.tables is not None
    return shadows.coarse, shadows.tables.packed.data.tobytes()


def test_sharp_shadows_follow_soft_ones():
    store, before, after = Store(), lit((0.4, 0.7, -0.5)), lit((0.3, 0.7, -0.5))
    known = packed(before, store, quick=False)
    assert known == (False, packed(before, Store(), quick=False)[1])
    assert packed(before, store, quick=True) == known  # nothing is made anew of what is there
    soft, sharp = packed(after, store, quick=True), packed(after, store, quick=False)
    assert soft[0]
    assert not sharp[0]
    assert len(soft[1]) < len(sharp[1])
    assert sharp == packed(after, Store(), quick=False)  # to the bit
    assert packed(after, store, quick=True) == sharp


def test_shadows_that_cannot_be_sharper_are_made_once():
    """Of cells wider than voxels, as few rows ask for."""
    scene, store = lit((0.4, 0.7, -0.5)), Store()
    settings = replace(SETTINGS, shadow_resolution=16)
    first, second = (make_shadows(scene, settings, store, quick=quick)[0] for quick in (True, False))
    assert first is not None
    assert second is not None
    assert first.tables is not None
    assert second.tables is not None
    assert not first.coarse
    assert np.array_equal(first.tables.packed.data, second.tables.packed.data)


def test_a_picture_that_has_come_to_rest_is_that_of_a_fresh_one():
    scene, eye = lit((0.35, 0.6, -0.5)), camera((0, -6, 3), resolution=(48, 32))
    request = Request(eye, SETTINGS, frozenset({"combined"}), 5, interactive=True)
    renderer = drawing.opengl()
    renderer.store.clear()
    moving = renderer.render(scene, replace(request, changing=True)).pixels["combined"]
    rest = renderer.render(scene, request).pixels["combined"]
    renderer.store.clear()
    assert np.array_equal(rest, renderer.render(scene, request).pixels["combined"])
    assert 0 < np.abs(moving - rest).max() < 0.2  # other shadows, but of the same smoke
