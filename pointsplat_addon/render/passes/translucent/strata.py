"""Blends translucent splats over the layers that the sub-samples of the visibility buffer show.

Splats that are at least a pixel wide are looked at in the middle of the pixel, once for each layer: a group, or what is
open. With L what they send to the eye and T what they let through, the layer gains L - (1 - T) opaque, and these
differences go through the pixel filter by the weights of the layer's sub-samples. Edges of what is opaque are as exact
as without them. Narrower splats are looked at in a few places of a pixel (few_places.py), or in each sub-sample
(cells.py).

Captured splats (passes/captured) have the pixel filter in them, and are to be seen as their training saw them: where a
view has some, all splats are looked at in pixels' centres alone, and L and T of a pixel's layers hold for all
sub-samples that the pixel filter takes in, by their depths. Blending then begins with nothing: L and T are known.
"""

from __future__ import annotations

import numpy as np

from ....core.numeric.lattice import Lattice
from ....core.splat.kernel import SUPPORT
from ....shading.interface import Interface
from ..tiles import TILE
from ..uniforms import CAMERA_FIELDS, RECTANGLE_FIELDS, block
from ..visibility.buffer import LATTICE_DEFINE, LATTICE_FIELDS
from .blend import Bounds
from .options import TranslucentOptions

NARROW = 1.0  # pixels: standard deviation of the narrower axis below which splats are looked at in all sub-samples
FINEST_KERNEL = 3.0  # how many times as fine as the default kernel others may be
OPEN_LAYER = -1  # what is open, where it is a layer apart: TranslucentOptions.open_apart
NOWHERE = -1e30  # depth of pixels over which nothing is blended: shaders/lib/translucent/place.glsl
EXPAND = block("Expand", CAMERA_FIELDS, LATTICE_FIELDS, (("int", "sub_samples"), ("int", "layer")))
DIFFERENCE = block("Difference", (("int", "sub_samples"), ("int", "neighbours")))
CENTRED = block("Centred", CAMERA_FIELDS, LATTICE_FIELDS, (("int", "sub_samples"), ("int", "neighbours")))
ADD_TILE_BLOCK = block("AddTile", RECTANGLE_FIELDS, (("ivec2", "corner"),))
ADD_TILE = Interface(
    "add", vertex="common/rectangle.vert", fragment="translucent/add_tile.frag", block=ADD_TILE_BLOCK,
    samplers=(("FLOAT_2D", "ps_difference"),), outputs=(("vec4", "out_combined"),),
)  # fmt: skip
CODES = (("UINT_2D", "ps_first"), ("UINT_2D", "ps_second"))


def expand_program(
    behind: bool, places: bool, empty: bool = False, apart: bool = False, mattes: bool = False
) -> Interface:
    """Returns the program that writes a layer of each pixel and its depth.

    `behind`: open sub-samples show something. `places`: the list of groups is not in the order of the pixels. `empty`:
    blending begins with nothing, and what is opaque is not written. `apart`: what is open is the layer OPEN_LAYER.
    `mattes`: some groups are.
    """
    listed = mattes or not empty
    flags = {"PS_BEHIND": behind and not empty, "PS_PLACES": places and listed, "PS_EMPTY": empty, "PS_APART": apart}
    flags |= {"PS_MATTES": mattes}
    read = ("ps_members", *(() if empty else ("ps_combined", *(("ps_behind",) if behind else ()))))
    read += ("ps_starts", *(("ps_places",) if places else ())) if listed else ()
    read += ("ps_matte",) if mattes else ()
    return Interface(
        "expand", fragment="translucent/expand.frag", block=EXPAND,
        samplers=(*CODES, ("UINT_2D", "ps_depths"), *(("FLOAT_2D", name) for name in read)),
        outputs=(("vec4", "out_layer"), *(() if empty else (("vec4", "out_opaque"),)), ("vec4", "out_place")),
        defines=(LATTICE_DEFINE, *((name, "1") for name, on in flags.items() if on)),
    )  # fmt: skip


