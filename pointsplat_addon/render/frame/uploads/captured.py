"""Uploads of captured splats: their pages, which of them a view shows, and in which order."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import groupby

import numpy as np

from ....core.lod.depth_order import back_to_front
from ....core.scene.camera import Camera
from ....core.scene.captured import CapturedSplats
from ....core.scene.scene import Geometry, Scene
from ....core.splat import captured
from ....core.surface.neighbourhoods.captured import captured_normals
from ...cache.keys import Key, Kind
from ...cache.store import Store
from ...device.packing import PAGE_WIDTH, paged
from ...device.protocol import Device, Texture
from ...passes.captured.page import CapturedPage
from ...passes.captured.project import UNLIT, CapturedLighting, project_program
from ...passes.translucent.light import draw_list_rows
from ...passes.translucent.lit_splats import LitSplats
from ...passes.uniforms import SampleView
from ...plan.plan import Plan
from ...prepare.captured import CapturedNodes, view_from_splats
from ...prepare.prepare import Prepared
from .lighting import LightingUploads
from .scope import UploadScope
from .translucent import TranslucentUploads


@dataclass(frozen=True, eq=False)
class _Shown:
    """The instances of one geometry."""

    key: str  # of the geometry
    splats: CapturedSplats
    page: CapturedPage
    largest: np.ndarray  # (N,) float32: core.splat.captured.bounds_of_scales
    first: int  # of the instances, among all that are shown
    instances: tuple[int, ...]  # of the scene
    rows: tuple[np.ndarray | None, ...]  # of each instance: (R,) int64 of the splats that the cut names; None: all
    nodes: bool = False  # they stand for many splats
    light: CapturedLighting = UNLIT  # what it does to them
    lighting: LightingUploads | None = None  # what that reads

    @property
    def most(self) -> int:
        """How many splats a view shows at most."""
        return sum(len(self.splats) if rows is None else len(rows) for rows in self.rows)

    @property
    def content(self) -> tuple:
        """What is shown: a cut follows from the view, and from how fine it is."""
        return self.key, tuple(None if rows is None else len(rows) for rows in self.rows)


@dataclass(eq=False)
class CapturedOrder:
    """The captured splats that one view shows, back to front; kept from picture to picture."""

    key: tuple = ()  # what it depends on
    depth: np.ndarray = field(default_factory=lambda: np.empty(0, np.float32))  # (K,)
    texture: Texture | None = None  # the draw list
    picture: Texture | None = None  # what they send to the eye, and what they hide, where nothing is among them

    def release(self) -> None:
        for texture in (self.texture, self.picture):
            if texture is not None:
                texture.release()
        self.texture = self.picture = None


class CapturedUploads:
    """The captured splats of one frame."""

    def __init__(
        self,
        scope: UploadScope,
        store: Store,
        scene: Scene,
        camera: Camera,
        prepared: Prepared,
        plan: Plan,
        lighting: Mapping[int, LightingUploads],
    ) -> None:
        """`lighting`: of those geometries, by row, that light changes. DeviceError: there are more splats than textures
        hold."""
        self._scope, self._plan, self._scene = scope, plan, scene
        self._trained = plan.translucent is not None and plan.translucent.trained
        self._varies = camera.aperture is not None  # each sample may have a view of its own
        self._order_key = scope.kept.own_key(Kind.CAPTURED_ORDER)
        self._shown: list[_Shown] = []
        first, lights = 0, dict(plan.captured_light)
        for row, group in groupby(prepared.captured, lambda instance: int(scene.instances.geometry[instance])):
            for one in _shown(
                scope, store, scene.geometries[row], first, tuple(group), prepared.captured_nodes.get(row),
                row in lights, self._trained,
            ):  # fmt: skip
                lit = {"light": lights[row], "lighting": lighting[row]} if row in lights else {}
                self._shown.append(replace(one, **lit))
                first += len(one.instances)
        self.sort_ms: float | None = None  # that finding and sorting what is seen took; None: nothing has changed
        self.count = 0  # splats that the view shows

    @property
    def most(self) -> int:
        """The most splats that a view of this frame shows; through a lens, each sample has a view of its own."""
        return sum(one.most for one in self._shown) if self._varies else self.count

    @property
    def keeps_picture(self) -> bool:
        """Whether one picture of the splats alone is drawn, which the same view can show again."""
        options = self._plan.translucent
        assert options is not None
        read = bool(self._plan.captured_light) or options.depth or options.term is not None
        return options.alone and not (options.opaque or options.holdout or self._varies or read)

    @property
    def picture(self) -> Texture | None:
        """That of an earlier frame with the same view, or of this one after `keep`."""
        return self._order.picture if self.keeps_picture else None

    def keep(self, picture: Texture) -> None:
        self._order.picture = picture

    def upload_view(self, prepared: Prepared, camera: Camera, others: TranslucentUploads | None) -> None:
        """Finds and sorts what a view shows. `others`: translucent splats among which they are."""
        views = [
            view_from_splats(prepared.view_from_object[row], one.splats.origin)
            for one in self._shown
            for row in one.instances
        ]
        self._slopes = captured.slope_limits(camera)
        self._low_pass = captured.LOW_PASS / camera.coarseness**2
        self._views = self._scope.view_texture(self._view_rows(views, camera))
        self._order = self._sorted(views, camera)
        self.count = len(self._order.depth)
        self._listed = None if others is None else self._merged(others, camera)

    def project(self, lit: LitSplats, view: SampleView) -> None:
        """Projects the splats of the view, behind the others of `lit`."""
        options = self._plan.translucent
        assert options is not None
        assert self._order.texture is not None
        lit.captured = self.count
        lit.listed = {} if self._listed is None else {"ps_listed": self._listed}
        for one in self._shown:
            page = one.page
            program = project_program(
                options, page.sh_texels, page.sh_shift, one.splats.antialiased, one.nodes, one.light
            )
            record = view.record_of(
                program.block,
                slopes=self._slopes,
                low_pass=self._low_pass,
                instances=(one.first, one.first + len(one.instances)),
                first=lit.count,
                count=self.count,
                light_count=len(self._scene.lights),
            )
            textures = {**page.textures, "ps_order": self._order.texture, "ps_views": self._views}
            textures |= {} if one.lighting is None else one.lighting.textures
            self._scope.device.draw(program, lit.target, uniforms=record, textures=textures)

    def _view_rows(self, views: list[np.ndarray], camera: Camera) -> np.ndarray:
        """Rows (I, 4, 4) of the texture `views`: passes/captured/project.py."""
        rows = np.zeros((max(len(views), 1), 4, 4), np.float32)
        holdout = self._scene.instances.holdout
        instances = [row for one in self._shown for row in one.instances]
        with np.errstate(over="ignore"):
            for out, view, instance in zip(rows, views, instances, strict=False):
                out[:3] = view[:3]
                out[3, :3] = captured.eye_in_object(view, camera.perspective)
                out[3, 3] = 0.0 if holdout is None else holdout[instance]
        return rows

    def _sorted(self, views: list[np.ndarray], camera: Camera) -> CapturedOrder:
        """The draw list of a view; that of before where nothing has changed."""
        order: CapturedOrder = self._scope.lookup(self._order_key, CapturedOrder)
        numbers = (*camera.pixel_from_view(), *camera.window, *camera.resolution, camera.near, camera.far)
        key = (
            numbers,
            self._varies,
            self._trained,
            *(one.content for one in self._shown),
            *(view.tobytes() for view in views),
        )
        if order.texture is not None and order.key == key:
            return order
        before = time.perf_counter()
        rows, depths, instances = [], [], []
        first = -float(views[0][2, 3]) if views else 0.0
        for one in self._shown:
            for number, among in enumerate(one.rows, one.first):
                found, depth = captured.seen(one.splats, one.largest, views[number], camera, self._varies, among)
                rows.append(found)
                depths.append(depth + np.float32(-views[number][2, 3] - first))
                instances.append(np.full(len(found), number, np.int64))
        depth = np.concatenate(depths)
        # Of splats at one depth the first is the nearest, as published.
        index = len(depth) - 1 - back_to_front(depth[::-1], 0.0).index
        order.release()
        entries = draw_list_rows(np.concatenate(rows)[index], np.concatenate(instances)[index])
        order.key, order.depth = key, depth[index] + np.float32(first)
        order.texture = _list_texture(self._scope.device, entries)
        self.sort_ms = 1000 * (time.perf_counter() - before)
        return order

    def _merged(self, others: TranslucentUploads, camera: Camera) -> Texture:
        """The list of all splats, back to front: columns and rows of lit ones, these after the others."""
        depth = others.depths(camera.view_from_world)
        behind = len(depth)
        place = np.searchsorted(-depth, -self._order.depth, side="right") + np.arange(self.count)
        index = np.empty(behind + self.count, np.int64)
        mine = np.zeros(len(index), bool)
        mine[place] = True
        index[mine], index[~mine] = np.arange(behind, len(index)), np.arange(behind)
        rows = np.column_stack([index & (PAGE_WIDTH - 1), index // PAGE_WIDTH])
        return self._scope.view_texture(rows)


def _list_texture(device: Device, rows: np.ndarray) -> Texture:
    size, data = paged(rows, 2)
    return device.texture(size, "RG32F", data)


def _shown(
    scope: UploadScope,
    store: Store,
    geometry: Geometry,
    first: int,
    instances: tuple[int, ...],
    nodes: CapturedNodes | None,
    lit: bool,
    trained: bool,
) -> list[_Shown]:
    """The splats of one geometry, and the nodes that stand for some of them; `first`: of all instances. `lit`: light
    changes them. `trained`: they are blended in display values."""
    splats, found = geometry.captured, []
    assert splats is not None
    cuts = {} if nodes is None else nodes.cuts
    rows = {i: cuts[i].splats if i in cuts else None for i in instances}
    rows = {i: some for i, some in rows.items() if some is None or len(some)}
    if rows:
        normals = _normals(store, Key(Kind.CAPTURED_NORMALS, geometry.key), splats) if lit else None
        key = Key(Kind.CAPTURED_PAGE, geometry.key)
        page = scope.lookup(key, lambda: CapturedPage(scope.device, splats, normals=normals))
        largest = store.lookup(Key(Kind.LARGEST_SCALES, geometry.key), lambda: captured.bounds_of_scales(splats))
        found.append(_Shown(geometry.key, splats, page, largest, first, tuple(rows), tuple(rows.values())))
    if nodes is not None:
        tree, merged = nodes.tree, nodes.tree.nodes
        if trained and tree.trained_base is not None:
            merged = replace(merged, base=tree.trained_base)
        normals = _normals(store, Key(Kind.CAPTURED_NODE_NORMALS, geometry.key), merged) if lit else None
        page = scope.lookup(
            Key(Kind.CAPTURED_NODE_PAGE, geometry.key, other=trained),
            lambda: CapturedPage(scope.device, merged, tree.means, normals),
        )
        drawn = tuple(cut.nodes for cut in cuts.values())
        key, largest = f"{geometry.key} nodes", merged.scale[:, 2]
        found.append(_Shown(key, merged, page, largest, first + len(rows), tuple(cuts), drawn, nodes=True))
    return found


def _normals(store: Store, key: Key, splats: CapturedSplats) -> np.ndarray:
    return store.lookup(key, lambda: captured_normals(splats))
