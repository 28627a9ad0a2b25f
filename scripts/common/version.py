"""Which PointSplat this is: what machines that draw one film have to agree in."""

import tomllib
from pathlib import Path

from pointsplat_addon.formats.code_version import code_digest


def version_of(root: Path) -> str:
    """The version of the checkout, or of the installed extension, in a folder, such as "0.1.0+1f2e3d4c": that of the
    manifest and a digest (blake2b) of all code and shaders."""
    manifest = tomllib.loads((root / "blender_manifest.toml").read_text(encoding="utf-8"))
    return f"{manifest['version']}+{code_digest(root, 4)}"
