"""Strands on the device: pages of control points, and the segments that a view draws of them.

A page holds the points of one geometry, texture by texture, one texel a point:
  point     xyz relative to the geometry's origin; radius
  tangent   unit, along the strand; number of the strand, from which it is known which points of wide lights it looks at
  side      unit, across a ribbon
  color, surface, emission   as in pages of splats, where the scene has them
Segments of a view, two texels each: first point, last point, instance, material (-1 - m: a holdout); of narrow ones
share of the raster line's width at both ends (-1: as wide as the strand), phase; of wide tubes the points where the
strand ends, as far as they are near, or -1: tubes end there in a plane.
"""

from __future__ import annotations

import numpy as np

from ....core.scene.materials import MaterialTable
from ....core.scene.strands import Strands
from ....core.strand.levels import StrandLevels
from ....core.strand.segments import Segments
from ...device.packing import PAGE_WIDTH, paged
from ...device.protocol import Device, Texture, releases_on_failure
from ..gbuffer import Variant

TEXELS = 2  # of a segment
STRAND_NUMBERS = 1 << 20  # shaders/lib/geometry/surfel_kind.glsl


class StrandPage:
    """The control points of one geometry on the device."""

    def __init__(
        self, device: Device, lines: Strands, strands: StrandLevels, variant: Variant, table: MaterialTable
    ) -> None:
        self._device, self.strands, self.textures = device, strands, {}
        self.ribbon = strands.side is not None
        self._upload("point", "RGBA32F", 4, np.column_stack([strands.position, strands.radius]))
        number = strands.strand % STRAND_NUMBERS
        self._upload("tangent", "RGBA32F", 4, np.column_stack([strands.tangent, number.astype(np.float32)]))
        if strands.side is not None:
            self._upload("side", "RGBA32F", 4, strands.side)
        rows = strands.material[strands.strand]
        surface = np.stack([table.roughness, table.metallic], axis=1)
        for name, format, channels, on, given, constant in (
            ("color", "RGBA16F", 4, variant.color, lines.color, table.base_color),
            ("surface", "RG32F", 2, variant.surface, lines.surface, surface),
            ("emission", "RGBA16F", 4, variant.emission, lines.emission, table.emission),
        ):
            if on:
                self._upload(name, format, channels, constant[rows] if given is None else given)

    def _upload(self, name: str, format: str, channels: int, values: np.ndarray) -> None:
        size, data = paged(values, channels)
        self.textures[f"ps_{name}"] = self._device.texture(size, format, data)

    def release(self) -> None:
        for texture in self.textures.values():
            texture.release()


class StrandDraw:
    """What one view draws of one geometry."""

    @releases_on_failure
    def __init__(self, device: Device, page: StrandPage, segments: Segments, holdout: np.ndarray | None = None) -> None:
        """holdout: (I,) bool, of all instances."""
        self.device, self.page, self.segments = device, page, segments
        rows = np.zeros((len(segments), TEXELS, 4), np.float32)
        rows[:, 0, :2] = segments.ends
        rows[:, 0, 2], rows[:, 0, 3] = segments.instance, segments.material
        if holdout is not None:
            cut = holdout[segments.instance]
            rows[cut, 0, 3] = -1 - segments.material[cut]
        rows[:, 1, :2], rows[:, 1, 2] = segments.share, segments.phase
        if not page.ribbon:
            wide = segments.wide
            rows[wide, 1, :2] = page.strands.ends_near(segments.ends[wide])
        size, data = paged(rows.reshape(-1, 4), 4)
        self.texture = device.texture(size, "RGBA32F", data)
        # By kind, the segments that are drawn in every sample, (n,) int64.
        self.indices = {"TUBE": segments.wide, "STRIP": segments.narrow}
        if page.ribbon:
            self.indices = {"STRIP": np.concatenate([segments.narrow, segments.wide])}
        if segments.on_lattice:
            self.indices["THIN"] = segments.thin
        self._lists = {kind: self._listed(index) for kind, index in self.indices.items()}
        self.thin: tuple[Texture, int] | None = None
        self.turn = -1.0  # of the sample that thin ones are listed for
        self.drawn = 0  # segments of all samples

    def _listed(self, index: np.ndarray) -> tuple[Texture, int] | None:
        if len(index) == 0:
            return None
        texel = TEXELS * index
        size, data = paged(np.stack([texel % PAGE_WIDTH, texel // PAGE_WIDTH], axis=1), 2)
        return self.device.texture(size, "RG32F", data), len(index)

    def list_thin(self, turn: float) -> None:
        """List the thin segments of the sample with this turn."""
        if turn != self.turn:
            self._forget()
            self.thin, self.turn = self._listed(self.segments.drawn(turn)), turn
        self.drawn += sum(count for _, count in self.lists().values())

    def lists(self) -> dict[str, tuple[Texture, int]]:
        """Texture and length of the list of each kind that there is."""
        named = self._lists if self.thin is None else {**self._lists, "THIN": self.thin}
        return {kind: listed for kind, listed in named.items() if listed is not None}

    def _forget(self) -> None:
        if self.thin is not None:
            self.thin[0].release()
        self.thin = None

    def release(self) -> None:
        self._forget()
        for texture, _ in self.lists().values():
            texture.release()
        self.texture.release()
