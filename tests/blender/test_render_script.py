"""scripts/render.py as a person calls it: a picture and a report, or words that say what was wrong."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
REPORT_KEYS = {
    "device", "seconds", "passes", "skipped", "points", "samples", "technique", "triangles", "lines", "bytes",
    "warnings", "version",
}  # fmt: skip

MAKE_FILES = """
import os, sys
import bpy
folder = sys.argv[1]
scene = bpy.context.scene
scene.render.resolution_x, scene.render.resolution_y = 48, 32
bpy.ops.wm.save_as_mainfile(filepath=os.path.join(folder, "cube.blend"))
image = bpy.data.images.new("Picture", 4, 4)
image.source, image.filepath, image.use_fake_user = "FILE", "//nowhere.png", True
bpy.ops.wm.save_as_mainfile(filepath=os.path.join(folder, "no_picture.blend"))
bpy.data.images.remove(image)
bpy.data.objects.remove(scene.camera)
bpy.ops.wm.save_as_mainfile(filepath=os.path.join(folder, "no_camera.blend"))
sys.stdout.flush()
os._exit(0)
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with Blender's start-up file, with a camera and without."""
    folder = tmp_path_factory.mktemp("files")
    subprocess.run([sys.executable, "-c", MAKE_FILES, str(folder)], check=True, capture_output=True, timeout=120)
    (folder / "text.blend").write_text("no Blender file")
    return folder


def render(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOT / "scripts" / "render.py"), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


def test_a_file_becomes_a_picture_of_its_size_and_a_report(files: Path, tmp_path: Path) -> None:
    result = render(files / "cube.blend", "--output", tmp_path / "new/a.png", "--report", tmp_path / "new/a.json")
    assert result.returncode == 0, result.stdout + result.stderr
    picture = Image.open(tmp_path / "new/a.png")
    assert picture.size == (48, 32)
    report = json.loads((tmp_path / "new/a.json").read_text())
    assert set(report) == REPORT_KEYS
    assert set(report["points"]) == {"total", "cut", "drawn"}
    assert set(report["bytes"]) == {"cpu", "gpu"}
    assert all(set(p) == {"name", "ms"} for p in report["passes"])


def test_frames_are_numbered_and_each_has_its_report(files: Path, tmp_path: Path) -> None:
    result = render(
        *(files / "cube.blend", "--output", tmp_path / "b.exr", "--frames", "2-3", "--size", "16x24"),
        *("--set", "samples=1", "--report", tmp_path / "b.json"),
    )
    assert result.returncode == 0, result.stdout + result.stderr
    assert sorted(p.name for p in tmp_path.glob("*.exr")) == ["b_0002.exr", "b_0003.exr"]
    assert len(json.loads((tmp_path / "b.json").read_text())) == 2


WRONG = {
    "no file": (("nowhere.blend",), 2, "there is no file"),
    "no Blender file": (("text.blend",), 2, "cannot open"),
    "no camera": (("no_camera.blend",), 2, "has no camera"),
    "unknown camera": (("cube.blend", "--camera", "Kamera"), 2, "there are Camera"),
    "empty size": (("cube.blend", "--size", "0x9"), 2, "is no size"),
    "frames backwards": (("cube.blend", "--frames", "9-1"), 2, "no range"),
    "unknown setting": (("cube.blend", "--set", "smples=3"), 2, "samples"),
    "no number": (("cube.blend", "--set", "samples=many"), 2, "no int"),
    "out of range": (("cube.blend", "--set", "tolerance=0"), 2, "must lie between"),
    "unknown choice": (("cube.blend", "--set", "technique=OILS"), 2, "IMAGE_SPACE"),
}


@pytest.mark.either
@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_said_and_no_picture_is_written(case: str, files: Path, tmp_path: Path) -> None:
    (name, *rest), code, words = WRONG[case]
    result = render(files / name, "--output", tmp_path / "c.png", *rest)
    assert result.returncode == code, result.stdout + result.stderr
    assert words in result.stderr
    assert "Traceback" not in result.stderr
    assert not (tmp_path / "c.png").exists()


RAISES = """
import runpy, sys
sys.argv = sys.argv[1:]
sys.path.insert(0, {root!r})
from pointsplat_addon.host import final

def fail(self, engine, depsgraph):
    raise {error}

final.FinalRender.render = fail
runpy.run_path(sys.argv[0], run_name="__main__")
"""


