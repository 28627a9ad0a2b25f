"""Draws the panes of one picture, layer by layer, over the opaque part that the visibility buffer holds."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace

import numpy as np

from ....core.scene.scene import Scene
from ...device.owned import Owned, texture_of
from ...device.protocol import Device, Target, Texture, releases_on_failure
from ...passes.gbuffer import GBuffer
from ...passes.grouping.groups import Groups, Leaders
from ...passes.translucent.before_panes import NOTHING
from ...passes.translucent.blend import COARSE
from ...passes.translucent.cells import number_texels
from ...passes.translucent.lit_splats import LitSplats
from ...passes.translucent.pane_layers import (
    BARE,
    COMPOSE,
    FILTER,
    STATE,
    change_program,
    compose_program,
    filter_program,
)
from ...passes.translucent.strata import member_texels, weight_rows
from ...passes.uniforms import SampleView
from ...passes.visibility.buffer import VisibilityBuffer
from ...passes.visibility.polygon_ids import FOLLOWING, OPAQUE, PolygonCover
from ...passes.visibility.polygon_mesh import THROUGH
from ...plan.plan import Plan
from ...prepare.prepare import Prepared
from ..indirect.light import GroupsInIndirectLight
from ..shading import Shading
from ..uploads.polygons import PolygonUploads
from ..uploads.uploads import Uploads
from ..visibility.placed import placed_textures
from ..visibility.polygon_draws import polygon_draws
from ..visibility.targets import VisibilityTargets
from ..visibility.tiles import PictureTile
from .splats import SplatsBeforePanes

MOST_LAYERS = 128
Run = Callable[[str, Callable[[], None]], None]  # runs a pass, and times it under a name


@dataclass(eq=False)
class _Panes:
    """The panes of a view, for `polygon_draws`."""

    scene: Scene
    prepared: Prepared  # whose polygons they are
    polygons: PolygonUploads


class Panes:
    """Draws the panes of one picture."""

    @releases_on_failure
    def __init__(
        self,
        device: Device,
        plan: Plan,
        uploads: Uploads,
        targets: VisibilityTargets,
        shading: Shading,
        sums: Target,
        run: Run,
        indirect: GroupsInIndirectLight | None,
        lit: LitSplats | None,
    ) -> None:
        """`sums`: of Combined alone. `run` times each pass. `indirect`: light that surfaces receive from each other.
        `lit`: translucent splats among the panes, that are drawn with these."""
        self._device, self._plan, self._uploads, self._targets = device, plan, uploads, targets
        self._shading, self._sums, self._run, self._indirect = shading, sums, run, indirect
        self._owned = owned = Owned(device)
        lattice, cells = targets.buffer.lattice, targets.buffer.cells
        self._buffer = owned.add(VisibilityBuffer(device, lattice, targets.size_of_tile))
        self._splats: SplatsBeforePanes | None = None
        if lit is not None:
            self._splats = owned.add(SplatsBeforePanes(device, plan, lit, self._buffer, run))
        self._centred = self._splats is not None and self._splats.centred
        self._groups = owned.add(Groups(device, self._buffer))
        held = STATE | (BARE if self._centred else {})
        self._states = [{name: owned.texture(cells, format) for name, format in held.items()} for _ in range(2)]
        self._state_targets = [owned.target(*state.values()) for state in self._states]
        self._left = [owned.texture(cells, "R32F")] if self._centred else []
        written = ("ps_light", "ps_hidden", "ps_bare") if self._centred else ("ps_light",)
        self._change_targets = [owned.target(*(of[name] for name in written), *self._left) for of in self._states]
        self._numbers = owned.filled(number_texels(lattice), "R32F")
        self._members = owned.filled(member_texels(lattice, np.arange(lattice.count)), "RGBA32F")

    def draw(
        self, view: SampleView, tile: PictureTile, shaded: dict[str, Texture], weights: np.ndarray, coarse: bool
    ) -> np.ndarray | None:
        """Adds to the sums what panes, and translucent splats among them, change in a tile of the picture.

        `shaded`: what opaque groups show, by sampler name. weights: (N, S), of the pixel filter. `coarse`: splats are
        drawn at a lower resolution. Returns in which tiles of passes splats were drawn, (rows, columns) bool; None: in
        none.
        """
        device, uploads = self._device, self._uploads
        panes = _Panes(uploads.scene, replace(uploads.prepared, polygons=uploads.prepared.panes), uploads.polygons)
        draws = polygon_draws(device, panes, view, 0, None)
        if self._splats is not None:
            self._splats.look(view, len(weights) ** 0.5 // 2 + 2 * COARSE, coarse)
        last = None if self._splats is None or self._centred else 0
        device.clear(self._state_targets[0])
        if draws:
            cover = PolygonCover(device, draws, self._buffer, self._plan.variant.normal, (FOLLOWING, OPAQUE))
            try:
                composed = self._draw_layers(view, cover)
            finally:
                cover.release()
            last = last if composed is None else composed
        if last is None:
            return None
        self._add(view, tile, shaded, weights, last)
        return None if self._splats is None else self._splats.tiles

    def _draw_layers(self, view: SampleView, cover: PolygonCover) -> int | None:
        """Composes all layers, and returns which of the states holds them; None: there are none."""
        device, current = self._device, 0
        for layer in range(MOST_LAYERS):
            state = self._states[current]
            peeled = {OPAQUE: self._targets.buffer.depths, FOLLOWING: state[FOLLOWING]}
            self._buffer.clear()
            self._run("polygons", lambda peeled=peeled: cover.rasterise(view, {**self._uploads.shared, **peeled}))
            self._run("group", lambda: self._group(view, cover))
            if self._groups.total == 0:
                return None if layer == 0 else current
            if layer == 0 and self._splats is not None:
                self._splats.note_panes(self._groups)
            assert self._groups.leaders is not None
            leaders = self._groups.leaders
            lists = self._targets.lists_of_panes(leaders.size)
            lists.surfaces.clear()
            device.clear(lists.target)
            through: list[Texture] = []
            try:
                self._run(
                    "attributes",
                    lambda leaders=leaders, lists=lists, through=through: through.append(
                        self._write_attributes(view, cover, leaders, lists.surfaces)
                    ),
                )
                self._shade(view, leaders, lists.surfaces, lists.target)
                before = self._draw_splats(view, self._buffer, self._groups, open_too=False)
                shown = {THROUGH: through[0], "ps_combined": lists.shaded["ps_combined"]}
                self._run(
                    "compose",
                    lambda state=state, shown=shown, before=before, current=current: self._compose(
                        view, {**state, **shown, **before}, self._state_targets[1 - current]
                    ),
                )
            finally:
                for texture in through:
                    texture.release()
            current = 1 - current
        return current

    def _group(self, view: SampleView, cover: PolygonCover) -> None:
        self._groups.group(view)
        if self._groups.total:
            self._groups.sort(view, [draw.first_id for draw in cover.draws])

    def _write_attributes(self, view: SampleView, cover: PolygonCover, leaders: Leaders, out: GBuffer) -> Texture:
        """Writes the attributes of groups, and returns what passes them."""
        variant, scene, lattice = self._plan.variant, self._uploads.scene, self._buffer.lattice
        placed = placed_textures(
            self._device,
            scene,
            cover.draws,
            variant,
            view,
            lattice,
            self._groups,
            leaders,
            translucent=True,
            term=self._plan.term,
        )
        through = placed.pop(THROUGH)
        with ExitStack() as unfinished:
            unfinished.callback(through.release)
            try:
                cover.write_attributes(variant, view, self._uploads.shared, self._groups, leaders, out, placed)
            finally:
                for texture in placed.values():
                    texture.release()
            unfinished.pop_all()
        return through

    def _shade(self, view: SampleView, leaders: Leaders, surfaces: GBuffer, target: Target) -> None:
        received: dict[str, Texture] = {}
        if self._indirect is not None:
            indirect, listed, entries = self._indirect, leaders.list, self._groups.entries
            assert listed is not None
            self._run("gather", lambda: received.update(indirect.gather(view, surfaces, listed, entries)))
        groups = leaders.bound | self._groups.codes
        self._run("shade", lambda: self._shading.shade_groups(view, surfaces, groups, self._buffer, target, received))

    def _draw_splats(
        self, view: SampleView, buffer: VisibilityBuffer, groups: Groups, open_too: bool
    ) -> dict[str, Texture]:
        """Draws the translucent splats before what a buffer shows: see SplatsBeforePanes."""
        if self._splats is None:
            return {}
        return self._splats.draw(view, buffer, groups, open_too)

    def _compose(self, view: SampleView, textures: dict[str, Texture], target: Target) -> None:
        found = NOTHING if self._splats is None else self._splats.found(open_too=False)
        program = compose_program(self._groups.places is not None, self._plan.term, found)
        bound = {**_listed(self._groups), **textures, "ps_numbers": self._numbers, "ps_depths": self._buffer.depths}
        record = view.record(COMPOSE, **self._buffer.values)
        self._device.draw(program, target, uniforms=record, textures=bound)

    def _add(
        self, view: SampleView, tile: PictureTile, shaded: dict[str, Texture], weights: np.ndarray, last: int
    ) -> None:
        """Adds what the layers of a state change in a tile to the sums."""
        before = self._draw_splats(view, self._targets.buffer, self._targets.groups, open_too=True)
        self._run("add", lambda: self._filter(view, tile, shaded | before, weights, last))

    def _filter(
        self, view: SampleView, tile: PictureTile, shown: dict[str, Texture], weights: np.ndarray, last: int
    ) -> None:
        """Adds what a state changes to the sums. `shown`: what opaque groups show, and splats before them, by sampler
        name."""
        device, targets, lattice = self._device, self._targets, self._buffer.lattice
        behind = {} if targets.behind is None else {"ps_behind": targets.behind}
        found = NOTHING if self._splats is None else self._splats.found(open_too=True)
        program = change_program(targets.behind is not None, targets.groups.places is not None, found)
        state, other = self._states[last], self._states[1 - last]
        textures = {**_listed(targets.groups), **behind, **shown, "ps_numbers": self._numbers}
        textures |= {name: state[name] for name in ("ps_light", "ps_hidden", *(BARE if self._centred else ()))}
        record = view.record(COMPOSE, **self._buffer.values)
        device.draw(program, self._change_targets[1 - last], uniforms=record, textures=textures)
        rows = weight_rows(weights, np.arange(lattice.count))
        with_rows = texture_of(device, rows, "R32F")
        try:
            record = view.record(
                FILTER, rectangle=tile.rectangle(targets.size), corner=tile.origin, sub_samples=lattice.count,
                neighbours=len(rows), **self._buffer.values,
            )  # fmt: skip
            bound = {"ps_change": other["ps_light"], "ps_members": self._members, "ps_weights": with_rows}
            if self._centred:
                bound |= {"ps_seen": other["ps_hidden"], "ps_bare": other["ps_bare"], "ps_left": self._left[0]}
            program = filter_program(lattice, self._centred)
            device.draw(program, self._sums, uniforms=record, textures=bound, vertices=6, blend=True)
        finally:
            with_rows.release()

    def release(self) -> None:
        self._owned.release()


def _listed(groups: Groups) -> dict[str, Texture]:
    """What tells which group of the list each sub-sample shows, by sampler name."""
    assert groups.starts is not None
    places = {} if groups.places is None else {"ps_places": groups.places}
    return {**groups.codes, "ps_starts": groups.starts, **places}
