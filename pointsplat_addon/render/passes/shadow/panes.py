"""Draws one layer of panes as a light sees them: depths behind those of the layer before, and what passes through."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ....core.numeric.lattice import Lattice
from ....shading.interface import Interface
from ...device.protocol import Device, Texture
from ..uniforms import CAMERA_FIELDS, ONE_INSTANCE_FIELDS, Fields, SampleView, Values, block
from ..visibility.buffer import DEPTH_OUTPUT, LATTICE_FIELDS, DepthBuffer
from ..visibility.polygon_draw import Drawn
from ..visibility.polygon_ids import PolygonDepths, depths_program
from ..visibility.polygon_mesh import Group
from ..visibility.small_triangles import group_fields

PANE_FIELDS: Fields = (("float", "through"),)  # share of light
LAYER_FIELDS: Fields = (("ivec2", "before"), ("int", "height"))  # texels from a view to the layer before; to its shares


class PaneBuffer(DepthBuffer):
    """The depth of the nearest pane of a layer at each cell, and the share of light that passes all up to this one."""

    def _colors(self) -> list[Texture]:
        self.shares = self._device.texture(self.cells, "R32UI")
        return [self.depths, self.shares]

    @property
    def textures(self) -> dict[str, Texture]:
        return {**super().textures, "ps_shares": self.shares}


def pane_program(first: bool, lattice: Lattice, group: Group, one: bool) -> Interface:
    """Returns the program that draws a group of triangles into the first layer or a further one. `one`: there is one
    instance."""
    program = depths_program(lattice, group, one)
    further = () if first else LAYER_FIELDS
    alone = ONE_INSTANCE_FIELDS if one else ()
    return replace(
        program,
        block=block("Panes", CAMERA_FIELDS, group_fields(one), PANE_FIELDS, further, alone, LATTICE_FIELDS),
        samplers=(*program.samplers, *(() if first else (("UINT_2D", "ps_before"),))),
        outputs=(*DEPTH_OUTPUT, ("uint", "out_share")),
        defines=(*program.defines, ("PS_PANES", "1"), *(() if first else (("PS_BEHIND_LAYER", "1"),))),
    )


class PaneLayers(PolygonDepths):
    """Draws panes layer by layer."""

    def __init__(self, device: Device, draws: list[Drawn], buffer: PaneBuffer, through: np.ndarray) -> None:
        """`draws`: all of the rasteriser. through: (M,) float32, share of light that each material lets through."""
        super().__init__(device, draws, buffer)
        self._through = through
        self._before: Values = {}  # where the layer before the one that is drawn lies; empty: it is the first

    def draw_layer(
        self,
        view: SampleView,
        shared: dict[str, Texture],
        layers: Texture,
        before: tuple[int, int] | None,
        height: int,
    ) -> None:
        """Draws the layer behind another one, which lies at `before` in the texture of all `layers`; None: the first.

        height: texels there from a layer's depths to its shares.
        """
        self._depths.clear()
        self._before = {} if before is None else {"before": before, "height": height}
        self.rasterise(view, shared if before is None else {**shared, "ps_before": layers})

    def _raster_program(self, draw: Drawn, group: Group, listed: bool) -> Interface:
        return pane_program(not self._before, self._depths.lattice, group, draw.one)

    def _record(self, program: Interface, draw: Drawn, group: Group, view: SampleView, **own: object) -> np.ndarray:
        through = float(self._through[group.material])
        return super()._record(program, draw, group, view, through=through, **self._before, **own)
