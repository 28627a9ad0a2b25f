"""Draws the maps of panes as lights see them, one layer behind another."""

from __future__ import annotations

from contextlib import ExitStack

import numpy as np

from ...device.protocol import Device, Texture
from ...passes.shadow.keep_depths import keep_depths
from ...passes.shadow.panes import PaneBuffer, PaneLayers
from ...passes.uniforms import view_of
from ...shadow.panes import PaneMaps, pane_shares
from ..visibility.polygon_draws import polygon_draws
from .shadow_maps import ONE_EACH, CasterUploads


def draw_panes(device: Device, panes: PaneMaps, casters: CasterUploads) -> Texture:
    """Returns the texture of all layers, R32UI: bits of depths beyond the near planes of their views, and those of the
    shares of light (float32) that the panes up to there let through; see PaneMaps.size."""
    views, height = panes.maps.views, panes.maps.size[1]
    width, rows = np.max([view.size for view in views], axis=0).tolist()
    through = pane_shares(casters.scene.materials)
    with ExitStack() as unfinished, ExitStack() as temporary:  # what is released if it fails, and in any case
        buffer = PaneBuffer(device, ONE_EACH, (width, rows), panes.channels)
        temporary.callback(buffer.release)
        texture = device.texture(panes.size, "R32UI")
        unfinished.callback(texture.release)
        target = device.target([texture])
        temporary.callback(target.release)
        for view in views:
            seen = view_of(view.camera)
            casters.look_from(seen)
            drawn = PaneLayers(device, polygon_draws(device, casters, seen, 0, None), buffer, through)
            temporary.callback(drawn.release)
            x, y = view.corner
            before = None
            for layer in range(panes.layers):
                drawn.draw_layer(seen, casters.points.instances, texture, before, height)
                before = x, y + layer * panes.layer_height
                for k, texture_of_layer in enumerate((buffer.depths, *buffer.shares)):
                    keep_depths(device, texture_of_layer, (x, before[1] + k * height), view.size, target)
        unfinished.pop_all()
    return texture
