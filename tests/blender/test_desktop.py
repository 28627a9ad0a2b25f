"""The add-on in a desktop Blender with a window (tests/desktop/run.py), where there is one."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def desktop_command() -> list[str]:
    """Blender, on this screen or on a virtual one; skips where either is missing."""
    blender = os.environ.get("POINTSPLAT_BLENDER") or shutil.which("blender")
    if not blender:
        pytest.skip("no desktop Blender: none on PATH and POINTSPLAT_BLENDER is not set")
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        return [blender]
    screen = shutil.which("xvfb-run")
    if not screen:
        pytest.skip("no screen for the desktop Blender: neither DISPLAY nor WAYLAND_DISPLAY nor xvfb-run")
    return [screen, "-a", "-s", "-screen 0 1280x800x24", blender]


def run(tmp_path: Path, *arguments: str, timeout: int = 630) -> str:
    """What the script says that drives Blender; all facts hold."""
    script = str(ROOT / "tests" / "desktop" / "run.py")
    command = [*desktop_command(), "--factory-startup", "--python", script, "--", *arguments]
    environment = {**os.environ, "BLENDER_USER_RESOURCES": str(tmp_path)}
    process = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=timeout, check=False
    )
    output = process.stdout + process.stderr
    assert process.returncode == 0, output
    assert "desktop: all is well" in output
    return output


def test_a_desktop_blender_draws_orbits_renders_cancels_reloads_and_quits(tmp_path: Path) -> None:
    assert "Not freed memory blocks" not in run(tmp_path)


def test_a_desktop_blender_imports_files_of_every_format(tmp_path: Path) -> None:
    data = os.environ.get("POINTSPLAT_DATA")
    if not data:
        pytest.skip(
            "no scans and captures: POINTSPLAT_DATA names no folder of them (tests/desktop/files.py lists them)"
        )
    archives = sorted((ROOT / "dist").glob("pointsplat-*.zip"))  # the libraries that read LAZ come with the extension
    if not archives:
        pytest.skip("no extension in dist/: python3 scripts/dev.py build makes it")
    archive = str(archives[-1])
    run(tmp_path, "--zip", archive, "--data", data, "--output", str(tmp_path), "--limit", "1200", timeout=1230)
