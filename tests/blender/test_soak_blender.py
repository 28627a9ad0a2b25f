"""Through Blender's gpu: a changing scene, dozens of times over, leaves no memory and no state behind."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

bpy = pytest.importorskip("bpy")
gpu = pytest.importorskip("gpu")

from pointsplat_addon.devices.blender_gpu import BlenderDevice  # noqa: E402 - needs Blender
from pointsplat_addon.render.frame import Renderer  # noqa: E402
from pointsplat_addon.render.prepare import STORE  # noqa: E402
from tests.blender.test_blender_gpu import start_gpu  # noqa: E402
from tests.extreme.soak import KEPT, draw, soak  # noqa: E402


@pytest.fixture
def renderer() -> Iterator[Renderer]:
    start_gpu()
    renderer = Renderer(BlenderDevice())
    yield renderer
    renderer.release()
    renderer.device.release()


def state() -> tuple:
    """What Blender lets a script ask about the state that its own drawing relies on."""
    s = gpu.state
    return (s.blend_get(), s.depth_test_get(), s.depth_mask_get(), s.line_width_get(), tuple(s.viewport_get()))


def assert_nothing_is_left(renderer: Renderer, frames: int) -> None:
    STORE.clear()
    draw(renderer, 3)
    renderer.release()
    start, before = renderer.device.bytes_allocated(), state()

    def unchanged() -> None:
        assert state() == before

    first, last = soak(renderer, frames, unchanged)
    assert last.process <= 1.05 * first.process  # measured: docs/stability.md
    assert last.device <= 2 * KEPT
    renderer.release()
    assert renderer.device.bytes_allocated() == start
    assert STORE.nbytes == 0


def test_sixty_frames_leave_nothing_behind_in_blender(renderer):
    assert_nothing_is_left(renderer, 60)


@pytest.mark.long
def test_two_thousand_frames_leave_nothing_behind_in_blender(renderer):
    assert_nothing_is_left(renderer, 2000)
