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
COLORED_PANE_FIELDS: Fields = (("vec4", "through"),)
# Texels from a view to the layer before; to its shares, and from channel to channel.
LAYER_FIELDS: Fields = (("ivec2", "before"), ("int", "height"))
SHARES = ("share", "green", "blue")  # of the light of all channels, or the first; of the other two


class PaneBuffer(DepthBuffer):
    """The depth of the nearest pane of a layer at each cell, and the share of light that passes all up to this one."""

    def __init__(self, device: Device, lattice: Lattice, size: tuple[int, int], channels: int) -> None:
        """`channels`: of shares. Raises as DepthBuffer does."""
        self._channels = channels
        super().__init__(device, lattice, size)

    def _colors(self) -> list[Texture]:
        self.shares = [self._device.texture(self.cells, "R32UI") for _ in range(self._channels)]
        return [self.depths, *self.shares]

    @property
    def textures(self) -> dict[str, Texture]:
        named = {f"ps_{name}": share for name, share in zip(SHARES, self.shares, strict=False)}
        return {**super().textures, **named}


def pane_program(first: bool, lattice: Lattice, group: Group, one: bool, channels: int) -> Interface:
    """Returns the program that draws a group of triangles into the first layer or a further one. `one`: there is one
    instance. `channels`: of shares."""
    program = depths_program(lattice, group, one)
    further = () if first else LAYER_FIELDS
    alone = ONE_INSTANCE_FIELDS if one else ()
    fields = PANE_FIELDS if channels == 1 else COLORED_PANE_FIELDS
    named = {"PS_PANES": True, "PS_PANES_COLORED": channels > 1, "PS_BEHIND_LAYER": not first}
    return replace(
        program,
        block=block("Panes", CAMERA_FIELDS, group_fields(one), fields, further, alone, LATTICE_FIELDS),
        samplers=(*program.samplers, *(() if first else (("UINT_2D", "ps_before"),))),
        outputs=(*DEPTH_OUTPUT, *(("uint", f"out_{name}") for name in SHARES[:channels])),
        defines=(*program.defines, *((name, "1") for name, on in named.items() if on)),
    )


class PaneLayers(PolygonDepths):
    """Draws panes layer by layer."""

    def __init__(self, device: Device, draws: list[Drawn], buffer: PaneBuffer, through: np.ndarray) -> None:
        """`draws`: all of the rasteriser. through: (M, C) float32, shares of light that each material lets through."""
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

        height: texels there from a layer's depths to its shares, and from channel to channel.
        """
        self._depths.clear()
        self._before = {} if before is None else {"before": before, "height": height}
        self.rasterise(view, shared if before is None else {**shared, "ps_before": layers})

    def _raster_program(self, draw: Drawn, group: Group, listed: bool) -> Interface:
        return pane_program(not self._before, self._depths.lattice, group, draw.one, self._through.shape[1])

    def _record(self, program: Interface, draw: Drawn, group: Group, view: SampleView, **own: object) -> np.ndarray:
        shares = self._through[group.material]
        through = float(shares[0]) if len(shares) == 1 else np.append(shares, 1.0)
        return super()._record(program, draw, group, view, through=through, **self._before, **own)
