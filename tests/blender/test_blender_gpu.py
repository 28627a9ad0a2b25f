"""Blender's gpu module does what moderngl does, pixel by pixel, and neither disturbs the other."""

import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from tests.support.blender.devices import start_gpu

bpy = pytest.importorskip("bpy")
gpu = pytest.importorskip("gpu")

from pointsplat_addon.devices import blender_gpu
from pointsplat_addon.devices.blender_gpu import BlenderDevice
from pointsplat_addon.devices.opengl import OpenGLDevice
from pointsplat_addon.render.device.protocol import DeviceError
from pointsplat_addon.shading import sources
from pointsplat_addon.shading.interface import Interface
from tests.support import devices_suite as suite

SOLID = Interface("solid", fragment=suite.path("solid.frag"), block=suite.SOLID, outputs=(("vec4", "color"),))


@pytest.fixture(scope="module")
def device():
    start_gpu()
    device = BlenderDevice()
    yield device
    device.release()


@pytest.fixture(scope="module")
def opengl():
    """The other device, on a thread of its own as in a render; yields a function that calls with it there."""
    with ThreadPoolExecutor(1) as thread:
        other = thread.submit(OpenGLDevice).result()
        yield lambda function, *arguments: thread.submit(function, other, *arguments).result()
        thread.submit(other.release).result()


@pytest.mark.parametrize("case", suite.CASES, ids=lambda case: case.__name__)
def test_both_devices_draw_the_same_pixels(device, opengl, case):
    here = suite.run(device, case)
    there = opengl(suite.run, case)
    suite.compare(case.__name__, here, there)


def test_another_thread_has_no_context(device):
    answers = []
    thread = threading.Thread(target=lambda: answers.append(blender_gpu.available()))
    thread.start()
    thread.join()
    ok, reason = answers[0]
    assert not ok
    assert "context" in reason
    assert blender_gpu.available() == (True, "")
    with ThreadPoolExecutor(1) as pool, pytest.raises(DeviceError, match="context"):
        pool.submit(BlenderDevice).result()


def test_drawing_leaves_blenders_state_as_it_was(device):
    """Blender draws its window with the same state."""
    state = gpu.state

    def read_all():
        return (
            state.blend_get(),
            state.depth_test_get(),
            state.depth_mask_get(),
            state.line_width_get(),
            state.viewport_get(),
        )

    own = gpu.types.GPUFrameBuffer(color_slots=(gpu.types.GPUTexture((40, 30), format="RGBA16F"),))
    image = device.texture((8, 8), "RGBA32F")
    target = device.target([image], depth=True)
    with own.bind():
        state.blend_set("ALPHA_PREMULT")
        state.depth_test_set("GREATER_EQUAL")
        state.depth_mask_set(False)
        state.viewport_set(3, 4, 20, 10)
        before = read_all()
        device.clear(target)
        for primitive in ("TRIANGLES", "LINES"):
            options = {"blend": True, "depth_test": True, "cull": True, "primitive": primitive}
            device.draw(SOLID, target, uniforms=suite.SOLID.record(color=(1, 1, 1, 1)), vertices=6, **options)
        assert own.is_bound
        assert read_all() == before
        state.blend_set("NONE")
        state.depth_test_set("NONE")
    assert device.read(image).max() == 1.0


def test_without_a_target_it_draws_into_what_blender_has_bound(device):
    """As in the viewport: within the viewport that is set, and nowhere else."""
    texture = gpu.types.GPUTexture((8, 4), format="RGBA32F")
    framebuffer = gpu.types.GPUFrameBuffer(color_slots=(texture,))
    with framebuffer.bind():
        framebuffer.clear(color=(0.0, 0.0, 0.0, 0.0))
        gpu.state.viewport_set(2, 1, 3, 2)
        device.draw(SOLID, None, uniforms=suite.SOLID.record(color=(0.18, 1, 1, 1)))
    pixels = texture.read()
    pixels.dimensions = 8 * 4 * 4
    seen = np.asarray(pixels).reshape(4, 8, 4)
    expected = np.zeros((4, 8), np.float32)
    expected[1:3, 2:5] = 0.18
    np.testing.assert_array_equal(seen[..., 0], expected)


def test_a_shader_error_names_what_is_wrong_and_where(device, tmp_path):
    (tmp_path / "part.glsl").write_text("\nfloat ps_one() { return wrong; }\n")
    (tmp_path / "broken.frag").write_text(
        f'#include "{tmp_path / "part.glsl"}"\nvoid main() {{\n  color = vec4(ps_one());\n}}\n'
    )
    sources.load.cache_clear()
    interface = Interface("broken", fragment=str(tmp_path / "broken.frag"), outputs=(("vec4", "color"),))
    # Blender 4.5's log has no line that can be relied on.
    match = r"part\.glsl:2\b.*wrong" if bpy.app.version >= (5,) else r"broken\.frag:.*\s.*wrong"
    with pytest.raises(sources.ShaderError, match=f"(?s){match}"):
        device.draw(interface, device.target([device.texture((1, 1), "RGBA32F")]))


def test_a_broken_vertex_or_compute_shader_is_an_error_too(device, tmp_path):
    (tmp_path / "broken.vert").write_text("void main() {\n  gl_Position = nowhere;\n}\n")
    (tmp_path / "broken.comp").write_text("void main() {\n\n  lost();\n}\n")
    outputs = (("vec4", "color"),)
    vertex = Interface("v", vertex=str(tmp_path / "broken.vert"), fragment="device/probe_blend.frag", outputs=outputs)
    with pytest.raises(sources.ShaderError, match=r"(?s)broken\.vert.*nowhere"):
        device.draw(vertex, device.target([device.texture((1, 1), "RGBA32F")]))
    with pytest.raises(sources.ShaderError, match=r"(?s)broken\.comp.*lost"):
        device.dispatch(Interface("c", compute=str(tmp_path / "broken.comp")), 1)
