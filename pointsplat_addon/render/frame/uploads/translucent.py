"""Uploads of translucent splats: their page, their draw list, and the shares of light that reach them."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from ....core.scene.camera import Camera
from ....core.scene.scene import Scene
from ...cache.keys import Key, Kind
from ...device.packing import paged
from ...device.protocol import Target, Texture
from ...passes.pages.point_page import instance_rows
from ...passes.translucent.light import MOST_SHARED_LIGHTS, draw_list_rows, light_shares_program
from ...passes.translucent.light_shares import LightShares
from ...passes.translucent.page import TranslucentPage
from ...passes.uniforms import SampleView
from ...plan.plan import Plan
from ...prepare.prepare import Prepared
from .draw_order import SortedDrawList, cut_texels
from .instances import constants_key, origins
from .lighting import LightingUploads
from .scope import UploadScope


class TranslucentUploads:
    """The translucent splats of one frame."""

    def __init__(
        self,
        scope: UploadScope,
        scene: Scene,
        camera: Camera,
        prepared: Prepared,
        plan: Plan,
        lighting: LightingUploads,
        exact: bool,
    ) -> None:
        """`exact`: what this view alone would show, to the bit; else what an earlier one left, where that will do."""
        self._exact = exact
        self._scope, self._scene, self._plan, self._lighting = scope, scene, plan, lighting
        self._order_key = scope.kept.own_key(Kind.DRAW_ORDER)
        self._shares_key = scope.kept.own_key(Kind.LIGHT_SHARES)
        self._layer = prepared.translucent
        self.textures: dict[str, Texture] = {}  # of the page and the draw list, by sampler name
        self.count = 0  # splats of the draw list
        self.shared_lights = 0  # the share of so many lights that reaches each splat may be kept; 0: of none
        self._instance_of_splat = np.empty(0, np.int64)  # of the page, where shares are kept
        self._shares_depend_on: tuple = ()
        self.sort_ms: float | None = None  # that sorting took; None: the latest order was good enough
        self._upload(camera, prepared)

    def depths(self, view_from_world: np.ndarray) -> np.ndarray:
        """Returns the depths in a view (4, 4) of the splats of the draw list, (N,) float64, to a slice of its order."""
        draws: SortedDrawList = self._scope.lookup(self._order_key, SortedDrawList)
        return draws.depths(view_from_world)

    def upload_view(self, prepared: Prepared) -> None:
        """Uploads the transforms of a view."""
        rows = instance_rows(prepared.view_from_object, origins(self._layer), self._scene.instances.holdout)
        self.textures["ps_instances"] = self._scope.view_texture(rows)

    def light_shares(
        self, point: int, view: SampleView, run: Callable[[str, Callable[[], None]], None]
    ) -> dict[str, Texture]:
        """Returns the shares of light that reach the splats, by sampler name. `point`: which point of wide lights."""
        device, options = self._scope.device, self._plan.translucent
        assert options is not None
        program = light_shares_program(options, self._plan.lighting, self.shared_lights)
        count = len(self._instance_of_splat)

        def light(target: Target) -> None:
            # In a space that is no camera's, so that shares are the same to the bit whichever camera is the first.
            matrices = self._scene.instances.world_from_object
            space = np.eye(4)
            space[:3, 3] = -matrices[self._layer.set_of_instance >= 0, :3, 3].mean(axis=0)
            rows = instance_rows(space @ matrices, origins(self._layer), self._scene.instances.holdout)
            placed = {"ps_instances": self._scope.view_texture(rows), **self._lighting.textures_in(space)}
            uniforms = view.record_of(program.block, count=count)
            size, data = paged(draw_list_rows(np.arange(count), self._instance_of_splat), 2)
            order = device.texture(size, "RG32F", data)
            textures = {**self.textures, **placed, "ps_order": order}
            try:
                run("reach", lambda: device.draw(program, target, uniforms=uniforms, textures=textures))
            finally:
                order.release()

        kept: LightShares = self._scope.lookup(self._shares_key, lambda: LightShares(device))
        size, on_disk = self.textures["ps_position"].size, self._lighting.on_disk
        return kept.textures(self._shares_depend_on, point, program, size, light, on_disk)

    def _upload(self, camera: Camera, prepared: Prepared) -> None:
        """Uploads the page, and the order in which this view draws its splats."""
        layer, scene, scope = self._layer, self._scene, self._scope
        options = self._plan.translucent
        assert options is not None
        sets = list({points.key: points for points in layer.point_sets.values()}.values())
        key = Key(Kind.TRANSLUCENT_PAGE, tuple(p.key for p in sets), other=(options, constants_key(scene)))
        covered = {layer.point_sets[row].key: share for row, share in prepared.shares.items()}

        def make() -> TranslucentPage:
            return TranslucentPage(scope.device, sets, options, scene.materials, covered)

        page: TranslucentPage = scope.lookup(key, make)
        if self._plan.defocus:
            # The pass that gathers sorts by tiles.
            texel, instance = cut_texels(page, layer)
            texture, self.count = scope.texture(draw_list_rows(texel, instance), 2), len(texel)
        else:
            texture = self._sort(page, key, camera)
            self._find_shared_lights(page, key)
        self.textures = {**page.textures, "ps_order": texture}

    def _sort(self, page: TranslucentPage, key: Key, camera: Camera) -> Texture:
        """Returns the draw list of the cut, back to front."""
        layer, matrices = self._layer, self._scene.instances.world_from_object
        draws: SortedDrawList = self._scope.lookup(self._order_key, SortedDrawList)
        before, sorts = time.perf_counter(), draws.sorts
        depends_on = (key, layer.set_of_instance.tobytes(), matrices.tobytes())
        draws.update(self._scope.device, page, layer, matrices, camera.view_from_world, depends_on, self._exact)
        if draws.sorts > sorts:
            self.sort_ms = 1000 * (time.perf_counter() - before)
        self.count = draws.count
        assert draws.texture is not None
        return draws.texture

    def _find_shared_lights(self, page: TranslucentPage, key: Key) -> None:
        """Finds whether the light that reaches each splat can be kept for all cameras: each splat has one instance, and
        lights that cast shadows are few."""
        layer, lights = self._layer, len(self._scene.lights)
        shown = layer.set_of_instance[layer.set_of_instance >= 0]
        if self._scene.world.fog is not None:
            return  # shadows are looked up along the rays to splats, too
        if self._lighting.shadow_key is None or len(np.unique(shown)) < len(shown) or lights > MOST_SHARED_LIGHTS:
            return
        instance = np.zeros(page.count, np.int64)
        for row in np.flatnonzero(layer.set_of_instance >= 0):
            points = layer.point_sets[int(layer.set_of_instance[row])]
            first = page.first[points.key]
            instance[first : first + len(points)] = row
        placed = (layer.set_of_instance.tobytes(), self._scene.instances.world_from_object.tobytes())
        self._shares_depend_on = (key, self._lighting.shadow_key, *placed)
        self.shared_lights, self._instance_of_splat = lights, instance
