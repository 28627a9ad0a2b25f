"""What a frame needs on the device beside its targets: tables, pages of points, polygons, the environment."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...core.light import hair
from ...core.light.environment import build_atlas, pyramid, stacked
from ...core.light.light_table import light_texture
from ...core.lod import depth_order
from ...core.material.graph import MaterialGraph
from ...core.numeric.segments import ranges
from ...core.scene.camera import Camera
from ...core.scene.mesh import Mesh
from ...core.scene.scene import Geometry, Scene
from ...core.scene.strands import Strands
from ...core.strand.preparation import with_levels
from ...core.strand.projection import tube_radius_scale
from ...core.surface.appearance import digest
from ...core.surface.density import Parts, make_parts
from ..cache.device_cache import DeviceCache
from ..cache.keys import Key, Kind
from ..cache.store import Store
from ..device.packing import PAGE_WIDTH, paged
from ..device.protocol import Device, Target, Texture
from ..passes.pages.point_page import Page, PageDraw, blocks, instance_rows, with_origin
from ..passes.shading import lighting, materials
from ..passes.translucent import light as light_pass
from ..passes.translucent import light_shares
from ..passes.translucent.page import TranslucentPage
from ..passes.uniforms import SampleView, Values
from ..passes.visibility import polygon_mesh, strand_page
from ..plan.plan import Plan
from ..prepare.point_sets import Layer, PointSet
from ..prepare.prepare import Prepared
from ..shadow.shadows import Shadows

OWN_PAGE = 4 << 20  # splats: larger sets get a page of their own, so that small changes upload little


class Uploads:
    """Everything that one view of a scene reads; small tables are this frame's own, the rest is `kept`."""

    def __init__(
        self,
        store: Store,
        kept: DeviceCache,
        scene: Scene,
        camera: Camera,
        prepared: Prepared,
        plan: Plan,
        motion: bool = False,
        shadows: Shadows | None = None,
    ) -> None:
        self.store, self.kept, self.device = store, kept, kept.device
        self.scene, self.camera, self.prepared, self.plan = scene, camera, prepared, plan
        self.used = kept.begin()
        self._order_key, self._reach_key = kept.own_key(Kind.DRAW_ORDER), kept.own_key(Kind.LIGHT_SHARES)
        self._owned: list[Any] = []
        self._of_view: list[Texture] = []
        self._packed = None if shadows is None else shadows.packed
        self._one: Values = {}  # the only instance of points, as uniforms
        self.shared: dict[str, Texture] = {}
        self.lights: Texture | None = None
        self.environment: Texture | None = None
        self.levels: Texture | None = None  # of the environment, each half as wide: passes/backdrop.py
        self.previous: Texture | None = None
        self.shadows: tuple[Texture | None, Texture | None] = None, None  # tables, and their records in this view
        self.draws: list[PageDraw] = []
        self.balls: list[PageDraw] = []
        self.meshes: dict[int, polygon_mesh.PolygonMesh] = {}
        # Of each group, by instance, where it draws only some parts.
        self.part_lists: dict[int, list[polygon_mesh.PartList | None]] = {}
        self.lines: list[strand_page.StrandDraw] = []
        self.line_instances: Texture | None = None
        self.splats: dict[str, Texture] = {}  # translucent ones, and their draw list
        self.listed = 0  # how many
        self.reach_lights = 0  # of so many lights the share that reaches each of them may be kept
        self.reach_instances = np.empty(0, np.int64)
        self.reach_key: tuple = ()  # what that light depends on
        self.spent: dict[str, float] = {}  # milliseconds by pass, of those that the processor does
        try:
            self._upload(motion, shadows)
        except Exception:
            self.release()
            raise

    @property
    def shading(self) -> dict[str, Texture]:
        """Textures that shading reads, by sampler name."""
        tables, records = self.shadows
        return lighting.bound_textures(
            materials=self.shared.get("ps_materials"), lights=self.lights, environment=self.environment,
            shadow_tables=tables, shadow_lights=records,
        )  # fmt: skip

    def narrow(self, draws: list[PageDraw]) -> None:
        """Points are drawn by these from now on, whose blocks become the frame's own."""
        if draws is not self.draws:
            self.draws = draws
            self._owned.extend(draw.blocks for draw in draws)

    def move(self, view_from_middle: np.ndarray, camera: Camera) -> None:
        """Make anew what depends on the view alone, for a camera that is prepared for too. `view_from_middle` (4, 4):
        its view space from that of the camera that all was uploaded for."""
        self._release_view()
        self.camera = camera
        self.prepared = replace(self.prepared, view_from_object=view_from_middle @ self._middle)
        self._upload_view()
        self.draws = [*self.draws]  # who keeps what it projected of them sees that they are others

    def release(self) -> None:
        self.kept.end(self.used)
        self._release_view()
        for item in self._owned:
            item.release()
        self._owned.clear()

    def _release_view(self) -> None:
        for texture in self._of_view:
            texture.release()
        self._of_view.clear()

    def _for_view(self, rows: np.ndarray) -> Texture:
        """(H, W, 4) or (N, 4) float32 as a texture that is released with the view."""
        size, data = ((rows.shape[1], rows.shape[0]), rows.reshape(-1)) if rows.ndim == 3 else paged(rows, 4)
        self._of_view.append(self.device.texture(size, "RGBA32F", data))
        return self._of_view[-1]

    def _own(self, item: Any) -> Any:
        self._owned.append(item)
        return item

    def _upload(self, motion: bool, shadows: Shadows | None) -> None:
        scene, plan, device = self.scene, self.plan, self.device
        table = materials.material_rows(scene.materials, self._escape())
        bare = not (plan.shades or (plan.polygons and plan.variant.color) or plan.lines or plan.options.cull)
        if (plan.solid or plan.translucent is not None) and not bare:
            self.shared["ps_materials"] = self._own(device.texture((4, len(table)), "RGBA32F", table.reshape(-1)))
        self._surface = float(table[0, 2, 1]), float(table[0, 2, 3])
        self._middle = self.prepared.view_from_object
        if "PS_HAS_ENVIRONMENT" in (*plan.lighting, *plan.world) and scene.world.image is not None:
            self.environment = self._environment(scene.world.image)
            if plan.backdrop:
                self.levels = self._levels(scene.world.image)
        if shadows is not None:
            self._upload_shadows(shadows)
        if plan.points or plan.spheres:
            self.draws = self._point_draws(self.prepared, self._one)
            self.balls = self._point_draws(self.prepared.spheres, self._one)
        if plan.polygons:
            self.meshes = self._polygon_meshes()
        if plan.lines:
            self._lines()
        if plan.translucent is not None:
            self._draw_list()
        self._upload_view()
        if motion:
            self.previous = self._own(self._motion())
        self.kept.trim_unused()

    def _upload_view(self) -> None:
        """Small tables that hold the view."""
        scene, plan, prepared = self.scene, self.plan, self.prepared
        if plan.lighting or plan.world:
            self.lights = self._for_view(
                light_texture(scene.lights, scene.world, self.camera.view_from_world, *self._surface)
            )
        if self._packed is not None:
            records = self._packed.records(self.camera.view_from_world).astype(np.float32)
            self.shadows = self.shadows[0], self._for_view(records)
        if plan.points or plan.spheres:
            self._transforms()
        if plan.lines:
            origin = np.zeros((len(scene.instances), 3))
            for row in prepared.lines:
                origin[scene.instances.geometry == row] = _lines_of(scene, row).origin
            rows = instance_rows(prepared.view_from_object, origin, scene.instances.holdout)
            rows[3::4, 1] = tube_radius_scale(prepared.view_from_object)
            self.line_instances = self._for_view(rows)
        if plan.translucent is not None:
            origin = _origins(prepared.translucent)
            self.splats["ps_instances"] = self._for_view(
                instance_rows(prepared.view_from_object, origin, scene.instances.holdout)
            )

    def _upload_shadows(self, shadows: Shadows) -> None:
        data, device = shadows.packed.data, self.device

        def make() -> Texture:
            return device.texture((data.shape[1], data.shape[0]), "RGBA32F", data.reshape(-1))

        self._shadow_key = shadows.key
        key = Key(Kind.SHADOW_TEXTURE, shadows.key)
        self.used.add(key)
        self.shadows = self.kept.lookup(key, make), None

    def _environment(self, image: np.ndarray) -> Texture:
        def make() -> Texture:
            atlas = build_atlas(image)
            rgba = np.concatenate([atlas[..., :3], np.ones((*atlas.shape[:2], 1), np.float32)], axis=2)
            return self.device.texture((atlas.shape[1], atlas.shape[0]), "RGBA32F", rgba.reshape(-1))

        # The array itself is part of the key, so that its identity is not given to another one.
        key = Key(Kind.ENVIRONMENT, Same(image))
        self.used.add(key)
        return self.kept.lookup(key, make)

    def _levels(self, image: np.ndarray) -> Texture:
        def make() -> Texture:
            levels = stacked(pyramid(build_atlas(image)))
            rgba = np.concatenate([levels, np.ones((*levels.shape[:2], 1), np.float32)], axis=2)
            return self.device.texture((levels.shape[1], levels.shape[0]), "RGBA32F", rgba.reshape(-1))

        key = Key(Kind.ENVIRONMENT_LEVELS, Same(image))
        self.used.add(key)
        return self.kept.lookup(key, make)

    def _transforms(self) -> None:
        """The only instance of points as uniforms, or a texture for all and no uniforms."""
        prepared, instances = self.prepared, self.scene.instances
        origin = _origins(prepared, prepared.spheres)
        if self.plan.options.one_instance:
            one = np.concatenate([prepared.cut.instance, prepared.spheres.cut.instance])[:1]
            matrix = with_origin(prepared.view_from_object[one], origin[one])[0]
            self._one["view_from_object"] = matrix.T.reshape(-1)
            return
        rows = instance_rows(prepared.view_from_object, origin, instances.holdout)
        self.shared["ps_instances"] = self._for_view(rows)

    def _point_draws(self, layer: Layer, transform: Values) -> list[PageDraw]:
        draws, index = [], 0
        for group in _pages(layer.point_sets, self.device.limits.texture_size):
            page = self._page(group)
            first = {row: page.first[points.key] for row, points in group.items()}
            rows, shift = blocks(layer, first)
            if len(rows) == 0:
                continue
            size, data = paged(rows, 4)
            texture = self._own(self.device.texture(size, "RGBA32F", data))
            draws.append(PageDraw(page, texture, len(rows), shift, index, transform))
            index += len(rows) << shift
        return draws

    def _page(self, group: dict[int, PointSet]) -> Page:
        plan, table = self.plan, self.scene.materials
        sets = list({points.key: points for points in group.values()}.values())
        filled = _fill_key(self.scene) if plan.variant.color or plan.variant.emission else b""
        key = Key(Kind.PAGE, tuple(p.key for p in sets), other=(plan.variant, plan.options.shading_normal, filled))
        self.used.add(key)
        return self.kept.lookup(key, lambda: Page(self.device, sets, plan.variant, plan.options, table))

    def _escape(self) -> np.ndarray:
        """(M,) how much light leaves the hair of each material; of the strands that have most of it, in view or not."""
        scene = self.scene
        most = np.zeros(len(scene.materials))
        for geometry in scene.geometries:
            if geometry.strands is not None and scene.materials.hair is not None:
                lines, rows = geometry.strands, list(geometry.strands.materials)
                number = self.store.lookup(
                    Key(Kind.CROSSED_HAIRS, geometry.key), lambda lines=lines: hair.strands_crossed(lines)
                )
                most[rows] = np.maximum(most[rows], number)
        return hair.escape_share(most)

    def _lines(self) -> None:
        """Pages of control points, and the segments that this view draws of them."""
        scene, prepared, variant = self.scene, self.prepared, self.plan.variant
        for row, segments in prepared.lines.items():
            geometry, lines = scene.geometries[row], _lines_of(scene, row)
            key = Key(Kind.STRAND_PAGE, geometry.key, other=(variant, _fill_key(scene)))
            self.used.add(key)

            def make(lines: Strands = lines, geometry: Geometry = geometry) -> strand_page.StrandPage:
                strands = self.store.lookup(Key(Kind.CLEAN_STRANDS, geometry.key), lambda: with_levels(lines))
                return strand_page.StrandPage(self.device, lines, strands, variant, scene.materials)

            page = self.kept.lookup(key, make)
            self.lines.append(self._own(strand_page.StrandDraw(self.device, page, segments, scene.instances.holdout)))

    def _draw_list(self) -> None:
        """Translucent splats, and the order in which this view draws them."""
        layer, scene, device = self.prepared.translucent, self.scene, self.device
        options = self.plan.translucent
        assert options is not None
        sets = list({points.key: points for points in layer.point_sets.values()}.values())
        key = Key(Kind.TRANSLUCENT_PAGE, tuple(p.key for p in sets), other=(options, _fill_key(scene)))
        self.used.add(key)
        shares = {layer.point_sets[row].key: share for row, share in self.prepared.shares.items()}

        def make() -> TranslucentPage:
            return TranslucentPage(device, sets, options, scene.materials, shares)

        page = self.kept.lookup(key, make)
        matrices, view = scene.instances.world_from_object, self.camera.view_from_world
        self.used.add(self._order_key)
        if self.plan.defocus:
            texture, self.listed = self._unsorted(page, layer)
        else:
            sorted_list: DrawList = self.kept.lookup(self._order_key, DrawList)
            before, sorts = time.perf_counter(), sorted_list.sorts
            sorted_list.update(
                device, page, layer, matrices, view, (key, layer.set_of_instance.tobytes(), matrices.tobytes())
            )
            if sorted_list.sorts > sorts:
                self.spent["order"] = 1000 * (time.perf_counter() - before)
            texture, self.listed = sorted_list.texture, sorted_list.count
            self._remember(page, key, layer, matrices)
        assert texture is not None
        self.splats = {**page.textures, "ps_order": texture}

    def _unsorted(self, page: TranslucentPage, layer: Layer) -> tuple[Texture, int]:
        """The splats of a cut as they come, and how many."""
        texel, instance = listed(page, layer)
        size, data = paged(light_pass.draw_list_rows(texel, instance), 2)
        return self._own(self.device.texture(size, "RG32F", data)), len(texel)

    def _remember(self, page: TranslucentPage, key: Key, layer: Layer, world_from_object: np.ndarray) -> None:
        """What it needs to know the light that reaches each splat for all cameras: one instance for each splat."""
        shown = layer.set_of_instance[layer.set_of_instance >= 0]
        lights = len(self.scene.lights)
        if self.shadows[0] is None or len(np.unique(shown)) < len(shown) or lights > light_pass.MOST_SHARED_LIGHTS:
            return
        instance = np.zeros(page.count, np.int64)
        for row in np.flatnonzero(layer.set_of_instance >= 0):
            points = layer.point_sets[int(layer.set_of_instance[row])]
            first = page.first[points.key]
            instance[first : first + len(points)] = row
        self.reach_key = (key, self._shadow_key, layer.set_of_instance.tobytes(), world_from_object.tobytes())
        self.reach_lights, self.reach_instances = lights, instance

    def reach(self, tap: int, view: SampleView, run: Callable[[str, Callable[[], None]], None]) -> dict[str, Texture]:
        """How much of each light reaches the translucent splats, by sampler name; `tap`: which point of wide lamps."""
        device, options = self.device, self.plan.translucent
        assert options is not None
        program = light_pass.light_shares_program(options, self.plan.lighting, self.reach_lights)
        count = len(self.reach_instances)

        def light(target: Target) -> None:
            size, data = paged(light_pass.draw_list_rows(np.arange(count), self.reach_instances), 2)
            order = device.texture(size, "RG32F", data)
            every = view.record_of(program.block, count=count)
            textures = {**self.splats, **self.shading, "ps_order": order}
            try:
                run("reach", lambda: device.draw(program, target, uniforms=every, textures=textures))
            finally:
                order.release()

        self.used.add(self._reach_key)
        kept: light_shares.LightShares = self.kept.lookup(self._reach_key, lambda: light_shares.LightShares(device))
        return kept.textures(self.reach_key, tap, program, self.splats["ps_position"].size, light)

    def _polygon_meshes(self) -> dict[int, polygon_mesh.PolygonMesh]:
        scene, plan, meshes = self.scene, self.plan, {}
        for row in np.unique(scene.instances.geometry[self.prepared.polygons]).tolist():
            geometry = scene.geometries[row]
            mesh = geometry.mesh
            assert mesh is not None
            look = digest(mesh, scene.materials)
            parts = None
            if geometry.primitive == "AUTO":
                parts = self.store.lookup(Key(Kind.PARTS, geometry.key), lambda mesh=mesh: make_parts(mesh))
            more = (plan.variant, _fill_key(scene), scene.materials.cull.tobytes(), parts is not None)
            key = Key(Kind.POLYGON_MESH, geometry.key, look, other=more)
            self.used.add(key)

            def make(mesh: Mesh = mesh, parts: Parts | None = parts) -> polygon_mesh.PolygonMesh:
                return polygon_mesh.PolygonMesh(self.device, mesh, scene.materials, plan.variant, parts)

            meshes[row] = self.kept.lookup(key, make)
            meshes[row].hang(self._pictures)
        for instance, parts in self.prepared.parts.items():
            groups = meshes[int(scene.instances.geometry[instance])].groups
            self.part_lists[instance] = [self._part_list(group.rows(parts)) for group in groups]
        return meshes

    def _pictures(self, graph: MaterialGraph, row: int) -> polygon_mesh.Pictures:
        """Of a graph, over constants of the material table's row."""
        table, emission = self.scene.materials, self.plan.variant.emission
        constants = (table.base_color[row].tobytes(), float(table.roughness[row]), float(table.metallic[row]))
        key = Key(Kind.TEXTURES, graph.digest, other=(*constants, emission))
        self.used.add(key)
        return self.kept.lookup(key, lambda: polygon_mesh.Pictures(self.device, graph, table, row, emission))

    def _part_list(self, rows: np.ndarray) -> polygon_mesh.PartList | None:
        if len(rows) == 0:
            return None
        size, data = paged(rows, 4)
        return polygon_mesh.PartList(self._own(self.device.texture(size, "RGBA32F", data)), len(rows))

    def _motion(self) -> Texture:
        """Clip space a frame before from today's view space, four rows for each instance."""
        camera, instances = self.camera, self.scene.instances
        view = camera.view_from_world if camera.previous_view_from_world is None else camera.previous_view_from_world
        clip = camera.clip_from_view if camera.previous_clip_from_view is None else camera.previous_clip_from_view
        before = instances.world_from_object if instances.previous is None else instances.previous
        with np.errstate(all="ignore"):
            still = clip @ view @ np.linalg.inv(camera.view_from_world)
            rows = np.broadcast_to(still, (len(instances), 4, 4)).copy()
            good = np.abs(np.linalg.det(self.prepared.view_from_object[:, :3, :3])) > 1e-30
            good &= np.isfinite(self.prepared.view_from_object).all(axis=(1, 2))
            rows[good] = clip @ view @ before[good] @ np.linalg.inv(self.prepared.view_from_object[good])
        size, data = paged(np.nan_to_num(rows).reshape(-1, 4), 4)
        return self.device.texture(size, "RGBA32F", data)


