"""Indirect light that is gathered a little between any two redraws of a view that stands still."""

import time
from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.render.budget import following
from pointsplat_addon.render.budget.following import Following
from pointsplat_addon.render.cache.store import Store
from pointsplat_addon.render.frame.frame import Frame
from pointsplat_addon.render.frame.indirect import kept
from pointsplat_addon.render.indirect import known_sites
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes import drawing, indirect_cases
from scripts.scenes.case import Case

CASES = pytest.mark.parametrize("make", indirect_cases.EVERY)


def view_of(case: Case) -> Request:
    return replace(case.request(frozenset({"combined"}), 2), interactive=True)


def brought_in(of: Renderer, case: Case) -> tuple[Frame | None, int]:
    """The frame with indirect light, and how often work went on for a moment."""
    made, moments = Following(of, case.scene, view_of(case)), 0
    while not made.done:
        made.go_on()
        moments += 1
        if of.store.building:
            time.sleep(0.001)
    return made.frame, moments


@CASES
def test_a_view_lit_in_moments_is_one_lit_at_once(make, gathered, monkeypatch):
    """To the bit, and nothing is gathered twice, though each moment is over after sixteen receivers."""
    case, at_once = make(), Renderer(drawing.opengl().device)
    whole = at_once.start(case.scene, view_of(case))
    while whole.sample():
        pass
    receivers, slices = sum(gathered), len(gathered)
    gathered.clear()
    monkeypatch.setattr(known_sites, "FIRST_SLICE", 16)
    monkeypatch.setattr(known_sites, "SLICE_SECONDS", 0.0)
    monkeypatch.setattr(following, "LEAST_SECONDS", 0.0)
    monkeypatch.setattr(following, "max", lambda *_: 0.0, raising=False)
    own = Renderer(drawing.opengl().device)
    frame, moments = brought_in(own, case)
    assert frame is not None
    np.testing.assert_array_equal(frame.mean(), whole.mean())
    assert sum(gathered) == receivers
    assert max(gathered) <= 16
    assert moments > len(gathered) - slices > 10
    for one in (frame, whole, own, at_once):
        one.release()


def test_what_is_put_off_leaves_nothing_on_the_device(monkeypatch):
    monkeypatch.setattr(known_sites, "FIRST_SLICE", 16)
    own, case = Renderer(drawing.opengl().device), indirect_cases.in_a_corner()
    made = Following(own, case.scene, view_of(case))
    while own.store.building or not made.frame:
        own.release()
        before = own.device.bytes_allocated()
        made.go_on()
        if made.frame is None:
            own.release()
            assert own.device.bytes_allocated() == before
    made.release()
    own.release()


def test_where_nothing_scatters_light_there_is_no_other_picture():
    case = indirect_cases.in_a_corner()
    dark = replace(case.scene, lights=(), world=replace(case.scene.world, color=np.zeros(3), image=None))
    own = Renderer(drawing.opengl().device)
    frame, moments = brought_in(own, replace(case, scene=dark))
    assert frame is None
    assert moments == 1
    own.release()


def test_an_error_on_the_store_s_thread_is_told(monkeypatch):
    def fail(*_):
        raise MemoryError("no room for surfels")

    monkeypatch.setattr(kept, "scene_surfels", fail)
    own = Renderer(drawing.opengl().device, Store())
    with pytest.raises(MemoryError, match="no room"):
        brought_in(own, indirect_cases.in_a_corner())
    own.release()
