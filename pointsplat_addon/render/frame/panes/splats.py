"""Draws translucent splats up to the depths of a layer of panes, or of what is opaque."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ....core.splat.kernel import SUPPORT
from ...device.owned import Owned, texture_of
from ...device.protocol import Device, Target, Texture, releases_on_failure
from ...passes.grouping.groups import Groups
from ...passes.tiles import TILE
from ...passes.translucent.before_panes import (
    DENSE,
    KEEP,
    LOW_PASS,
    OPEN_LAYER,
    PLACE,
    PLACE_CELLS,
    Found,
    keep_program,
    place_cells_program,
    place_program,
)
from ...passes.translucent.blend import COARSE, ENLARGE
from ...passes.translucent.lit_splats import LitSplats
from ...passes.translucent.strata import are_narrow, bounds, splats_over, tiles_by_layer, touched_tiles, widened
from ...passes.uniforms import SampleView
from ...passes.visibility.buffer import VisibilityBuffer
from ...plan.plan import Plan

BEFORE = 6.0  # standard deviations along a ray, see ps_below
Run = Callable[[str, Callable[[], None]], None]  # runs a pass, and times it under a name


@dataclass(eq=False)
class _Where:
    """Tiles, (rows, columns) bool, that splats touch."""

    narrow: np.ndarray  # in which they are looked at in each sub-sample
    wide: np.ndarray  # in which once for each group
    mask: Texture | None  # of the narrow ones; None: there are none
    low_pass: float  # of splats in the wide ones


@dataclass(eq=False)
class _Splats:
    """The splats of one view, as the pass `light` left them, (N, 4) each, and where they are."""

    centre: np.ndarray
    shape: np.ndarray
    nearest: np.ndarray  # (N,): depths before which they neither send nor hide anything
    before_panes: _Where
    before_opaque: _Where

    def over(self, tiles: np.ndarray, view: SampleView, farthest: float) -> tuple[np.ndarray, float]:
        """Returns which splats touch some of tiles (rows, columns) bool and begin before the depth `farthest`, (K,)
        int64, and the greatest sum of both axes' variances, in square pixels."""
        rows = splats_over(tiles, self.centre, self.shape, view.principal_point)
        rows = rows[self.nearest[rows] < farthest]
        rows = rows if len(rows) else np.arange(min(len(self.centre), 1))  # what is planned is drawn
        return rows, float((self.shape[rows, 0] + self.shape[rows, 2]).max(initial=0.0))


def _nearest(centre: np.ndarray, shape: np.ndarray, front: np.ndarray) -> np.ndarray:
    """Returns depths before which splats neither send nor hide anything, (N,), by shaders/translucent/blend.frag."""
    with np.errstate(all="ignore"):
        half = np.sqrt(SUPPORT * (np.maximum(shape[:, [0, 2]], 0) + LOW_PASS))
        found = centre[:, 2] - BEFORE * front[:, 0] - (half * np.abs(front[:, 1:3])).sum(axis=1)
        return np.where(np.isfinite(found), found, -np.inf)


