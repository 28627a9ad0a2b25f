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


def test_a_desktop_blender_draws_orbits_renders_cancels_reloads_and_quits(tmp_path: Path) -> None:
    script = str(ROOT / "tests" / "desktop" / "run.py")
    command = [*desktop_command(), "--factory-startup", "--python", script]
    environment = {**os.environ, "BLENDER_USER_RESOURCES": str(tmp_path)}
    process = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=630, check=False
    )
    output = process.stdout + process.stderr
    assert process.returncode == 0, output
    assert "desktop: all is well" in output
    assert "Not freed memory blocks" not in output