@pytest.mark.either
@pytest.mark.parametrize("error", ["ValueError('broken')", "final.RenderError('broken')"])
def test_a_render_that_raises_exits_with_an_error_and_leaves_no_file(error: str, files: Path, tmp_path: Path) -> None:
    code = RAISES.format(root=str(ROOT), error=error)
    script = [str(ROOT / "scripts" / "render.py"), str(files / "cube.blend"), "--output", str(tmp_path / "c.png")]
    result = subprocess.run([sys.executable, "-c", code, *script], capture_output=True, text=True, timeout=300)
    assert result.returncode == 1, result.stdout + result.stderr
    assert "broken" in result.stderr
    assert list(tmp_path.iterdir()) == []


RAISES_FOR_AN_OBJECT = """
import runpy, sys
sys.argv = sys.argv[1:]
sys.path.insert(0, {root!r})
from pointsplat_addon.host import geometries

def fail(self, source, rows, table):
    raise ValueError("broken")

geometries.Geometries._convert_surface = fail
runpy.run_path(sys.argv[0], run_name="__main__")
"""


def test_what_raises_is_told_with_its_frame_and_object(files: Path, tmp_path: Path) -> None:
    code = RAISES_FOR_AN_OBJECT.format(root=str(ROOT))
    words = [str(files / "cube.blend"), "--frame", "7", "--output", str(tmp_path / "c.png")]
    command = [sys.executable, "-c", code, str(ROOT / "scripts" / "render.py"), *words]
    result = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert result.returncode == 1, result.stdout + result.stderr
    assert "frame 7: Error: PointSplat: ConversionError: Cube: ValueError: broken" in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_parts_are_joined_to_the_picture_of_one_process(files: Path, tmp_path: Path) -> None:
    words = files / "cube.blend", "--set", "samples=1"
    assert render(*words, "--output", tmp_path / "whole.png").returncode == 0
    for k in (1, 2):
        result = render(*words, "--output", tmp_path / "a.png", "--part", f"{k}/2")
        assert result.returncode == 0, result.stdout + result.stderr
    assert not (tmp_path / "a.png").exists()
    assert render(*words, "--output", tmp_path / "a.png", "--join", "2").returncode == 0
    whole, joined = (np.asarray(Image.open(tmp_path / name)) for name in ("whole.png", "a.png"))
    assert np.array_equal(whole, joined)
    (tmp_path / "a.parts" / "layer0_2_of_2.npz").unlink()
    result = render(*words, "--output", tmp_path / "b.png", "--join", "2", "--parts", tmp_path / "a.parts")
    assert result.returncode == 1
    assert "part 2 of 2 is missing" in result.stderr
    assert not (tmp_path / "b.png").exists()


def test_a_disk_that_is_full_leaves_no_picture(files: Path, tmp_path: Path) -> None:
    """As a limit of a file's size, which a picture of noise exceeds."""
    code = "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (2048, 2048)); "
    code += "import runpy; sys.argv = sys.argv[1:]; runpy.run_path(sys.argv[0], run_name='__main__')"
    words = [str(ROOT / "scripts" / "render.py"), str(files / "cube.blend"), "--size", "400x300"]
    for name in ("c.png", "c.exr"):
        command = [sys.executable, "-c", code, *words, "--output", str(tmp_path / name)]
        result = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
        assert result.returncode == 3, result.stdout + result.stderr
        assert "could not be written whole" in result.stderr
        assert list(tmp_path.iterdir()) == []


def test_a_machine_without_a_driver_says_so(files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("__EGL_VENDOR_LIBRARY_FILENAMES", str(tmp_path / "none"))
    monkeypatch.delenv("DISPLAY", raising=False)
    result = render(files / "cube.blend", "--output", tmp_path / "c.png")
    assert result.returncode == 3, result.stdout + result.stderr
    assert "finds nothing to draw with" in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_machine_of_another_version_says_so(files: Path, tmp_path: Path) -> None:
    result = render(files / "cube.blend", "--output", tmp_path / "c.png", "--require", "0.0.1+12345678")
    assert result.returncode == 3, result.stdout + result.stderr
    assert "and 0.0.1+12345678 is asked for" in result.stderr


def test_a_file_that_is_missing_is_named_where_that_is_asked_for(files: Path, tmp_path: Path) -> None:
    words = files / "no_picture.blend", "--output", tmp_path / "c.png", "--set", "samples=1"
    assert render(*words).returncode == 0
    (tmp_path / "c.png").unlink()
    result = render(*words, "--strict")
    assert result.returncode == 3, result.stdout + result.stderr
    assert "nowhere.png" in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_an_ending_that_is_no_format_is_refused(files: Path, tmp_path: Path) -> None:
    result = render(files / "cube.blend", "--output", tmp_path / "c.jpg")
    assert result.returncode == 2
    assert ".png or .exr" in result.stderr
