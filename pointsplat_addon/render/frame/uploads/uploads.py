"""Coordinates the uploads of one frame: makes them for a view, and moves them to another one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ....core.scene.camera import Camera
from ....core.scene.scene import Scene
from ...cache.device_cache import DeviceCache
from ...cache.keys import Key
from ...cache.store import Store
from ...device.protocol import Texture
from ...plan.plan import Plan
from ...prepare.prepare import Prepared
from ...shadow.shadows import Shadows
from .captured import CapturedUploads
from .instances import previous_clip_from_view
from .lighting import LightingUploads
from .points import PointUploads
from .polygons import PolygonUploads
from .scope import UploadScope
from .strands import StrandUploads
from .translucent import TranslucentUploads

Run = Callable[[str, Callable[[], None]], None]  # runs a pass by its name


def at_once(name: str, work: Callable[[], None]) -> None:
    """Runs a pass."""
    work()


class Uploads:
    """Everything that one view of a scene reads; small tables are this frame's own, the rest is kept in a cache."""

    def __init__(
        self,
        store: Store,
        kept: DeviceCache,
        scene: Scene,
        camera: Camera,
        prepared: Prepared,
        plan: Plan,
        motion: bool = False,
        exact: bool = False,
        shadows: Shadows | None = None,
        captured_shadows: Mapping[int, Shadows | None] | None = None,
        matte_shadows: Shadows | None = None,
        run: Run = at_once,
    ) -> None:
        """`motion`: a pass asks how instances move. `exact`: nothing may depend on earlier frames.
        `captured_shadows`: that captured splats receive, by geometry; `matte_shadows`: that mattes do.
        `run`: times what is drawn. DeviceError: a texture is too large, or memory is full."""
        self.scene, self.camera, self.prepared = scene, camera, prepared
        self._middle = prepared.view_from_object
        self._scope = UploadScope(kept)
        self.translucent: TranslucentUploads | None = None
        self.captured: CapturedUploads | None = None
        self._captured_lighting: dict[int, LightingUploads] = {}
        self.matte_lighting: LightingUploads | None = None
        self.previous: Texture | None = None  # clip space a frame before from today's view space
        if pages := {geometry.key for geometry in scene.geometries if geometry.streamed is not None}:
            kept.forget_streamed(but=pages)  # before others are uploaded, for both may not fit
        try:
            self.lighting = LightingUploads(self._scope, store, scene, plan, shadows, camera)
            if plan.matte_light.lit:
                self.matte_lighting = self._lighting_of_captured(
                    store, scene, plan, plan.matte_light.names, matte_shadows
                )
            if pages:
                self.draw_maps(run)  # before what is drawn is uploaded: what casts takes as much
            self.points = PointUploads(self._scope, scene, prepared, plan)
            if pages:
                kept.forget_streamed()  # what cast, where no picture draws the same
            self.polygons = PolygonUploads(self._scope, store, scene, prepared, plan, camera)
            self.strands = StrandUploads(self._scope, store, scene, prepared, plan)
            if plan.translucent is not None and plan.translucent.captured:
                self._captured_lighting = {
                    row: self._lighting_of_captured(store, scene, plan, light.names, (captured_shadows or {})[row])
                    for row, light in plan.captured_light
                }
                lighting = self._captured_lighting
                self.captured = CapturedUploads(self._scope, store, scene, camera, prepared, plan, lighting)
            if plan.translucent is not None and not plan.translucent.alone:
                self.translucent = TranslucentUploads(self._scope, scene, camera, prepared, plan, self.lighting, exact)
            self._upload_view()
            if motion:
                rows = previous_clip_from_view(scene, camera, prepared.view_from_object)
                self.previous = self._scope.texture(rows)
            kept.trim_unused()
        except Exception:
            self.release()
            raise

    def _lighting_of_captured(
        self, store: Store, scene: Scene, plan: Plan, names: tuple[str, ...], shadows: Shadows | None
    ) -> LightingUploads:
        plan = replace(plan, lighting=names)
        return LightingUploads(self._scope, store, scene, plan, shadows, self.camera, materials=False)

    def lookup(self, key: Key, make: Callable[[], Any]) -> Any:
        """Returns what `make` puts on the device, made once for `key`; it stays at least as long as the frame."""
        return self._scope.lookup(key, make)

    @property
    def shared(self) -> dict[str, Texture]:
        """What several passes of geometry read, by sampler name: the material table, and the instances of points."""
        return {**self.lighting.materials, **self.points.instances}

    @property
    def lightings(self) -> tuple[LightingUploads, ...]:
        """What lights everything, and what lights captured splats."""
        mattes = () if self.matte_lighting is None else (self.matte_lighting,)
        return self.lighting, *mattes, *self._captured_lighting.values()

    def draw_maps(self, run: Run) -> None:
        """Draws the depth maps of lights that are not there."""
        for lighting in self.lightings:
            if lighting.lacks_maps:
                run("shadow maps", lighting.draw_maps)

    @property
    def shading(self) -> dict[str, Texture]:
        """What shading reads, by sampler name."""
        return self.lighting.textures

    @property
    def behind(self) -> dict[str, Texture]:
        """What passes read that draw the world behind everything, by sampler name."""
        return self.lighting.behind

    @property
    def spent(self) -> dict[str, float]:
        """Milliseconds of the passes that the processor does, by name."""
        sorts = [uploads.sort_ms for uploads in (self.translucent, self.captured) if uploads is not None]
        known = [sort_ms for sort_ms in sorts if sort_ms is not None]
        return {"order": sum(known)} if known else {}

    def move(self, view_from_middle: np.ndarray, camera: Camera) -> None:
        """Uploads anew what depends on the view alone, for a camera that the cut was prepared for too.

        view_from_middle: (4, 4), its view space from that of the camera that everything was uploaded for.
        """
        self._scope.release_view()
        self.camera = camera
        self.prepared = replace(self.prepared, view_from_object=view_from_middle @ self._middle)
        self._upload_view()
        self.points.mark_moved()

    def _upload_view(self) -> None:
        for lighting in self.lightings:
            lighting.upload_view(self.camera)
        self.points.upload_view(self.prepared)
        self.strands.upload_view(self.prepared)
        if self.translucent is not None:
            self.translucent.upload_view(self.prepared)
        if self.captured is not None:
            self.captured.upload_view(self.prepared, self.camera, self.translucent)

    def release(self) -> None:
        """Frees what only this frame needs."""
        self._scope.release()