class SplatsBeforePanes:
    """The translucent splats of one picture, among panes.

    Textures by sampler name: `ps_listed` has of each group of the layer that was drawn last the light of splats before
    it, and in w the share that they hide, where these are wide; `ps_cells` has the same of each cell where some are
    narrow, and `ps_open` of what is open. Where the light that passes is coloured, `ps_listed_depths` and the like have
    optical depths of each channel.
    """

    @releases_on_failure
    def __init__(self, device: Device, plan: Plan, lit: LitSplats, buffer: VisibilityBuffer, run: Run) -> None:
        """`buffer`: of a tile of the picture. `run` times each pass."""
        assert plan.translucent is not None
        self._device, self._lit, self._run, self._options = device, lit, run, plan.translucent
        self.tint = plan.translucent.tint
        self.centred = plan.translucent.captured  # all are looked at in pixels' centres, and only where panes are
        self._buffer_size, self._cells_size = buffer.size, buffer.cells
        self._owned = owned = Owned(device)
        self._names = ("", "_depths") if self.tint else ("",)
        self._pixels = {name: owned.texture(buffer.size, "RGBA32F") for name in self._names}
        self._pixel_targets = {name: owned.target(texture) for name, texture in self._pixels.items()}
        self._open: dict[str, Texture] = {}
        self._open_targets: dict[str, Target] = {}
        self._place = owned.texture(buffer.size, "R32F")
        self._place_target = owned.target(self._place)
        self._coarse_target: Target | None = None
        if plan.coarse:
            size = -(-buffer.size[0] // COARSE), -(-buffer.size[1] // COARSE)
            self._coarse = owned.texture(size, "RGBA32F")
            self._coarse_target = owned.target(self._coarse)
        self._cells: dict[str, Texture] = {}
        self._cell_targets: dict[str, Target] = {}
        self._cell_place_target: Target | None = None
        self._lists: dict[str, Texture] = {}
        self._list_target: Target | None = None
        self._seen: _Splats | None = None

    def look(self, view: SampleView, around: float, coarse: bool) -> None:
        """Finds where splats are in a view of a tile. `around`: pixels around a splat that count as touched.
        `coarse`: they are drawn at a lower resolution, and looked at once for each group."""
        self._forget()
        if self.centred:
            nowhere, nothing = np.zeros([-(-side // TILE) for side in reversed(view.size)], bool), np.empty((0, 4))
            where = _Where(nowhere, nowhere, None, 0.0)
            self._seen, self._coarse_now = _Splats(nothing, nothing, nothing[:, 0], where, where), False
            return
        centre, shape, front = (
            self._device.read(self._lit.textures[name]).reshape(-1, 4)[: self._lit.count]
            for name in ("ps_centre", "ps_shape", "ps_front")
        )
        where = view.principal_point, view.size, around
        touched = touched_tiles(centre, shape, *where)
        touched[0, 0] |= not touched.any()  # what is planned is drawn
        thin = are_narrow(shape, self._options.kernels) & (not coarse)
        dense, thin_tiles = (
            touched_tiles(centre[some], shape[some], *where) if some.any() else np.zeros_like(touched)
            for some in (thin & (centre[:, 3] > DENSE), thin)
        )
        low_pass = LOW_PASS if thin.any() else 0.0
        before_panes = _Where(dense, touched & ~dense, self._narrow_mask(dense), low_pass)
        before_opaque = _Where(thin_tiles, touched & ~thin_tiles, self._narrow_mask(thin_tiles), low_pass)
        self._seen = _Splats(centre, shape, _nearest(centre, shape, front), before_panes, before_opaque)
        self._coarse_now = coarse

    def note_panes(self, groups: Groups) -> None:
        """Takes note of where the nearest panes are: before what is opaque there, splats are looked at as before these.

        `groups`: of the first layer.
        """
        assert self._seen is not None
        if self.centred:
            # The pixel filter takes in pixels of tiles beside those with panes.
            nowhere = self._seen.before_panes.narrow
            panes = widened(tiles_by_layer(groups.covered, ~nowhere)[0])
            where = _Where(nowhere, panes, None, 0.0)
            self._seen = replace(self._seen, before_panes=where, before_opaque=where)
            return
        seen, touched = self._seen, self._seen.before_opaque.narrow
        narrow = seen.before_panes.narrow | (touched & ~tiles_by_layer(groups.covered, touched)[0])
        wide = (seen.before_opaque.wide | touched) & ~narrow
        if seen.before_opaque.mask is not None:
            seen.before_opaque.mask.release()
        seen.before_opaque = _Where(narrow, wide, self._narrow_mask(narrow), seen.before_panes.low_pass)

    @property
    def tiles(self) -> np.ndarray:
        """The tiles in which they are drawn among panes, (rows, columns) bool."""
        assert self._seen is not None
        return self._seen.before_opaque.narrow | self._seen.before_opaque.wide

    def found(self, open_too: bool) -> Found:
        """Where splats are, which programs that read what is drawn depend on."""
        where = self._where(open_too)
        return Found(bool(where.narrow.any()), bool(where.wide.any()), self.tint, self.centred)

    def _where(self, open_too: bool) -> _Where:
        assert self._seen is not None
        return self._seen.before_opaque if open_too else self._seen.before_panes

    def draw(self, view: SampleView, buffer: VisibilityBuffer, groups: Groups, open_too: bool) -> dict[str, Texture]:
        """Draws the splats before what a buffer shows, and returns the textures that programs read: see Found.

        `groups`: of the buffer. `open_too`: all of them, too, where nothing is.
        """
        where, textures = self._where(open_too), {}
        farthest = np.inf if open_too or self.centred else self._farthest(view, groups)
        if where.narrow.any():
            self._draw_cells(view, buffer, groups, open_too, farthest)
            assert where.mask is not None
            textures |= {f"ps_cells{name}": texture for name, texture in self._cells.items()}
            textures["ps_narrow"] = where.mask
        if where.wide.any():
            self._draw_layers(view, groups, where, farthest)
            textures |= self._lists
            if open_too:
                self._draw_open(view, groups, where)
                textures |= {f"ps_open{name}": texture for name, texture in self._open.items()}
        return textures

    def _farthest(self, view: SampleView, groups: Groups) -> float:
        """The greatest depth of all groups."""
        assert groups.leaders is not None
        bits = self._device.read(groups.leaders.textures["ps_leader_depths"]).reshape(-1)[: groups.total]
        return float(bits.view(np.float32).max(initial=0.0)) + view.camera.near

    # Wide splats

    def _draw_layers(self, view: SampleView, groups: Groups, where: _Where, farthest: float) -> None:
        """Draws splats up to the middle of each group of pixels in tiles that only wide ones touch."""
        assert groups.leaders is not None
        self._fit_lists(groups.leaders.size)
        assert self._list_target is not None
        self._device.clear(self._list_target)
        for layer, tiles in enumerate(tiles_by_layer(groups.covered, where.wide)):
            if not tiles.any():
                continue
            self._draw_layer(view, groups, layer, tiles, self._pixel_targets, where.low_pass, farthest)
            self._run("compose", lambda layer=layer: self._keep(view, groups, layer))

    def _draw_open(self, view: SampleView, groups: Groups, where: _Where) -> None:
        """Draws all splats where nothing is behind them."""
        if not self._open:
            self._open = {name: self._owned.texture(self._buffer_size, "RGBA32F") for name in self._names}
            self._open_targets = {name: self._owned.target(texture) for name, texture in self._open.items()}
        tiles = tiles_by_layer(groups.layers - groups.covered, where.wide)[0]
        self._draw_layer(view, groups, OPEN_LAYER, tiles, self._open_targets, where.low_pass, np.inf)

    def _draw_layer(
        self,
        view: SampleView,
        groups: Groups,
        layer: int,
        tiles: np.ndarray,
        targets: dict[str, Target],
        low_pass: float,
        farthest: float,
    ) -> None:
        """Draws splats over nothing up to the depth of a layer in tiles (rows, columns) bool."""
        assert self._seen is not None
        device, around, run = self._device, bounds(tiles), self._run
        wanted = texture_of(self._device, tiles, "R32F")
        try:
            run("expand", lambda: self._expand(view, groups, layer, wanted))
        finally:
            wanted.release()
        for target in targets.values():
            device.clear(target)
        if self._coarse_now and (coarse := self._coarse_target) is not None:
            device.clear(coarse)
            run("translucent", lambda: self._lit.draw(coarse, view, self._place, COARSE, around))
            textures = {"ps_coarse": self._coarse}
            run("enlarge", lambda: device.draw(ENLARGE, targets[""], textures=textures, over=True))
            return
        if self.centred:
            seen = replace(view, offset=(0.0, 0.0))
            where = targets[""], seen, self._place
            run("translucent", lambda: self._lit.draw(*where, bounds=around, tiles=tiles))
            return
        rows, widest = self._seen.over(tiles, view, farthest)
        where = view, self._place, (1.0, 0.0), (0.0, 0.0), rows, widest, around, low_pass
        for name, target in targets.items():
            run(
                "translucent",
                lambda name=name, target=target: self._lit.draw_turned(target, *where, depths=bool(name)),
            )

    def _expand(self, view: SampleView, groups: Groups, layer: int, wanted: Texture) -> None:
        assert groups.leaders is not None
        assert groups.starts is not None
        places = {} if groups.places is None else {"ps_places": groups.places}
        depths = {"ps_leader_depths": groups.leaders.textures["ps_leader_depths"]}
        textures = {**groups.codes, **depths, **places, "ps_starts": groups.starts, "ps_wanted": wanted}
        record = view.record(PLACE, layer=layer)
        self._device.draw(place_program(bool(places)), self._place_target, uniforms=record, textures=textures)

    def _keep(self, view: SampleView, groups: Groups, layer: int) -> None:
        assert groups.leaders is not None
        assert groups.leaders.list is not None
        assert self._list_target is not None
        textures = {"ps_list": groups.leaders.list, "ps_layer": self._pixels[""]}
        if self.tint:
            textures["ps_layer_depths"] = self._pixels["_depths"]
        record = view.record(KEEP, layer=layer)
        self._device.draw(keep_program(self.tint), self._list_target, uniforms=record, textures=textures)

    def _fit_lists(self, size: tuple[int, int]) -> None:
        """Makes lists of this size, if those of before do not fit."""
        if self._lists and self._lists["ps_listed"].size == size:
            return
        self._release_lists()
        for name in self._names:
            self._lists[f"ps_listed{name}"] = self._device.texture(size, "RGBA32F")
        self._list_target = self._device.target(list(self._lists.values()))

    # Narrow splats

    def _draw_cells(
        self, view: SampleView, buffer: VisibilityBuffer, groups: Groups, open_too: bool, farthest: float
    ) -> None:
        """Draws splats up to the depth of each sub-sample in tiles that narrow ones touch."""
        assert self._seen is not None
        if not self._cells:
            self._cells = {name: self._owned.texture(self._cells_size, "RGBA32F") for name in self._names}
            self._cell_targets = {name: self._owned.target(texture) for name, texture in self._cells.items()}
            self._cell_place = self._owned.texture(self._cells_size, "R32F")
            self._cell_place_target = self._owned.target(self._cell_place)
        counts = groups.layers if open_too else groups.covered
        tiles = tiles_by_layer(counts, self._where(open_too).narrow)[0]
        for target in self._cell_targets.values():
            self._device.clear(target)
        rows, widest = self._seen.over(tiles, view, farthest)
        wanted = texture_of(self._device, tiles, "R32F")
        try:
            self._run("expand", lambda: self._expand_cells(view, buffer, wanted, open_too))
        finally:
            wanted.release()
        p, q, *origin = buffer.values["lattice"]  # pyright: ignore[reportGeneralTypeIssues]
        where = view, self._cell_place, (p, q), (origin[0], origin[1]), rows, widest
        for name, target in self._cell_targets.items():
            self._run(
                "translucent",
                lambda name=name, target=target: self._lit.draw_turned(target, *where, depths=bool(name)),
            )

    def _expand_cells(self, view: SampleView, buffer: VisibilityBuffer, wanted: Texture, open_too: bool) -> None:
        assert self._cell_place_target is not None
        record = view.record(PLACE_CELLS, **buffer.values)
        textures = {"ps_depths": buffer.depths, "ps_wanted": wanted}
        program = place_cells_program(open_too)
        self._device.draw(program, self._cell_place_target, uniforms=record, textures=textures)

    def _narrow_mask(self, tiles: np.ndarray) -> Texture | None:
        """A texture of tiles (rows, columns) bool; None where there are none."""
        return texture_of(self._device, tiles, "R32F") if tiles.any() else None

    def _forget(self) -> None:
        """Releases what is known of a view."""
        if self._seen is not None:
            for where in (self._seen.before_panes, self._seen.before_opaque):
                if where.mask is not None:
                    where.mask.release()
        self._seen = None

    def _release_lists(self) -> None:
        for item in (*self._lists.values(), *(() if self._list_target is None else (self._list_target,))):
            item.release()
        self._lists, self._list_target = {}, None

    def release(self) -> None:
        self._forget()
        self._release_lists()
        self._owned.release()
