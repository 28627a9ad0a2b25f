"""EWA splatting: splats as elliptical Gaussians that are blended and normalised (Zwicker et al. 2001, Ren et al. 2002).

Four passes. `splats` projects every splat once for all samples of a view; then, sample by sample, `visibility` finds
the nearest surface under each pixel's centre, `blend` adds up the attributes of all splats of that surface, weighted by
their kernels, and `normalise` divides by the sum of the weights, into the G-buffer that polygons and spheres share.

What `splats` leaves of each drawn element, one texel each:
  centre    centre in pixels from the principal point; depth; 1 + 2 instance (small), 2 + 2 instance (large), 0: not
            drawn; negative where the splat shows its back
  shape     covariance in pixels^2 (xx, xy, yy) without low-pass, its rim at 2 sigma; material (-1 - m: a holdout)
  front     change of depth per pixel (x, y); share of the ellipse that the splat stands for; depth within which it is
            one surface with others
  normal    in view space, (0, 0, 0) for a ball; roughness   \\
  color     base colour, metallic                            | where the G-buffer has them
  emission                                                   |
  velocity                                                   /
What `visibility` leaves of each pixel: depth beyond the near plane (0: nothing), depth up to which splats belong to it,
material, 2 instance (and 1 where it shows its back).
What `blend` sums, times weights: depth, material, 1 for front faces, 1; normal; color; emission;
velocity.

Small splats are squares around points, projected affinely. Large ones are rectangles, whose fragments meet the splat's
plane exactly; only views that may have any draw them.
"""

from __future__ import annotations

import numpy as np

from ....shading.interface import Interface
from ...device.protocol import Device, Target, Texture
from ..gbuffer import GBuffer, Variant
from ..pages.point_page import PageDraw, PointOptions
from ..tiles import Region
from ..uniforms import SampleView
from . import cover as ewa_cover
from .options import WIDEST_POINT, EwaOptions
from .programs import NORMALISE, blended_attributes, programs
from .projected import ProjectedSplats

CHUNK = 1 << 20  # splats of one draw; Blender wants a vertex buffer, if an empty one, for all its vertices


