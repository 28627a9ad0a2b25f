"""Through Blender's gpu: a changing scene, dozens of times over, leaves no memory and no state behind."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
gpu = pytest.importorskip("gpu")

from gpu_extras.batch import batch_for_shader

from pointsplat_addon.devices.blender_gpu import BlenderDevice
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes.store import STORE
from tests.support.blender.devices import start_gpu
from tests.support.soak import KEPT, PERIOD, SHORT, draw, soak

SIDE = 8  # pixels


@pytest.fixture
def renderer() -> Iterator[Renderer]:
    start_gpu()
    renderer = Renderer(BlenderDevice(), STORE)
    yield renderer
    renderer.release()
    renderer.device.release()


def state() -> tuple:
    """What Blender lets a script ask about the state that its own drawing relies on."""
    s = gpu.state
    bound = s.active_framebuffer_get()
    return (s.blend_get(), s.depth_test_get(), s.depth_mask_get(), s.line_width_get(), tuple(s.viewport_get()),
            tuple(s.scissor_get()), tuple(bound.viewport_get()))  # fmt: skip


def blenders_own() -> Callable[[], np.ndarray]:
    """Draws with one of Blender's shaders, and sets none of the state: triangles that face either way, lines and points
    over half of a picture (SIDE, SIDE, 4) that is half grey. What it shows depends on what cannot be asked: the mask of
    colours, culling, the bound framebuffer and shader."""
    plain, dots = (gpu.shader.from_builtin(name) for name in ("UNIFORM_COLOR", "POINT_UNIFORM_COLOR"))
    texture = gpu.types.GPUTexture((SIDE, SIDE), format="RGBA32F")
    target = gpu.types.GPUFrameBuffer(color_slots=(texture,))
    either_way = [(-1, -1, 0), (0, -1, 0), (0, 0, 0), (-1, 0, 0), (0, 0.5, 0), (0, 0, 0)]
    batches = (
        (plain, batch_for_shader(plain, "TRIS", {"pos": either_way}), (0.5, 0.25, 1, 0.75)),
        (plain, batch_for_shader(plain, "LINES", {"pos": [(-0.9, 0.7, 0), (0.9, 0.7, 0)]}), (0, 1, 0.25, 0.5)),
        (dots, batch_for_shader(dots, "POINTS", {"pos": [(0.4, -0.4, 0), (0.6, 0.2, 0)]}), (1, 0, 0.5, 1)),
    )

    def picture() -> np.ndarray:
        with target.bind():
            target.clear(color=(0.5, 0.5, 0.5, 0.5))
            for shader, batch, color in batches:
                shader.bind()
                shader.uniform_float("color", color)
                batch.draw(shader)
        pixels = texture.read()
        pixels.dimensions = SIDE * SIDE * 4  # as in devices/blender_gpu.py
        return np.array(pixels, np.float32).reshape(SIDE, SIDE, 4)

    return picture


def assert_nothing_is_left(renderer: Renderer, frames: int, warm: int = PERIOD) -> None:
    picture = blenders_own()
    alone = picture()
    STORE.clear()
    draw(renderer, 3)
    renderer.release()
    start, before = renderer.device.bytes_allocated(), state()

    def unchanged() -> None:
        assert state() == before
        np.testing.assert_array_equal(picture(), alone)

    first, last = soak(renderer, frames, unchanged, warm)
    growth = last.process / max(first.process, 1) - 1
    print(f"{frames} frames: the process grew by {growth:.2%}")
    assert growth <= 0.05  # measured 0.006
    assert last.device <= 2 * KEPT
    renderer.release()
    assert renderer.device.bytes_allocated() == start
    assert STORE.nbytes == 0


def test_the_picture_that_is_looked_at_shows_state_that_was_left(renderer):
    """State that drawing changes and that cannot be asked for, left as it is not by default, changes the picture."""
    s, picture = gpu.state, blenders_own()
    alone = picture()
    assert len(np.unique(alone.reshape(-1, 4), axis=0)) == 4, alone
    states = {
        "blend": (lambda: s.blend_set("ADDITIVE_PREMULT"), lambda: s.blend_set("NONE")),
        "mask": (lambda: s.color_mask_set(True, False, True, True), lambda: s.color_mask_set(True, True, True, True)),
        "culling": (lambda: s.face_culling_set("BACK"), lambda: s.face_culling_set("NONE")),
    }
    shown = set()
    for name, (leave, put_back) in states.items():
        leave()
        try:
            shown |= set() if np.array_equal(picture(), alone) else {name}
        finally:
            put_back()
    assert shown == states.keys()
    np.testing.assert_array_equal(picture(), alone)


def test_sixty_frames_leave_nothing_behind_in_blender(renderer):
    assert_nothing_is_left(renderer, 60 - SHORT, SHORT)


@pytest.mark.long
def test_a_whole_period_and_sixty_frames_leave_nothing_behind_in_blender(renderer):
    assert_nothing_is_left(renderer, 60)


@pytest.mark.long
def test_two_thousand_frames_leave_nothing_behind_in_blender(renderer):
    assert_nothing_is_left(renderer, 2000)