class DrawList:
    """Translucent splats back to front on the device; sorted again only where that would matter."""

    def __init__(self) -> None:
        self.texture: Texture | None = None
        self.count = 0
        self.sorts = 0  # how often they were sorted
        self._order: depth_order.Order | None = None
        self._key: tuple = ()

    def update(
        self,
        device: Device,
        page: TranslucentPage,
        layer: Layer,
        world_from_object: np.ndarray,
        view_from_world: np.ndarray,
        key: tuple,
    ) -> None:
        """Sort what `layer` shows for a view, unless the last order does. `key`: what is drawn, and where it stands."""
        known = self._order if self.texture is not None and key == self._key else None
        if known is not None and not known.stale(view_from_world, layer.cut):
            return
        entries = {row: points.hierarchy or points.cloud for row, points in layer.point_sets.items()}
        self._order = depth_order.sort_cut(
            layer.cut, entries, layer.set_of_instance, world_from_object, view_from_world
        )
        self._key, self.sorts = key, self.sorts + 1
        texel, instance = listed(page, layer)
        index = self._order.index
        self.count = len(index)
        size, data = paged(light_pass.draw_list_rows(texel[index], instance[index]), 2)
        self.release()
        self.texture = device.texture(size, "RG32F", data)

    def release(self) -> None:
        if self.texture is not None:
            self.texture.release()
        self.texture = None


