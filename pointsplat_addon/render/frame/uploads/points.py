"""Uploads of opaque points: their pages, the blocks that a view draws, and the transforms of their instances."""

from __future__ import annotations

import numpy as np

from ....core.scene.scene import Scene
from ...cache.keys import Key, Kind
from ...device.packing import PAGE_WIDTH
from ...device.protocol import Texture
from ...passes.gbuffer import Variant
from ...passes.pages.point_page import Page, PageDraw, blocks, instance_rows, with_origin
from ...passes.uniforms import Values
from ...plan.plan import Plan
from ...prepare.point_sets import Layer, PointSet
from ...prepare.prepare import Prepared
from .instances import constants_key, origins
from .scope import UploadScope

OWN_PAGE = 4 << 20  # splats: larger sets get a page of their own, so that small changes upload little


class PointUploads:
    """The opaque points of one frame: `draws` of splats, and `balls` that are wide on the screen."""

    def __init__(
        self, scope: UploadScope, scene: Scene, prepared: Prepared, plan: Plan, partly: Variant | None = None
    ) -> None:
        """`partly`: the variant of pages with splats of which a fraction is covered; None: that of the plan."""
        self._scope, self._scene, self._plan = scope, scene, plan
        self._of_partly = plan.variant if partly is None else partly
        self.partly: set[Key] = set()  # keys of pages with such splats
        self._transform: Values = {}  # of the only instance, as uniforms
        self.instances: dict[str, Texture] = {}  # the transforms of several instances, by sampler name
        self.draws: list[PageDraw] = []
        self.balls: list[PageDraw] = []
        self._drawn = plan.points or plan.spheres
        if self._drawn:
            self.draws = self._draws_of(prepared)
            self.draws += self._draws_of(prepared.nodes, sum(draw.elements for draw in self.draws))
            self.balls = self._draws_of(prepared.spheres)

    def upload_view(self, prepared: Prepared) -> None:
        """Uploads the transforms of a view: of the only instance as uniforms, else of all instances as a texture."""
        if not self._drawn:
            return
        origin = origins(prepared, prepared.spheres, prepared.nodes)
        for draw in self.draws:
            if draw.whole >= 0:
                only = slice(draw.whole, draw.whole + 1)
                draw.view_from_page = with_origin(prepared.view_from_object[only], origin[only])[0]
        drawn = np.concatenate([layer.cut.instance for layer in (prepared, prepared.spheres, prepared.nodes)])
        if self._plan.options.one_instance:
            one = drawn[:1]
            matrix = with_origin(prepared.view_from_object[one], origin[one])[0]
            self._transform["view_from_object"] = matrix.T.reshape(-1)
            return
        some = np.flatnonzero(np.bincount(drawn))
        rows = instance_rows(prepared.view_from_object, origin, self._scene.instances.holdout, some)
        self.instances["ps_instances"] = self._scope.view_texture(rows)

    def mark_moved(self) -> None:
        """Makes `draws` another list, by which a pass that keeps projected splats sees that the view has changed."""
        self.draws = [*self.draws]

    def narrow(self, draws: list[PageDraw]) -> None:
        """Replaces the draws by some of their blocks, which become the frame's own."""
        if draws is not self.draws:
            self.draws = draws
            for draw in draws:
                assert draw.blocks is not None  # only the visibility buffer draws whole pages
                self._scope.own(draw.blocks)

    def _draws_of(self, layer: Layer, index: int = 0) -> list[PageDraw]:
        """The draws of a layer's pages. `index`: the number of the first splat."""
        draws = []
        for group in _page_groups(layer.point_sets, self._scope.device.limits.texture_size):
            page = self._page(group)
            first = {row: page.first[points.key] for row, points in group.items()}
            rows, shift = blocks(layer, first)
            if len(rows) == 0:
                continue
            whole = _only_instance(layer, group, page) if self._plan.sub_samples else -1
            texture = self._scope.texture(rows) if whole < 0 else None
            draws.append(PageDraw(page, texture, len(rows), shift, index, self._transform, whole))
            index += len(rows) << shift
        return draws

    def _page(self, group: dict[int, PointSet]) -> Page:
        plan, table = self._plan, self._scene.materials
        sets = list({points.key: points for points in group.values()}.values())
        partly = any(map(_is_partly_covered, sets))
        variant = self._of_partly if partly else plan.variant
        filled = constants_key(self._scene) if variant.color or variant.emission else b""
        small, nodes = plan.sub_samples > 0, sets[0].shape is not None
        other = (variant, plan.options.shading_normal, plan.options.velocity, filled, small, nodes)
        key = Key(Kind.PAGE, tuple(p.key for p in sets), other=other)
        if partly:
            self.partly.add(key)
        return self._scope.lookup(key, lambda: Page(self._scope.device, sets, variant, plan.options, table, small))


def _is_partly_covered(points: PointSet) -> bool:
    return points.cloud.share is not None and points.shape is None


def _only_instance(layer: Layer, group: dict[int, PointSet], page: Page) -> int:
    """Returns the instance as which all splats of a page are drawn, if there is one; else -1."""
    cut = layer.cut
    mine = np.flatnonzero(np.isin(layer.set_of_instance[cut.instance], list(group)))
    if len(mine) != 1 or cut.first[mine[0]] != 0 or cut.count[mine[0]] != page.count:
        return -1
    return int(cut.instance[mine[0]])


def _page_groups(point_sets: dict[int, PointSet], texture_size: int) -> list[dict[int, PointSet]]:
    """Groups point sets by page, each by geometry row: large ones alone, small ones together as far as a page holds
    them, those of which a fraction is covered apart from others."""
    limit = PAGE_WIDTH * texture_size
    pages: list[dict[int, PointSet]] = []
    small: dict[bool, dict[int, PointSet]] = {}
    for row, points in point_sets.items():
        if len(points) >= OWN_PAGE:
            pages.append({row: points})
            continue
        partly = _is_partly_covered(points)
        group = small.setdefault(partly, {})
        if sum(len(p) for p in group.values()) + len(points) > limit:
            pages.append(group)
            small[partly] = group = {}
        group[row] = points
    return [*pages, *small.values()]
