"""Smaller levels of the pictures of materials (Williams 1983), as the device reads them: shaders/lib/data/levels.glsl.

Each level has half as many texels along a side as the one before, rounded down, each the mean over its area, whatever
the size is: max(size >> k, 1) of them over the unit square. Levels hold the light that the picture itself, level 0,
shows: its texels are interpolated as they are stored, encoded and beside what lies under an alpha of 0, which is darker
than the mean of decoded texels. Colours are multiplied by alpha where the material has one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ..numeric.record import value_record
from .color_models import linear_from_srgb
from .textures import Pyramid, half_rows, half_size

STEPS = 1 << 14  # of the sRGB curve
_TABLE = linear_from_srgb(np.arange(STEPS + 1, dtype=np.float32) / np.float32(STEPS))
GAUSS = np.float32(0.5 - 12**-0.5)  # of the way from a texel to the next: the first of Gauss's two points
ROWS = 32  # that are read at a time
RING = 1  # texels around a smaller level of a picture with a border


def interleaved(
    picture: Mapping[str, np.ndarray], constants: Mapping[str, np.ndarray], channels: Sequence[str]
) -> np.ndarray:
    """(H, W, C) float32: channels of a picture side by side; what it lacks is constant, a name that is none is zero."""
    height, width = next(iter(picture.values())).shape[:2]
    values = [picture[c] if c in picture else constants.get(c, np.zeros(1)) for c in channels]
    ends = np.cumsum([value.shape[-1] for value in values])
    data = np.empty((height, width, ends[-1]), np.float32)
    for end, value in zip(ends, values, strict=True):
        data[..., end - value.shape[-1] : end] = value
    return data


@value_record
class Stored:
    """How RGBA is stored in a picture, and read between its texels."""

    encoded: bool  # by the sRGB curve
    associated: bool  # colour is multiplied by alpha
    weighted: bool  # the material has an alpha, and levels' colours are multiplied by it
    closest: bool  # texels are not interpolated
    beyond: str  # the edges, as np.pad calls it


def shown_light(texels: np.ndarray, stored: Stored) -> np.ndarray:
    """(H, W, 4) float32: the mean, over each texel's square, of the light that stored RGBA (H, W, 4) shows.

    By four points of each, Gauss's two between texels along each axis; where nothing but interpolation lies between the
    two, the texels themselves.
    """
    if not (stored.encoded or stored.weighted or stored.associated):
        return texels
    # Channels one by one: NumPy is several times slower where neighbours are not neighbours in memory.
    planes = np.moveaxis(texels, 2, 0)
    if not stored.closest:
        planes = np.pad(planes, ((0, 0), (1, 1), (1, 1)), mode=stored.beyond)  # type: ignore[call-overload]
    else:
        planes = np.array(planes, order="C")
    light = _Light(stored, planes)
    out = np.empty_like(texels)
    for low in range(0, len(texels), ROWS):  # temporaries stay in the processor's cache
        rows = slice(low, min(low + ROWS, len(texels)))
        if stored.closest:
            shown = light.of(planes[:, rows])
        else:
            shown = _mean_of_four(light.of, planes[:, rows.start : rows.stop + 2])
        out[rows] = np.moveaxis(shown, 0, 2)
    return out


def _mean_of_four(shown: Callable[[np.ndarray], np.ndarray], planes: np.ndarray) -> np.ndarray:
    """(C, h, w): the mean of what planes show at Gauss's points of the inner texels of (C, h + 2, w + 2)."""
    total = np.zeros((len(planes), planes.shape[1] - 2, planes.shape[2] - 2), np.float32)
    middle = (1 - GAUSS) * planes[:, 1:-1]
    for beside in (planes[:, :-2], planes[:, 2:]):
        rows = GAUSS * beside
        rows += middle
        centre = (1 - GAUSS) * rows[:, :, 1:-1]
        for columns in (rows[:, :, :-2], rows[:, :, 2:]):
            point = GAUSS * columns
            point += centre
            total += shown(point)
    total *= np.float32(0.25)
    return total


class _Light:
    """What RGBA that is stored so stands for, in planes (4, ...)."""

    def __init__(self, stored: Stored, planes: np.ndarray) -> None:
        """`planes`: between whose values lie all that it is asked for."""
        self._stored = stored
        color = planes[:3]
        self._by_table = not stored.associated and bool(color.min(initial=0) >= 0 and color.max(initial=0) <= 1)

    def of(self, planes: np.ndarray) -> np.ndarray:
        """(4, ...); the planes may be changed."""
        stored, color, alpha = self._stored, planes[:3], planes[3]
        if stored.associated:
            color /= np.where(alpha > 0, alpha, np.float32(1))
        if stored.encoded and (self._by_table or (color.min(initial=0) >= 0 and color.max(initial=0) <= 1)):
            # Steps of the table are finer than half floats show: powers take ten times as long.
            color *= np.float32(STEPS)
            color += np.float32(0.5)
            _TABLE.take(color.astype(np.uint16), out=color, mode="clip")
        elif stored.encoded:
            color[:] = linear_from_srgb(color)
        if stored.weighted:
            color *= alpha
        return planes


