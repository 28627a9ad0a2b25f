"""Draws depth maps seen from lights: what casts is uploaded as for a picture, and drawn into one view after another."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace

import numpy as np

from ....core.lod.cut import cut_of_all_points
from ....core.numeric.lattice import Lattice
from ....core.numeric.linear import are_similarities
from ....core.scene.bounds import box_corners
from ....core.scene.camera import Camera
from ....core.scene.scene import Instances, Scene
from ....core.strand.segments import Segments, concatenate_segments
from ....core.strand.selection import select
from ...cache.device_cache import DeviceCache
from ...cache.keys import Key, Kind
from ...cache.store import Store
from ...device.protocol import Device, Target, Texture, let_go
from ...passes.pages.point_page import PointOptions
from ...passes.shadow.keep_depths import keep_depths
from ...passes.strands.strand_ids import cover_depths
from ...passes.uniforms import SampleView, view_of
from ...passes.visibility.buffer import DepthBuffer
from ...passes.visibility.polygon_ids import PolygonDepths
from ...passes.visibility.splat_ids import SplatDepths
from ...plan.plan import Plan
from ...prepare.point_sets import Layer, PointSet, coherent_with_foliage, point_counts
from ...prepare.prepare import Prepared
from ...shadow.casting import cached_bounding_box, cached_strands
from ...shadow.map_views import MapView
from ...shadow.maps import ShadowMaps
from ..visibility.polygon_draws import polygon_draws
from .points import PointUploads
from .polygons import PolygonUploads
from .scope import UploadScope
from .strands import StrandUploads

ONE_EACH = Lattice(1, 0)  # a texel is a cell
TOLERANCE = 1.0  # texels: outlines of strands may move by a share of it
WIDE_RADIUS = 2.5  # texels: where no splat is wider, none covers more than a compute invocation draws


class CasterUploads:
    """What casts into maps, on the device: pages and meshes are those of pictures, where these draw all of it."""

    def __init__(self, kept: DeviceCache, store: Store, scene: Scene, plan: Plan, maps: ShadowMaps) -> None:
        self._scope = UploadScope(kept)
        self._of_block = UploadScope(kept)
        self._strands: StrandUploads | None = None  # of the block that is drawn
        self.scene = _scene_of_casters(scene, maps)
        self._store = store
        self.prepared = _all_of(self.scene, store)
        self.plan = replace(
            plan,
            points=self.prepared.cut.splats > 0,
            polygons=len(self.prepared.polygons) > 0,
            spheres=False,
            lines=any(geometry.strands is not None for geometry in self.scene.geometries),
            options=_options(plan.options, self.prepared),
        )
        # Nodes of scans read by pages cast as balls: no picture draws the same, and none casts colours.
        self._alone = any(geometry.node_shape is not None for geometry in self.scene.geometries)
        bare = replace(plan.variant, color=False, surface=False, emission=False) if self._alone else None
        try:
            self.points = PointUploads(self._scope, self.scene, self.prepared, self.plan, bare)
            self.polygons = PolygonUploads(self._scope, store, self.scene, self.prepared, self.plan, whole_scene=scene)
        except Exception:
            self.release()
            raise
        self._all_polygons, self._corners = self.prepared.polygons, self._polygon_corners()

    def _polygon_corners(self) -> np.ndarray:
        """Returns (P, 8, 3) float64, the corners in the world of the boxes around all instances of polygons."""
        instances, shown = self.scene.instances, self.prepared.polygons
        corners = np.zeros((len(shown), 8, 3))
        for row, mesh in self.polygons.meshes.items():
            here = instances.geometry[shown] == row
            matrices = instances.world_from_object[shown[here]]
            local = box_corners(*mesh.box) + mesh.origin
            corners[here] = np.einsum("iab,cb->ica", matrices[:, :3, :3], local) + matrices[:, None, :3, 3]
        for paged in self.polygons.pages:
            member = paged.member[instances.geometry[shown]]
            here = member >= 0
            matrices, member = instances.world_from_object[shown[here]], member[here]
            low, high = np.moveaxis(paged.page.box[member] + paged.page.origin[member, None], 1, 0)
            local = box_corners(low, high)
            corners[here] = np.einsum("iab,icb->ica", matrices[:, :3, :3], local) + matrices[:, None, :3, 3]
        return corners

    def look_from(self, view: SampleView) -> None:
        """Uploads the transforms of a view, of polygons only where their boxes may lie in it."""
        self._scope.release_view()
        camera = view.camera
        matrices = camera.view_from_world @ self.scene.instances.world_from_object
        polygons = self._all_polygons[_may_show(camera, self._corners)]
        self.prepared = replace(self.prepared, view_from_object=matrices, polygons=polygons)
        self.points.upload_view(self.prepared)

    def choose_strands(self, block: MapView) -> None:
        """Uploads the segments of strands that a view shows; those from points of a light show the same ones, chosen
        from its middle."""
        self._of_block.release_view()
        instances = self.scene.instances
        shown = np.zeros(len(instances), bool)
        for row, geometry in enumerate(self.scene.geometries):
            if geometry.strands is not None:
                here = np.flatnonzero(instances.geometry == row)
                low, high = cached_bounding_box(geometry, self._store)
                matrices = instances.world_from_object[here]
                corners = box_corners(low, high) @ matrices[:, :3, :3].transpose(0, 2, 1) + matrices[:, None, :3, 3]
                shown[here] = np.any([_may_show(view.camera, corners) for view in block.each], axis=0)
        prepared = replace(self.prepared, strands=self._segments(block, shown))
        self._strands = StrandUploads(self._of_block, self._store, self.scene, prepared, self.plan, for_view=True)
        self._chosen = prepared

    def look_at_strands(self) -> StrandUploads:
        """Uploads their transforms for the view that is looked from."""
        assert self._strands is not None
        self._strands.upload_view(replace(self._chosen, view_from_object=self.prepared.view_from_object))
        return self._strands

    def _segments(self, block: MapView, shown: np.ndarray) -> dict[int, Segments]:
        """Returns the segments of strands that a view draws, by geometry row. shown: (I,) bool, instances."""
        found: dict[int, Segments] = {}
        camera, culled, instances = block.camera, block.points is None, self.scene.instances
        for row, geometry in enumerate(self.scene.geometries):
            if geometry.strands is None:
                continue
            levels = cached_strands(geometry, self._store)
            here = np.flatnonzero(shown & (instances.geometry == row))
            matrices = camera.view_from_world @ instances.world_from_object[here]
            looks = zip(matrices, here.tolist(), strict=True)
            parts = [select(levels, look, i, camera, TOLERANCE, ONE_EACH, culled) for look, i in looks]
            parts = [part for part in parts if len(part)]
            if parts:
                found[row] = concatenate_segments(parts)
        return found

    def release(self) -> None:
        self._of_block.release()
        self._scope.release()
        if self._alone:  # before what is drawn is uploaded: both may not fit
            self._scope.kept.forget(self.points.partly)
            let_go(self._scope.device)


def draw_maps(device: Device, maps: ShadowMaps, casters: CasterUploads, of_scene: Texture | None = None) -> Texture:
    """Returns the texture of all maps: bits of depths beyond the near planes of their views, R32UI. `of_scene`: what it
    begins with, where others are nested in maps of the scene."""
    width, height = np.max([view.size for view in maps.views], axis=0).tolist()
    with ExitStack() as unfinished, ExitStack() as temporary:  # what is released if it fails, and in any case
        depths = DepthBuffer(device, ONE_EACH, (width, height))
        unfinished.callback(depths.depths.release)
        temporary.callback(depths.target.release)
        splats = _splats(device, maps, casters, depths) if casters.plan.points else None
        if splats is not None:
            temporary.callback(splats.release)
        if maps.size == depths.size and of_scene is None:
            _draw_block(device, maps.blocks[0], casters, depths, splats, None)
            unfinished.pop_all()
            return depths.depths
        texture = device.texture(maps.size, "R32UI")
        unfinished.callback(texture.release)
        target = device.target([texture])
        temporary.callback(target.release)
        if of_scene is not None:
            keep_depths(device, of_scene, (0, 0), of_scene.size, target)
        for block in maps.blocks:
            _draw_block(device, block, casters, depths, splats, target)
        unfinished.pop_all()
        depths.depths.release()
    return texture


def _draw_block(
    device: Device,
    block: MapView,
    casters: CasterUploads,
    depths: DepthBuffer,
    splats: SplatDepths | None,
    target: Target | None,
) -> None:
    """Draws a view, or those from all points of a light, each into its place of a target if there is one."""
    if casters.plan.lines:
        casters.choose_strands(block)
    for number, view in enumerate(block.each):
        _draw_view(device, view_of(view.camera, sample=number), casters, depths, splats)
        if target is not None:
            keep_depths(device, depths.depths, view.corner, view.size, target)


def _draw_view(
    device: Device, seen: SampleView, casters: CasterUploads, depths: DepthBuffer, splats: SplatDepths | None
) -> None:
    casters.look_from(seen)
    depths.clear()
    shared = casters.points.instances
    # Compute shaders compare with what the rasteriser has drawn.
    if splats is not None:
        splats.rasterise(casters.points.draws, seen, shared)
    if casters.plan.lines:
        strands = casters.look_at_strands()
        cover_depths(device, strands.draws, depths, seen, strands.instances)
    if casters.plan.polygons:
        polygons = PolygonDepths(device, polygon_draws(device, casters, seen, 0, depths.cells), depths)
        try:
            polygons.rasterise(seen, shared)
            polygons.cover(seen, shared)
        finally:
            polygons.release()
    if splats is not None:
        splats.cover(casters.points.draws, seen, shared)


def _may_show(camera: Camera, corners: np.ndarray) -> np.ndarray:
    """Returns which boxes, (N, 8, 3) float64 in the world, a camera may show, (N,) bool."""
    clip = camera.clip_from_view @ camera.view_from_world
    place = corners @ clip[:, :3].T + clip[:, 3]
    outside = np.concatenate([place[..., :3] > place[..., 3:], place[..., :3] < -place[..., 3:]], axis=2)
    return ~outside.all(axis=1).any(axis=1)


def _splats(device: Device, maps: ShadowMaps, casters: CasterUploads, depths: DepthBuffer) -> SplatDepths:
    prepared = casters.prepared
    sheared = any(view.parallel and any(view.point) for view in maps.views)
    round_balls = not sheared and are_similarities(prepared.view_from_object[np.unique(prepared.cut.instance)])
    wide = any(not view.parallel or prepared.largest > WIDE_RADIUS * view.step for view in maps.views)
    return SplatDepths(device, casters.plan.options, depths, wide, round_balls)


def _scene_of_casters(scene: Scene, maps: ShadowMaps) -> Scene:
    """Returns a scene of the instances that cast, and of nothing else."""
    by_key = {geometry.key: geometry for geometry in scene.geometries}
    counts = [len(matrices) for _, matrices in maps.casters]
    geometry = np.repeat(np.arange(len(counts), dtype=np.int32), counts)
    instances = Instances(geometry, np.concatenate([matrices for _, matrices in maps.casters]))
    return replace(scene, geometries=tuple(by_key[key] for key, _ in maps.casters), instances=instances)


def _all_of(scene: Scene, store: Store) -> Prepared:
    """Returns everything in a scene of clouds and meshes, clouds as points and meshes as polygons."""
    sets: dict[int, PointSet] = {}
    meshes = []
    for row, geometry in enumerate(scene.geometries):
        cloud = geometry.cloud
        if cloud is None:
            if geometry.mesh is not None:
                meshes.append(row)
            continue
        if geometry.streamed is None:  # pages are coherent
            coherent = Key(Kind.COHERENT_POINTS, geometry.key)
            cloud = store.lookup(coherent, lambda cloud=cloud: coherent_with_foliage(cloud))
        sets[row] = PointSet(Key(Kind.CLOUD, geometry.key), cloud)
    instances = scene.instances
    set_of_instance = np.where(np.isin(instances.geometry, list(sets)), instances.geometry, -1)
    none = np.full(len(instances), -1)
    nothing = Layer({}, none, cut_of_all_points(point_counts({}), none))
    cut = cut_of_all_points(point_counts(sets), set_of_instance)
    polygons = np.flatnonzero(np.isin(instances.geometry, meshes))
    scale = np.abs(instances.world_from_object[:, :3, :3]).sum(axis=2).max(initial=0.0)
    radii = [float(points.cloud.radii[:, 0].max()) for points in sets.values() if points.cloud.radii is not None]
    return Prepared(
        sets, set_of_instance, cut, nothing, nothing, nothing, polygons, instances.world_from_object,
        largest=scale * max(radii, default=0.0), total=cut.splats,
    )  # fmt: skip


def _options(options: PointOptions, prepared: Prepared) -> PointOptions:
    """Returns the shader variants that draw all points of casters, whichever side they show."""
    clouds = [points.cloud for points in prepared.point_sets.values()]
    return replace(
        options,
        cull=False,
        holdout=False,
        ellipses=any(cloud.axis is not None for cloud in clouds),
        one_instance=len(np.unique(prepared.cut.instance)) == 1,
        depth=True,
    )
