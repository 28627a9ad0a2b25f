"""What panes let through of a light, at the texels of one layer of its map."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ....core.numeric.vectors import each_block
from ....core.scene.mesh import Mesh
from ....core.scene.scene import Scene
from ....core.surface.appearance import graphs_of
from ....core.surface.footprints import through_at
from ...device.protocol import EMPTY
from ...passes.uniforms import SampleView
from ...passes.visibility.buffer import RASTERISED
from ...passes.visibility.polygon_draw import Drawn
from ...shadow.panes import pane_shares
from ..visibility.placed import BLOCK, footprints_in_view, on_objects

STEP = 4  # texels between those at which functions are evaluated first
CHANGE = 1 / 64  # of a share: between those that differ by less, it is interpolated
MOST_BETWEEN = 1 << 16  # texels of a layer at which functions are evaluated beside: those where shares change most


def shares_of_layer(
    scene: Scene, draws: Sequence[Drawn], view: SampleView, ids: np.ndarray, depths: np.ndarray
) -> np.ndarray:
    """Returns the share of light that passes each texel, (H, W, C) float32; 1 where nothing is.

    ids: (H, W) uint32, numbers of triangles. depths: (H, W) uint32, the bits of float32 beyond the near plane.

    Functions are evaluated at texels STEP apart, and at those between them that show another triangle or lie where
    shares change most; elsewhere they are interpolated.
    """
    constants = pane_shares(scene.materials)
    found = np.ones((*ids.shape, constants.shape[1]), np.float32)
    begins = np.array([draw.first_id for draw in draws])
    varies = np.zeros(ids.shape, np.bool_)

    def of_each(wanted: np.ndarray) -> Iterator[tuple[Drawn, np.ndarray, np.ndarray, np.ndarray]]:
        """Yields each draw that texels (H, W) bool show, with these rows and columns (N,) and its triangles (N,)."""
        rows, columns = np.nonzero(wanted)
        if not len(rows):
            return
        number = (ids[rows, columns] & ~np.uint32(RASTERISED)).astype(np.int64)
        owner = np.searchsorted(begins, number, side="right") - 1
        order = np.argsort(owner, kind="stable")
        shown, at = np.unique(owner[order], return_index=True)
        for k, some in zip(shown.tolist(), np.split(order, at[1:]), strict=True):
            yield draws[k], rows[some], columns[some], number[some] - draws[k].first_id

    for draw, rows, columns, number in of_each(ids != EMPTY):
        material = draw.identify(number)[:, 1]
        found[rows, columns] = constants[material]
        varies[rows, columns] = np.isin(material, [group.material for group in draw.groups if group.placed])
    if not varies.any():
        return found

    def evaluate(wanted: np.ndarray) -> None:
        for draw, rows, columns, number in of_each(wanted):
            depth = depths[rows, columns].view(np.float32).astype(np.float64) + view.near
            where = np.stack([columns, rows], axis=1) + 0.5
            found[rows, columns] = _shares(scene, draw, view, where, depth, number, found.shape[2])

    first = np.zeros_like(varies)
    first[::STEP, ::STEP] = True
    evaluate(varies & first)
    between, change = _interpolated(found, ids)
    change[~varies | first] = 0
    uneven = change[(change > CHANGE) & np.isfinite(change)]
    least = CHANGE if len(uneven) <= MOST_BETWEEN else np.partition(uneven, -MOST_BETWEEN)[-MOST_BETWEEN]
    even = varies & ~first & (change <= least)
    found[even] = between[even]
    evaluate(varies & ~first & ~even)
    return found


def _interpolated(shares: np.ndarray, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns shares (H, W, C) interpolated between texels STEP apart, and by how much these differ, (H, W) float32;
    infinite where they do not show the same triangle."""
    height, width = ids.shape
    rows, columns = -(-height // STEP), -(-width // STEP)
    coarse, known = shares[::STEP, ::STEP], ids[::STEP, ::STEP]
    whole = [known]
    ends = [coarse]
    for y, x in ((0, 1), (1, 0), (1, 1)):
        # Beyond the last there are none: no number is one of none.
        whole.append(np.pad(known[y:, x:], ((0, y), (0, x)), constant_values=EMPTY))
        ends.append(np.pad(coarse[y:, x:], ((0, y), (0, x), (0, 0))))
    least, most = np.minimum.reduce(ends), np.maximum.reduce(ends)
    alike = np.logical_and.reduce([other == known for other in whole[1:]])
    change = np.where(alike, (most - least).max(axis=2), np.float32(np.inf))
    at = (np.arange(STEP) / STEP).astype(np.float32)
    across, up = at[None, None, None, :, None], at[None, :, None, None, None]
    a, b, c, d = (end[:, None, :, None] for end in ends)
    between = (1 - up) * (a + across * (b - a)) + up * (c + across * (d - c))
    between = between.reshape(rows * STEP, columns * STEP, -1)[:height, :width]
    change, known = (a.repeat(STEP, axis=0).repeat(STEP, axis=1)[:height, :width] for a in (change, known))
    return between, np.where(known == ids, change, np.float32(np.inf))


def _shares(
    scene: Scene,
    draw: Drawn,
    view: SampleView,
    where: np.ndarray,
    depth: np.ndarray,
    number: np.ndarray,
    channels: int,
) -> np.ndarray:
    """Returns the shares, (N, C) float32, of triangles of a draw by their numbers (N,), at positions in the picture
    (N, 2) and depths (N,)."""
    slot, triangle = draw.locate(number)
    geometry = scene.instances.geometry[draw.instance][slot]
    found = np.empty((len(number), channels), np.float32)
    for row in np.unique(geometry).tolist():
        mesh = scene.geometries[row].mesh
        assert mesh is not None
        own = np.flatnonzero(geometry == row)

        def evaluate(block: slice, own: np.ndarray = own, mesh: Mesh = mesh) -> None:
            some = own[block]
            samples, scale = footprints_in_view(
                view, where[some], depth[some], mesh, triangle[some], draw.object_from_view, slot[some]
            )
            # Receivers look at a pane from where the light does not.
            assert samples.backfacing is not None
            samples = replace(samples, backfacing=~samples.backfacing)
            of_objects, samples = on_objects(scene, mesh, samples, draw.instance[slot[some]])
            through = through_at(of_objects, samples, graphs_of(mesh, scene.materials), scene.materials, scale)
            found[some] = through[:, :channels]

        each_block(len(own), evaluate, BLOCK)
    return found
