"""Uploads of strands: pages of control points, and the segments that a view draws of them."""

from __future__ import annotations

import numpy as np

from ....core.scene.scene import Geometry, Scene
from ....core.scene.strands import Strands
from ....core.strand.preparation import with_levels
from ....core.strand.projection import tube_radius_scale
from ...cache.keys import Key, Kind
from ...cache.store import Store
from ...device.protocol import Texture
from ...passes.pages.point_page import instance_rows
from ...passes.strands.strand_page import StrandDraw, StrandPage
from ...plan.plan import Plan
from ...prepare.prepare import Prepared
from .instances import constants_key
from .scope import UploadScope


class StrandUploads:
    """The strands of one frame."""

    def __init__(
        self,
        scope: UploadScope,
        store: Store,
        scene: Scene,
        prepared: Prepared,
        plan: Plan,
        for_view: bool = False,
    ) -> None:
        """`for_view`: segments are released with the view, as its transforms are."""
        self._scope, self._store, self._scene, self._plan = scope, store, scene, plan
        self.draws: list[StrandDraw] = []
        self.instances: dict[str, Texture] = {}  # transforms, by sampler name
        if plan.lines:
            for row, segments in prepared.strands.items():
                draw = StrandDraw(scope.device, self._page(row), segments, scene.instances.holdout)
                self.draws.append(scope.own_for_view(draw) if for_view else scope.own(draw))

    def upload_view(self, prepared: Prepared) -> None:
        """Uploads the transforms of a view."""
        if not self._plan.lines:
            return
        instances = self._scene.instances
        origin = np.zeros((len(instances), 3))
        for row in prepared.strands:
            origin[instances.geometry == row] = _strands_of(self._scene, row).origin
        rows = instance_rows(prepared.view_from_object, origin, instances.holdout)
        rows[3::4, 1] = tube_radius_scale(prepared.view_from_object)
        self.instances["ps_instances"] = self._scope.view_texture(rows)

    def _page(self, row: int) -> StrandPage:
        scene, variant = self._scene, self._plan.variant
        geometry, strands = scene.geometries[row], _strands_of(scene, row)
        key = Key(Kind.STRAND_PAGE, geometry.key, other=(variant, constants_key(scene)))

        def make(strands: Strands = strands, geometry: Geometry = geometry) -> StrandPage:
            levels = self._store.lookup(Key(Kind.CLEAN_STRANDS, geometry.key), lambda: with_levels(strands))
            return StrandPage(self._scope.device, strands, levels, variant, scene.materials)

        return self._scope.lookup(key, make)


def _strands_of(scene: Scene, row: int) -> Strands:
    strands = scene.geometries[row].strands
    assert strands is not None
    return strands
