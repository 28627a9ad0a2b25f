"""Shades what rays have met, exactly as what is seen without mirrors, but for what depends on pixels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ....core.scene.scene import Scene
from ...device.packing import octahedral, paged
from ...device.protocol import CHANNELS, Device, Texture
from ...indirect.traced import Hits, SceneTriangles, cut_out, is_traced, reflecting, surfaces_at
from ...passes.gbuffer import Variant
from ...passes.shading.shade import shade_program, shade_values
from ...passes.uniforms import SampleView
from ...plan.plan import Plan
from ..uploads.uploads import Uploads
from .receivers import Groups

COARSER = np.float32(2.0)  # in mirrors, indirect light is found in cells so many times as wide
POLYGON = -1e30  # shaders/lib/geometry/surfel_kind.glsl
# Draws what groups show, given what indirect light they receive, by sampler name. Of groups, with the lengths of their
# ways as depths: roughness (N,), < 0: nothing is mirrored; directions (N, 3) to where they are seen from.
Lit = Callable[[SampleView, Groups, np.ndarray, np.ndarray, Callable[[dict[str, Texture]], None]], None]
# Which groups (n,) mirror something sharply; (n, 4) what: radiance, and 1 where nothing is; and its share (n,) in what
# they mirror.
Mirrored = tuple[np.ndarray, np.ndarray, np.ndarray]
Mirror = Callable[[Groups, np.ndarray, np.ndarray, np.ndarray], Mirrored | None]  # also their planes


class HitShading:
    """The program that shades what rays have met, and what it reads."""

    def __init__(self, device: Device, scene: Scene, plan: Plan, uploads: Uploads, samples: int) -> None:
        """`samples`: of a picture."""
        self._device, self._scene, self._uploads = device, scene, uploads
        self._variant = Variant(color=True, surface=True, emission=True, wide=True, spread=True, front=False)
        # Nothing depends on where in the picture it lies; of light, all terms are seen.
        lighting = tuple(name for name in plan.lighting if name not in ("PS_SHADOW_NESTED", "PS_FOG"))
        terms = set() if plan.term is None else set(plan.term.defines)
        materials = [name for name in plan.materials if name not in {*terms, "PS_ONE_SURFACE", "PS_HAS_METAL"}]
        self._program = shade_program(
            self._variant, lighting, (*materials, "PS_HAS_METAL"), frozenset({"combined"}), samples,
            indirect=True, hits=True,
        )  # fmt: skip
        self._reflects = reflecting(scene.materials)
        self._textures: dict[str, Texture] = {}
        self._textures_of: object = None  # the camera that they are for

    def cut_out(self, triangles: SceneTriangles, row: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """(N,) bool: places that alpha cuts out, in rows (N,) of triangles, with weights (N, 2) of corners 1 and 2."""
        return cut_out(self._scene, triangles, row, weights)

    def shade(
        self,
        view: SampleView,
        triangles: SceneTriangles,
        hits: Hits,
        position: np.ndarray,
        seen: Groups,
        lit: Lit,
        mirrored: Mirror | None,
    ) -> np.ndarray:
        """Returns the radiance, (N, 3) float32, that hits send back along their rays. `mirrored`: what they mirror.

        position: (N, 3), from the eye along the world's axes. `seen`: the mirrors' depths and pixels; see `lit`.
        """
        found = surfaces_at(self._scene, triangles, hits)
        smooth = np.where(self._reflects[found.material] | (found.surface[:, 1] > 0), found.surface[:, 0], -1)
        groups = Groups(seen.eye, position + seen.eye, found.normal, seen.depth, seen.pixel)
        turn = view.world_from_view[:3, :3]
        instance, holdout = triangles.instance[hits.row], self._scene.instances.holdout
        material = found.material.astype(np.float32)
        if holdout is not None:
            material = np.where(holdout[instance], -1 - material, material)
        count = len(position)
        zero = np.zeros(count)
        rows = {
            "ps_centre": np.column_stack(
                [seen.depth, found.spread, 1 + octahedral(found.plane @ turn), zero + POLYGON]
            ),
            "ps_shape": np.column_stack([zero, zero, zero, material]),
            "ps_normal": np.column_stack([found.normal @ turn, found.surface[:, 0]]),
            "ps_color": np.column_stack([found.color, found.surface[:, 1]]),
            "ps_emission": np.column_stack([found.emission, zero]),
        }
        formats = {f"ps_{name}": format for name, format, _ in self._variant.channels}
        rows |= {"ps_hit_places": position @ turn, "ps_hit_rays": hits.direction @ turn}
        device, made, shaded = self._device, {}, []
        try:
            for name, values in rows.items():
                format = formats.get(name, "RGBA32F")
                size, data = paged(values.astype(np.float32), CHANNELS[format])
                made[name] = device.texture(size, format, data)

            def draw(received: dict[str, Texture]) -> None:
                out = device.texture(made["ps_centre"].size, "RGBA32F")
                target = device.target([out])
                device.clear(target)
                try:
                    wanted = {name for _, name in self._program.samplers}
                    if mirrored is not None:
                        shown = mirrored(groups, smooth, found.plane, -hits.direction)
                        received = received if shown is None else received | mixed(received, shown)
                    textures = {**self._lighting(view), **made, **received}
                    textures = {name: texture for name, texture in textures.items() if name in wanted}
                    record = view.record_of(self._program.block, **shade_values(self._scene))
                    device.draw(self._program, target, uniforms=record, textures=textures)
                    shaded.append(device.read(out).reshape(-1, 4)[:count, :3])
                finally:
                    target.release()
                    out.release()

            def mixed(received: dict[str, Texture], shown: Mirrored) -> dict[str, Texture]:
                rows, light, share = shown
                whole = device.read(received["ps_mirrored_light"])
                texels = whole.reshape(-1, 4).copy()
                texels[rows] += share[:, None] * (light - texels[rows])
                made["again"] = device.texture(made["ps_centre"].size, "RGBA32F", texels.reshape(-1))
                return {"ps_mirrored_light": made["again"]}

            gathering = smooth if mirrored is None else np.where(is_traced(smooth) == 1, -1, smooth)
            lit(view, replace(groups, depth=COARSER * seen.depth), gathering, -hits.direction, draw)
        finally:
            for texture in made.values():
                texture.release()
        return shaded[0]

    def _lighting(self, view: SampleView) -> dict[str, Texture]:
        """What shading reads of lights and shadows, also beside the picture, by sampler name."""
        uploads = self._uploads
        if self._textures_of is not uploads.camera:
            own = uploads.lighting.textures
            textures = uploads.lighting.textures_for_all_cameras(view.camera.view_from_world)
            # The world as mirrors show it.
            textures |= {name: own[name] for name in ("ps_lights", "ps_environment") if name in own}
            self._textures, self._textures_of = textures, uploads.camera
        return self._textures
