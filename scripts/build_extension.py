"""Build the Blender extension: dist/pointsplat-<version>.zip, checked by Blender's own validator.

    python scripts/build_extension.py [--output-dir dist]

Downloads the wheels that blender_manifest.toml names into wheels/ (hashes: requirements/wheels.txt). Building is done
by the extension tool in the bpy package, or by a desktop Blender on PATH (or in POINTSPLAT_BLENDER).
Exit codes: 0 built, 1 failed, 2 wheels or Blender are not to be had.
"""

import argparse
import hashlib
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
WHEELS = ROOT / "wheels"
PINS = ROOT / "requirements" / "wheels.txt"
PYTHONS = ("311", "313", "314")  # Blender 4.5 LTS, 5.2 LTS, and as distributions build it
PLATFORMS = (("manylinux_2_28_x86_64", "manylinux2014_x86_64"), ("win_amd64",), ("macosx_11_0_arm64",))


class UnavailableError(Exception):
    """Something that has to come from outside is not to be had."""


def manifest() -> dict:
    return tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))


def pinned(wheel: Path) -> bool:
    hashes = set(re.findall(r"sha256:([0-9a-f]{64})", PINS.read_text(encoding="utf-8")))
    return wheel.is_file() and hashlib.sha256(wheel.read_bytes()).hexdigest() in hashes


def download_wheels(names: set[str]) -> None:
    """Bring the named wheels into wheels/, and nothing else."""
    if all(pinned(WHEELS / name) for name in names):
        return
    WHEELS.mkdir(exist_ok=True)
    for python in PYTHONS:
        for platforms in PLATFORMS:
            command = [sys.executable, "-m", "pip", "download", "-q", "--disable-pip-version-check", "--no-deps"]
            command += ["--only-binary=:all:", "--require-hashes", "-r", str(PINS), "-d", str(WHEELS)]
            command += ["--implementation", "cp", "--python-version", python]
            command += [word for platform in platforms for word in ("--platform", platform)]
            result = subprocess.run(command, capture_output=True, text=True, check=False)
            if result.returncode != 0:
                raise UnavailableError(f"pip could not download the wheels for {platforms[0]}:\n{result.stderr}")
    missing = sorted(name for name in names if not pinned(WHEELS / name))
    if missing:
        raise UnavailableError(f"blender_manifest.toml names wheels that pip did not bring: {', '.join(missing)}")


def extension_tool() -> list[str]:
    """The command that answers to `validate` and `build`: bpy's own script, or a desktop Blender."""
    spec = importlib.util.find_spec("bpy")
    for folder in (spec and spec.submodule_search_locations) or ():
        for script in Path(folder).glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"):
            return [sys.executable, str(script)]
    blender = os.environ.get("POINTSPLAT_BLENDER") or shutil.which("blender")
    if blender:
        return [blender, "--factory-startup", "--command", "extension"]
    raise UnavailableError("neither the bpy package nor a blender on PATH is here to build the extension")


def build(output_dir: Path) -> Path:
    """Build and validate; the path of the zip."""
    facts = manifest()
    download_wheels({Path(wheel).name for wheel in facts["wheels"]})
    tool = extension_tool()
    output_dir.mkdir(parents=True, exist_ok=True)
    target = output_dir / f"{facts['id']}-{facts['version']}.zip"
    subprocess.run([*tool, "validate", str(ROOT)], check=True)
    subprocess.run([*tool, "build", "--source-dir", str(ROOT), "--output-filepath", str(target)], check=True)
    subprocess.run([*tool, "validate", str(target)], check=True)
    return target


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output-dir", type=Path, default=ROOT / "dist")
    args = parser.parse_args()
    try:
        target = build(args.output_dir)
    except UnavailableError as error:
        print(f"build_extension: {error}", file=sys.stderr)
        return 2
    except subprocess.CalledProcessError as error:
        print(f"build_extension: Blender's tool refused: {' '.join(error.cmd)}", file=sys.stderr)
        return 1
    print(f"build_extension: {target} ({target.stat().st_size / 1e6:.1f} MB)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
