"""A changing scene, hundreds of times over, on one device: nothing is left behind, in the process or on the device."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from pointsplat_addon.devices.opengl import OpenGLDevice
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes.store import STORE
from tests.support.soak import KEPT, PERIOD, SHORT, draw, soak


@pytest.fixture
def renderer() -> Iterator[Renderer]:
    renderer = Renderer(OpenGLDevice(), STORE)
    yield renderer
    renderer.release()
    renderer.device.release()


def assert_nothing_is_left(renderer: Renderer, frames: int, growth: float, within, warm: int = PERIOD) -> None:
    STORE.clear()
    draw(renderer, 3)
    renderer.release()
    start = renderer.device.bytes_allocated()
    first, last = soak(renderer, frames, warm=warm)
    case = f"{frames if warm == PERIOD else warm + frames} frames of a changing scene"
    within(case, "growth of the process, once its stores are full", last.process / max(first.process, 1) - 1, growth)
    assert last.device <= 2 * KEPT  # what is kept, and what the pool lends
    renderer.release()
    within(case, "bytes left on the device", renderer.device.bytes_allocated() - start, 0.0)
    assert STORE.nbytes == 0


def test_sixty_frames_leave_nothing_behind(renderer, within):
    assert_nothing_is_left(renderer, 60 - SHORT, 0.05, within, SHORT)


@pytest.mark.long
def test_two_thousand_frames_leave_nothing_behind(renderer, within):
    assert_nothing_is_left(renderer, 2000, 0.05, within)  # measured 0.013


@pytest.mark.long
def test_a_whole_period_and_sixty_frames_leave_nothing_behind(renderer, within):
    assert_nothing_is_left(renderer, 60, 0.05, within)
