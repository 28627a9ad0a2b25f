"""The record of what is drawn in one view and with which passes, targets and shader variants."""

from __future__ import annotations

import math
from dataclasses import replace

from ...core.numeric.pixel_filter import FILTER_SIZE
from ...core.numeric.record import value_record
from ..passes.captured.project import UNLIT, CapturedLighting
from ..passes.ewa.options import EwaOptions
from ..passes.gbuffer import Variant
from ..passes.pages.point_page import PointOptions
from ..passes.shading.terms import Term
from ..passes.translucent.options import TranslucentOptions


@value_record
class Plan:
    """Everything that is decided before the first draw of one view; `make_plan` makes it."""

    points: bool
    polygons: bool
    spheres: bool  # balls so wide on the screen that each is drawn by itself
    lines: bool  # strands
    variant: Variant  # of the G-buffer that is shaded
    data_variant: Variant  # of the G-buffer that passes without averages read
    options: PointOptions
    lighting: tuple[str, ...]  # names of shader defines, PS_*: the lights and shadows on what is drawn
    materials: tuple[str, ...]  # names of shader defines, PS_*: what surfaces do with light
    background: bool  # the pass `background` fills pixels in which nothing opaque is
    data: bool  # the pass `data` runs: depth, position, motion or indices are asked for
    translucent: TranslucentOptions | None  # None: nothing translucent is drawn
    coarse: bool  # the first sample's translucent layer has fewer pixels: views that move show it at once
    skipped: tuple[tuple[str, str], ...] = ()  # (pass that is left out, reason)
    ewa: EwaOptions | None = None  # points are drawn by EWA; None: in image space, or by the painter
    world: tuple[str, ...] = ()  # names of shader defines, PS_*: the world behind everything
    painter: bool = False  # opaque points are painted; the G-buffer holds them for the other passes only
    backdrop: bool = False  # the world is out of focus: passes/shading/backdrop.py
    presented: bool = False  # the picture is shown between samples, with its depth
    picture: bool = True  # Combined is drawn, not the auxiliary passes alone
    shades: bool = True  # Combined is drawn, or an averaged pass, which shading writes too
    sub_samples: int = (
        0  # of each pixel in each sample of the picture, by the visibility buffer; 0: by another technique
    )
    filter_size: float = FILTER_SIZE  # pixels: core/numeric/pixel_filter.py
    eye_dome: bool = False  # Combined is darkened by the depths under the pixels' centres: passes/output/eye_dome.py
    # What light does to captured splats, by row of geometries, of those that it changes.
    captured_light: tuple[tuple[int, CapturedLighting], ...] = ()
    matte_light: CapturedLighting = UNLIT  # what light does to mattes, where there are some
    indirect: bool = False  # surfaces receive light from each other, and hide the world
    widest_translucent: float = math.inf  # pixels: no radius of a translucent splat is larger
    mirrors: bool = False  # sharp ones show them as rays do
    panes: bool = False  # translucent meshes are layers of triangles, over what is opaque
    term: Term | None = None  # the light that is drawn; None: all of it
    defocus: bool = False  # translucent splats are drawn together with what is out of focus: passes/defocus/gather.py

    @property
    def gathers(self) -> bool:
        """Whether something that is drawn receives light from other things."""
        return self.indirect or (
            self.translucent is not None and (self.translucent.gathered or self.translucent.received)
        )

    @property
    def gathers_media(self) -> bool:
        """Whether what fills volumes gathers light."""
        return self.translucent is not None and self.translucent.gathered

    @property
    def gathers_by_tile(self) -> bool:
        """Whether all gathering is part of drawing a tile, which goes on from it where it is put off."""
        return self.indirect and not (self.defocus or self.panes or self.gathers_media)

    @property
    def solid(self) -> bool:
        """Whether something is in the G-buffer."""
        return self.points or self.polygons or self.spheres or self.lines

    @property
    def central(self) -> bool:
        """Whether a G-buffer holds what lies under the pixels' centres, beside the groups of sub-samples."""
        return self.sub_samples > 0 and (self.data or self.eye_dome or (self.presented and not self.defocus))

    @property
    def shaded(self) -> Plan:
        """The plan of the G-buffer that is shaded: it holds no points where these are painted."""
        return replace(self, points=False) if self.painter else self

    @property
    def background_defines(self) -> tuple[str, ...]:
        """Names of the shader defines of passes that draw the world behind everything."""
        return ("PS_BACKDROP",) if self.backdrop and "PS_FOG" not in self.world else self.world

    def splat_radius(self, largest: float) -> float:
        """Returns in pixels how far splats of a radius of at most `largest` pixels are drawn around their centres."""
        if not self.points:
            return 0.0
        return largest if self.ewa is None else self.ewa.reach(largest)
