"""`blender -b FILE -f N`: a frame that raises ends the process, so that farms see it; scripts go on."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

# As the program, which the package bpy is not.
FAILS = """
import os, sys
from types import SimpleNamespace
from pointsplat_addon.host import command_line
scene = SimpleNamespace(frame_current=7)
app = SimpleNamespace(module=False, background=True)
command_line.bpy = SimpleNamespace(app=app, context=SimpleNamespace(scene=scene))
command_line.fail("Cow: ValueError: broken")
print("went on", flush=True)
os._exit(0)
"""


def run(*words: str) -> tuple[int, str]:
    command = [sys.executable, "-c", FAILS, *words]
    found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
    return found.returncode, found.stdout


@pytest.mark.parametrize("option", ["-f", "-a", "--render-frame", "--render-anim"])
def test_a_frame_of_the_command_line_that_raises_ends_blender(option: str) -> None:
    code, said = run("-b", "a.blend", option, "7")
    assert code == 1
    assert "Error: frame 7: Cow: ValueError: broken" in said
    assert "went on" not in said


def test_a_script_s_render_that_raises_ends_nothing() -> None:
    code, said = run("-b", "a.blend", "-P", "script.py", "--", "-f", "7")
    assert (code, said.split()[-2:]) == (0, ["went", "on"])


WRITTEN = """
import os, sys
from types import SimpleNamespace
from pointsplat_addon.host import command_line
path = os.environ["PICTURE"]
scene = SimpleNamespace(frame_current=7, render=SimpleNamespace(engine="POINTSPLAT", frame_path=lambda frame: path))
app = SimpleNamespace(module=False, background=True)
command_line.bpy = SimpleNamespace(app=app, context=SimpleNamespace(scene=scene), path=SimpleNamespace(abspath=str))
command_line.check_written(scene)
print("went on", flush=True)
os._exit(0)
"""


@pytest.mark.parametrize("ending", ["png", "exr"])
@pytest.mark.parametrize("cut", [0, 1, 700])
def test_a_file_that_was_cut_off_is_not_left_behind(tmp_path: Path, ending: str, cut: int) -> None:
    import bpy

    path, image = tmp_path / f"a b.{ending}", bpy.data.images.new("picture", 64, 64)
    image.generated_type, image.file_format = "COLOR_GRID", {"png": "PNG", "exr": "OPEN_EXR"}[ending]
    image.save(filepath=str(path))
    path.write_bytes(path.read_bytes()[: path.stat().st_size - cut])
    command = [sys.executable, "-c", WRITTEN, "-b", "a.blend", "-f", "7"]
    environment = {**os.environ, "PICTURE": str(path)}
    found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False, env=environment)
    assert found.returncode == (1 if cut else 0), found.stderr
    assert path.exists() == (cut == 0)
    assert ("frame 7: the picture could not be written whole" in found.stdout) == bool(cut)


THREADS = """
import os
from types import SimpleNamespace
from pointsplat_addon.host import command_line
command_line.use_threads(SimpleNamespace(threads_mode="AUTO", threads=8))
before = os.environ.get("LP_NUM_THREADS")
command_line.use_threads(SimpleNamespace(threads_mode="FIXED", threads=3))
print(before, os.environ["LP_NUM_THREADS"], flush=True)
os._exit(0)
"""


def test_mesa_draws_with_as_many_threads_as_blender_was_told_to_take() -> None:
    environment = {name: value for name, value in os.environ.items() if name != "LP_NUM_THREADS"}
    command = [sys.executable, "-c", THREADS]
    found = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=120, check=False)
    assert found.stdout.split()[-2:] == ["None", "3"], found.stdout + found.stderr
