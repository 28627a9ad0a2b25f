"""Blends translucent splats over the layers of a picture's sub-samples, and adds what that changes to the sums."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from ....core.numeric.pixel_filter import filter_reach, weights_of_blurred
from ...device.owned import texture_of
from ...device.protocol import Device, Target, Texture
from ...passes.tiles import TILE, Region
from ...passes.translucent.blend import COARSE, ENLARGE
from ...passes.translucent.centres import Centres, centres_of
from ...passes.translucent.few_places import LEAST_FILTER, MOST_EXACT, PLACES, steep_pixels
from ...passes.translucent.lit_splats import LitSplats
from ...passes.translucent.strata import (
    ADD_TILE,
    ADD_TILE_BLOCK,
    CENTRED,
    DIFFERENCE,
    EXPAND,
    NOWHERE,
    OPEN_LAYER,
    are_narrow,
    bounds,
    centred_program,
    difference_program,
    expand_program,
    member_texels,
    open_tiles,
    tiles_by_layer,
    tiles_with,
    touched_tiles,
    weight_rows,
    widened,
)
from ...passes.uniforms import SampleView
from ...plan.plan import Plan
from .targets import LayerTargets, VisibilityTargets
from .tiles import PictureTile
from .translucent_cells import TranslucentCells, TranslucentPlaces

Run = Callable[[str, Callable[[], None]], None]  # runs a pass, and times it under a name


class TranslucentLayers:
    """Draws the translucent splats of one picture whose opaque part the visibility buffer holds."""

    def __init__(
        self, device: Device, plan: Plan, lit: LitSplats, targets: VisibilityTargets, sums: Target, run: Run
    ) -> None:
        """`sums`: of Combined alone. `run` times each pass."""
        assert plan.translucent is not None
        self._device, self._lit, self._sums, self._run = device, lit, sums, run
        self._options = plan.translucent
        self._targets = targets
        self._difference = difference_program(plan.translucent)
        self._centred = plan.translucent.centred
        self._cells: TranslucentCells | None = None
        self._places: TranslucentPlaces | None = None
        self._filter_size = plan.filter_size

    def draw(
        self,
        view: SampleView,
        tile: PictureTile,
        shaded: dict[str, Texture],
        weights: np.ndarray,
        coarse: bool,
        drawn: np.ndarray | None,
    ) -> None:
        """Adds to the sums what translucent splats change in a tile.

        `shaded`: what groups show, by sampler name. weights: (N, S), of the pixel filter. `coarse`: one sub-sample
        stands for all, and splats are drawn at a lower resolution. `drawn`: tiles of passes in which captured splats
        are drawn already, among panes, (rows, columns) bool; None: in none.
        """
        device, lattice = self._device, self._targets.buffer.lattice
        if drawn is not None and drawn.all():
            return
        device.clear(self._layers.difference_target)
        if self._options.captured:
            # Boxes of all splats would take longer to find than tiles without any take to draw.
            every = np.arange(lattice.count)
            touched = np.ones([-(-side // TILE) for side in reversed(view.size)], bool)
            self._draw_layers(view, every, weights, shaded, touched if drawn is None else ~drawn)
            self._add(tile)
            return
        around = len(weights) ** 0.5 // 2 + 2 * COARSE
        splats = self._read_splats()
        centres = centres_of(*splats, view.principal_point, view.size)
        touched, narrow = self._touched_tiles(view, *splats, around, centres)
        every = np.arange(lattice.count)
        if coarse:
            weights = weights / weights[:, 0].sum()
            self._draw_layers(view, every[:1], weights, shaded, touched, COARSE)
        else:
            self._draw_narrow(view, splats, centres, shaded, weights, narrow)
            if (wide := touched & ~narrow).any() or not narrow.any():
                self._draw_layers(view, every, weights, shaded, wide)
        self._add(tile)

    @property
    def _layers(self) -> LayerTargets:
        return self._targets.translucent

    def _draw_narrow(
        self,
        view: SampleView,
        splats: tuple[np.ndarray, np.ndarray],
        centres: Centres | None,
        shaded: dict[str, Texture],
        weights: np.ndarray,
        tiles: np.ndarray,
    ) -> None:
        """Adds the differences in tiles (rows, columns) bool, which narrow splats touch, sub-sample by sub-sample."""
        if not tiles.any():
            return
        exact = None if centres is None else self._exact_pixels(splats, centres, tiles)
        if exact is not None:
            assert centres is not None
            self._draw_places(view, splats, centres, shaded, tiles_with(~exact) & tiles, ~exact)
            tiles = tiles_with(exact) & tiles
        if not tiles.any():
            return
        if self._cells is None:
            margin = round(len(weights) ** 0.5) // 2
            self._cells = TranslucentCells(self._device, self._options, self._targets, margin, self._run)
        self._cells.draw(view, self._lit, splats, shaded, weights, tiles, exact, centres)

    def _draw_places(
        self,
        view: SampleView,
        splats: tuple[np.ndarray, np.ndarray],
        centres: Centres,
        shaded: dict[str, Texture],
        tiles: np.ndarray,
        part: np.ndarray,
    ) -> None:
        """Adds the differences in pixels (H, W) bool of tiles (rows, columns) bool, at a few places of each."""
        lattice = self._targets.buffer.lattice
        with (
            self._texture(member_texels(lattice, np.arange(lattice.count)), "RGBA32F") as members,
            self._texture(widened(tiles)[..., None], "R32F") as around,
        ):
            self._run("expand", lambda: self._expand(view, 0, members, shaded, Region(around)))
        if self._places is None:
            margin = self._reach_of_places
            self._places = TranslucentPlaces(self._device, self._options, self._targets, PLACES, margin, self._run)
        fitted = weights_of_blurred(PLACES.lattice, view.offset, self._filter_size, PLACES.deviation)
        whole = bool(part.all())
        self._places.draw(view, self._lit, splats, shaded, fitted, tiles, None if whole else part, centres)

    def _exact_pixels(
        self, splats: tuple[np.ndarray, np.ndarray], centres: Centres, tiles: np.ndarray
    ) -> np.ndarray | None:
        """Returns in which pixels each sub-sample has to be looked at, (H, W) bool; None: in most.

        tiles: (rows, columns) bool, that narrow splats touch.
        """
        options, fewer = self._options, PLACES.lattice.count < self._targets.buffer.lattice.count
        if options.kernels or options.holdout or options.tint or self._filter_size < LEAST_FILTER or not fewer:
            return None
        layers = self._targets.groups.layers
        exact = (layers > 1) | steep_pixels(*splats, centres, PLACES.steep)
        exact = widened(exact, self._reach_of_places)
        inside = tiles.repeat(TILE, axis=0).repeat(TILE, axis=1)[: exact.shape[0], : exact.shape[1]]
        return None if np.count_nonzero(exact & inside) > MOST_EXACT * np.count_nonzero(inside) else exact

    @property
    def _reach_of_places(self) -> int:
        """How many pixels away the places lie that a pixel takes in."""
        return filter_reach(self._filter_size) + 1

    def _add(self, tile: PictureTile) -> None:
        """Adds the differences of a tile to the sums."""
        device, layers = self._device, self._layers
        record = ADD_TILE_BLOCK.record(rectangle=tile.rectangle(self._targets.size), corner=tile.origin)
        textures = {"ps_difference": layers.difference}
        self._run(
            "add", lambda: device.draw(ADD_TILE, self._sums, uniforms=record, textures=textures, vertices=6, blend=True)
        )

    def _read_splats(self) -> tuple[np.ndarray, np.ndarray]:
        """Returns centre and shape of all splats, (N, 4) each, as the pass `light` left them."""
        lit = self._lit
        centre, shape = (
            self._device.read(lit.textures[name]).reshape(-1, 4)[: lit.count] for name in ("ps_centre", "ps_shape")
        )
        return centre, shape

    def _touched_tiles(
        self, view: SampleView, centre: np.ndarray, shape: np.ndarray, around: float, centres: Centres | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Returns which tiles splats touch, and which of them narrow ones touch, (rows, columns) bool each.

        centre, shape: (N, 4) each. around: pixels around a splat that count as touched.
        """
        narrow = are_narrow(shape, self._options.kernels)
        if centres is not None and narrow.all():
            touched = centres.tiles(around)
            return touched, touched
        where = view.principal_point, view.size, around
        touched = touched_tiles(centre, shape, *where)
        if narrow.all():
            return touched, touched
        return touched, touched_tiles(centre[narrow], shape[narrow], *where) if narrow.any() else np.zeros_like(touched)

    def _draw_layers(
        self,
        view: SampleView,
        members: np.ndarray,
        weights: np.ndarray,
        shaded: dict[str, Texture],
        tiles: np.ndarray,
        pixels: int = 1,
    ) -> None:
        """Adds the differences in tiles (rows, columns) bool, layer by layer of each pixel.

        members: sub-samples (K,) whose layers these are. `pixels`: of the picture along one of what splats are drawn
        into.
        """
        lattice, groups = self._targets.buffer.lattice, self._targets.groups
        apart = self._options.open_apart
        layers = tiles_by_layer(groups.covered if apart else groups.layers, tiles)
        with (
            self._texture(member_texels(lattice, members), "RGBA32F") as texels,
            self._texture(weight_rows(weights, members), "R32F") as rows,
        ):
            if apart and (where := open_tiles(groups.layers, groups.covered, tiles)).any():
                self._draw_layer(view, OPEN_LAYER, (texels, rows), shaded, where, pixels)
            for layer, where in enumerate(layers[: len(members)]):
                if apart and not where.any():
                    continue
                self._draw_layer(view, layer, (texels, rows), shaded, where, pixels)

    def _draw_layer(
        self,
        view: SampleView,
        layer: int,
        tables: tuple[Texture, Texture],
        shaded: dict[str, Texture],
        tiles: np.ndarray,
        pixels: int,
    ) -> None:
        """Adds the differences of a layer in tiles.

        `tables`: the sub-samples whose layers these are, and what the pixel filter weighs them by.
        """
        members, rows = tables
        # The pixel filter takes in pixels of tiles beside those that change.
        outer = tiles if self._centred else widened(tiles)
        with self._texture(tiles[..., None], "R32F") as inside, self._texture(outer[..., None], "R32F") as around:
            self._device.clear(self._layers.place_target, (NOWHERE, -1.0, 0.0, 0.0))
            self._run("expand", lambda: self._expand(view, layer, members, shaded, Region(around)))
            self._blend(view, outer, pixels, None if layer == OPEN_LAYER else self._layers.place)
            self._run("difference", lambda: self._subtract(view, members, rows, shaded, Region(inside)))

    @contextmanager
    def _texture(self, texels: np.ndarray, format: str) -> Iterator[Texture]:
        """A texture of texels (rows, columns, channels) that is released after use."""
        made = texture_of(self._device, texels, format)
        try:
            yield made
        finally:
            made.release()

    def _expand(
        self, view: SampleView, layer: int, members: Texture, shaded: dict[str, Texture], region: Region
    ) -> None:
        targets, groups, buffer = self._targets, self._targets.groups, self._targets.buffer
        program = expand_program(
            targets.behind is not None, groups.places is not None, self._centred, self._options.open_apart,
            self._options.mattes,
        )  # fmt: skip
        record = view.record(EXPAND, sub_samples=members.size[0], layer=layer, **buffer.values)
        named = {"ps_starts": groups.starts, "ps_places": groups.places, "ps_behind": targets.behind}
        textures = {name: texture for name, texture in named.items() if texture is not None}
        textures |= {"ps_depths": buffer.depths, "ps_combined": shaded["ps_combined"], "ps_members": members}
        textures |= groups.codes | ({"ps_matte": shaded["ps_matte"]} if self._options.mattes else {})
        region.draw(self._device, program, self._layers.expanded, uniforms=record, textures=textures)

    def _blend(self, view: SampleView, tiles: np.ndarray, pixels: int, place: Texture | None) -> None:
        device, layers, lit, around = self._device, self._layers, self._lit, bounds(tiles)
        if self._options.captured:
            view = replace(view, offset=(0.0, 0.0))
        if layers.cut is not None:
            device.clear(layers.cut_target)
        if pixels == 1:
            self._run("translucent", lambda: lit.draw(layers.blended, view, place, bounds=around, tiles=tiles))
            return
        device.clear(layers.coarse_target)
        self._run("translucent", lambda: lit.draw(layers.coarse_target, view, place, pixels, around))
        textures = {"ps_coarse": layers.coarse}
        self._run("enlarge", lambda: device.draw(ENLARGE, layers.blended, textures=textures, over=True))

    def _subtract(
        self, view: SampleView, members: Texture, rows: Texture, shaded: dict[str, Texture], region: Region
    ) -> None:
        layers = self._layers
        if self._centred:
            self._subtract_centred(view, members, rows, shaded, region)
            return
        assert layers.opaque is not None
        textures = {**self._targets.groups.codes, "ps_layer": layers.layer, "ps_opaque": layers.opaque}
        textures |= {"ps_place": layers.place, "ps_members": members, "ps_weights": rows}
        textures |= {} if layers.cut is None else {"ps_cut": layers.cut}
        record = DIFFERENCE.record(sub_samples=members.size[0], neighbours=rows.size[1])
        region.draw(
            self._device, self._difference, layers.difference_target, uniforms=record, textures=textures, blend=True
        )

    def _subtract_centred(
        self, view: SampleView, members: Texture, rows: Texture, shaded: dict[str, Texture], region: Region
    ) -> None:
        """Adds what splats change in a layer, looked at in pixels' centres alone."""
        targets, layers, groups, buffer = self._targets, self._layers, self._targets.groups, self._targets.buffer
        named = {"ps_starts": groups.starts, "ps_places": groups.places, "ps_behind": targets.behind}
        named |= {"ps_cut": layers.cut}
        textures = {name: texture for name, texture in named.items() if texture is not None}
        textures |= {**groups.codes, "ps_layer": layers.layer, "ps_place": layers.place, "ps_depths": buffer.depths}
        textures |= {"ps_combined": shaded["ps_combined"], "ps_members": members, "ps_weights": rows}
        program = centred_program(self._options, targets.behind is not None, groups.places is not None)
        counts = {"sub_samples": members.size[0], "neighbours": rows.size[1]}
        record = view.record(CENTRED, **counts, **buffer.values)
        region.draw(self._device, program, layers.difference_target, uniforms=record, textures=textures, blend=True)

    def release(self) -> None:
        for cells in (self._cells, self._places):
            if cells is not None:
                cells.release()
