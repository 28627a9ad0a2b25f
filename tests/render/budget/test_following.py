"""Pictures that take the place of the first one of a view that stands still."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.numeric.lattice import FEW, MANY
from pointsplat_addon.render.budget import following as following_module
from pointsplat_addon.render.budget.following import Followers, Following
from pointsplat_addon.render.frame import frame as frame_module
from pointsplat_addon.render.frame.frame import Frame
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes import drawing, indirect_cases, solid_cases, translucent_cases
from scripts.scenes.case import Case

COMBINED = frozenset({"combined"})
IN_LATTICES = pytest.mark.parametrize(
    "make", [solid_cases.mixed, translucent_cases.smoke, translucent_cases.panes_in_smoke]
)


@pytest.fixture(autouse=True)
def one_step_at_a_time(monkeypatch):
    monkeypatch.setattr(following_module, "LEAST_SECONDS", 0.0)


def still(case: Case, samples: int = 16, **more) -> Request:
    """The view as a viewport asks for it first."""
    settings = replace(case.settings, **{"technique": "AUTO", "use_indirect": False} | more)
    return Request(case.camera, settings, COMBINED, samples, interactive=True, first=True)


def then(request: Request, **more) -> Request:
    """As it asks for the picture that follows."""
    return replace(request, first=False, following=True, settings=replace(request.settings, **more))


def drawn(renderer: Renderer, case: Case, request: Request) -> Frame:
    frame = renderer.start(case.scene, request)
    while frame.sample():
        pass
    return frame


def renderer() -> Renderer:
    return Renderer(drawing.opengl().device)


def in_tiles(monkeypatch) -> None:
    """Pictures are divided into tiles of at most 2^14 cells."""
    monkeypatch.setattr(frame_module, "cells_of_tile", lambda primitives, shown, streamed: 1 << 14)


@IN_LATTICES
def test_a_lattice_of_few_comes_first_and_one_of_many_follows(make):
    own, case = renderer(), make()
    first = drawn(own, case, still(case))
    assert first.frame_plan.followed
    assert (first.done, first.frame_plan.plan.sub_samples) == (1, FEW.count)
    following = Following(own, case.scene, then(still(case)))
    while not following.done:
        following.go_on()
    last = following.taken()
    assert (last.done, last.frame_plan.plan.sub_samples) == (1, MANY.count)
    final = drawn(own, case, replace(then(still(case)), interactive=False, following=False))
    np.testing.assert_array_equal(last.mean(), final.mean())  # that of a final picture
    for one in (first, last, final, own):
        one.release()


@IN_LATTICES
def test_a_picture_drawn_tile_by_tile_is_one_drawn_at_once(make, monkeypatch):
    in_tiles(monkeypatch)
    own, case = renderer(), make()
    at_once = drawn(own, case, then(still(case)))
    following, steps = Following(own, case.scene, then(still(case))), 0
    while not following.done:
        following.go_on()
        steps += 1
    last = following.taken()
    assert last.visibility is not None
    assert steps == 1 + len(last.visibility.tiles) > 4
    np.testing.assert_array_equal(last.mean(), at_once.mean())
    for one in (at_once, last, own):
        one.release()


def test_smoke_alone_is_drawn_whole_first_and_then_in_one_lattice():
    own, case = renderer(), translucent_cases.in_smoke()
    first, last = drawn(own, case, still(case)), drawn(own, case, then(still(case)))
    assert (first.done, first.frame_plan.plan.sub_samples, first.frame_plan.followed) == (1, 0, True)
    assert (last.done, last.frame_plan.plan.sub_samples) == (1, MANY.count)
    for one in (first, last, own):
        one.release()


@pytest.mark.parametrize(("technique", "samples"), [("EWA", 16), ("IMAGE_SPACE", 16), ("VISIBILITY", 5)])
def test_what_would_be_the_same_picture_does_not_follow(technique, samples):
    """Other techniques draw sample by sample, and show each."""
    own, case = renderer(), solid_cases.balls()
    request = still(case, samples, technique=technique)
    first = drawn(own, case, request)
    assert not first.frame_plan.followed
    assert first.done * max(first.frame_plan.plan.sub_samples, 1) == samples
    followers = Followers()
    followers.add(Following(own, case.scene, then(request)))
    assert followers.go_on(first) is first
    assert not followers
    for one in (first, own):
        one.release()


def test_pictures_are_shown_in_turn_each_as_soon_as_it_is_better(monkeypatch):
    """That with many sub-samples from its first lattice on, that with indirect light once it is complete; of those
    before only what is shown is held."""
    in_tiles(monkeypatch)
    own, case = renderer(), indirect_cases.in_a_corner()
    request = still(case, 2 * MANY.count)
    first = drawn(own, case, request)
    picture = first.mean()
    followers = Followers()
    followers.add(Following(own, case.scene, then(request)))
    followers.add(Following(own, case.scene, then(request, use_indirect=True)))
    shown = followers.go_on(first)
    assert shown is first
    np.testing.assert_array_equal(shown.mean(), picture)
    while shown is first:
        shown = followers.go_on(shown)
    assert (shown.done, shown.frame_plan.plan.sub_samples, shown.complete) == (1, MANY.count, False)
    assert not shown.frame_plan.plan.indirect
    while shown.sample():
        pass
    before = shown
    while followers:
        shown = followers.go_on(shown)
        assert shown.complete
    assert shown is not before
    assert shown.frame_plan.plan.indirect
    at_once = drawn(renderer(), case, then(request, use_indirect=True))
    np.testing.assert_array_equal(shown.mean(), at_once.mean())
    for one in (shown, at_once, own):
        one.release()


def test_what_is_only_shown_holds_no_sub_samples():
    own, case = renderer(), solid_cases.mixed()
    first = drawn(own, case, still(case))
    picture, before = first.mean(), own.device.bytes_allocated()
    targets = first.targets
    first.keep_shown()
    first.keep_shown()  # once more changes nothing
    _, _, width, height = case.camera.window
    # Each has 16 bytes, and about as many of its groups.
    assert before - own.device.bytes_allocated() > 2 * 16 * FEW.count * width * height
    np.testing.assert_array_equal(first.mean(), picture)
    first.release()
    again = own.start(case.scene, still(case))
    assert again.targets is not targets  # which cannot draw any more
    again.release()
    own.release()


def test_what_follows_is_released_with_its_followers():
    own, case = renderer(), solid_cases.mixed()
    own.release()
    before = own.device.bytes_allocated()
    first, followers = drawn(own, case, still(case)), Followers()
    followers.add(Following(own, case.scene, then(still(case))))
    followers.go_on(first)
    followers.release()
    assert not followers
    first.release()
    own.release()
    assert own.device.bytes_allocated() == before


@pytest.mark.parametrize("samples", [1, FEW.count])
def test_smoke_is_as_fine_where_no_picture_follows(samples):
    """Splats of half the resolution are for pictures that others replace."""
    own, case = renderer(), translucent_cases.smoke()
    only = drawn(own, case, still(case, samples))
    assert not only.frame_plan.followed
    moving = drawn(own, case, replace(still(case, samples), first=False))
    final = drawn(own, case, replace(then(still(case, samples)), interactive=False, following=False))
    np.testing.assert_array_equal(only.mean(), final.mean())
    assert np.abs(moving.mean() - final.mean()).max() > 0.05
    for one in (only, moving, final, own):
        one.release()
