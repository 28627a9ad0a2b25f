"""Equirectangular pictures of expressions that vary with the direction."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ..light.environment import WIDTHS, bilinear, texel_directions
from ..material.expression import Expression, SampleInputs, evaluate, walk
from ..material.nodes.texture_nodes import ImageTexture

NARROWEST, WIDEST = 64, WIDTHS[-1]  # texels of a picture's width
RELATIVE, OF_MEAN = 0.01, 0.01  # error between texels that is not seen: of the value, and of the picture's mean
QUARTERS = ((-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25))  # texels: where four samples of a texel lie


def inputs_of(direction: np.ndarray) -> SampleInputs:
    """What shaders of a world read for rays along unit vectors (N, 3), as in Cycles: the position is the direction, and
    the normal looks back along the ray."""
    direction = np.ascontiguousarray(direction, np.float32)
    return SampleInputs(position=direction, generated=direction, normal=-direction)


def radiance_at(output: Expression, direction: np.ndarray) -> np.ndarray:
    """The radiance (..., 3) float32, finite, that an expression has in the directions (..., 3)."""
    found = evaluate(output, inputs_of(direction.reshape(-1, 3)))
    found = np.broadcast_to(found[:, :3], (len(found), 3))
    return np.nan_to_num(found, posinf=0.0, neginf=0.0).reshape(*direction.shape[:-1], 3)


def picture_of(output: Expression) -> np.ndarray:
    """The equirectangular picture (H, W, 3) float32 of an expression, rows from the bottom, W = 2 H a power of two.

    It is as large as it takes for values between texels to be right to RELATIVE or OF_MEAN, from the size of the
    images that the expression reads on, but not wider than WIDEST. Texels that are still not smooth then, at edges,
    are means of four samples.
    """
    width = first_width(walk(output))
    found = radiance_at(output, texel_directions(width, width // 2))
    rough = _rough(found.reshape(width // 4, 2, width // 2, 2, 3).mean((1, 3)), found)
    while width < WIDEST:
        width *= 2
        coarse, found = found, radiance_at(output, texel_directions(width, width // 2))
        rough = _rough(coarse, found)
        if not rough.any():
            return found
    return _smoothed(output, found, rough)


def first_width(of: Iterable[Expression]) -> int:
    """The least width of a picture: the power of two that is not less than the width of any image among `of`."""
    widths = [node.image.size[0] for node in of if isinstance(node, ImageTexture)]
    return min(max(1 << (max(widths, default=1) - 1).bit_length(), NARROWEST), WIDEST)


def _rough(coarse: np.ndarray, fine: np.ndarray) -> np.ndarray:
    """Which texels (H, W) of `fine` are not those of the picture half as wide, interpolated."""
    height, width = fine.shape[:2]
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    error = np.abs(bilinear(coarse, np.stack([u, v], -1)) - fine)
    return (error > RELATIVE * np.abs(fine) + OF_MEAN * np.abs(fine).mean()).any(axis=2)


def _smoothed(output: Expression, picture: np.ndarray, rough: np.ndarray) -> np.ndarray:
    """The picture, with those of its texels that are rough as means of four samples."""
    height, width = picture.shape[:2]
    row, column = np.nonzero(rough)
    total = np.zeros((len(row), 3), np.float32)
    for x, y in QUARTERS:
        azimuth = (0.5 - (column + 0.5 + x) / width) * (2 * np.pi)
        elevation = ((row + 0.5 + y) / height - 0.5) * np.pi
        flat = np.cos(elevation)
        total += radiance_at(
            output, np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=1)
        )
    picture = picture.copy()
    picture[row, column] = total / len(QUARTERS)
    return picture
