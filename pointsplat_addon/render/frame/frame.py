"""One picture on the device: its samples drawn, averaged, presented and read back."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ...core.lens.backdrop import backdrop_grid
from ...core.numeric.blocks import give_back
from ...core.numeric.lattice import lattice_of
from ...core.scene.scene import Scene
from ...core.strand.segments import sample_offsets
from ..device.clock import Clock
from ..device.protocol import Texture, let_go
from ..indirect.known_sites import Slices
from ..indirect.light import IndirectLight
from ..indirect.traced import shines_past_rays
from ..passes.captured.half_depth import half_depth
from ..passes.gbuffer import GBuffer
from ..passes.grouping.centre import CentreDepths
from ..passes.image_space.pyramid import levels
from ..passes.output import present
from ..passes.output.adaptive import Adaptive
from ..passes.outputs import BY_KEY, CRYPTO, empty_pixels
from ..passes.shading import averages, data
from ..passes.shading.backdrop import Backdrop
from ..passes.tiles import EVERYWHERE
from ..passes.uniforms import SampleView, view_of
from ..plan.frame_plan import make_frame_plan
from ..plan.request import Request
from .data import DataPasses
from .defocus import OutOfFocus, in_focus
from .indirect.hits import HitShading
from .indirect.kept import kept_light, kept_triangles
from .indirect.light import GroupsInIndirectLight
from .indirect.mirrors import Mirrors
from .lens_samples import LensSamples
from .panes.layers import Panes
from .resources import FrameResources
from .sample_positions import is_checkpoint, lattice_offsets, offsets
from .shading import Shading
from .surfels import gbuffer_textures
from .targets import Targets
from .translucent import LitTranslucent, Translucent, lighting_of_sample
from .uploads.uploads import Uploads
from .visibility.crowds import without_unseen
from .visibility.layers import Visibility
from .visibility.targets import VisibilityTargets
from .visibility.tiles import IN_INSTANCE, cells_of_tile
from .visibility.translucent import TranslucentLayers


class Frame:
    """One picture in the making. Every call comes from the device's thread."""

    def __init__(
        self,
        renderer: FrameResources,
        scene: Scene,
        request: Request,
        cancelled: Callable[[], bool] = lambda: False,
        presented: bool = False,
        picture: bool = True,
        slices: Slices | None = None,
        known: IndirectLight | None = None,
    ) -> None:
        """Plans the picture and allocates what it needs on the device.

        `presented`: the picture is shown between samples. `picture`: draw Combined, not only auxiliary passes.
        `slices`: in which indirect light is gathered; None: all at once. Cancelled: the picture is not wanted, or
        gathering was put off. `known`: light of the same scene, from which indirect light is estimated; then nothing is
        gathered, and sharp mirrors show it blurred.
        """
        self._known = known
        self.renderer, self.presented = renderer, presented
        self.slices = Slices() if slices is None else slices
        self.device = renderer.device
        self.clock = Clock(self.device, cancelled)
        self.whole = scene  # before anything was left out of it
        # Planning can be cancelled: nothing of this frame is on the device yet.
        scene, self._hidden_known = without_unseen(renderer, scene, request, self.clock, presented, picture)
        self.frame_plan = make_frame_plan(
            scene,
            request,
            renderer.store,
            self.device.limits,
            renderer.costs,
            self.clock,
            presented,
            picture,
            renderer.kept.forget_streamed,
        )
        self.view = self.frame_plan.view  # of the sample that is drawn
        # Samples before it are not drawn.
        self.first = request.moment[0] if self.frame_plan.request.samples == request.moment[1] else 0
        self.done = self.first
        self.ended = False  # before all samples were drawn
        self.hurried = False  # presented only when it has ended
        self.beside: Frame | None = None
        self.lens: LensSamples | None = None
        self.backdrop: Backdrop | None = None
        self.adaptive: Adaptive | None = None
        self._indirect: IndirectLight | None = None
        self.lit: LitTranslucent | None = None
        self.translucent: Translucent | None = None
        self.visibility: Visibility | None = None
        self.out_of_focus: OutOfFocus | None = None
        # Of what lies under the pixels' centres, where it is known.
        self.central: GBuffer | None = None
        self.depths: CentreDepths | None = None
        self._drawing: Iterator[None] | None = None  # the sample that is being drawn
        self._darkened = 0  # samples in the picture with eye-dome lighting
        self._turns = sample_offsets(self.frame_plan.request.samples)
        self._data = DataPasses(self.frame_plan.scene, self.frame_plan.request)
        self._owned: list[Any] = []
        self._lent: tuple[tuple, Targets] | None = None
        try:
            if self.frame_plan.auxiliary is not None:
                self.beside = Frame(renderer, *self.frame_plan.auxiliary, cancelled, presented, picture=False)
                self.beside.clock.slow = False
            if not self.frame_plan.trivial:
                self._allocate()
        except Exception:
            self.release()
            raise

    # What is on the device

    def _allocate(self) -> None:
        device, frame_plan, run = self.device, self.frame_plan, self.clock.run
        plan, request = frame_plan.plan, frame_plan.request
        if frame_plan.through_lens:
            self.lens = self._own(LensSamples(device, frame_plan.view, request.samples))
        motion = plan.data and "vector" in data.data(request.passes)
        count = levels(frame_plan.prepared.largest, frame_plan.view.resolution)
        primitives = frame_plan.splats + frame_plan.triangles + frame_plan.segments
        primitives += IN_INSTANCE * len(frame_plan.scene.instances)
        most_cells = cells_of_tile(primitives, plan.presented, frame_plan.streamed is not None)
        wanted = plan, request.passes, frame_plan.view.window[2:], count, most_cells
        self.renderer.pool.make_room(*wanted)
        self._give_back()
        self.uploads: Uploads = self._own(
            Uploads(
                self.renderer.store,
                self.renderer.kept,
                frame_plan.scene,
                frame_plan.view,
                frame_plan.prepared,
                plan,
                motion,
                not (request.interactive or request.settings.budget != "NONE"),
                frame_plan.shadows,
                frame_plan.captured_shadows,
                frame_plan.matte_shadows,
                run,
            )
        )
        self.clock.spent |= self.uploads.spent
        self.uploads.draw_maps(run)
        if plan.backdrop:
            self.backdrop = self._own(Backdrop(device, backdrop_grid(frame_plan.view, device.limits.texture_size)))
        self._give_back()
        self._lent = self.renderer.pool.borrow(*wanted)
        self.targets = self._lent[1]
        if self.targets.sums:
            device.clear(self.targets.sum_target)
        if not frame_plan.not_adaptive:
            shown = self.presented and not plan.defocus and self.targets.surfels is not None
            centre = gbuffer_textures(self.targets.surfels).get("ps_centre") if shown else None
            threshold = request.settings.adaptive_threshold
            gather = 2 << count  # two pixels of the coarsest level on either side
            self.adaptive = self._own(Adaptive(device, self.targets.sums[0], threshold, gather, centre))
        self.shading = Shading(device, frame_plan.scene, plan, request, self.uploads, self.targets, self.backdrop)
        self._indirect = None
        if plan.gathers:
            self._indirect = self._kept_light() if self._known is None else self._known
        if plan.defocus:
            transparent = frame_plan.scene.transparent
            slices = self.slices if self._known is None else None
            self.out_of_focus = self._own(
                OutOfFocus(
                    device,
                    plan,
                    self.uploads,
                    self.targets,
                    transparent,
                    run,
                    self.renderer.store,
                    self._indirect,
                    slices,
                )
            )
        elif plan.translucent is not None:
            samples = request.samples * max(plan.sub_samples, 1)
            on_media = self._indirect if plan.translucent.gathered else None
            self.lit = self._own(LitTranslucent(device, plan, self.uploads, samples, run, on_media))
        if self.targets.visibility is not None:
            self._allocate_visibility(self.targets.visibility)
        elif self.lit is not None:
            self.translucent = Translucent(device, plan, self.lit, self.targets, run)

    def _give_back(self) -> None:
        """Gives freed memory back to the system, where much of it comes and goes and there is time for it."""
        if self.frame_plan.streamed is not None and not self.frame_plan.request.moving:
            let_go(self.device)
            give_back()

    def _allocate_visibility(self, targets: VisibilityTargets) -> None:
        device, plan, run, over = self.device, self.frame_plan.plan, self.clock.run, None
        if self.lit is not None and (not plan.panes or self.lit.captured is not None):
            over = self._own(TranslucentLayers(device, plan, self.lit.lit, targets, self.targets.combined_target, run))
        passes = self.frame_plan.request.passes
        indirect = None
        if plan.indirect and self._indirect is not None:
            light = self._indirect
            mirrors, slices = (self._mirrors(light), self.slices) if self._known is None else (None, None)
            indirect = GroupsInIndirectLight(device, light, self.uploads, plan.variant, slices, mirrors)
        part, panes = self.frame_plan.request.part if self._in_parts else (0, 1), None
        if plan.panes:
            lit, sums = None if self.lit is None else self.lit.lit, self.targets.combined_target
            panes = self._own(Panes(device, plan, self.uploads, targets, self.shading, sums, run, indirect, lit))
        self.visibility = self._own(
            Visibility(
                device,
                plan,
                passes,
                self.uploads,
                targets,
                self.shading,
                over,
                run,
                indirect,
                part,
                panes,
                self._hidden_known,
            )
        )

    def _kept_light(self) -> IndirectLight:
        """Returns the light that surfaces and media receive from each other."""
        device, frame_plan, uploads, store = self.device, self.frame_plan, self.uploads, self.renderer.store
        camera, bounces = frame_plan.request.camera, frame_plan.request.settings.bounces
        found: list[IndirectLight] = []
        scene, plan, check = frame_plan.scene, frame_plan.plan, self.clock.check

        def make() -> None:
            found.append(kept_light(device, uploads, scene, camera, plan, bounces, store, check, self.slices))

        self.clock.run("light tree", make)
        return found[0]

    def _mirrors(self, light: IndirectLight) -> Mirrors | None:
        """Returns what shows sharp mirrors what rays from them meet; None where there are none."""
        plan, scene = self.frame_plan.plan, self.frame_plan.scene
        if not plan.mirrors:
            return None
        shading = HitShading(self.device, scene, plan, self.uploads, self.frame_plan.request.samples)
        triangles = partial(kept_triangles, self.device, self.uploads, scene, light.origin)
        return Mirrors(triangles, shading, shines_past_rays(scene))

    # Parts

    @property
    def _in_parts(self) -> bool:
        """Whether each tile is drawn by itself; else the first part is the whole picture, and the others are empty."""
        plan = self.frame_plan.plan
        alone = not (plan.eye_dome or plan.defocus or self.beside is not None or self._data.every_sample)
        return not self.frame_plan.trivial and plan.sub_samples > 0 and alone

    @property
    def drawn(self) -> tuple[tuple[int, int, int, int], ...] | None:
        """The rectangles of the picture that are drawn, as in Result; None: all."""
        index, count = self.frame_plan.request.part
        if count == 1:
            return None
        if self.visibility is None or not self._in_parts:
            return () if index else ((0, 0, *self.frame_plan.size),)
        corner, size = np.array(self.frame_plan.corner), np.array(self.frame_plan.size)
        clipped = [np.clip((tile.corner, tile.end) - corner, 0, size).ravel() for tile in self.visibility.tiles]
        return tuple((x, y, right, up) for x, y, right, up in np.array(clipped).reshape(-1, 4).tolist())

    # Drawing

    def sample(self) -> bool:
        """Draws one more sample; returns False when there were enough. Cancelled: gathering indirect light was put off;
        the frame can only be released."""
        while True:
            more = self.sample_tile()
            if self._drawing is None:
                return more

    def sample_tile(self) -> bool:
        """Draws one more tile of a sample, or its beginning where gathering indirect light is put off, from which it
        goes on; returns and raises what `sample` does. Nothing of the picture can be had until `done` has grown."""
        if self.complete:
            return False
        if not self.frame_plan.trivial:
            if self._drawing is None:
                self._drawing = self._draw_sample(self.done == self.first)
            if next(self._drawing, True) is None:
                return True
            self._drawing = None
        self.done += 1
        if self.adaptive is not None and not self.complete:
            adaptive = self.adaptive
            self.clock.run("adapt", lambda: self._adapt(adaptive))
        if self.presented:
            self._darken()
        if self.presented and (self.complete or is_checkpoint(self.done)) and not self.hurried:
            self._gather()
        return not self.complete

    def end(self) -> None:
        """Ends the picture before all its samples are drawn."""
        self.ended = True
        if self.presented:
            self._gather()

    @property
    def complete(self) -> bool:
        """Whether no sample is missing."""
        request = self.frame_plan.request
        last = request.samples if request.moment[1] == 1 else self.first + 1
        return self.ended or self.done >= last or (self.adaptive is not None and self.adaptive.finished)

    def _draw_sample(self, first: bool) -> Iterator[None]:
        """Draws a sample. Stops between its tiles, and where gathering is put off."""
        plan = self.frame_plan.plan
        if self.lens is not None:
            self.view = self.lens.view(self.done, self.uploads)
        view = self._sample_view(self.done)
        if plan.defocus:
            near, far = in_focus(self.view, plan, self.frame_plan.prepared.largest)
            view = replace(view, near=near, far=far)
        if first and self.backdrop is not None:
            self.clock.run("backdrop", lambda: self.shading.draw_backdrop(self._centred()))
        if self.lit is not None:
            self._light(self.lit)
        if self.visibility is not None:
            yield from self._draw_visible(self.visibility, view, first)
        else:
            self._draw_shifted(view, first)
        if self.lit is not None and plan.translucent is not None and plan.translucent.depth and first:
            self._find_captured_depth(self.lit)
        if self.beside is not None:
            self.beside.sample()

    def _find_captured_depth(self, lit: LitTranslucent) -> None:
        nodes = bool(self.frame_plan.prepared.captured_nodes)

        def find() -> None:
            depth = half_depth(self.device, lit.lit, self._centred(), nodes)
            self._data.add_captured(self.frame_plan.cropped(depth))

        self.clock.run("captured depth", find)

    def _draw_shifted(self, view: SampleView, first: bool) -> None:
        """Draws a sample that is a picture of its own, shifted by a part of a pixel."""
        plan = self.frame_plan.plan
        self._draw_surfels(view, first)
        shown = self.adaptive.shown if self.adaptive else EVERYWHERE
        if self.translucent is not None:
            self.device.clear(self.targets.layer_target)
        if self.targets.surfels is not None and plan.shades:
            self.clock.run("shade", lambda: self.shading.shade(view, shown))
        if plan.background and plan.shades:
            self.clock.run("background", lambda: self.shading.draw_background(view, shown))
        if self.translucent is not None:
            self._draw_translucent(self.translucent, view, first)

    def _draw_visible(self, visibility: Visibility, view: SampleView, first: bool) -> Iterator[None]:
        """Draws a sample that is a whole lattice of sub-samples; stops as _draw_sample does."""
        assert self.targets.visibility is not None
        central, identify = first and self.frame_plan.plan.central, self._data.every_sample
        coarse = first and self.frame_plan.plan.coarse
        sums = self.targets.sum_target if self.targets.sums else None
        shown = yield from visibility.draw(view, sums, central, identify, coarse)
        if central:
            self.central, self.depths = self.targets.visibility.central, self.targets.visibility.depths
            if self.frame_plan.plan.data:
                self.clock.run("data", lambda: self._draw_data(view))
                self._data.read(self.targets.data, self._cropped, first, identify=False)
        if shown is not None:
            self._data.identify(shown, visibility.weights(view))

    def _draw_surfels(self, view: SampleView, first: bool) -> None:
        """Draws opaque primitives into G-buffers, and the passes that do not depend on light."""
        plan, uploads, run = self.frame_plan.plan, self.uploads, self.clock.run
        surfels, data_surfels = self.targets.surfels, self.targets.data_surfels
        projection = self.targets.projection
        for lines in uploads.strands.draws:
            lines.list_thin(float(self._turns[self.done]))
        beside = first or self._data.every_sample or self.shading.averages
        if projection is not None and (beside or not plan.painter):
            run("project", lambda: projection.run(uploads.points.draws, view, uploads.shared))
        if surfels is not None:
            region = self.adaptive.gathered if self.adaptive else EVERYWHERE
            surfels.draw(uploads, None if plan.painter else projection, view, run, region)
        if beside and data_surfels is not None and data_surfels is not surfels:
            data_surfels.draw(uploads, projection, view, run)
        if self.lens is not None and first and self.presented and data_surfels is not None:
            self.lens.keep(data_surfels.buffer.textures["centre"])
        if plan.data and (first or self._data.every_sample):
            run("data", lambda: self._draw_data(view))
            self._data.read(self.targets.data, self._cropped, first)
        if self.shading.averages:
            run("averages", lambda: self.shading.average(view))

    def _sample_view(self, index: int) -> SampleView:
        """Returns the view of one sample, with its offset within the pixel."""
        samples, plan = self.frame_plan.request.samples, self.frame_plan.plan
        x, y = (0.0, 0.0)
        if samples > 1 and plan.sub_samples:
            x, y = lattice_offsets(samples, lattice_of(plan.sub_samples))[index]
        elif samples > 1:
            x, y = offsets(samples, plan.filter_size)[index]
        return view_of(self.view, (float(x), float(y)), index)

    def _centred(self) -> SampleView:
        """Returns the view whose rays go through pixel centres."""
        return view_of(self.view)

    def _draw_data(self, view: SampleView) -> None:
        frame_plan = self.frame_plan
        textures = gbuffer_textures(self.targets.data_surfels) if self.central is None else self.central.bound()
        if self.uploads.previous is not None:
            textures["ps_previous"] = self.uploads.previous
        program = data.data_program(
            frame_plan.plan.data_variant, frame_plan.request.passes, frame_plan.plan.matte_light.lit
        )
        record = view.record_of(program.block, resolution=self.view.resolution, corner=self.view.window[:2])
        self.device.draw(program, self.targets.data_target, uniforms=record, textures=textures)

    def _draw_translucent(self, translucent: Translucent, view: SampleView, first: bool) -> None:
        translucent.draw(view, gbuffer_textures(self.targets.surfels), coarse=first and self.frame_plan.plan.coarse)

    def _light(self, lit: LitTranslucent) -> None:
        """Lights translucent splats for the sample that is drawn, where they are not lit like that."""
        # All samples share the light of translucent splats, except with a lens or shadows of wide lights, whose points
        # are averaged over samples.
        shadows = self.frame_plan.shadows, *self.frame_plan.captured_shadows.values()
        wide = any(one is not None and one.wide for one in shadows)
        points = lighting_of_sample(self.frame_plan.request, self.done) if wide else 0
        if points != lit.lit_by or self.lens is not None:
            lit.light(points, self._centred())

    def _adapt(self, adaptive: Adaptive) -> None:
        """Narrows the drawn points to those in tiles that still need samples."""
        view, projection, uploads = self._sample_view(0), self.targets.projection, self.uploads
        if adaptive.check(self.done) and projection is not None and not adaptive.finished:
            uploads.points.narrow(projection.within(uploads.points.draws, view, uploads.shared, adaptive.gathered))

    def _darken(self) -> None:
        """Brings eye-dome lighting into the picture so far."""
        if not self.frame_plan.plan.eye_dome or self._darkened == self.done:
            return
        dome, centre, self._darkened = self.targets.eye_dome, self._centre, self.done
        assert dome is not None
        assert centre is not None
        settings = self.frame_plan.request.settings
        radius, strength = settings.eye_dome_radius, settings.eye_dome_strength
        self.clock.run("eye dome", lambda: dome.draw(self.targets.sums[0], centre, self.view, radius, strength))

    def _gather(self) -> None:
        """Gathers the splats that are out of focus into the picture so far."""
        if self.out_of_focus is not None:
            behind, texels = self.shading.backdrop_textures, self.shading.backdrop_texels
            self.out_of_focus.gather(self.done - self.first, self._centred(), behind, texels, self.adaptive)

    # Between samples

    @property
    def indirect(self) -> IndirectLight | None:
        """The indirect light of the picture; None where it has none."""
        return self._indirect

    @property
    def blends(self) -> bool:
        """Whether each sample draws translucent splats."""
        return self.lit is not None

    @property
    def color(self) -> Texture:
        """The texture of the sum of all samples so far: premultiplied, scene-linear. `present` averages it."""
        if self.out_of_focus is not None:
            return self.targets.seen
        return self.targets.sums[0] if self.targets.eye_dome is None else self.targets.eye_dome.lit

    def other(self, request: Request, samples: int) -> np.ndarray | None:
        """Returns the mean, (H, W, 4) float32, of `samples` samples of the scene by another request.

        Returns None if that request would draw the same picture.
        """
        frame = Frame(self.renderer, self.whole, request, self.clock.cancelled)
        try:
            a, b = frame.frame_plan, self.frame_plan
            if (a.splats, a.segments, a.triangles) == (b.splats, b.segments, b.triangles):
                return None
            while frame.done < samples and frame.sample():
                frame.clock.settle()
                frame.clock.check()
            return frame.mean()
        finally:
            frame.release()

    def hold(self, squares: np.ndarray, limit: float) -> None:
        """Continues adaptive sampling in tiles where the root mean of the squared errors (H, W) exceeds `limit`."""
        if self.adaptive is not None:
            self.adaptive.hold(self.frame_plan.padded(squares), limit)

    def present(self, smooth: bool = False) -> None:
        """Draws the average so far and its depth into the bound framebuffer, within the current viewport.

        `smooth`: where pixels are wider than the viewport's, colours change evenly between their centres.
        """
        if self.frame_plan.trivial:
            self._present_constant()
            return
        weight = 1.0 if self.out_of_focus is not None else 1 / max(self.done - self.first, 1)
        adaptive = self.adaptive if self.out_of_focus is None else None
        counts = None if adaptive is None else adaptive.known
        camera = self.frame_plan.request.camera
        corner, centre = self.frame_plan.corner, self._centre
        present.draw_picture(self.device, camera, corner, self.color, weight, centre, counts, smooth=smooth)

    @property
    def _centre(self) -> Texture | None:
        """Returns the texture with depths of a picture without a lens, which occlude Blender's own drawing."""
        if self.lens is not None and self.lens.centre is not None:
            return self.lens.centre
        if self.adaptive is not None and self.out_of_focus is None:
            return self.adaptive.centre
        under_centres = self.central or self.depths
        if under_centres is not None:
            return under_centres.textures["centre"]
        if self.beside is not None and not self.beside.frame_plan.trivial:
            return self.beside._centre
        return gbuffer_textures(self.targets.data_surfels).get("ps_centre")

    def _present_constant(self) -> None:
        """Presents a world of one colour, for which one texel suffices."""
        texel = self.device.texture((1, 1), "RGBA32F", self.frame_plan.world_color.astype(np.float32))
        present.draw_picture(self.device, self.frame_plan.request.camera, (0, 0), texel, 1.0, size=(1, 1))
        texel.release()

    # Results

    def counts(self) -> np.ndarray | int:
        """Returns how many samples each pixel has: (H, W, 1) float32, or one number for all pixels."""
        return (
            max(self.done - self.first, 1)
            if self.adaptive is None
            else self.frame_plan.cropped(self.adaptive.samples(self.done))
        )

    def in_focus(self) -> np.ndarray | None:
        """Returns the share of each pixel that is in focus, (H, W, 1) float32; None if nothing is out of focus."""
        if self.out_of_focus is None:
            return None
        return self._cropped(self.targets.focus)[..., 1:2] / self.counts()

    def mean(self) -> np.ndarray:
        """Returns the picture so far, (H, W, 4) float32."""
        if self.frame_plan.trivial:
            return self._empty(frozenset({"combined"}))["combined"]
        if self.out_of_focus is not None:
            self._gather()
            return self._cropped(self.targets.seen)
        self._darken()
        return self._cropped(self.color) / self.counts()

    def pixels(self) -> dict[str, np.ndarray]:
        """Returns every requested pass, (H, W, C) float32 by name."""
        plan, passes = self.frame_plan.plan, self.frame_plan.request.passes
        wanted = passes | (frozenset({"combined"}) if plan.picture else frozenset())
        if self.frame_plan.trivial:
            return self._empty(wanted)
        self._gather()
        self._darken()
        sums = [self.color, *self.targets.sums[1:]] if plan.picture else self.targets.sums
        sums, samples = (sums, self.counts()) if self.out_of_focus is None else ([self.color], 1)
        out: dict[str, np.ndarray] = {}
        names = (*(("combined",) if plan.picture else ()), *averages.averaged(passes))
        for name, texture in zip(names, sums, strict=True):
            mean = self._cropped(texture) / samples
            out[name] = np.ascontiguousarray(mean[..., : BY_KEY[name].channels])
        out |= self._data.pixels(self.frame_plan.cropped)
        found = {key: array for key, array in out.items() if key in wanted or key.startswith(CRYPTO)}
        found |= self._empty(frozenset(key for key in wanted if not {key, f"{key}00"} & found.keys()))
        if self.beside is not None:
            found |= self.beside.pixels()
        return found

    def _empty(self, keys: frozenset[str]) -> dict[str, np.ndarray]:
        return empty_pixels(
            keys, self.frame_plan.size, self.frame_plan.world_color, self.frame_plan.request.crypto_levels
        )

    def _cropped(self, texture: Texture) -> np.ndarray:
        return self.frame_plan.cropped(self.device.read(texture))

    def keep_shown(self) -> None:
        """Frees what drawing samples needs most memory for: what is drawn can then only be presented or read."""
        visibility = None if self._lent is None else self.targets.visibility
        if visibility is None:
            return
        # As they are others cannot borrow them.
        self._lent = None
        self._own(self.targets)
        visibility.release_cells()
        self._give_back()

    def release(self) -> None:
        """Frees everything on the device that only this picture needs."""
        self._drawing = None
        self.clock.release()
        for item in self._owned:
            item.release()
        self._owned.clear()
        if self.beside is not None:
            self.beside.release()
        if self._lent is not None:
            self.renderer.pool.give_back(*self._lent)
        self._lent = None

    def _own(self, item: Any) -> Any:
        self._owned.append(item)
        return item
