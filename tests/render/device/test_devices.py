"""The devices without Blender: moderngl draws every case of the suite; the null device records."""

import ctypes
import os
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from pointsplat_addon.devices.null import NullDevice
from pointsplat_addon.devices.opengl import SPARE_QUERIES, OpenGLDevice
from pointsplat_addon.render.device.protocol import DRAW_NOTHING, LET_GO, DeviceError, Limits, layout_groups, let_go
from pointsplat_addon.shading import sources
from pointsplat_addon.shading.interface import Block, Interface
from pointsplat_addon.shading.sources import ShaderError
from tests.support import devices_suite as suite
from tests.support.soak import resident

ROOT = Path(__file__).resolve().parents[3]
SOLID = Interface("solid", fragment=suite.path("solid.frag"), block=suite.SOLID, outputs=(("vec4", "color"),))


@pytest.fixture(scope="module")
def device():
    device = OpenGLDevice()
    yield device
    device.release()


@pytest.mark.parametrize("case", suite.CASES, ids=lambda case: case.__name__)
def test_opengl(device, case):
    suite.run(device, case)


def test_opengl_41_prints_shaders_without_compute():
    """macOS has no newer OpenGL than 4.1: no compute shaders, hence no image atomics; all else works."""
    script = """
        from pointsplat_addon.devices.opengl import SPARE_QUERIES, OpenGLDevice
        from pointsplat_addon.render.device.protocol import DeviceError
        from tests.support import devices_suite as suite
        device = OpenGLDevice()
        assert (device.context.version_code, device.version) == (410, 410), device.context.version_code
        assert not device.limits.image_atomics
        assert device.limits.float_blend
        for case in suite.CASES:
            suite.run(device, case)
        try:
            device.dispatch(suite.Interface("none", compute="device/probe_atomics.comp"), 1)
        except DeviceError as error:
            assert "compute" in str(error)
        else:
            raise AssertionError("compute shaders in OpenGL 4.1")
    """
    environment = os.environ | {"MESA_GL_VERSION_OVERRIDE": "4.1", "MESA_GLSL_VERSION_OVERRIDE": "410"}
    command = [sys.executable, "-c", textwrap.dedent(script)]
    result = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    if "(4" in result.stderr and "AssertionError: 4" in result.stderr:
        pytest.skip("this driver is not Mesa, whose version can be set")
    assert result.returncode == 0, result.stderr


