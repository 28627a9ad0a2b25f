"""Draws one picture of many sub-samples by the visibility buffer: all primitives once, each surface of a pixel shaded once.

The primitives are drawn into the visibility buffer; the sub-samples of each pixel are grouped by surface; layer by layer,
the attributes of the groups are written into a G-buffer, shaded, and spread over the picture by the pixel filter.
"""

from __future__ import annotations

from collections.abc import Callable

from ...device.protocol import Device, Target, Texture
from ...passes.gbuffer import GBuffer, Variant
from ...passes.strands import strand_ids
from ...passes.tiles import EVERYWHERE, Region
from ...passes.uniforms import SampleView
from ...passes.visibility import polygon_ids
from ...passes.visibility.groups import OPEN
from ...passes.visibility.splat_ids import SplatCover
from ...passes.visibility.spread import SPREAD_BLOCK, filter_weights, spread_program
from ...plan.plan import Plan
from ..sample_positions import FILTER_WIDTH
from ..shading import Shading
from ..uploads.uploads import Uploads
from .numbers import NumberedDraws, number_draws
from .targets import VisibilityTargets

WIDE_RADIUS = 2.5  # pixels: where no splat is wider, none covers more cells than a compute invocation draws
Run = Callable[[str, Callable[[], None]], None]  # runs a pass, and times it under a name


class Visibility:
    """Draws the samples of one picture, each of which is a whole lattice of sub-samples."""

    def __init__(
        self,
        device: Device,
        plan: Plan,
        passes: frozenset[str],
        uploads: Uploads,
        targets: VisibilityTargets,
        shading: Shading,
        run: Run,
    ) -> None:
        """`run` times each pass."""
        self._device, self._plan, self._uploads, self._targets = device, plan, uploads, targets
        self._shading, self._run = shading, run
        self._spread = spread_program(targets.buffer.lattice, passes, plan.picture)
        self._weights: Texture | None = None
        self._splats: SplatCover | None = None
        if plan.points:
            wide = uploads.prepared.largest > WIDE_RADIUS
            self._splats = SplatCover(device, plan.options, targets.buffer, wide)

    def draw(self, view: SampleView, sums: Target) -> None:
        """Draws all sub-samples of one view, and adds what they show to the sums."""
        targets, groups = self._targets, self._targets.groups
        draws = number_draws(self._uploads, view)
        targets.buffer.clear()
        self._draw_primitives(draws, view)
        self._run("group", lambda: groups.group(view))
        self._upload_weights(view)
        if not self._plan.shades:
            return
        for layer in range(groups.layers):
            region = groups.region(layer)
            self._run("group", lambda layer=layer, region=region: groups.lead(view, layer, region))
            self._run(
                "attributes",
                lambda layer=layer: self._write_attributes(draws, view, layer, targets.surfaces, self._plan.variant),
            )
            self._device.clear(targets.shaded_target)
            self._run("shade", lambda region=region: self._shading.shade_groups(view, region, targets.surfaces, targets.shaded_target))
            self._add(layer, sums)
        if self._plan.background and groups.open:
            region = groups.region(OPEN)
            self._device.clear(targets.shaded_target)
            self._run("background", lambda: self._shading.draw_open(view, region, groups.codes, targets.shaded_target))
            self._add(OPEN, sums)

    def draw_central(self, view: SampleView) -> GBuffer:
        """Writes what lies under the pixels' centres into a G-buffer of its own; follows `draw` of the same view."""
        targets, plan = self._targets, self._plan
        assert targets.central is not None
        targets.groups.lead(view, 0, EVERYWHERE, central=True)
        self._write_attributes(number_draws(self._uploads, view), view, 0, targets.central, plan.data_variant)
        return targets.central

    def _draw_primitives(self, drawn: NumberedDraws, view: SampleView) -> None:
        device, plan, shared, buffer = self._device, self._plan, self._uploads.shared, self._targets.buffer
        splats, draws, normal = self._splats, self._uploads.points.draws, plan.variant.normal
        # Compute shaders compare with what the rasteriser has drawn, which does not look at what they draw.
        if splats is not None:
            self._run("cover", lambda: splats.rasterise(draws, view, shared))
        if plan.polygons:
            self._run("polygons", lambda: polygon_ids.draw_ids(device, normal, drawn.polygons, view, shared, buffer))
        if plan.lines:
            held = {**shared, **self._uploads.strands.instances}
            self._run("lines", lambda: strand_ids.draw_ids(device, normal, drawn.strands, view, held, buffer))
        if splats is not None:
            self._run("cover", lambda: splats.cover(draws, view, shared))

    def _write_attributes(
        self, drawn: NumberedDraws, view: SampleView, layer: int, out: GBuffer, variant: Variant
    ) -> None:
        device, shared, groups = self._device, self._uploads.shared, self._targets.groups
        lattice = self._targets.buffer.lattice
        out.clear()
        polygon_ids.draw_attributes(device, variant, drawn.polygons, view, shared, groups, lattice, out)
        if drawn.strands:
            held = {**shared, **self._uploads.strands.instances}
            strand_ids.draw_attributes(device, variant, drawn.strands, view, held, groups, lattice, out)
        if self._splats is not None:
            draws = self._uploads.points.draws
            self._splats.write_attributes(variant, draws, view, shared, groups, layer, out)

    def _upload_weights(self, view: SampleView) -> None:
        weights = filter_weights(self._targets.buffer.lattice, view.offset, FILTER_WIDTH)
        self._forget_weights()
        self._weights = self._device.texture(weights.shape[1::-1], "RGBA32F", weights.reshape(-1))

    def _add(self, layer: int, sums: Target) -> None:
        """Spreads a shaded layer over the sums."""
        targets, region = self._targets, self._targets.groups.region(layer, beyond=1)
        record = SPREAD_BLOCK.record(layer=layer)
        assert self._weights is not None
        textures = {**targets.groups.codes, **targets.shaded, "ps_weights": self._weights}

        def add() -> None:
            region.draw(self._device, self._spread, sums, uniforms=record, textures=textures, blend=True)

        self._run("spread", add)

    def release(self) -> None:
        if self._splats is not None:
            self._splats.release()
        self._forget_weights()

    def _forget_weights(self) -> None:
        if self._weights is not None:
            self._weights.release()
        self._weights = None
