"""Draws the maps of panes as lights see them, one layer behind another."""

from __future__ import annotations

from contextlib import ExitStack

import numpy as np

from ...device.protocol import Device, Texture
from ...passes.shadow.keep_depths import keep_depths
from ...passes.shadow.panes import keep_shares, mark_following
from ...passes.uniforms import view_of
from ...passes.visibility.buffer import IdBuffer
from ...passes.visibility.polygon_ids import FOLLOWING, PolygonCover
from ...shadow.panes import PaneMaps
from ..panes.shares import shares_of_layer
from ..visibility.polygon_draws import polygon_draws
from .shadow_maps import ONE_EACH, CasterUploads


def draw_panes(device: Device, panes: PaneMaps, casters: CasterUploads) -> Texture:
    """Returns the texture of all layers, R32UI: bits of depths beyond the near planes of their views, and those of the
    shares of light (float32) that the panes up to there let through; see PaneMaps.size."""
    views, height = panes.maps.views, panes.maps.size[1]
    width, rows = np.max([view.size for view in views], axis=0).tolist()
    with ExitStack() as unfinished, ExitStack() as temporary:  # what is released if it fails, and in any case
        buffer = IdBuffer(device, ONE_EACH, (width, rows))
        temporary.callback(buffer.release)
        following = device.texture((width, rows), "R32UI")
        temporary.callback(following.release)
        mark = device.target([following])
        temporary.callback(mark.release)
        texture = device.texture(panes.size, "R32UI")
        unfinished.callback(texture.release)
        target = device.target([texture])
        temporary.callback(target.release)
        peeled = {**casters.points.instances, FOLLOWING: following}
        for view in views:
            seen, (columns, lines) = view_of(view.camera), view.size
            casters.look_from(seen)
            cover = PolygonCover(device, polygon_draws(device, casters, seen, 0, None), buffer, False, (FOLLOWING,))
            temporary.callback(cover.release)
            device.fill(following)
            through = np.ones((lines, columns, panes.channels), np.float32)
            x, y = view.corner
            for layer in range(panes.layers):
                buffer.clear()
                cover.rasterise(seen, peeled)
                corner = x, y + layer * panes.layer_height
                keep_depths(device, buffer.depths, corner, view.size, target)
                ids, depths = (device.read(one)[:lines, :columns] for one in (buffer.ids, buffer.depths))
                through *= shares_of_layer(casters.scene, cover.draws, seen, ids, depths)
                for k in range(panes.channels):
                    keep_shares(device, through[..., k], (x, corner[1] + (k + 1) * height), target)
                mark_following(device, buffer.depths, mark)
        unfinished.pop_all()
    return texture
