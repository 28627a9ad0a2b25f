"""Equirectangular pictures of expressions that vary with the direction."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ..material.expression import Expression, SampleInputs, evaluate, walk
from ..material.nodes.direction_nodes import SkyTexture
from ..material.nodes.texture_nodes import ImageTexture
from .environment import WIDTHS, bilinear, direction_from_uv, texel_directions, texel_uv

NARROWEST, WIDEST = 64, WIDTHS[-1]  # texels of a picture's width
WHOLE = 512  # texels of the width up to which all texels are evaluated: what is smaller may be missed
OF_SKY = 256  # texels of the width of a picture of a sky, which is brightest about the sun
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
    are means of four samples. From WHOLE on only texels next to such that are not smooth are evaluated; what lies
    between the others is interpolated.
    """
    width = first_width(walk(output))
    found = radiance_at(output, texel_directions(width, width // 2))
    rough = _rough(_interpolated(found.reshape(width // 4, 2, width // 2, 2, 3).mean((1, 3)), width), found)
    while width < WIDEST:
        width *= 2
        guess, finer = _interpolated(found, width), np.ones((width // 2, width), bool)
        if width > WHOLE:
            finer = _next_to(rough).repeat(2, axis=0).repeat(2, axis=1)
        found = guess.copy()
        row, column = np.nonzero(finer)
        found[row, column] = radiance_at(output, _directions(row, column, width))
        rough = _rough(guess, found)
        if not rough.any():
            return found
    row, column = np.nonzero(rough)
    found[row, column] = np.mean([radiance_at(output, _directions(row + y, column + x, width)) for x, y in QUARTERS], 0)
    return found


def _directions(row: np.ndarray, column: np.ndarray, width: int) -> np.ndarray:
    """Unit vectors (N, 3) to places in a picture, in texels: the centre of the first texel is at (0, 0)."""
    return direction_from_uv(np.stack([(column + 0.5) / width, (row + 0.5) * 2 / width], axis=-1))


def first_width(of: Iterable[Expression]) -> int:
    """The least width of a picture: the power of two that is not less than the width of any image among `of`, and the
    widest where the sun is small."""
    widths = [NARROWEST]
    for node in of:
        if isinstance(node, ImageTexture):
            widths.append(node.image.size[0])
        if isinstance(node, SkyTexture):
            widths.append(WIDEST if node.disc is not None else OF_SKY)
    return min(1 << (max(widths) - 1).bit_length(), WIDEST)


def _interpolated(picture: np.ndarray, width: int) -> np.ndarray:
    """A picture with another width."""
    return bilinear(picture, texel_uv(width, width // 2))


def _rough(guess: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Which texels (H, W) of a picture are not as guessed from a coarser one."""
    size = np.abs(found)
    return (np.abs(guess - found) > RELATIVE * size + OF_MEAN * size.mean()).any(axis=2)


def _next_to(rough: np.ndarray) -> np.ndarray:
    """Which texels (H, W) are among `rough` ones or touch one, around the seam, too."""
    wide = rough | np.roll(rough, 1, axis=1) | np.roll(rough, -1, axis=1)
    found = wide.copy()
    found[1:] |= wide[:-1]
    found[:-1] |= wide[1:]
    return found
