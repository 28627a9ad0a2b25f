"""The built extension in an empty Blender: it enables, draws, disables, enables again and lets Blender quit.

Blender's own installer runs in a fresh process with an empty user folder. That process ends by itself, because
"Blender quits while the extension is enabled" is one of the facts.
"""

import json
import os
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
MANIFEST = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
TOP_LEVEL = {
    "blender_manifest.toml",
    "__init__.py",
    "LICENSE",
    "README.md",
    "CHANGELOG.md",
    "pointsplat_addon",
    "shaders",
    "wheels",
}

SCRIPT = """
import json, sys
import bpy
import addon_utils  # bpy puts it on the path
archive, report = sys.argv[1:]
module = "bl_ext.user_default.pointsplat"
facts = {}

def engine():
    return next((c for c in bpy.types.RenderEngine.__subclasses__()
                 if getattr(c, "bl_idname", "") == "POINTSPLAT" and c.is_registered), None)

def state():
    return [module in bpy.context.preferences.addons, engine() is not None, hasattr(bpy.types.Scene, "pointsplat")]

def centre():
    scene = bpy.context.scene
    scene.render.engine = "POINTSPLAT"
    scene.render.resolution_x = scene.render.resolution_y = 32
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode = "RGBA"
    scene.render.film_transparent = True
    scene.render.filepath = report + ".png"
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(report + ".png")
    pixels = list(image.pixels)
    bpy.data.images.remove(image)
    return [pixels[(16 * 32 + 16) * 4 + 3], pixels[3]]

facts["before"] = state()
bpy.ops.extensions.package_install_files(repo="user_default", filepath=archive, enable_on_install=True)
facts["installed"] = state()
facts["defined_in"] = engine().__module__
facts["alpha"] = centre()
addon_utils.disable(module, default_set=True)
facts["disabled"] = state()
addon_utils.enable(module, default_set=True)
facts["enabled_again"] = state()
facts["alpha_again"] = centre()
with open(report, "w") as file:
    json.dump(facts, file)
"""


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, str(ROOT / "scripts" / "build_extension.py"), "--output-dir", str(folder)]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode == 2:
        pytest.skip(f"the extension's wheels cannot be had: {result.stderr.strip()}")
    assert result.returncode == 0, result.stdout + result.stderr
    return folder / f"pointsplat-{MANIFEST['version']}.zip"


@pytest.fixture(scope="module")
def facts(archive: Path, tmp_path_factory: pytest.TempPathFactory) -> dict:
    folder = tmp_path_factory.mktemp("blender")
    report = folder / "report.json"
    environment = {**os.environ, "BLENDER_USER_RESOURCES": str(folder / "user")}
    process = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(archive), str(report)],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,  # a hang at exit is what this limit is for
        check=False,
    )
    assert process.returncode == 0, process.stdout + process.stderr
    assert "Traceback" not in process.stderr + process.stdout, process.stdout + process.stderr
    return json.loads(report.read_text())


def test_the_archive_holds_the_package_the_shaders_and_nothing_of_the_workshop(archive: Path) -> None:
    with zipfile.ZipFile(archive) as file:
        names = [name for name in file.namelist() if not name.endswith("/")]
    assert {name.split("/")[0] for name in names} <= TOP_LEVEL
    for folder in ("pointsplat_addon", "shaders"):
        here = {p.relative_to(ROOT).as_posix() for p in (ROOT / folder).rglob("*") if p.is_file()}
        here = {name for name in here if "__pycache__" not in name and not Path(name).name.startswith(".")}
        assert {name for name in names if name.startswith(folder + "/")} == here


def test_each_supported_python_and_system_has_its_wheels() -> None:
    """Blender 4.5 has Python 3.11, 5.2 has 3.13, distributions build with 3.14; Intel Macs have no moderngl."""
    systems = {"manylinux": "linux", "win": "windows", "macosx": "macos"}
    found = set()
    pure = [wheel for wheel in MANIFEST["wheels"] if wheel.endswith("-py3-none-any.whl")]
    assert [Path(wheel).name.split("-")[0] for wheel in pure] == ["laspy"]
    for wheel in set(MANIFEST["wheels"]) - set(pure):
        match = re.match(r"\./wheels/(\w+)-[\d.]+-(cp\d+)-cp\d+-([a-z]+)", wheel)
        assert match, wheel
        found.add((match[1], match[2], systems[match[3]]))
    assert found == {
        (name, python, system)
        for name in ("moderngl", "glcontext", "lazrs", "python_neo_lzf")
        for python in ("cp311", "cp313", "cp314")
        for system in ("linux", "windows", "macos")
    }


def test_the_manifest_and_the_project_file_name_one_version() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert MANIFEST["version"] == project["version"]
    assert MANIFEST["license"] == [f"SPDX:{project['license']}"]


def test_installing_enables_and_registers_the_engine(facts: dict) -> None:
    assert facts["before"] == [False, False, False]
    assert facts["installed"] == [True, True, True]
    assert facts["defined_in"].startswith("bl_ext.user_default.pointsplat.")


def test_the_installed_extension_draws_the_default_cube(facts: dict) -> None:
    """The cube of Blender's start-up file covers the middle of the picture and not its corner."""
    assert facts["alpha"] == [1.0, 0.0]


def test_disabling_takes_everything_back_and_enabling_brings_it_again(facts: dict) -> None:
    assert facts["disabled"] == [False, False, False]
    assert facts["enabled_again"] == [True, True, True]
    assert facts["alpha_again"] == [1.0, 0.0]
