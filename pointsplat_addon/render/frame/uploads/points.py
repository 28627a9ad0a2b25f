"""Uploads of opaque points: their pages, the blocks that a view draws, and the transforms of their instances."""

from __future__ import annotations

import numpy as np

from ....core.scene.scene import Scene
from ...cache.keys import Key, Kind
from ...device.packing import PAGE_WIDTH
from ...device.protocol import Texture
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

    def __init__(self, scope: UploadScope, scene: Scene, prepared: Prepared, plan: Plan) -> None:
        self._scope, self._scene, self._plan = scope, scene, plan
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
        filled = constants_key(self._scene) if plan.variant.color or plan.variant.emission else b""
        small = plan.sub_samples > 0
        other = (plan.variant, plan.options.shading_normal, plan.options.velocity, filled, small)
        key = Key(Kind.PAGE, tuple(p.key for p in sets), other=other)
        return self._scope.lookup(key, lambda: Page(self._scope.device, sets, plan.variant, plan.options, table, small))


def _only_instance(layer: Layer, group: dict[int, PointSet], page: Page) -> int:
    """Returns the instance as which all splats of a page are drawn, if there is one; else -1."""
    cut = layer.cut
    mine = np.flatnonzero(np.isin(layer.set_of_instance[cut.instance], list(group)))
    if len(mine) != 1 or cut.first[mine[0]] != 0 or cut.count[mine[0]] != page.count:
        return -1
    return int(cut.instance[mine[0]])


def _page_groups(point_sets: dict[int, PointSet], texture_size: int) -> list[dict[int, PointSet]]:
    """Groups point sets by page, each by geometry row: large ones alone, small ones together as far as a page holds
    them."""
    limit = PAGE_WIDTH * texture_size
    pages: list[dict[int, PointSet]] = []
    small: dict[int, PointSet] = {}
    for row, points in point_sets.items():
        if len(points) >= OWN_PAGE:
            pages.append({row: points})
            continue
        if sum(len(p) for p in small.values()) + len(points) > limit:
            pages.append(small)
            small = {}
        small[row] = points
    return [*pages, small] if small else pages
