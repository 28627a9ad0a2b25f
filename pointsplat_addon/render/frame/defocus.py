"""Gathers the splats of a picture that are out of focus, once for all samples, over the mean of those in focus.

Passes that are not blurred come from an auxiliary picture without a lens.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from ...core.indirect.closed import is_closed
from ...core.lod.criteria import NEIGHBOUR_EXTENT
from ...core.scene.camera import Camera
from ...core.scene.scene import Scene
from ...core.splat.blur import OUT_OF_FOCUS, defocus_blur
from ..cache.keys import Key, Kind
from ..cache.store import Store
from ..device.protocol import Device, Texture
from ..indirect.known_sites import Slices
from ..indirect.light import IndirectLight
from ..passes.defocus.gather import Defocus, defocus_program
from ..passes.defocus.tile_lists import Planes, tile_lists
from ..passes.output.adaptive import Adaptive
from ..passes.translucent.light import instances_of_rows, light_program, places_program
from ..passes.translucent.lit_splats import LitSplats
from ..passes.uniforms import SampleView
from ..plan.plan import Plan
from .indirect.light import GroupsInIndirectLight
from .targets import Targets
from .uploads.uploads import Uploads


def in_focus(camera: Camera, plan: Plan, largest: float) -> tuple[float, float]:
    """Returns the nearest and farthest depth, in scene units, at which something may be in focus.

    `largest`: radius of the widest splat in pixels. Image-space reconstruction spreads points over their neighbours,
    which widens the range. The camera must have an aperture.
    """
    blur = defocus_blur(camera)
    assert blur is not None
    near, far = blur.depth_range(OUT_OF_FOCUS)
    if plan.points and plan.ewa is None and not plan.sub_samples:
        reach = (NEIGHBOUR_EXTENT - 1) * largest / abs(camera.pixel_from_view()[0])
        near -= reach * (near if camera.perspective else 1.0)
        far += reach * (far if camera.perspective else 1.0)
    return max(camera.near, near), min(camera.far, far)


def seen_from_outside(scene: Scene, camera: Camera, instances: np.ndarray, store: Store) -> np.ndarray:
    """Returns which instances (K,) int are closed meshes in whose box the camera is not, (K,) bool."""
    eye = np.linalg.inv(camera.view_from_world)[:3, 3]
    geometry, matrices = scene.instances.geometry[instances], scene.instances.world_from_object[instances]
    found = np.zeros(len(instances), bool)
    for row in np.unique(geometry).tolist():
        mesh, rows = scene.geometries[row].mesh, np.flatnonzero(geometry == row)
        if mesh is None or len(mesh.position) == 0:
            continue
        if store.lookup(Key(Kind.IS_CLOSED, mesh.key), partial(is_closed, mesh)):
            ends = np.stack([mesh.position.min(axis=0), mesh.position.max(axis=0)]).astype(np.float64)
            corners = np.stack(np.meshgrid(*ends.T, indexing="ij"), axis=-1).reshape(-1, 3)
            placed = corners @ matrices[rows, :3, :3].transpose(0, 2, 1) + matrices[rows, None, :3, 3]
            within = ((eye > placed.min(axis=1)) & (eye < placed.max(axis=1))).all(axis=1)
            found[rows] = ~(within & camera.perspective)
    return found


class OutOfFocus:
    """Draws the splats of one picture that are out of focus, together with the translucent ones."""

    def __init__(
        self,
        device: Device,
        plan: Plan,
        uploads: Uploads,
        targets: Targets,
        transparent: bool,
        run: Callable[[str, Callable[[], None]], None],
        store: Store,
        indirect: IndirectLight | None = None,
        slices: Slices | None = None,
    ) -> None:
        """Prepares to light the splats.

        `transparent`: whether the film is. `run` times each pass. `store`: for what is known of the scene. `indirect`:
        light that they receive from each other, gathered in `slices`, or estimated. Raises DeviceError if there are
        more splats than a texture holds.
        """
        assert plan.translucent is not None
        assert uploads.translucent is not None
        self.splats = uploads.translucent
        self.device, self.plan, self.uploads, self.targets = device, plan, uploads, targets
        self.transparent, self._run = transparent, run
        self.gathered = 0  # samples in the picture
        self.tiles: Defocus | None = None
        options = plan.translucent
        if options.gathered and (indirect is None or indirect.media is None):
            options = replace(options, gathered=False)
        program = light_program(options, plan.lighting, plan.materials)
        self.lit = LitSplats(device, options, program, self.splats.count)
        self._indirect, self._surfaces, self._store = indirect, None, store
        if options.received and indirect is not None:
            self._surfaces = GroupsInIndirectLight(device, indirect, uploads, plan.variant, slices)
            self._places = places_program(options)

    def gather(
        self,
        done: int,
        view: SampleView,
        behind: dict[str, Texture],
        backdrop_texels: tuple[float, float] | None,
        adaptive: Adaptive | None,
    ) -> None:
        """Draws the picture after `done` samples of the parts in focus.

        `view`: of rays through pixel centres. `behind`: texture of the world out of focus, by sampler name.
        `backdrop_texels`: its texels that a pixel spans. `adaptive`: given if pixels differ in their number of samples.
        """
        if self.gathered == done or (self.gathered and not self.plan.solid):
            return
        self.gathered = done
        assert self.plan.translucent is not None
        if self.tiles is None:
            self._run("light", lambda: self._light(view))
            self._run("tiles", lambda: self._list(view))
        tiles = self.tiles
        assert tiles is not None
        program = defocus_program(
            self.plan.background_defines, self.transparent, self.plan.translucent.slopes, self.plan.translucent.tint,
            self.plan.translucent.holdout, adaptive is not None, tiles.tile, self.plan.term,
        )  # fmt: skip
        sharp = {"ps_focused": self.targets.sums[0], "ps_focus": self.targets.focus}
        textures = {**self.uploads.behind, **behind, **sharp}
        if adaptive is not None:
            textures["ps_counts"] = adaptive.known
        record = view.record_of(
            program.block, sample_weight=1 / done, backdrop_texels=backdrop_texels,
            light_count=len(self.uploads.scene.lights),
        )  # fmt: skip
        self._run("defocus", lambda: tiles.draw(program, self.targets.seen_target, record, self.lit.textures, textures))

    def _light(self, view: SampleView) -> None:
        textures, gathered = {**self.splats.textures, **self.uploads.shading}, {}
        if self._indirect is not None and (on := self._indirect.on_media(view.camera.view_from_world)) is not None:
            gathered, textures["ps_medium_light_of"] = on

        def light(received: dict[str, Texture]) -> None:
            self.lit.light(view, len(self.uploads.scene.lights), textures | received, **gathered)

        if self._surfaces is None:
            light({})
        else:
            self._surfaces.received_by(view, *self._places_of_splats(view), light)

    def _places_of_splats(self, view: SampleView) -> tuple[np.ndarray, np.ndarray]:
        """Places and normals of all splats, (N, 4) float32 each, as shaders/indirect/group_points.frag has them."""
        device, program, held = self.device, self._places, []
        turned = np.eye(4)
        turned[:3, :3] = view.world_from_view[:3, :3]
        try:
            held += [device.texture(self.lit.target.colors[0].size, "RGBA32F") for _ in range(2)]
            held.append(device.target(held[:2]))
            names = {name for _, name in program.samplers}
            textures = {**self.splats.textures, **self.uploads.shading}
            record = view.record_of(
                program.block, count=self.lit.count, low_pass_scale=1.0, tree_from_view=turned,
                light_count=0,
            )  # fmt: skip
            device.clear(held[2])
            device.draw(
                program, held[2], uniforms=record,
                textures={name: texture for name, texture in textures.items() if name in names},
            )  # fmt: skip
            place, up = (device.read(texture).reshape(-1, 4)[: self.lit.count] for texture in held[:2])
            order = device.read(textures["ps_order"]).reshape(-1, 2)[: self.lit.count]
        finally:
            for item in reversed(held):
                item.release()
        # Backs of bodies are hidden, or seen past the front by parts of the lens: within them all would be dark.
        backs = np.flatnonzero(place[:, 3] < 0)
        instances, of_each = np.unique(instances_of_rows(order[backs]), return_inverse=True)
        outside = seen_from_outside(self.uploads.scene, view.camera, instances, self._store)
        up[backs[outside[of_each]], :3] *= -1
        place[:, 3] = np.abs(place[:, 3])
        return place, up

    def _list(self, view: SampleView) -> None:
        """Lists the lit splats by the tiles of the picture that they overlap."""
        lit = self.lit
        names = ("ps_centre", "ps_shape", "ps_slope") if "ps_slope" in lit.textures else ("ps_centre", "ps_shape")
        centre, shape, *slopes = (self.device.read(lit.textures[name]).reshape(-1, 4)[: lit.count] for name in names)
        focal = np.array([*view.camera.pixel_from_view()[:2], *view.principal_point], np.float32).astype(np.float64)
        planes = Planes(slopes[0], view.camera.perspective) if slopes else None
        self.tiles = Defocus(self.device, tile_lists(centre, shape, focal, self.targets.seen.size, planes))

    def release(self) -> None:
        self.lit.release()
        if self._surfaces is not None:
            self._surfaces.release()
        if self.tiles is not None:
            self.tiles.release()