def listed(page: TranslucentPage, layer: Layer) -> tuple[np.ndarray, np.ndarray]:
    """(N,) int64: where in its page each splat of a layer's cut is, and of which instance it is one."""
    first = np.zeros(max(layer.point_sets) + 1, np.int64)
    for row, points in layer.point_sets.items():
        first[row] = page.first[points.key]
    cut = layer.cut
    texel = ranges(first[layer.set_of_instance[cut.instance]] + cut.first, cut.count)
    return texel, np.repeat(cut.instance, cut.count)


@dataclass(frozen=True)
class Same:
    """An array as a key: equal to itself only."""

    array: np.ndarray = field(compare=False)

    def __hash__(self) -> int:
        return id(self.array)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Same) and other.array is self.array


def _lines_of(scene: Scene, row: int) -> Strands:
    lines = scene.geometries[row].strands
    assert lines is not None
    return lines


def _origins(*layers: Layer) -> np.ndarray:
    """(I, 3) float64: of the clouds that instances show."""
    origin = np.zeros((len(layers[0].set_of_instance), 3))
    for layer in layers:
        for row, points in layer.point_sets.items():
            origin[layer.set_of_instance == row] = points.cloud.origin
    return origin


def _fill_key(scene: Scene) -> bytes:
    """The constants that fill attributes which a cloud lacks."""
    table = scene.materials
    return b"".join(a.tobytes() for a in (table.base_color, table.roughness, table.metallic, table.emission))


def _pages(point_sets: dict[int, PointSet], texture_size: int) -> list[dict[int, PointSet]]:
    """Point sets by geometry row, grouped: large ones alone, small ones together as long as a page holds them."""
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