class Ewa:
    """From the splats of a view to a G-buffer: the textures between them."""

    def __init__(
        self, device: Device, variant: Variant, points: PointOptions, ewa: EwaOptions, size: tuple[int, int]
    ) -> None:
        self.device, self.options, self.size = device, ewa, size
        self.programs = programs(variant, points, ewa)
        self.nearest = device.texture(size, "RGBA32F")
        self.nearest_target: Target = device.target([self.nearest], depth=True)
        self.sums: dict[str, Texture] = {
            f"ps_sum_{name}": device.texture(size, "RGBA32F") for name in ("depth", *blended_attributes(variant))
        }
        self.sum_target: Target = device.target(list(self.sums.values()))
        self._splats: list[ProjectedSplats] = []
        self.draws: list[PageDraw] | None = None  # of which the splats are projected
        self._mask: Texture | None = None  # of the region that they are listed for
        self._left = False  # some are left out
        self._begun = False  # visibility has drawn what comes first

    def project(self, draws: list[PageDraw], view: SampleView, shared: dict[str, Texture]) -> None:
        """Project the splats of a view and list those that are drawn; `view`: of the sample that is drawn next."""
        self._forget()
        self.draws = draws
        program = self.programs.splats
        assert program.block is not None
        for draw in draws:
            splats = ProjectedSplats(self.device, self.programs.splats, draw)
            self._splats.append(splats)
            textures = {**shared, **draw.textures}
            record = draw.record(view, program.block, low_pass=self.options.low_pass)
            self.device.draw(program, splats.target, uniforms=record, textures=textures)
            splats.find(self.device, view, self.options.reach(WIDEST_POINT) + self.options.shift)
        self._leave_out(view, shared)
        for splats in self._splats:
            splats.list_found(self.device)

    def _leave_out(self, view: SampleView, shared: dict[str, Texture]) -> None:
        """Of many splats, leave out those that passes/ewa/cover.py finds not needed."""
        device = self.device
        facing, turned = (sum(len(splats.found[name]) for splats in self._splats) for name in ("first", "then"))
        if facing == 0 or facing + turned < ewa_cover.LEAST_SPLATS:
            return
        for splats in self._splats:
            splats.list_first(device, splats.found["first"])
        pages = [({**splats.textures, "ps_list": texture}, total)
                 for splats in self._splats for texture, total in (splats.lists["first"],) if total]  # fmt: skip
        sizes = ewa_cover.measure_sizes(device, pages, view, self.options.low_pass)
        if not sizes.pays(facing, turned):
            return
        drawn = [ewa_cover.hashed_share(splats.found["first"], sizes.share) for splats in self._splats]
        if sizes.thin:
            for splats, index in zip(self._splats, drawn, strict=True):
                splats.list_first(device, index)
        device.clear(self.nearest_target)
        self._see(("first",), view, shared)
        if ewa_cover.closed_share(device, self.nearest, sizes) < ewa_cover.ENOUGH:
            self._begun = not sizes.thin
            return
        margin = 0.0 if self.options.low_pass == 1 else self.options.shift
        cover = ewa_cover.Cover(device, self.nearest, sizes, margin)
        for splats, index in zip(self._splats, drawn, strict=True):
            splats.keep(index, cover.needed(splats.textures, view, self.options.low_pass))
        cover.release()
        self._begun = self._left = True

    def narrow(self, region: Region) -> None:
        """List the splats for what `region` shows; it names tiles as far around as kernels reach."""
        if region.mask is self._mask:
            return
        self._mask = region.mask
        tiles = None if region.mask is None else self.device.read(region.mask)[..., 0] != 0
        for splats in self._splats:
            splats.list_found(self.device, tiles)

    def see(self, view: SampleView, shared: dict[str, Texture]) -> None:
        """Finds the nearest surface under each pixel's centre."""
        if not self._begun:
            self.device.clear(self.nearest_target)
            self._see(("first",), view, shared)
        self._begun = False
        self._see(("then", "large"), view, shared)

    def _see(self, names: tuple[str, ...], view: SampleView, shared: dict[str, Texture]) -> None:
        self._draw(self.programs.visibility, names, self.nearest_target, view, shared, depth_test=True)

    def blend(self, view: SampleView, shared: dict[str, Texture]) -> None:
        """Sums the attributes of the nearest surface's splats times their kernels."""
        self.device.clear(self.sum_target)
        textures = {**shared, "ps_nearest": self.nearest}
        names = ("blended",) if self._left else ("first", "then")
        self._draw(self.programs.blend, (*names, "large"), self.sum_target, view, textures, blend=True)

    def normalise(self, view: SampleView, out: GBuffer, region: Region) -> None:
        """Writes sums over weights into the G-buffer; pixels that no splat touches stay as they are."""
        program = self.programs.normalise
        textures = {**self.sums, "ps_nearest": self.nearest}
        region.draw(
            self.device,
            program,
            out.target,
            uniforms=view.record(NORMALISE),
            textures=textures,
            depth_test=program.depth,
        )

    def _draw(
        self,
        kinds: tuple[Interface, ...],
        names: tuple[str, ...],
        target: Target,
        view: SampleView,
        shared: dict[str, Texture],
        depth_test: bool = False,
        blend: bool = False,
    ) -> None:
        """Draw lists of splats; `kinds`: programs of small ones and, where there are any, of large ones."""
        for splats in self._splats:
            draw = splats.draw
            textures = {**shared, **draw.textures, **splats.textures}
            for name in names:
                large = name == "large"
                if name not in splats.lists or large >= len(kinds):
                    continue
                textures["ps_list"], total = splats.lists[name]
                for first in range(0, max(total, 1), CHUNK):
                    record = self._record(kinds[large], draw, view, first)
                    count = min(CHUNK, total - first)
                    self.device.draw(
                        kinds[large], target, uniforms=record, textures=textures, vertices=count * (6 if large else 1),
                        primitive="TRIANGLES" if large else "POINTS", depth_test=depth_test, blend=blend,
                    )  # fmt: skip

    def _record(self, program: Interface, draw: PageDraw, view: SampleView, first: int) -> np.ndarray:
        """The uniforms of a pass that draws the list of a page's splats from `first` on."""
        assert program.block is not None
        names = {name for _, name in program.block.fields}
        own = {"first": first} | ({"low_pass": self.options.low_pass} if "low_pass" in names else {})
        return draw.record(view, program.block, **own) if "block_count" in names else view.record(program.block, **own)

    def _forget(self) -> None:
        for splats in self._splats:
            splats.release()
        self._splats.clear()
        self.draws = self._mask = None
        self._begun = self._left = False

    def release(self) -> None:
        self._forget()
        self.nearest_target.release()
        self.sum_target.release()
        for texture in (self.nearest, *self.sums.values()):
            texture.release()
