"""Which PointSplat this is: what machines that draw one film have to agree in."""

import hashlib
import tomllib
from pathlib import Path

FOLDERS = "pointsplat_addon", "shaders"


def version_of(root: Path) -> str:
    """The version of the checkout, or of the installed extension, in a folder, such as "0.1.0+1f2e3d4c": that of the
    manifest and a digest (blake2b) of all code and shaders."""
    manifest = tomllib.loads((root / "blender_manifest.toml").read_text(encoding="utf-8"))
    digest = hashlib.blake2b(digest_size=4)
    files = [file for folder in FOLDERS for file in (root / folder).rglob("*") if file.is_file()]
    for name, file in sorted((file.relative_to(root).as_posix(), file) for file in files):
        if "__pycache__" not in name and not file.name.startswith("."):
            digest.update(name.encode() + b"\0" + hashlib.blake2b(file.read_bytes()).digest())
    return f"{manifest['version']}+{digest.hexdigest()}"
