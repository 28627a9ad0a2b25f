"""Pictures of scripts/benchmarks/beside_cycles: reading them, and showing them beside the truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from scripts.common.images import displayed

GAIN = 8.0  # of the differences


def read(path: Path) -> np.ndarray:
    """(H, W, 4) float32 of an EXR file, premultiplied and scene-linear, bottom row first."""
    import bpy

    image = bpy.data.images.load(str(path))
    width, height = image.size
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(height, width, 4)


def beside(picture: np.ndarray, truth: np.ndarray, path: Path) -> None:
    """A PNG of a picture, the truth and GAIN times their difference about grey: colours above, alphas below."""
    rows = []
    for shown, true in ((displayed(picture), displayed(truth)), (grey(picture), grey(truth))):
        rows.append(np.concatenate([shown, true, np.clip(0.5 + GAIN * (shown - true), 0, 1)], axis=1)[::-1])
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray((255 * np.concatenate(rows) + 0.5).astype(np.uint8)).save(path)


def grey(picture: np.ndarray) -> np.ndarray:
    """(H, W, 3) of the alphas."""
    return np.repeat(np.clip(picture[..., 3:], 0, 1), 3, axis=2)
