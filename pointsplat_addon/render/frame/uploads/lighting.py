"""Uploads that shading reads: the material table, lights, the environment, and tables and maps of shadows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field

import numpy as np

from ....core.light import hair
from ....core.light.environment import build_atlas, pyramid, stack_levels, widest_image
from ....core.light.light_table import light_texture
from ....core.numeric.record import value_record
from ....core.scene.camera import Camera
from ....core.scene.scene import Scene
from ...cache.keys import Key, Kind
from ...cache.on_disk import NOWHERE, OnDisk
from ...cache.store import Store
from ...device.protocol import Texture
from ...passes.shading.lighting import bound_textures
from ...passes.shading.materials import material_rows
from ...passes.shadow.kept_depths import depths_form
from ...plan.plan import Plan
from ...shadow.maps import ShadowMaps
from ...shadow.shadows import Shadows, Tables
from .pane_maps import draw_panes
from .scope import UploadScope
from .shadow_maps import CasterUploads, draw_maps


@value_record
class ArrayIdentity:
    """An array as part of a key: equal to itself only. It holds the array, so that no other one takes its identity."""

    array: np.ndarray = field(compare=False)

    def __hash__(self) -> int:
        return id(self.array)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ArrayIdentity) and other.array is self.array


class LightingUploads:
    """What the shading of one frame reads."""

    def __init__(
        self,
        scope: UploadScope,
        store: Store,
        scene: Scene,
        plan: Plan,
        shadows: Shadows | None,
        camera: Camera,
        materials: bool = True,
    ) -> None:
        """`camera`: that sees the world. `materials`: what is lit has some."""
        self._scope, self._store, self._scene, self._plan = scope, store, scene, plan
        self._tables = None if shadows is None else shadows.tables
        self._maps = None if shadows is None else shadows.maps
        self._panes = None if shadows is None else shadows.panes
        self._faces = None if shadows is None else shadows.faces
        self.on_disk = NOWHERE if plan.presented else store.on_disk
        self.shadow_key = None if shadows is None else shadows.key  # None: nothing casts shadows
        table = material_rows(scene.materials, self._hair_escape())
        self._surface = float(table[0, 2, 1]), float(table[0, 2, 3])  # roughness and relative index of the first one
        self.materials: dict[str, Texture] = {}  # the material table, by sampler name, where a pass reads it
        bare = not (plan.shades or (plan.polygons and plan.variant.color) or plan.lines or plan.options.cull)
        lit = plan.solid or (plan.translucent is not None and not plan.translucent.alone)
        if materials and lit and not bare:
            texture = scope.device.texture((table.shape[1], len(table)), "RGBA32F", table.reshape(-1))
            self.materials["ps_materials"] = scope.own(texture)
        self._lights: Texture | None = None
        self._environment: Texture | None = None
        self.levels: Texture | None = None  # of the environment, each half as wide: passes/shading/backdrop.py
        pixel = 1 / max(abs(focal) for focal in camera.pixel_from_view()[:2]) if camera.perspective else np.inf
        self._widest = widest_image(pixel)  # texels along a side of pictures of the world
        world = scene.world
        reading = (*plan.lighting, *(plan.world if world.seen is None else ()))
        if "PS_HAS_ENVIRONMENT" in reading and world.image is not None:
            self._environment = self._upload_environment(world.image, world.mirrored)
        self._seen: Texture | None = None  # the environment and the lights' table of the world that cameras see,
        self._seen_lights: Texture | None = None  # if it is another one
        if world.seen is not None and "PS_HAS_ENVIRONMENT" in plan.world and world.seen.image is not None:
            self._seen = self._upload_environment(world.seen.image)
        if plan.backdrop and world.behind.image is not None:
            self.levels = self._upload_levels(world.behind.image)
        self._shadow_tables = None if self._tables is None else self._upload_tables(self._tables)
        self._shadow_maps: Texture | None = None
        self._shadow_panes: Texture | None = None
        if self._maps_are_kept:
            self.draw_maps()
        self._table_records: Texture | None = None  # of the lights in this view
        self._map_records: Texture | None = None
        self._pane_records: Texture | None = None
        self._face_records: Texture | None = None

    @property
    def textures(self) -> dict[str, Texture]:
        """What shading reads, by sampler name."""
        return bound_textures(
            materials=self.materials.get("ps_materials"), lights=self._lights, environment=self._environment,
            shadow_tables=self._shadow_tables, shadow_lights=self._table_records,
            shadow_maps=self._shadow_maps, map_lights=self._map_records,
            shadow_panes=self._shadow_panes, pane_lights=self._pane_records,
            pane_faces=self._face_records,
        )  # fmt: skip

    @property
    def behind(self) -> dict[str, Texture]:
        """What passes read that draw the world behind everything, by sampler name."""
        return self.textures | bound_textures(lights=self._seen_lights, environment=self._seen)

    @property
    def sky(self) -> dict[str, Texture]:
        """The picture of the world that surfaces gather, by sampler name; empty if the world is none."""
        world = self._scene.world
        if self._environment is None or world.image is None:
            return {}
        return {
            "ps_environment": self._environment if world.mirrored is None else self._upload_environment(world.image)
        }

    @property
    def lacks_maps(self) -> bool:
        """Whether `draw_maps` is to be called before anything is shaded."""
        return (self._maps is not None and self._shadow_maps is None) or (
            self._panes is not None and self._shadow_panes is None
        )

    def draw_maps(self) -> None:
        """Draws the depth maps of lights, and those of panes, or takes those that are kept."""
        device, maps, panes = self._scope.device, self._maps, self._panes
        if maps is not None:
            self._shadow_maps = self._drawn_maps(maps)
        if panes is not None:
            key = Key(Kind.PANE_TEXTURE, panes.key)
            # Not on disk: they are drawn in less time than they are read.
            self._shadow_panes = self._drawn(key, panes.maps, lambda casters: draw_panes(device, panes, casters))

    def _drawn_maps(self, maps: ShadowMaps) -> Texture:
        """Returns the texture of maps; those that others are nested in are drawn once for all views."""
        device, key = self._scope.device, Key(Kind.SHADOW_MAP_TEXTURE, maps.key)
        if maps.of_scene is None:
            return self._drawn(key, maps, lambda casters: draw_maps(device, maps, casters), self.on_disk)
        of_scene = self._drawn_maps(maps.of_scene)
        return self._drawn(key, maps, lambda casters: draw_maps(device, maps, casters, of_scene))

    def _drawn(
        self, key: Key, maps: ShadowMaps, draw: Callable[[CasterUploads], Texture], on_disk: OnDisk = NOWHERE
    ) -> Texture:
        """Returns the texture with a key, which `draw` makes where it is kept neither on the device nor on disk."""
        scope = self._scope

        def make() -> Texture:
            casters = CasterUploads(scope.kept, self._store, self._scene, self._plan, maps)
            try:
                return draw(casters)
            finally:
                casters.release()

        device = scope.device
        return scope.lookup(key, lambda: on_disk.lookup(key, make, depths_form(device), device.limits.driver))

    @property
    def _maps_are_kept(self) -> bool:
        kept, maps, panes = self._scope.kept, self._maps, self._panes
        return (maps is None or Key(Kind.SHADOW_MAP_TEXTURE, maps.key) in kept) and (
            panes is None or Key(Kind.PANE_TEXTURE, panes.key) in kept
        )

    def upload_view(self, camera: Camera) -> None:
        """Uploads the lights, and the records of their shadow tables and maps, in the space of a view."""
        scene = self._scene
        if self._plan.lighting or self._plan.world:
            rows = light_texture(scene.lights, scene.world, camera.view_from_world, *self._surface, near=camera.near)
            self._lights = self._scope.view_texture(rows)
            self._seen_lights = None
            if scene.world.seen is not None and self._plan.world:
                rows = light_texture((), scene.world.seen, camera.view_from_world)
                self._seen_lights = self._scope.view_texture(rows)
        records = self._records(camera.view_from_world, self._maps)
        self._table_records = records["shadow_lights"]
        self._map_records = records["map_lights"]
        self._pane_records = records["pane_lights"]
        self._face_records = records["pane_faces"]

    def _records(self, view_from_world: np.ndarray, maps: ShadowMaps | None) -> dict[str, Texture | None]:
        """Uploads the records of shadows in the space of a view, (4, 4), until the view is released."""
        tables = None if self._tables is None else self._tables.packed
        of = {"shadow_lights": tables, "map_lights": maps, "pane_lights": self._panes, "pane_faces": self._faces}
        upload = self._scope.view_texture
        return {name: None if one is None else upload(one.records(view_from_world)) for name, one in of.items()}

    def textures_in(self, view_from_world: np.ndarray) -> dict[str, Texture]:
        """Returns what shading reads, by sampler name, with shadows in the space of another view, (4, 4)."""
        return self.textures | bound_textures(**self._records(view_from_world, self._maps))

    def textures_for_all_cameras(self, view_from_world: np.ndarray) -> dict[str, Texture]:
        """Returns what shading reads, by sampler name, in a space, (4, 4), that is no camera's, without shadow maps
        that are nested in others for one."""
        scene, maps = self._scene, self._maps
        of_scene = None if maps is None else maps.of_scene
        records = self._records(view_from_world, maps if of_scene is None else of_scene)
        textures = self.textures | bound_textures(**records) | self.sky
        rows = light_texture(scene.lights, scene.world, view_from_world, *self._surface)
        textures["ps_lights"] = self._scope.view_texture(rows)
        if of_scene is not None:
            textures["ps_shadow_maps"] = self._drawn_maps(of_scene)
        return textures

    def _hair_escape(self) -> np.ndarray:
        """Returns how much light leaves the hair of each material, (M,): of the strands with most hairs, in view or
        not."""
        scene = self._scene
        most = np.zeros(len(scene.materials))
        for geometry in scene.geometries:
            if geometry.strands is not None and scene.materials.hair is not None:
                strands, rows = geometry.strands, list(geometry.strands.materials)
                key = Key(Kind.CROSSED_HAIRS, geometry.key)
                number = self._store.lookup(key, lambda strands=strands: hair.strands_crossed(strands))
                most[rows] = np.maximum(most[rows], number)
        return hair.escape_share(most)

    def _upload_tables(self, tables: Tables) -> Texture:
        data, device = tables.packed.data, self._scope.device

        def make() -> Texture:
            return device.texture((data.shape[1], data.shape[0]), "RGBA32F", data.reshape(-1))

        return self._scope.lookup(Key(Kind.SHADOW_TEXTURE, tables.key), make)

    def _upload_environment(self, image: np.ndarray, mirrored: np.ndarray | None = None) -> Texture:
        def make() -> Texture:
            atlas = build_atlas(image, mirrored, widest)
            return self._scope.device.texture((atlas.shape[1], atlas.shape[0]), "RGBA32F", atlas.reshape(-1))

        of = (image,) if mirrored is None else (image, mirrored)
        widest = min(self._widest, max(of[-1].shape[:2]))  # smaller ones are the same for all cameras
        return self._scope.lookup(Key(Kind.ENVIRONMENT, tuple(map(ArrayIdentity, of)), other=widest), make)

    def _upload_levels(self, image: np.ndarray) -> Texture:
        def make() -> Texture:
            levels = stack_levels(pyramid(build_atlas(image)))
            rgba = np.concatenate([levels, np.ones((*levels.shape[:2], 1), np.float32)], axis=2)
            return self._scope.device.texture((levels.shape[1], levels.shape[0]), "RGBA32F", rgba.reshape(-1))

        return self._scope.lookup(Key(Kind.ENVIRONMENT_LEVELS, ArrayIdentity(image)), make)
