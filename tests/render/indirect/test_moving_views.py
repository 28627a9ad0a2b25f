"""Views that move are lit by what was gathered when they stood still, and gather nothing themselves."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.render.budget.known_light import KnownLight
from pointsplat_addon.render.indirect import bake
from pointsplat_addon.render.indirect.light import IndirectLight
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes import drawing, indirect_cases
from scripts.scenes.case import Case
from tests.support.light_changes import CHANGES, changed

TURNS = 0.2, 0.7, 1.5  # radians about the middle of the room


def view_of(case: Case, camera: Camera, moving: bool = False) -> Request:
    return replace(case.request(frozenset({"combined"}), 16), camera=camera, interactive=True, moving=moving)


def drawn(of: Renderer, case: Case, request: Request, known: IndirectLight | None = None):
    """What a view shows, (H, W, 3), and its light."""
    frame = of.start(case.scene, request, known=known)
    while frame.sample():
        pass
    found = frame.mean()[..., :3], frame.indirect
    frame.release()
    return found


def turned(camera: Camera, angle: float) -> Camera:
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return replace(camera, view_from_world=camera.view_from_world @ turn)


def test_a_view_that_moves_in_a_room_is_lit_as_one_that_stands_still(gathered, monkeypatch):
    """Beside pictures by another renderer, which gathers for them alone. Worst: the mean is off by 0.0139, RMSE is
    0.0784 of the mean, where walls are new; at first 0.0040 and 0.0131. Without indirect light the sky makes the room
    4.88 times as bright at least."""
    # Each tree lights most of a room's surfaces by few receivers of 3,000, and by other ones.
    monkeypatch.setattr(bake, "MOST_BOUNCE_RECEIVERS", 20000)
    case, own = indirect_cases.in_a_room(), Renderer(drawing.opengl().device)
    _, light = drawn(own, case, view_of(case, case.camera))
    for angle in (0.0, *TURNS):
        camera = turned(case.camera, angle)
        gathered.clear()
        moving, _ = drawn(own, case, view_of(case, camera, moving=True), light)
        assert not sum(gathered)
        other = Renderer(drawing.opengl().device)
        still, _ = drawn(other, case, view_of(case, camera))
        flat = replace(view_of(case, camera), settings=replace(case.settings, use_indirect=False))
        plain, _ = drawn(other, case, flat)
        other.release()
        off, error = abs(moving.mean() / still.mean() - 1), np.sqrt(((moving - still) ** 2).mean()) / still.mean()
        assert off < (0.02 if angle else 0.008)
        assert error < (0.11 if angle else 0.015)
        assert plain.mean() > 4 * still.mean()
    own.release()


def test_a_picture_that_gathers_does_not_depend_on_views_that_moved(gathered):
    """To the bit."""
    case, own = indirect_cases.in_a_room(), Renderer(drawing.opengl().device)
    camera = turned(case.camera, TURNS[0])
    _, light = drawn(own, case, view_of(case, case.camera))
    drawn(own, case, view_of(case, camera, moving=True), light)
    after, _ = drawn(own, case, view_of(case, camera))
    other = Renderer(drawing.opengl().device)
    alone, _ = drawn(other, case, view_of(case, camera))
    np.testing.assert_array_equal(after, alone)
    own.release()
    other.release()


@pytest.mark.parametrize("make", indirect_cases.EVERY)
def test_all_kinds_of_things_are_lit(make, gathered):
    """The same view, RMSE over the mean: worst 0.0406, of balls and strands. In sharp mirrors light is blurred."""
    case, own = make(), Renderer(drawing.opengl().device)
    still, light = drawn(own, case, view_of(case, case.camera))
    gathered.clear()
    moving, _ = drawn(own, case, view_of(case, case.camera, moving=True), light)
    assert not sum(gathered)
    if make is indirect_cases.among_mirrors:
        assert 0.6 < moving.mean() / still.mean() < 1  # 0.73: the image of the sky in a wall is one of all around
    else:
        assert np.sqrt(((moving - still) ** 2).mean()) < 0.05 * still.mean()
    own.release()


@pytest.mark.parametrize("change", [*CHANGES, "settings", "none"])
def test_light_is_known_of_a_scene_by_its_content(change):
    case, own = indirect_cases.in_a_corner(), Renderer(drawing.opengl().device)
    _, light = drawn(own, case, view_of(case, case.camera))
    assert light is not None
    known = KnownLight(own, case.scene, case.settings, light)
    scene = changed(case.scene, change) if change in CHANGES else replace(case.scene)
    settings = replace(case.settings, bounces=1) if change == "settings" else case.settings
    assert known.is_of(own, scene, settings) == (change == "none")
    assert not known.is_of(Renderer(drawing.opengl().device), case.scene, case.settings)
    known.release()
    own.release()
    assert not known.is_of(own, case.scene, case.settings)
