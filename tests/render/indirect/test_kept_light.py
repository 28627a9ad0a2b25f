"""Light that is kept from picture to picture: what a picture shows depends on none that came before it."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.render.cache.on_disk import OnDisk
from pointsplat_addon.render.cache.store import Store
from pointsplat_addon.render.frame.indirect import kept
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes import drawing, indirect_cases
from scripts.scenes.cameras import camera
from scripts.scenes.case import Case
from tests.support.light_changes import CHANGES, changed

COMBINED = frozenset({"combined"})
CASES = pytest.mark.parametrize("make", indirect_cases.EVERY)


def renderer(store: Store | None = None) -> Renderer:
    return Renderer(drawing.opengl().device, store)


def picture(of: Renderer, case: Case, seen: Camera) -> np.ndarray:
    made = replace(case, camera=seen)
    return of.render(made.scene, made.request(COMBINED, 1)).pixels["combined"]


@CASES
def test_a_picture_is_the_same_after_others(make):
    """To the bit: after one nearby, and after one from elsewhere."""
    case, used = make(), renderer()
    seen = camera((0.41, -2.98, 0.61))
    for other in ((0.4, -3.0, 0.6), (-0.7, -2.6, 0.9)):
        picture(used, case, camera(other))
    after_others, alone = picture(used, case, seen), renderer()
    np.testing.assert_array_equal(after_others, picture(alone, case, seen))
    alone.release()
    used.release()


def test_a_still_view_gathers_nothing_again(gathered):
    case, own = indirect_cases.in_a_corner(), renderer()
    picture(own, case, case.camera)
    assert sum(gathered) > 0
    gathered.clear()
    picture(own, case, case.camera)
    assert not sum(gathered)
    own.release()


def test_a_step_of_the_camera_gathers_little(gathered):
    """A step of a hundredth of the distance: 0.0110 of the receivers of the first picture, with those of bounces."""
    case, own = indirect_cases.in_a_corner(), renderer()
    picture(own, case, case.camera)
    first = sum(gathered)
    gathered.clear()
    picture(own, case, camera((0.396, -2.97, 0.594)))
    assert sum(gathered) < 0.015 * first
    own.release()


@pytest.mark.parametrize("change", CHANGES)
def test_what_changes_light_makes_it_anew(gathered, change):
    case, own = indirect_cases.in_a_corner(), renderer()
    picture(own, case, case.camera)
    first = sum(gathered)
    scene = changed(case.scene, change)
    gathered.clear()
    again = replace(case, scene=scene)
    found = picture(own, again, case.camera)
    assert sum(gathered) > 0.5 * first
    np.testing.assert_array_equal(found, picture(renderer(), again, case.camera))
    own.release()


def test_processes_share_it_on_disk(tmp_path, monkeypatch):
    """A second one reads what the first has written, and draws the same to the bit."""
    case, found = indirect_cases.in_a_corner(), []
    monkeypatch.setattr("pointsplat_addon.render.cache.on_disk._pays", lambda took, size: True)
    for _ in range(2):
        store = Store()
        store.on_disk = OnDisk(tmp_path, lambda: None, at_once=True)
        own = renderer(store)
        found.append(picture(own, case, case.camera))
        own.release()
        monkeypatch.setattr(kept, "Baker", None)  # is not called
    np.testing.assert_array_equal(*found)
