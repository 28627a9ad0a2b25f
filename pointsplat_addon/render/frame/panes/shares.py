"""What panes let through of a light, at the texels of one layer of its map."""

from __future__ import annotations

from collections.abc import Sequence

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
from ..visibility.placed import BLOCK, footprints_in_view


def shares_of_layer(
    scene: Scene, draws: Sequence[Drawn], view: SampleView, ids: np.ndarray, depths: np.ndarray
) -> np.ndarray:
    """Returns the share of light that passes each texel, (H, W, C) float32; 1 where nothing is.

    ids: (H, W) uint32, numbers of triangles. depths: (H, W) uint32, the bits of float32 beyond the near plane.

    Functions are evaluated at every other texel of each row and column, and elsewhere only where another triangle
    begins.
    """
    constants = pane_shares(scene.materials)
    found = np.ones((*ids.shape, constants.shape[1]), np.float32)
    shared = ids[::2, ::2].repeat(2, axis=0).repeat(2, axis=1)[: ids.shape[0], : ids.shape[1]] == ids
    shared[::2, ::2] = False
    number = np.where(ids == EMPTY, -1, (ids & ~np.uint32(RASTERISED)).astype(np.int64))
    for draw in draws:
        mine = (number >= draw.first_id) & (number < draw.first_id + draw.triangles)
        material = draw.identify(number[mine] - draw.first_id)[:, 1]
        found[mine] = constants[material]
        varying = [group.material for group in draw.groups if group.placed]
        wanted = mine & ~shared
        wanted[mine] &= np.isin(material, varying)
        rows, columns = np.nonzero(wanted)
        if not len(rows):
            continue
        where = np.stack([columns, rows], axis=1) + 0.5
        depth = depths[wanted].view(np.float32).astype(np.float64) + view.near
        slot, triangle = draw.locate(number[wanted] - draw.first_id)
        geometry = scene.instances.geometry[draw.instance][slot]
        here = np.empty((len(rows), found.shape[2]), np.float32)
        for row in np.unique(geometry).tolist():
            mesh = scene.geometries[row].mesh
            assert mesh is not None
            own = np.flatnonzero(geometry == row)
            each_block(
                len(own),
                lambda block, own=own, mesh=mesh: _evaluate(
                    scene, view, draw, mesh, where, depth, slot, triangle, own[block], here
                ),
                BLOCK,
            )
        found[wanted] = here
        copied = mine & shared
        copied[mine] &= np.isin(material, varying)
        y, x = np.nonzero(copied)
        found[y, x] = found[y & ~1, x & ~1]
    return found


def _evaluate(
    scene: Scene,
    view: SampleView,
    draw: Drawn,
    mesh: Mesh,
    where: np.ndarray,
    depth: np.ndarray,
    slot: np.ndarray,
    triangle: np.ndarray,
    own: np.ndarray,
    out: np.ndarray,
) -> None:
    """Writes into `out` what passes at those of some texels that `own` lists."""
    samples, scale = footprints_in_view(
        view, where[own], depth[own], mesh, triangle[own], draw.object_from_view, slot[own]
    )
    through = through_at(mesh, samples, graphs_of(mesh, scene.materials), scene.materials, scale)
    out[own] = through[:, : out.shape[1]]
