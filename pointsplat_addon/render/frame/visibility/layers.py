"""Draws one picture by the visibility buffer: all primitives once, each surface of a pixel shaded once.

The primitives are drawn into the visibility buffer; the sub-samples of each pixel are grouped by surface, and the
groups listed; their attributes are written, group by group, into a G-buffer as long as the list, shaded, and spread
over the picture by the pixel filter.
"""

from __future__ import annotations

from collections.abc import Callable, Generator

import numpy as np

from ....core.numeric.linear import are_similarities
from ....core.numeric.pixel_filter import MOVED, edge_share, filter_reach, filter_weights
from ...device.clock import Cancelled
from ...device.protocol import Device, Target, Texture
from ...passes.gbuffer import GBuffer, Variant
from ...passes.grouping.groups import Leaders
from ...passes.grouping.spread import SPREAD_BLOCK, spread_program, weight_texels
from ...passes.strands.strand_ids import StrandCover
from ...passes.uniforms import SampleView
from ...passes.visibility.polygon_ids import PolygonCover
from ...passes.visibility.splat_ids import SplatCover
from ...plan.plan import Plan
from ..indirect.light import GroupsInIndirectLight
from ..panes.layers import Panes
from ..shading import Shading
from ..uploads.uploads import Uploads
from .identities import identities
from .occluders import Occluders
from .placed import placed_textures
from .polygon_draws import draws_of, polygons_in_view
from .strand_draws import strand_draws
from .targets import VisibilityTargets
from .tiles import PictureTile, tiles_of_part
from .translucent import TranslucentLayers

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
        translucent: TranslucentLayers | None,
        run: Run,
        indirect: GroupsInIndirectLight | None = None,
        part: tuple[int, int] = (0, 1),
        panes: Panes | None = None,
        hidden_known: bool = False,
    ) -> None:
        """`translucent`, `panes`: what is blended over the sub-samples. `run` times each pass. `indirect`: light that
        surfaces receive from each other. `part`: which tiles are drawn, see tiles_of_part. `hidden_known`: what others
        hide is left out already."""
        self.tiles = tiles_of_part(targets.tiles, part)
        self._device, self._plan, self._passes, self._uploads = device, plan, passes, uploads
        self._targets, self._shading, self._translucent, self._run = targets, shading, translucent, run
        self._indirect, self._panes, self._hidden_known = indirect, panes, hidden_known
        self._polygons: PolygonCover | None = None
        self._strands: StrandCover | None = None
        self._splats: SplatCover | None = None
        if plan.points:
            wide, shown = uploads.prepared.largest > WIDE_RADIUS, np.bincount(uploads.prepared.cut.instance) > 0
            round_balls = are_similarities(uploads.prepared.view_from_object[np.flatnonzero(shown)])
            self._splats = SplatCover(device, plan.options, targets.buffer, wide, round_balls)

    def draw(
        self,
        view: SampleView,
        sums: Target | None,
        central: bool,
        identify: bool,
        coarse: bool,
    ) -> Generator[None, None, np.ndarray | None]:
        """Draws all sub-samples of one view, and adds what they show to the sums; None: nothing is shaded. Stops
        between two tiles, and where gathering indirect light is put off.

        `central`: what lies under the pixels' centres is written into targets.central, or its depth into
        targets.depths. `coarse`: translucent splats are drawn at a lower resolution. Returns the instance and the
        material of each sub-sample, (S, H, W, 2) int32, where `identify`; else None.
        """
        found, (width, height) = None, view.size
        for tile in self.tiles:
            if tile is not self.tiles[0]:
                yield
            seen = tile.view(view)
            self._number_primitives(seen)
            self._targets.buffer.clear()
            self._draw_primitives(seen)
            if sums is not None:
                shaded = yield from self._shade(seen, tile, sums)
                drawn = None
                if self._panes is not None:
                    drawn = self._panes.draw(seen, tile, shaded, self.weights(seen), coarse)
                if self._translucent is not None:
                    self._translucent.draw(seen, tile, shaded, self.weights(seen), coarse, drawn)
            if central:
                self._draw_central(seen, tile)
            if identify:
                shown = self._identities()
                found = np.empty((len(shown), height, width, 2), np.int32) if found is None else found
                (x, y), (end_x, end_y), (left, low) = tile.corner, tile.end, tile.origin
                found[:, y:end_y, x:end_x] = shown[:, y - low : end_y - low, x - left : end_x - left]
        return found

    def weights(self, view: SampleView) -> np.ndarray:
        """Returns the weights of the pixel filter, (N, S): see filter_weights."""
        return filter_weights(self._targets.buffer.lattice, view.offset, self._plan.filter_size)

    def _number_primitives(self, view: SampleView) -> None:
        """Lists what a view shows, with the numbers of primitives: first splats, then triangles, then segments."""
        first = sum(draw.elements for draw in self._uploads.points.draws)
        if self._plan.polygons:
            self._forget_polygons()
            device, buffer, normal = self._device, self._targets.buffer, self._plan.variant.normal
            shown = polygons_in_view(device, self._uploads, view, buffer.cells)
            if not self._hidden_known:
                shown = Occluders(device, buffer, normal, view, self._uploads.shared, self._run).without_hidden(shown)
            draws = draws_of(device, shown, first)
            self._polygons = PolygonCover(device, draws, buffer, normal)
            first += sum(draw.triangles for draw in draws)
        if self._plan.lines:
            self._strands = StrandCover(self._device, strand_draws(self._uploads, first), self._targets.buffer)

    def _shade(self, view: SampleView, tile: PictureTile, sums: Target) -> Generator[None, None, dict[str, Texture]]:
        """Shades the groups of a tile, and adds them to the sums; returns what they show, by sampler name. Stops where
        gathering is put off."""
        targets, groups, run = self._targets, self._targets.groups, self._run
        run("group", lambda: self._group(view))
        assert groups.leaders is not None
        leaders, lists = groups.leaders, targets.lists(groups.leaders.size)
        lists.surfaces.clear()
        self._device.clear(lists.target)
        if lists.matte_target is not None:
            self._device.clear(lists.matte_target)
        if self._plan.solid:
            run("attributes", lambda: self._write_attributes(view, leaders, lists.surfaces, self._plan.variant))
            received: dict[str, Texture] = {}
            while self._indirect is not None and not received:
                try:
                    run("gather", lambda: received.update(self._received(view, lists.surfaces, leaders)))
                except Cancelled:
                    if not self._indirect.goes_on:
                        raise
                    yield  # and goes on with what is not known yet
            run(
                "shade",
                lambda: self._shading.shade_groups(
                    view, lists.surfaces, leaders.bound | groups.codes, targets.buffer, lists.target, received
                ),
            )
        if targets.behind is not None:
            run("background", lambda: self._shading.draw_open(view, groups.codes, targets.behind_target))
        if (matte_target := lists.matte_target) is not None:
            groups_of = leaders.bound | groups.codes
            behind = {} if targets.behind is None else {"ps_behind": targets.behind}
            run(
                "mattes",
                lambda: self._shading.shade_mattes(
                    view, lists.surfaces, groups_of | behind, targets.buffer, matte_target
                ),
            )
        run("spread", lambda: self._spread(view, tile, lists.shaded, sums))
        return lists.shaded

    def _received(self, view: SampleView, surfaces: GBuffer, leaders: Leaders) -> dict[str, Texture]:
        assert self._indirect is not None
        assert leaders.list is not None
        return self._indirect.gather(view, surfaces, leaders.list, self._targets.groups.entries)

    def _draw_central(self, view: SampleView, tile: PictureTile) -> None:
        """Writes what lies under the pixels' centres of a tile into its place in a G-buffer of the picture, or its
        depth alone."""
        targets, leaders = self._targets, self._targets.central_leaders
        if targets.depths is not None:
            targets.depths.draw(view, targets.buffer, tile.rectangle(targets.size), tile.origin)
            return
        assert targets.central is not None
        assert leaders is not None
        targets.groups.lead(view, leaders)
        if tile is self.tiles[0]:
            targets.central.clear()
        leaders.place = tile.rectangle(targets.size), tile.origin
        self._write_attributes(view, leaders, targets.central, self._plan.data_variant)

    def _identities(self) -> np.ndarray:
        polygons = [] if self._polygons is None else self._polygons.draws
        strands = [] if self._strands is None else self._strands.draws
        found = identities(self._device, self._targets.buffer, self._uploads.points.draws, polygons, strands)
        matte = self._uploads.scene.instances.matte
        if matte is not None:
            found[np.append(matte, False)[found[..., 0]]] = -1  # they are not seen
        return found

    def _draw_primitives(self, view: SampleView) -> None:
        shared, polygons, strands = self._uploads.shared, self._polygons, self._strands
        normal, instances = self._plan.variant.normal, self._uploads.strands.instances
        splats, draws = self._splats, self._uploads.points.draws
        # Compute shaders compare with what the rasteriser has drawn, which does not look at what they draw.
        if splats is not None:
            self._run("cover", lambda: splats.rasterise(draws, view, shared))
        if polygons is not None:
            self._run("polygons", lambda: polygons.rasterise(view, shared))
        if strands is not None:
            self._run("lines", lambda: strands.cover(normal, view, {**shared, **instances}))
        # All depths come before all numbers: what has the least depth is known then.
        if splats is not None:
            self._run("cover", lambda: splats.cover(draws, view, shared))
        if polygons is not None:
            self._run("polygons", lambda: polygons.cover(view, shared))
        if splats is not None:
            self._run("cover", lambda: splats.identify(draws, view, shared))
        if polygons is not None:
            self._run("polygons", lambda: polygons.identify(view, shared))

    def _group(self, view: SampleView) -> None:
        self._targets.groups.group(view)
        covers = [cover for cover in (self._polygons, self._strands) if cover is not None]
        self._targets.groups.sort(view, [draw.first_id for cover in covers for draw in cover.draws])

    def _write_attributes(self, view: SampleView, leaders: Leaders, out: GBuffer, variant: Variant) -> None:
        shared, groups = self._uploads.shared, self._targets.groups
        if self._polygons is not None:
            lattice, draws, scene = self._targets.buffer.lattice, self._polygons.draws, self._uploads.scene
            placed = placed_textures(self._device, scene, draws, variant, view, lattice, groups, leaders)
            try:
                self._polygons.write_attributes(variant, view, shared, groups, leaders, out, placed)
            finally:
                for texture in placed.values():
                    texture.release()
        if self._strands is not None:
            held = {**shared, **self._uploads.strands.instances}
            self._strands.write_attributes(variant, view, held, groups, leaders, out)
        if self._splats is not None:
            self._splats.write_attributes(variant, self._uploads.points.draws, view, shared, groups, leaders, out)

    @property
    def _moved(self) -> float:
        """The share of a neighbour's weight that is left to a pixel where each is of one group: none in scenes with
        things before or behind these that are weighed by themselves, whether a view shows them or not."""
        scene = self._uploads.scene
        clear = scene.materials.translucent is not None and bool(scene.materials.translucent.any())
        others = any(one.volume is not None or one.captured is not None for one in scene.geometries)
        if clear or others or scene.instances.matte is not None or self._plan.sub_samples < 2:
            return 0.0
        return MOVED * edge_share(self._plan.filter_size)

    def _spread(self, view: SampleView, tile: PictureTile, shaded: dict[str, Texture], sums: Target) -> None:
        """Adds what the groups show to the sums."""
        targets, groups = self._targets, self._targets.groups
        weights = self.weights(view)
        reach, behind = filter_reach(self._plan.filter_size), self._plan.background
        # The weights of one lattice are constants of the program; with several it would be compiled for each.
        fixed = weights if view.offset == (0.0, 0.0) and reach == 1 else None
        program = spread_program(
            targets.buffer.lattice,
            self._passes,
            self._plan.picture,
            reach,
            fixed,
            behind,
            groups.places is not None,
            self._plan.defocus,
            self._moved,
        )
        named = {"ps_starts": groups.starts, "ps_places": groups.places, "ps_behind": targets.behind}
        if fixed is None:
            texels = weight_texels(weights)
            named["ps_weights"] = self._device.texture((texels.shape[1], texels.shape[0]), "R32F", texels.reshape(-1))
        textures = {name: texture for name, texture in named.items() if texture is not None}
        record = SPREAD_BLOCK.record(rectangle=tile.rectangle(targets.size), corner=tile.origin)
        textures = {**groups.codes, **shaded, **textures}
        self._device.draw(program, sums, uniforms=record, textures=textures, vertices=6, blend=True)
        if fixed is None:
            textures["ps_weights"].release()

    def _forget_polygons(self) -> None:
        if self._polygons is not None:
            self._polygons.release()
        self._polygons = None

    def release(self) -> None:
        self._forget_polygons()
        if self._indirect is not None:
            self._indirect.release()
        if self._splats is not None:
            self._splats.release()
