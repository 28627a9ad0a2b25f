"""Writes PLY as the authors of 3D Gaussian splatting do (Kerbl et al. 2023): see ..ply."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from ....core.numeric.vectors import each_block
from ....core.scene.captured import CapturedSplats
from ..reader import BLOCK, CHUNK

OPAQUE = 18.0  # a logit whose sigmoid is 1 in float32; others than finite ones are read by few programs
FAR = 1000.0  # from where on positions are written in double precision
LEAST_SCALE = 1e-30  # of which the logarithm is written for 0


def write_ply(path: Path, splats: CapturedSplats) -> None:
    """Writes splats in the file's axes; positions are relative to no origin. Raises OSError; then there is no file."""
    coefficients = 0 if splats.sh is None else splats.sh.shape[1]
    disks = len(splats) > 0 and not splats.scale[:, 2].any() and bool(splats.scale[:, :2].all())
    far = bool(np.abs(splats.origin).max() > FAR)
    names = [*"xyz", "nx", "ny", "nz", *(f"f_dc_{c}" for c in range(3))]
    names += [f"f_rest_{i}" for i in range(3 * coefficients)]
    names += ["opacity", *(f"scale_{i}" for i in range(2 if disks else 3)), *(f"rot_{i}" for i in range(4))]
    kinds = {name: "double" if far and name in ("x", "y", "z") else "float" for name in names}
    head = ["ply", "format binary_little_endian 1.0"]
    if splats.antialiased:
        head.append("comment SplatRenderMode: mip")
    head += [
        f"element vertex {len(splats)}",
        *(f"property {kind} {name}" for name, kind in kinds.items()),
        "end_header",
    ]
    record = np.dtype([("place", "<f8" if far else "<f4", 3), ("rest", "<f4", len(names) - 3)])
    unfinished = path.with_name(path.name + ".part")
    try:
        with unfinished.open("wb") as file:
            file.write(("\n".join(head) + "\n").encode())
            for first in range(0, len(splats), CHUNK):
                rows = slice(first, min(first + CHUNK, len(splats)))
                records = np.empty(rows.stop - rows.start, record)
                each_block(len(records), lambda block, at=first, out=records: _fill(out, block, splats, at), BLOCK)
                file.write(records.data)
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)


def _fill(records: np.ndarray, block: slice, splats: CapturedSplats, first: int) -> None:
    """Fills a block of records with splats, of which the first record has the one at `first`."""
    rows = slice(first + block.start, first + block.stop)
    part = records[block]
    part["place"] = splats.position[rows] + (splats.origin if splats.origin.any() else 0)
    rest = part["rest"]
    rest[:, :3] = 0  # normals, which there are none of
    rest[:, 3:6] = splats.base[rows]
    at = 6
    if splats.sh is not None:
        count = splats.sh.shape[1]
        for c in range(3):
            rest[:, at : at + count] = splats.sh[rows, :, c]
            at += count
    with np.errstate(divide="ignore"):
        rest[:, at] = np.clip(logit(splats.opacity[rows]), -OPAQUE, OPAQUE)
    at += 1
    scales = rest.shape[1] - 4 - at
    rest[:, at : at + scales] = np.log(np.maximum(splats.scale[rows, :scales], np.float32(LEAST_SCALE)))
    rest[:, at + scales :] = splats.rotation[rows]


def logit(opacity: np.ndarray) -> np.ndarray:
    """Logits (n,) float64 of opacities."""
    wide = opacity.astype(np.float64)
    return np.log(wide) - np.log1p(-wide)