def shown_normals(texels: np.ndarray, stored: Stored) -> np.ndarray:
    """(H, W, 4) float32: x, y, 1 - z and 0 of the mean, over each texel's square, of the unit normals that stored ones
    (H, W, 4) in tangent space show, by four points of each, as `shown_light`.

    The mean is the shorter, the more normals spread (Toksvig 2005). 1 - z keeps digits of flat ones in half floats.
    """
    out = np.zeros_like(texels)
    planes = np.moveaxis(texels, 2, 0)[:3]
    if not stored.closest:
        planes = np.pad(planes, ((0, 0), (1, 1), (1, 1)), mode=stored.beyond)  # type: ignore[call-overload]
    for low in range(0, len(texels), ROWS):
        rows = slice(low, min(low + ROWS, len(texels)))
        if stored.closest:
            shown = _unit(np.array(planes[:, rows]))
        else:
            shown = _mean_of_four(_unit, planes[:, rows.start : rows.stop + 2])
        out[rows, :, :3] = np.moveaxis(shown, 0, 2)
    return out


def _unit(planes: np.ndarray) -> np.ndarray:
    """(3, ...): x, y and 1 - z of directions (3, ...), which may be changed; those of no length lead outwards."""
    length = np.sqrt(np.square(planes).sum(axis=0))
    planes /= np.where(length > 0, length, np.float32(1))
    x, y, z = planes
    side = x * x + y * y
    planes[2] = np.where(z > 0, side / (1 + np.abs(z)), np.where(length > 0, 1 - z, np.float32(0)))
    return planes


def shown_slopes(heights: np.ndarray, border: int, stored: Stored) -> np.ndarray:
    """(H, W, 4) float32: the means, over each texel's square, of the slopes along u and v that heights (H, W) show, and
    of their squares (Olano and Baker 2010), by four points of each, as `shown_light`. border: texels around the unit
    square."""
    high, wide = (side - 2 * border for side in heights.shape)
    padded = np.pad(heights, 1, mode=stored.beyond)  # type: ignore[call-overload]
    along_u, along_v = np.diff(padded, axis=1) * np.float32(wide), np.diff(padded, axis=0) * np.float32(high)
    out = np.zeros((*heights.shape, 4), np.float32)
    inner, before, after = slice(1, -1), slice(None, -2), slice(2, None)
    for column, next_column in ((slice(None, -1), before), (slice(1, None), after)):
        for row, next_row in ((slice(None, -1), before), (slice(1, None), after)):
            u = (1 - GAUSS) * along_u[inner, column] + GAUSS * along_u[next_row, column]
            v = (1 - GAUSS) * along_v[row, inner] + GAUSS * along_v[row, next_column]
            out += np.stack([u, v, u * u, v * v], axis=2)
    out *= np.float32(0.25)
    return out


def smaller_levels(texels: np.ndarray, border: int) -> list[np.ndarray]:
    """Levels (h, w, C) float32 from 1 on of texels (H, W, C), which are not changed, down to a single one; there are
    none of a single one.

    border: texels around the unit square, of which the outermost go on; levels have RING of these.
    """
    if not border:
        height, width = texels.shape[:2]
        return Pyramid(lambda rows: texels[rows], (width, height)).levels if max(height, width) > 1 else []
    levels: list[np.ndarray] = []
    while max(texels.shape[:2]) > 1 + 2 * border:
        texels, border = _half_with_ring(texels, border), RING
        levels.append(texels)
    return levels


def _half_with_ring(texels: np.ndarray, border: int) -> np.ndarray:
    """Half as many texels, and a ring of what lies around them: all of it is two of these texels wide, or alike."""
    inner = half_size(texels[border:-border, border:-border])
    out = np.empty((inner.shape[0] + 2 * RING, inner.shape[1] + 2 * RING, inner.shape[2]), np.float32)
    out[RING:-RING, RING:-RING] = inner
    nearest = min(2, border)
    for turned, around in ((texels, out), (texels.swapaxes(0, 1), out.swapaxes(0, 1))):
        for strip, column in (
            (turned[:, border - nearest : border], 0),
            (turned[:, turned.shape[1] - border : turned.shape[1] - border + nearest], -1),
        ):
            around[RING:-RING, column] = half_rows(strip[border:-border].mean(axis=1, keepdims=True))[:, 0]
    for y in (0, -1):
        for x in (0, -1):
            out[y, x] = texels[y, x]
    return out


def laid_out(levels: Sequence[np.ndarray]) -> np.ndarray:
    """(N, C) float32: texels of all levels one after another, row by row."""
    return np.concatenate([level.reshape(-1, level.shape[-1]) for level in levels])