def centred_program(options: TranslucentOptions, behind: bool, places: bool) -> Interface:
    """Returns the program that adds what splats change in a layer that they were blended for in pixels' centres alone.

    `behind`, `places`: as of `expand_program`.
    """
    read = ("ps_layer", "ps_place", "ps_members", "ps_weights", "ps_starts", "ps_combined")
    read += (*(("ps_behind",) if behind else ()), *(("ps_places",) if places else ()))
    read += ("ps_cut",) if options.holdout else ()
    flags = {"PS_BEHIND": behind, "PS_PLACES": places, "PS_HOLDOUT": options.holdout}
    return Interface(
        "difference", fragment="translucent/difference_centred.frag", block=CENTRED,
        samplers=(*CODES, ("UINT_2D", "ps_depths"), *(("FLOAT_2D", name) for name in read)),
        outputs=(("vec4", "out_difference"),),
        defines=(LATTICE_DEFINE, *((name, "1") for name, on in flags.items() if on)),
    )  # fmt: skip


def difference_program(options: TranslucentOptions) -> Interface:
    """Returns the program that adds what blending has changed in a layer."""
    read = ("ps_layer", "ps_opaque", "ps_place", "ps_members", "ps_weights", *(("ps_cut",) if options.holdout else ()))
    return Interface(
        "difference", fragment="translucent/difference.frag", block=DIFFERENCE,
        samplers=(*CODES, *(("FLOAT_2D", name) for name in read)), outputs=(("vec4", "out_difference"),),
        defines=(("PS_HOLDOUT", "1"),) if options.holdout else (),
    )  # fmt: skip


def member_texels(lattice: Lattice, members: np.ndarray) -> np.ndarray:
    """Returns sub-samples (K,), (1, K, 4) float32: index, cell from the pixel's central one, 0."""
    found = np.zeros((1, len(members), 4), np.float32)
    found[0, :, 0], found[0, :, 1:3] = members, lattice.offsets[members]
    return found


def weight_rows(weights: np.ndarray, members: np.ndarray) -> np.ndarray:
    """Returns the neighbours that sub-samples (K,) weigh something of, (R, 3 + K, 1) float32: x, y, the sum of the
    weights, and each of them.

    weights: (N, S) of the pixel filter, its rows as those of `filter_weights`.
    """
    side = round(len(weights) ** 0.5)
    y, x = (axis.reshape(-1) - side // 2 for axis in np.indices((side, side)))
    own = weights[:, members]
    rows = np.column_stack([x, y, own.sum(axis=1), own])
    return rows[rows[:, 2] > 0][..., None].astype(np.float32)


def are_narrow(shape: np.ndarray, kernels: bool) -> np.ndarray:
    """Returns which splats one place in a pixel is not enough for, (N,) bool.

    shape: (N, 4) as the pass `light` left it. `kernels`: some have kernels of their own, with finer parts.
    """
    xx, xy, yy = shape[:, 0], shape[:, 1], shape[:, 2]
    least = 0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), xy)
    return least < (NARROW * (FINEST_KERNEL if kernels else 1.0)) ** 2