def test_devices_on_two_threads_draw_at_once():
    """Each has a context of its own: neither sees the other's state."""
    failures = []

    def work(seed: int) -> None:
        device = OpenGLDevice()
        try:
            image = device.texture((64, 64), "RGBA32F")
            target = device.target([image])
            for number in range(50):
                device.draw(SOLID, target, uniforms=suite.SOLID.record(color=(seed, number, 0, 1)))
                if not (device.read(image) == (seed, number, 0, 1)).all():
                    failures.append((seed, number))
        finally:
            device.release()

    threads = [threading.Thread(target=work, args=(seed,)) for seed in (1, 2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failures


def test_no_timer_tells_more_than_has_passed(device, monkeypatch):
    def since_the_start_of_the_machine(query, name, address):
        ctypes.c_uint64.from_address(address).value = 1 << 60

    before = time.perf_counter()
    timer = device.start_timer()
    device.stop_timer(timer)
    monkeypatch.setattr(device, "query_result", since_the_start_of_the_machine)
    assert timer.milliseconds() <= 1e3 * (time.perf_counter() - before)


def test_queries_rest_before_they_begin_anew():
    """So that the driver frees nothing of one that its threads have hardly left, and few serve all timers."""
    device, began = OpenGLDevice(), []
    begin = device.begin_query
    device.begin_query = lambda target, query: (began.append(query), begin(target, query))[1]
    for _ in range(40):
        timer = device.start_timer()
        device.stop_timer(timer)
        timer.milliseconds()
    device.release()
    assert all(len(set(began[i : i + SPARE_QUERIES])) == SPARE_QUERIES for i in range(40 - SPARE_QUERIES))
    assert len(set(began)) == SPARE_QUERIES


def test_release_gives_memory_back_and_may_be_called_twice():
    def resident_pages() -> int:
        return int(Path("/proc/self/statm").read_text().split()[1])

    if not Path("/proc/self/statm").exists():
        pytest.skip("this system has no /proc to ask for the memory in use")

    def use() -> None:
        device = OpenGLDevice()
        image = device.texture((1024, 1024), "RGBA32F", np.ones(2**22, np.float32))
        device.clear(device.target([image], depth=True))
        device.read(image)
        device.release()
        device.release()

    use()
    before = resident_pages()
    for _ in range(10):
        use()
    # Ten devices that left their textures behind would hold 200 MiB more.
    grown = (resident_pages() - before) * os.sysconf("SC_PAGE_SIZE")
    assert grown < 40 * 2**20  # measured 3 MiB


def test_what_was_released_is_let_go_by_the_driver():
    """Of 64 MiB that the last dispatch has read, and of as many that the last draw has read, nothing is left."""
    device = OpenGLDevice()
    if "llvmpipe" not in device.limits.renderer or not Path("/proc/self/statm").exists():
        pytest.skip("its textures are not in this process's memory")

    def read(interface: Interface, **more) -> None:
        image = device.texture((4096, 1024), "RGBA32F", np.ones(2**24, np.float32))
        if interface.compute:
            device.dispatch(interface, 1, textures={"ps_texel": image}, **more)
        else:
            device.draw(interface, more["target"], textures={"ps_texel": image})
        image.release()

    let_go(device)  # compiled
    cell, pixel = device.texture((1, 1), "R32UI"), device.texture((1, 1), "R32F")
    target = device.target([pixel])
    before = resident()
    read(LET_GO, images={"cell": cell})
    read(DRAW_NOTHING, target=target)
    device.finish()
    alive = device.bytes_allocated()
    let_go(device)
    assert device.bytes_allocated() == alive
    assert resident() - before < 16 * 2**20  # measured 0.1 MiB; without it 128
    device.release()


def broken(tmp_path: Path, fragment: str, **names: str) -> Interface:
    for name, text in names.items():
        (tmp_path / f"{name}.glsl").write_text(text)
    (tmp_path / "broken.frag").write_text(fragment)
    return Interface("broken", fragment=str(tmp_path / "broken.frag"), outputs=(("vec4", "color"),))


def test_an_error_of_the_declarations_is_not_taken_for_the_file(device, tmp_path):
    interface = broken(tmp_path, "void main() { color = vec4(1.0); }\n")
    wrong = Interface("wrong", fragment=interface.fragment, outputs=(("no_type", "color"),))
    with pytest.raises(ShaderError, match=r"declarations:2\b.*"):
        draw_once(device, wrong)


def draw_once(device, interface: Interface) -> None:
    device.draw(interface, device.target([device.texture((1, 1), "RGBA32F")]))


def test_a_shader_error_names_the_file_and_its_line(device, tmp_path):
    interface = broken(tmp_path, "\n\nvoid main() {\n  color = nonsense;\n}\n")
    with pytest.raises(ShaderError, match=r"broken\.frag:4.*nonsense"):
        draw_once(device, interface)


def test_an_error_before_within_and_after_an_include_is_placed(device, tmp_path):
    include = f'#include "{tmp_path / "part.glsl"}"\n'
    good, bad = "float ps_one() { return 1.0; }\n", "\n\nfloat ps_one() { return wrong; }\n"
    body = "void main() { color = vec4(ps_one()); }\n"
    for part, text, place in (
        (good, "int x = first;\n" + include + body, r"broken\.frag:1\b.*first"),
        (bad, "\n" + include + body, r"part\.glsl:3\b.*wrong"),
        (good, "\n" + include + "\n" + "int y = last;\n" + body, r"broken\.frag:4\b.*last"),
    ):
        interface = broken(tmp_path, text, part=part)
        sources.load.cache_clear()
        with pytest.raises(ShaderError, match=place):
            draw_once(device, interface)


def test_an_error_in_a_vertex_shader_and_in_a_compute_shader_is_placed(device, tmp_path):
    (tmp_path / "broken.vert").write_text("void main() {\n  gl_Position = nowhere;\n}\n")
    (tmp_path / "broken.comp").write_text("void main() {\n\n  lost();\n}\n")
    vertex = Interface(
        "v", vertex=str(tmp_path / "broken.vert"), fragment="device/probe_blend.frag", outputs=(("vec4", "color"),)
    )
    with pytest.raises(ShaderError, match=r"broken\.vert:2\b.*nowhere"):
        draw_once(device, vertex)
    if device.limits.image_atomics:
        with pytest.raises(ShaderError, match=r"broken\.comp:3\b.*lost"):
            device.dispatch(Interface("c", compute=str(tmp_path / "broken.comp")), 1)


@pytest.mark.parametrize("make", [OpenGLDevice, NullDevice])
def test_wrong_calls_are_refused_with_a_reason(make):
    device = make()
    image, ids = device.texture((4, 4), "RGBA32F"), device.texture((4, 4), "R32UI")
    target, integers = device.target([image]), device.target([ids])
    record = suite.SOLID.record(color=(1, 1, 1, 1))
    copy = Interface(
        "copy",
        fragment=suite.path("copy.frag"),
        samplers=(("FLOAT_2D", "source"),),
        outputs=(("vec4", "color"),),
    )
    for call, reason in (
        (lambda: device.texture((0, 4), "RGBA32F"), "0 x 4"),
        (lambda: device.texture((device.limits.texture_size + 1, 1), "R32F"), "outside"),
        (lambda: device.texture((4, 4), "RGB8"), "no texture format"),
        (lambda: device.texture((4, 4), "RGBA32F", np.zeros(63, np.float32)), "63 numbers"),
        (lambda: device.texture((4, 4), "R32UI", np.zeros(16, np.float32)), "no data"),
        (lambda: device.target([]), "0 textures"),
        (lambda: device.target([image, device.texture((4, 5), "R32F")]), "different sizes"),
        (lambda: device.draw(SOLID, target), "uniforms"),
        (lambda: device.draw(SOLID, target, uniforms=np.zeros(4)), "uniforms"),
        (lambda: device.draw(SOLID, device.target([image, ids]), uniforms=record), "1 outputs into 2"),
        (lambda: device.draw(SOLID, integers, uniforms=record, blend=True), "blended"),
        (lambda: device.draw(copy, target), "no texture for source"),
        (lambda: device.draw(copy, target, textures={"source": ids}), "source is FLOAT_2D"),
        (lambda: device.draw(copy, target, textures={"source": image}), "both read and drawn"),
    ):
        with pytest.raises(DeviceError, match=reason):
            call()
    device.release()


def test_the_null_device_records_what_a_scene_needs():
    device = NullDevice(Limits("none", texture_size=64, image_atomics=False, float_blend=True))
    image = device.texture((8, 4), "RGBA16F", np.zeros(128, np.float32))
    target = device.target([image], depth=True)
    record = suite.SOLID.record(color=(1, 2, 3, 4))
    device.draw(SOLID, target, uniforms=record, vertices=3, blend=True)
    record["color"] = 0  # recorded as it was at the call
    device.draw(SOLID, target, uniforms=record, vertices=9, primitive="POINTS", depth_test=True)
    assert device.names == ["solid", "solid"]
    assert [call.count for call in device.calls] == [3, 9]
    assert [call.flags for call in device.calls] == [{"blend"}, {"depth_test"}]
    recorded = device.calls[0].uniforms
    assert recorded is not None
    assert recorded["color"].tolist() == [[1.0, 2.0, 3.0, 4.0]]
    assert device.interfaces == [SOLID]
    assert device.uploaded_bytes == 8 * 4 * 8
    assert device.bytes_allocated() == device.peak_bytes == 8 * 4 * (8 + 4)
    assert device.read(image).shape == (4, 8, 4)
    with pytest.raises(DeviceError, match="no compute"):
        device.dispatch(Interface("c", compute="device/probe_atomics.comp"), 1)
    with pytest.raises(ShaderError, match=r"missing\.frag"):
        device.draw(Interface("m", fragment="missing.frag", outputs=(("vec4", "color"),)), target)
    target.release()
    image.release()
    assert device.bytes_allocated() == 0


def test_rows_of_work_groups_waste_less_than_one_row():
    for groups in (1, 65_535, 65_536, 70_001, 131_071, 10_000_000):
        columns, rows = layout_groups(groups)
        assert max(columns, rows) <= 65_535
        assert 0 <= columns * rows - groups < rows


def test_a_block_with_another_layout_is_not_taken_for_ours():
    other = Block("Solid", "u", (("vec2", "color"),))
    device = NullDevice()
    with pytest.raises(DeviceError, match="uniforms"):
        device.draw(SOLID, device.target([device.texture((1, 1), "RGBA32F")]), uniforms=other.record(color=(1, 1)))
