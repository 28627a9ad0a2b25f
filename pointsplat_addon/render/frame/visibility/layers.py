"""Draws one picture of many sub-samples by the visibility buffer: all primitives once, each surface of a pixel shaded once.

The primitives are drawn into the visibility buffer; the sub-samples of each pixel are grouped by surface; layer by layer,
the attributes of the groups are written into a G-buffer, shaded, and spread over the picture by the pixel filter.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...device.protocol import Device, Target, Texture
from ...passes.gbuffer import GBuffer, Variant
from ...passes.tiles import EVERYWHERE, Region
from ...passes.uniforms import SampleView
from ...passes.visibility import polygon_ids
from ...passes.visibility.groups import OPEN
from ...passes.visibility.polygon_ids import PolygonDraw
from ...passes.visibility.splat_ids import SplatCover
from ...passes.visibility.spread import SPREAD_BLOCK, filter_weights, spread_program
from ...plan.plan import Plan
from ..sample_positions import FILTER_WIDTH
from ..shading import Shading
from ..uploads.uploads import Uploads
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
        polygons = self._polygon_draws(view)
        targets.buffer.clear()
        self._draw_primitives(polygons, view)
        self._run("group", lambda: groups.group(view))
        self._upload_weights(view)
        if not self._plan.shades:
            return
        for layer in range(groups.layers):
            region = groups.region(layer)
            self._run("group", lambda layer=layer, region=region: groups.lead(view, layer, region))
            self._run(
                "attributes",
                lambda layer=layer: self._write_attributes(polygons, view, layer, targets.surfaces, self._plan.variant),
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
        self._write_attributes(self._polygon_draws(view), view, 0, targets.central, plan.data_variant)
        return targets.central

    def _draw_primitives(self, polygons: list[PolygonDraw], view: SampleView) -> None:
        device, plan, shared, buffer = self._device, self._plan, self._uploads.shared, self._targets.buffer
        splats, draws = self._splats, self._uploads.points.draws
        # Compute shaders compare with what the rasteriser has drawn, which does not look at what they draw.
        if splats is not None:
            self._run("cover", lambda: splats.rasterise(draws, view, shared))
        if plan.polygons:
            normal = plan.variant.normal
            self._run("polygons", lambda: polygon_ids.draw_ids(device, normal, polygons, view, shared, buffer))
        if splats is not None:
            self._run("cover", lambda: splats.cover(draws, view, shared))

    def _write_attributes(
        self, polygons: list[PolygonDraw], view: SampleView, layer: int, out: GBuffer, variant: Variant
    ) -> None:
        targets, shared = self._targets, self._uploads.shared
        out.clear()
        polygon_ids.draw_attributes(
            self._device, variant, polygons, view, shared, targets.groups, targets.buffer.lattice, out
        )
        if self._splats is not None:
            draws = self._uploads.points.draws
            self._splats.write_attributes(variant, draws, view, shared, targets.groups, layer, out)

    def _polygon_draws(self, view: SampleView) -> list[PolygonDraw]:
        """Numbers the triangles of all instances, and finds where in the picture these are."""
        uploads, found = self._uploads, []
        first = sum(draw.elements for draw in uploads.points.draws)
        instances = uploads.scene.instances
        for instance in uploads.prepared.polygons.tolist():
            mesh = uploads.polygons.meshes[int(instances.geometry[instance])]
            matrix = uploads.prepared.view_from_object[instance].copy()
            matrix[:3, 3] += matrix[:3, :3] @ mesh.origin
            rectangle = rectangle_in_picture(mesh.box, matrix, view)
            if rectangle is not None:
                holdout = bool(instances.holdout is not None and instances.holdout[instance])
                parts = uploads.polygons.part_lists.get(instance)
                found.append(PolygonDraw(mesh, instance, matrix, holdout, first, rectangle, parts))
            first += mesh.triangles
        return found

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


def rectangle_in_picture(
    box: np.ndarray, view_from_object: np.ndarray, view: SampleView
) -> tuple[float, float, float, float] | None:
    """Returns the low and the high corner, from 0 to 1 over the picture, of a rectangle that holds what is in a box.

    box: (2, 3), in object space. view_from_object: (4, 4). None: all of it is outside the picture.
    """
    whole = 0.0, 0.0, 1.0, 1.0
    corners = np.stack(np.meshgrid(*box.T, indexing="ij"), axis=-1).reshape(-1, 3)
    with np.errstate(all="ignore"):
        p = corners @ view_from_object[:3, :3].T + view_from_object[:3, 3]
        depth = -p[:, 2]
        if not np.isfinite(p).all():
            return whole
        if (depth < view.near).all() or (depth > view.far).all():
            return None
        if view.camera.perspective and (depth <= view.near).any():
            return whole
        fx, fy = view.camera.pixel_from_view()[:2]
        scale = 1 / depth if view.camera.perspective else np.ones(len(p))
        pixels = np.stack([fx * p[:, 0] * scale, fy * p[:, 1] * scale], axis=1) + view.principal_point
    low, high = (pixels.min(axis=0) - 1) / view.size, (pixels.max(axis=0) + 1) / view.size
    if (low >= 1).any() or (high <= 0).any():
        return None
    low, high = np.clip(low, 0, 1), np.clip(high, 0, 1)
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])
