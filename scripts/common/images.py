"""How two pictures of one view differ, in silhouette and in shading: numpy only.

Pictures are (H, W, 4) premultiplied and scene-linear.
  holes       pixels of the second silhouette, eroded by one pixel, that the first picture does not cover fully
  IoU         of the silhouettes: alpha >= 0.5; soft: sum of the lesser alphas over sum of the greater
  thickening  sum of the first alpha over sum of the second
  PSNR        in decibels, of sRGB values in 0..1 over black, over the union of the two silhouettes
  interior    the same over the eroded silhouette only: without what the edges contribute
"""

import math

import numpy as np

COVERED = 1.0 - 1e-4  # alpha of a pixel that all samples hit, but for rounding of the mean


def eroded(mask: np.ndarray) -> np.ndarray:
    """The pixels of a mask (H, W) bool whose eight neighbours belong to it as well."""
    padded = np.pad(mask, 1)
    height, width = mask.shape
    shifts = [(y, x) for y in range(3) for x in range(3)]
    return np.logical_and.reduce([padded[y : y + height, x : x + width] for y, x in shifts])


def displayed(pixels: np.ndarray) -> np.ndarray:
    """(H, W, 3) sRGB in 0..1 of premultiplied scene-linear RGBA over black."""
    linear = np.clip(pixels[..., :3], 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def psnr(a: np.ndarray, b: np.ndarray, where: np.ndarray) -> float:
    """Of displayed values in decibels over the pixels `where`; infinite where nothing differs."""
    squared = (displayed(a) - displayed(b))[where] ** 2
    error = float(squared.mean()) if squared.size else 0.0
    return -10 * math.log10(error) if error > 0 else math.inf


def iou(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Intersection over union of two alphas (H, W): thresholded at one half, and soft."""
    hard = np.count_nonzero((a >= 0.5) & (b >= 0.5)) / max(np.count_nonzero((a >= 0.5) | (b >= 0.5)), 1)
    soft = float(np.minimum(a, b).sum() / max(np.maximum(a, b).sum(), 1e-30))
    return hard, soft


def compare(picture: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """The figures of `picture` against `truth`."""
    a, b = picture[..., 3], truth[..., 3]
    inside = eroded(b >= COVERED)
    hard, soft = iou(a, b)
    return {
        "holes": int(np.count_nonzero(inside & (a < COVERED))),
        "inside": int(np.count_nonzero(inside)),
        "iou": hard,
        "soft_iou": soft,
        "thickening": float(a.sum() / b.sum()),
        "psnr": psnr(picture, truth, (a > 0) | (b > 0)),
        "interior_psnr": psnr(picture, truth, inside),
    }


def directions(count: int) -> np.ndarray:
    """(count, 3) unit vectors spread over the sphere by a Fibonacci lattice."""
    i = np.arange(count) + 0.5
    z = 1 - 2 * i / count
    turn = math.pi * (1 + math.sqrt(5)) * i
    across = np.sqrt(1 - z * z)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)