def touched_tiles(
    centre: np.ndarray,
    shape: np.ndarray,
    principal_point: tuple[float, float],
    size: tuple[int, int],
    around: float,
    tile: int = TILE,
) -> np.ndarray:
    """Returns which tiles of a picture splats touch, (rows, columns) bool.

    centre, shape: (N, 4) as the pass `light` left them. size: (width, height) of the picture in pixels. around: pixels
    around a splat that count as touched. tile: pixels on a side.
    """
    last = np.array([-(-side // tile) for side in size])
    with np.errstate(all="ignore"):
        half = np.sqrt(SUPPORT * np.maximum(shape[:, [0, 2]], 0)) + around
        middle = centre[:, :2] + np.asarray(principal_point, np.float32)
        low, high = np.floor((middle - half) / tile), np.floor((middle + half) / tile) + 1
        there = (centre[:, 3] > 0) & (high > 0).all(axis=1) & (low < last).all(axis=1)
    low, high = (np.clip(corner[there], 0, last).astype(np.int64) for corner in (low, high))
    # How many boxes begin less how many end at each corner of tiles; summed over both axes, how many hold a tile.
    columns, rows = (last + 1).tolist()
    corners = np.zeros(columns * rows, np.int64)
    for sign, x, y in ((1, low, low), (-1, high, low), (-1, low, high), (1, high, high)):
        corners += sign * np.bincount(y[:, 1] * columns + x[:, 0], minlength=columns * rows)
    return corners.reshape(rows, columns).cumsum(axis=0).cumsum(axis=1)[:-1, :-1] > 0


def splats_over(
    tiles: np.ndarray,
    centre: np.ndarray,
    shape: np.ndarray,
    principal_point: tuple[float, float],
    tile: int = TILE,
) -> np.ndarray:
    """Returns which splats touch some of tiles (rows, columns) bool, (K,) int64, in their order.

    centre, shape: (N, 4) as the pass `light` left them, of a view with this principal point. tile: pixels on a side.
    """
    rows, columns = tiles.shape
    counts = np.zeros((rows + 1, columns + 1), np.int64)
    counts[1:, 1:] = tiles.cumsum(axis=0).cumsum(axis=1)
    with np.errstate(all="ignore"):
        half = np.sqrt(SUPPORT * np.maximum(shape[:, [0, 2]], 0))
        middle = centre[:, :2] + np.asarray(principal_point, np.float32)
        low = np.clip(np.floor((middle - half) / tile), 0, (columns, rows))
        high = np.clip(np.floor((middle + half) / tile) + 1, 0, (columns, rows))
        there = np.flatnonzero((centre[:, 3] > 0) & (high > low).all(axis=1))
    (x, y), (end_x, end_y) = (corner[there].astype(np.int64).T for corner in (low, high))
    inside = counts[end_y, end_x] - counts[y, end_x] - counts[end_y, x] + counts[y, x]
    return there[inside > 0]


def open_tiles(layers: np.ndarray, covered: np.ndarray, tiles: np.ndarray) -> np.ndarray:
    """Returns which of tiles (rows, columns) bool have pixels that are open in part.

    layers, covered: (H, W) int, of groups with and without what is open.
    """
    return tiles_by_layer(layers - covered, tiles)[0]


def tiles_by_layer(layers: np.ndarray, tiles: np.ndarray) -> list[np.ndarray]:
    """Returns of tiles (rows, columns) bool those that have a first layer, a second one, and so on; at least the first.

    layers: (H, W) int, of each pixel.
    """
    rows, columns = tiles.shape
    height, width = layers.shape
    padded = np.pad(layers, [(0, rows * TILE - height), (0, columns * TILE - width)])
    most = np.where(tiles, padded.reshape(rows, TILE, columns, TILE).max(axis=(1, 3)), 0)
    return [most > layer for layer in range(max(int(most.max()), 1))]


def tiles_with(pixels: np.ndarray) -> np.ndarray:
    """Returns which tiles hold some of pixels (H, W) bool, (rows, columns) bool."""
    rows, columns = (-(-side // TILE) for side in pixels.shape)
    padded = np.pad(pixels, [(0, rows * TILE - pixels.shape[0]), (0, columns * TILE - pixels.shape[1])])
    return padded.reshape(rows, TILE, columns, TILE).any(axis=(1, 3))


def widened(tiles: np.ndarray, by: int = 1) -> np.ndarray:
    """Returns tiles, or pixels, (rows, columns) bool and those that lie up to so many beside them."""
    rows, columns = tiles.shape
    around = np.pad(tiles, by)
    rows_of = np.any([around[y : y + rows] for y in range(2 * by + 1)], axis=0)
    return np.any([rows_of[:, x : x + columns] for x in range(2 * by + 1)], axis=0)


def bounds(tiles: np.ndarray) -> Bounds:
    """Returns the rectangle of pixels around tiles (rows, columns) bool: low and high corner."""
    y, x = (np.flatnonzero(tiles.any(axis=axis)) for axis in (1, 0))
    if len(x) == 0:
        return 0.0, 0.0, 0.0, 0.0
    return x[0] * TILE, y[0] * TILE, (x[-1] + 1) * TILE, (y[-1] + 1) * TILE
