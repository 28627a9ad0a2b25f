"""What pictures depend on beside the scene: PointSplat's own code, and the machine that computes."""

from __future__ import annotations

import hashlib
import platform
import sys
from functools import cache
from pathlib import Path

FOLDERS = "pointsplat_addon", "shaders"


def code_digest(root: Path, size: int) -> str:
    """A hexadecimal digest (blake2b of `size` bytes) of all code and shaders of the checkout, or of the installed
    extension, in a folder."""
    digest = hashlib.blake2b(digest_size=size)
    files = [file for folder in FOLDERS for file in (root / folder).rglob("*") if file.is_file()]
    for name, file in sorted((file.relative_to(root).as_posix(), file) for file in files):
        if "__pycache__" not in name and not file.name.startswith("."):
            digest.update(name.encode() + b"\0" + hashlib.blake2b(file.read_bytes()).digest())
    return digest.hexdigest()


@cache
def arithmetic() -> str:
    """What the last bits of results depend on that this process computes: its code, Python and NumPy, and which
    instructions of the processor these use."""
    import numpy as np  # not before scripts have said how many threads it may use

    core = np._core if hasattr(np, "_core") else np.core  # pyright: ignore[reportAttributeAccessIssue]
    features = core._multiarray_umath.__cpu_features__
    found = sorted(name for name, there in features.items() if there)
    versions = platform.system(), platform.machine(), sys.version, np.__version__
    return " ".join([code_digest(Path(__file__).resolve().parents[2], 16), *versions, *found])
