"""Draws one layer of panes as a light sees them: depths behind those of the layer before, and what passes through."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ....core.numeric.lattice import Lattice
from ....shading.interface import Interface
from ...device.protocol import Texture
from ..uniforms import CAMERA_FIELDS, ONE_INSTANCE_FIELDS, Fields, SampleView, block
from ..visibility.buffer import DEPTH_OUTPUT, LATTICE_FIELDS, DepthBuffer
from ..visibility.polygon_ids import PolygonDepths, PolygonDraw, depths_program
from ..visibility.polygon_mesh import Group

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
    own: Fields = (("int", "first"), ("int", "corners"), ("int", "first_slot"))
    alone = ONE_INSTANCE_FIELDS if one else ()
    return replace(
        program,
        block=block("Panes", CAMERA_FIELDS, own, PANE_FIELDS, further, alone, LATTICE_FIELDS),
        samplers=(*program.samplers, *(() if first else (("UINT_2D", "ps_before"),))),
        outputs=(*DEPTH_OUTPUT, ("uint", "out_share")),
        defines=(*program.defines, ("PS_PANES", "1"), *(() if first else (("PS_BEHIND_LAYER", "1"),))),
    )


@dataclass(frozen=True, eq=False)
class PaneLayers(PolygonDepths):
    """Draws panes layer by layer."""

    buffer: PaneBuffer
    through: np.ndarray  # (M,) float32: share of light that each material lets through

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
        self.buffer.clear()
        first = before is None
        further = {} if first else {"before": before, "height": height}
        textures = shared if first else {**shared, "ps_before": layers}
        self._cover(partial(pane_program, first), view, textures, **further)

    def _record(
        self, program: Interface, draw: PolygonDraw, group: Group, view: SampleView, **own: object
    ) -> np.ndarray:
        return super()._record(program, draw, group, view, through=float(self.through[group.material]), **own)
