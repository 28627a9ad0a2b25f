"""Draws narrow translucent splats over all sub-samples of a picture at once, block by block."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ....core.numeric.lattice import Lattice
from ....shading.interface import Block, Interface
from ...device.owned import Owned, texture_of
from ...device.protocol import Device, Target, Texture, releases_on_failure
from ...passes.tiles import Region
from ...passes.translucent.cells import (
    DIFFERENCE_CELLS,
    EXPAND_CELLS,
    PixelBlock,
    blocks,
    difference_cells_program,
    expand_cells_program,
    first_cell,
    largest_block,
    number_texels,
    splats_in,
)
from ...passes.translucent.centres import Centres
from ...passes.translucent.few_places import (
    CHANGE_PLACES,
    DIFFERENCE_PLACES,
    DIFFERENCE_PLACES_PROGRAM,
    EXPAND_PLACES,
    Places,
    change_places_program,
    expand_places_program,
    in_part,
)
from ...passes.translucent.lit_splats import LitSplats
from ...passes.translucent.options import TranslucentOptions
from ...passes.translucent.strata import member_texels, weight_rows, widened
from ...passes.uniforms import SampleView
from ...passes.visibility.buffer import lattice_values
from .targets import VisibilityTargets

Run = Callable[[str, Callable[[], None]], None]  # runs a pass, and times it under a name


class TranslucentCells:
    """The sub-samples of one block of pixels, over which splats are blended."""

    low_pass = 0.0  # pixels^2: variance by which splats are widened

    @releases_on_failure
    def __init__(
        self, device: Device, options: TranslucentOptions, targets: VisibilityTargets, margin: int, run: Run
    ) -> None:
        """`margin`: pixels around a pixel that the pixel filter takes in. `run` times each pass."""
        self._device, self._options, self._targets, self._margin, self._run = device, options, targets, margin, run
        self._owned = owned = Owned(device)
        lattice = self._lattice
        self._cells = lattice.size(largest_block(targets.size_of_tile, margin))
        self._layer, self._place = owned.texture(self._cells, "RGBA32F"), owned.texture(self._cells, "R32F")
        self._cut = owned.texture(self._cells, "RGBA32F") if options.holdout else None
        self._expanded = self._expanded_target()
        self._blended = owned.target(self._layer, *([] if self._cut is None else [self._cut]))
        self._cut_target = None if self._cut is None else owned.target(self._cut)
        self._members = owned.filled(member_texels(lattice, np.arange(lattice.count)), "RGBA32F")

    @property
    def _lattice(self) -> Lattice:
        return self._targets.buffer.lattice

    def _expanded_target(self) -> Target:
        """What `_expand` draws into."""
        self._numbers = self._owned.filled(number_texels(self._lattice), "R32F")
        return self._owned.target(self._layer, self._place)

    def draw(
        self,
        view: SampleView,
        lit: LitSplats,
        splats: tuple[np.ndarray, np.ndarray],
        shaded: dict[str, Texture],
        weights: np.ndarray,
        tiles: np.ndarray,
        part: np.ndarray | None = None,
        centres: Centres | None = None,
    ) -> None:
        """Adds what splats change in tiles (rows, columns) bool to the differences.

        part: (H, W) bool, the pixels of these tiles that are wanted; None: all. `centres`: of the splats, if known.

        splats: centre and shape, (N, 4) each, as the pass `light` left them. `shaded`: what groups show, by sampler
        name. weights: (N, S), of the pixel filter.
        """
        mask = None if part is None else texture_of(self._device, part[..., None], "R32F")
        try:
            self._draw_blocks(view, lit, splats, shaded, weights, tiles, part, mask, centres)
        finally:
            if mask is not None:
                mask.release()

    def _draw_blocks(
        self,
        view: SampleView,
        lit: LitSplats,
        splats: tuple[np.ndarray, np.ndarray],
        shaded: dict[str, Texture],
        weights: np.ndarray,
        tiles: np.ndarray,
        part: np.ndarray | None,
        mask: Texture | None,
        centres: Centres | None,
    ) -> None:
        """`draw`, with a texture of the part, too."""
        device, size = self._device, self._targets.size_of_tile
        rows = texture_of(device, weight_rows(weights, np.arange(self._lattice.count)), "R32F")
        # The pixel filter takes in pixels of tiles beside those that change.
        around = texture_of(device, widened(tiles)[..., None], "R32F")
        reached = None if part is None else widened(part, self._margin)
        try:
            for found, own in blocks(tiles, size, self._margin):
                inside = texture_of(device, own[..., None], "R32F")
                try:
                    self._run("expand", lambda found=found: self._expand(view, found, around, shaded))
                    if self._cut_target is not None:
                        device.clear(self._cut_target)
                    some = splats_of(found, splats, view, centres, reached)
                    _, shape = splats
                    widest = float((shape[some, 0] + shape[some, 2]).max(initial=0.0))
                    self._run(
                        "translucent",
                        lambda found=found, some=some, widest=widest: self._blend(view, lit, found, some, widest),
                    )
                    self._run(
                        "difference",
                        lambda found=found, inside=inside: self._subtract(
                            view, found, rows, Region(inside), shaded, mask
                        ),
                    )
                finally:
                    inside.release()
        finally:
            rows.release()
            around.release()

    def _expand(self, view: SampleView, found: PixelBlock, around: Texture, shaded: dict[str, Texture]) -> None:
        targets = self._targets
        program = expand_cells_program(targets.behind is not None, targets.groups.places is not None)
        record = self._record_of_cells(EXPAND_CELLS, view, found)
        textures = self._shown(shaded) | {"ps_depths": targets.buffer.depths}
        textures |= {"ps_numbers": self._numbers, "ps_wanted": around}
        self._device.draw(program, self._expanded, uniforms=record, textures=textures, vertices=6)

    def _blend(self, view: SampleView, lit: LitSplats, found: PixelBlock, splats: np.ndarray, variance: float) -> None:
        lattice, size = self._lattice, self._targets.size_of_tile
        p, q, *origin = lattice_values(lattice, size)["lattice"]  # pyright: ignore[reportGeneralTypeIssues]
        corner = first_cell(lattice, found, size)
        moved = origin[0] - corner[0], origin[1] - corner[1]
        low_pass = self.low_pass * lattice.count
        lit.draw_turned(self._blended, view, self._place, (p, q), moved, splats, variance, low_pass=low_pass)

    def _subtract(
        self,
        view: SampleView,
        found: PixelBlock,
        rows: Texture,
        inside: Region,
        shaded: dict[str, Texture],
        mask: Texture | None,
    ) -> None:
        targets = self._targets
        program = difference_cells_program(self._options, targets.behind is not None, targets.groups.places is not None)
        textures = self._shown(shaded) | {"ps_layer": self._layer}
        textures |= {} if self._cut is None else {"ps_cut": self._cut}
        self._add(program, DIFFERENCE_CELLS, textures, view, found, rows, inside, mask)

    def _record_of_cells(self, fields: Block, view: SampleView, found: PixelBlock, **own: object) -> np.ndarray:
        """Uniforms of a block of pixels: where its cells and those of the picture lie."""
        lattice, size = self._lattice, self._targets.size_of_tile
        used = (side / whole for side, whole in zip(lattice.size(found.size), self._cells, strict=True))
        return view.record_of(
            fields,
            corner=first_cell(lattice, found, size),
            low=found.low,
            high=found.high,
            rectangle=(0.0, 0.0, *used),
            size_of_tile=size,
            **lattice_values(lattice, size),
            **own,
        )

    def _add(
        self,
        program: Interface,
        fields: Block,
        textures: dict[str, Texture],
        view: SampleView,
        found: PixelBlock,
        rows: Texture,
        inside: Region,
        mask: Texture | None,
    ) -> None:
        """Adds differences in a block, by a program with these uniforms that weighs its cells by `rows`."""
        textures = textures | {"ps_members": self._members, "ps_weights": rows}
        if mask is not None:
            program, textures = in_part(program), textures | {"ps_part": mask}
        neighbours = {"sub_samples": self._lattice.count, "neighbours": rows.size[1]}
        record = self._record_of_cells(fields, view, found, **neighbours)
        target = self._targets.translucent.difference_target
        inside.draw(self._device, program, target, uniforms=record, textures=textures, blend=True)

    def _shown(self, shaded: dict[str, Texture]) -> dict[str, Texture]:
        """The textures that tell what the sub-samples show, by sampler name."""
        targets, groups = self._targets, self._targets.groups
        named = {"ps_starts": groups.starts, "ps_places": groups.places, "ps_behind": targets.behind}
        textures = {name: texture for name, texture in named.items() if texture is not None}
        return textures | groups.codes | {"ps_combined": shaded["ps_combined"]}

    def release(self) -> None:
        self._owned.release()


class TranslucentPlaces(TranslucentCells):
    """The places in the pixels of one block, fewer than sub-samples, over which widened splats are blended.

    What is opaque in pixels and its depth are in the textures of the picture's layers: the first layer of each.
    """

    def __init__(
        self,
        device: Device,
        options: TranslucentOptions,
        targets: VisibilityTargets,
        places: Places,
        margin: int,
        run: Run,
    ) -> None:
        """`margin`: pixels around a pixel that the pixel filter takes in, and one more, whose places those beside them
        need. `run` times each pass."""
        self._where = places
        self.low_pass = places.deviation**2
        super().__init__(device, options, targets, margin, run)

    @property
    def _lattice(self) -> Lattice:
        return self._where.lattice

    def _expanded_target(self) -> Target:
        self._opaque, self._change = (self._owned.texture(self._cells, "RGBA32F") for _ in range(2))
        self._change_target = self._owned.target(self._change)
        return self._owned.target(self._opaque, self._place)

    def _expand(self, view: SampleView, found: PixelBlock, around: Texture, shaded: dict[str, Texture]) -> None:
        layers = self._targets.translucent
        assert layers is not None
        assert layers.opaque is not None
        record = self._record_of_cells(EXPAND_PLACES, view, found)
        textures = {"ps_opaque": layers.opaque, "ps_place": layers.place, "ps_wanted": around}
        self._device.clear(self._blended)
        program = expand_places_program(self._where)
        self._device.draw(program, self._expanded, uniforms=record, textures=textures, vertices=6)

    def _subtract(
        self,
        view: SampleView,
        found: PixelBlock,
        rows: Texture,
        inside: Region,
        shaded: dict[str, Texture],
        mask: Texture | None,
    ) -> None:
        shown = {"ps_layer": self._layer, "ps_opaque": self._opaque, "ps_place": self._place}
        spacing = CHANGE_PLACES.record(spacing=self._lattice.spacing)
        change = change_places_program(self._where)
        self._device.draw(change, self._change_target, uniforms=spacing, textures=shown)
        textures = {"ps_change": self._change}
        self._add(DIFFERENCE_PLACES_PROGRAM, DIFFERENCE_PLACES, textures, view, found, rows, inside, mask)


def splats_of(
    found: PixelBlock,
    splats: tuple[np.ndarray, np.ndarray],
    view: SampleView,
    centres: Centres | None,
    reached: np.ndarray | None,
) -> np.ndarray:
    """Returns which splats reach into a block, or into those of its pixels that are `reached` (H, W) bool, (K,) int64.
    Where `centres` are known, some others, too."""
    if centres is None:
        return splats_in(found, *splats, view.principal_point)
    width, height = centres.size
    inside = np.zeros((height, width), bool)
    inside[found.low[1] : found.high[1], found.low[0] : found.high[0]] = True
    return centres.near(inside if reached is None else inside & reached)
