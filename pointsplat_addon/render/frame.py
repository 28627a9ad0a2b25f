"""One picture: prepare the scene for its view, plan, draw samples, average, report."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Set
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..core.backdrop import grid_of, why_sharp
from ..core.cost import DEFAULT
from ..core.cut import NEIGHBOURS
from ..core.defocus import BLURRED, NODE, blur_of
from ..core.lens import sampled
from ..core.scene import Camera, Scene, Settings, World
from ..core.sound import sound_camera
from ..core.strands import turns
from ..shading.interface import Interface
from . import budget
from .budget import checkpoint
from .device import Device, Target, Texture, Timer
from .faint import without_faint
from .filtering import cryptomatte, offsets
from .in_view import in_view
from .lens import LensSamples, prepared_for
from .outputs import BACKGROUND_DEPTH, BY_KEY, CRYPTO
from .painter import defocused, painted
from .parts import parted
from .passes import backdrop as backdrop_pass
from .passes import defocus as defocus_pass
from .passes import shade as shade_pass
from .passes import translucent as translucent_pass
from .passes.common import frame_record
from .passes.pyramid import levels
from .plan import make_plan
from .prepare import prepare, triangles_of
from .shadows import Shadows, cast
from .skipped import LATE, PASSES, UNKNOWN
from .store import STORE
from .surfels import Surfels
from .targets import Pool, Targets
from .technique import NAMES, NO_BLENDING, Technique, choose, reconsidered
from .tiles import EVERYWHERE, Adaptive, why_everywhere
from .uploads import Kept, Uploads

RELIT = 4  # times that translucent splats are lit in one picture, where lamps are wide
MOST_MARGIN = 64  # pixels around the window in which the centres of wide splats are looked for


@dataclass(frozen=True)
class Request:
    """What one picture needs."""

    camera: Camera
    settings: Settings
    passes: frozenset[str]  # keys of outputs.PASSES; combined is always there
    samples: int
    crypto_levels: int = 6
    interactive: bool = False  # drawn again and again, and at once: see prepare
    node: float = NODE  # largest nodes of what is out of focus, over the radii of their disks: core/defocus.py


@dataclass(frozen=True)
class Result:
    """Pictures (H, W, C) float32 by pass, bottom row first, and the report."""

    pixels: dict[str, np.ndarray]
    report: dict[str, Any]
    cancelled: bool = False


class Cancelled(Exception):  # noqa: N818 - not an error
    """The picture is not wanted any more."""


SLOW_SECONDS = 0.2  # a sample that takes longer is asked after each of its passes whether it is still wanted
MOST_OPEN = 64  # timers that wait to be read, of the last samples: a viewport may draw thousands, and read none


@dataclass
class Clock:
    """Time by pass; each reading waits for the device. Whoever has one releases it: timers are the device's."""

    device: Device
    cancelled: Callable[[], bool] = lambda: False
    slow: bool = True
    spent: dict[str, float] = field(default_factory=dict)
    _open: deque[tuple[str, Timer]] = field(default_factory=deque)

    def run(self, name: str, work: Callable[[], None]) -> None:
        timer = self.device.start_timer()
        self._open.append((name, timer))
        try:
            work()
        finally:  # a shader that fails must not leave the device timing
            self.device.stop_timer(timer)
        self.settle(0 if self.slow else MOST_OPEN)
        if self.slow:
            self.check()

    def check(self) -> None:
        """Raise Cancelled where the picture is not wanted any more."""
        if self.cancelled():
            raise Cancelled

    def settle(self, left: int = 0) -> None:
        """Read all timers but the last `left`."""
        while len(self._open) > left:
            name, timer = self._open.popleft()
            self.spent[name] = self.spent.get(name, 0.0) + timer.milliseconds()

    def release(self) -> None:
        """Time is not asked for any more."""
        for _, timer in self._open:
            timer.release()
        self._open.clear()


class Renderer:
    """Draws scenes on one device and keeps there what the next frame can use."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self.kept = Kept(device)
        self.pool = Pool(device)
        self.costs = DEFAULT  # of this device
        self.pacers = budget.Pacers()  # of the scenes that a budget of time was kept for

    def render(
        self,
        scene: Scene,
        request: Request,
        *,
        progress: Callable[[float, str], None] = lambda fraction, text: None,
        cancelled: Callable[[], bool] = lambda: False,
    ) -> Result:
        """All samples of a picture, or what its budget allows. DeviceError, ShaderError: the device cannot draw it."""
        if request.settings.budget != "NONE":
            return budget.kept(self, scene, request, progress, cancelled)
        return self.draw(scene, request, progress, cancelled)

    def draw(
        self,
        scene: Scene,
        request: Request,
        progress: Callable[[float, str], None],
        cancelled: Callable[[], bool],
        watch: budget.Watch | None = None,
    ) -> Result:
        """Samples of a picture until there are enough, or `watch` says so."""
        started = time.perf_counter()
        progress(0.0, "Preparing points")
        try:
            frame = Frame(self, scene, request, cancelled)
        except Cancelled:
            return Result({}, {}, cancelled=True)
        if watch is not None:
            watch.ready(frame)
        try:
            while not frame.complete:
                before = time.perf_counter()
                frame.sample()
                frame.clock.settle()
                frame.clock.slow = time.perf_counter() - before > SLOW_SECONDS
                if watch is not None and watch.enough(frame):
                    frame.end()
                progress(frame.done / request.samples, f"Sample {frame.done}/{request.samples}")
                if not frame.complete:
                    frame.clock.check()
            pixels = frame.pixels()
            if watch is not None:
                watch.finished()
            return Result(pixels, frame.report(time.perf_counter() - started))
        except Cancelled:
            return Result({}, frame.report(time.perf_counter() - started), cancelled=True)
        finally:
            frame.release()

    def start(self, scene: Scene, request: Request) -> Frame:
        """A picture that is drawn sample by sample."""
        frame = Frame(self, scene, request, presented=True)
        frame.clock.slow = False
        return frame

    def release(self) -> None:
        """Free everything that is kept on the device."""
        self.kept.release()
        self.pool.release()


class Frame:
    """One picture in the making. Every call comes from the device's thread."""

    def __init__(
        self,
        renderer: Renderer,
        scene: Scene,
        request: Request,
        cancelled: Callable[[], bool] = lambda: False,
        presented: bool = False,
        picture: bool = True,
    ) -> None:
        """`presented`: between samples too. `picture`: with Combined, not passes beside it alone."""
        self.renderer, self.presented = renderer, presented
        self.whole = scene  # as it was given
        scene, self._warnings = parted(scene)
        eye, unseen_lens = sound_camera(request.camera)
        self._warnings += unseen_lens
        self.request = request = request if eye is request.camera else replace(request, camera=eye)
        self.scene = scene
        self.device = renderer.device
        self.done = 0
        self._gathered = 0  # samples in the picture of the pass defocus
        self.hurried = False  # presented only when it has ended
        self._ended = False
        self.clock = Clock(self.device, cancelled)
        float_blend = self.device.limits.float_blend
        technique = choose(request.settings, scene, request.samples, request.interactive, float_blend)
        if technique.because == NO_BLENDING and request.settings.technique in NAMES:
            self._warnings += (f"{NAMES[request.settings.technique]} needs blending of floats, which this GPU lacks: "
                               "points are drawn in image space",)  # fmt: skip
        settings = replace(request.settings, technique=technique.name)
        through_lens = sampled(request.camera, settings) and request.samples > 1
        self.prepared = prepare(
            scene,
            prepared_for(scene, request.camera) if through_lens else request.camera,
            settings,
            request.samples,
            interactive=request.interactive,
            check=self.clock.check,
            costs=renderer.costs,
            node=request.node,
        )
        self.technique = reconsidered(technique, self.prepared)
        self.beside: Frame | None = None
        blurred, parts, asked = self.prepared.blurred is not None, scene, request
        if blurred:
            self.request = request = self._defocused()
        self.prepared, unseen = in_view(scene, self.prepared, request.camera)
        scene, reflects, self._faint = without_faint(scene, self.prepared, request.camera.view_from_world)
        self.scene = scene
        self.shadows, unshadowed = self._shadows()
        blended = (request.camera, request.samples) if self.technique.name == "EWA" else None
        paints = self.technique.name == "PAINTER" and self.prepared.cut.splats > 0
        if paints:
            others = shade_pass.averaged(request.passes) or shade_pass.data(request.passes)
            self.prepared = painted(self.prepared, keep=presented or bool(others))
        in_focus = "" if blur_of(request.camera) is None or through_lens else "nothing is out of focus"
        sharp_world = "each sample sees it through a place on the lens" if through_lens else ""
        self.plan = make_plan(
            scene, self.prepared, request.passes, self.shadows, unshadowed, request.interactive, blended, paints,
            reflects, unseen, in_focus, sharp_world or why_sharp(scene, request.camera), picture,
        )  # fmt: skip
        # Everything is drawn for `view`, of which the camera's window is a part.
        most = self.device.limits.texture_size
        self.view, self.corner = _widened(request.camera, self.plan.reach(self.prepared.largest), most)
        self._turns = turns(request.samples)
        self._tap = 0  # which points of wide lamps translucent splats are lit by
        self._owned: list[Any] = []
        self.lens = self._own(LensSamples(self.device, self.view, request.samples)) if through_lens else None
        self._lent: tuple[tuple, Targets] | None = None
        self._identities: list[np.ndarray] = []
        self._data: dict[str, np.ndarray] = {}
        self.adaptive: Adaptive | None = None
        self.backdrop: backdrop_pass.Backdrop | None = None
        plan = self.plan
        self.everywhere = why_everywhere(
            request.settings,
            request.samples,
            plan.translucent is not None and not plan.defocus,
            self._wants_identities,
            any(len(s.thin) for s in self.prepared.lines.values()),
            through_lens,
        )
        drawn = plan.points or plan.polygons or plan.spheres or plan.lines or plan.translucent is not None
        self._trivial = not drawn and (scene.world.image is None or scene.transparent)
        try:
            # Both are on the device, and what comes before can still be cancelled.
            if blurred:
                self.beside = self._others(parts, asked)
            if not self._trivial:
                self._allocate()
        except Exception:
            self.release()
            raise

    def _shadows(self) -> tuple[Shadows | None, str]:
        prepared = self.prepared
        layers = (prepared, prepared.translucent, prepared.spheres)
        if not (any(layer.cut.splats for layer in layers) or len(prepared.polygons) or prepared.lines):
            return None, "nothing is drawn"
        before = time.perf_counter()
        found = cast(self.scene, self.request.settings, STORE, self.clock.check)
        if found[0] is not None:
            self.clock.spent["shadows"] = 1000 * (time.perf_counter() - before)
        return found

    # What is on the device

    def _allocate(self) -> None:
        device, plan, passes = self.device, self.plan, self.request.passes
        motion = plan.data and "vector" in shade_pass.data(passes)
        self.uploads = self._own(
            Uploads(self.renderer.kept, self.scene, self.view, self.prepared, plan, motion, self.shadows)
        )
        self.clock.spent |= self.uploads.spent
        if plan.backdrop:
            grid = grid_of(self.view, device.limits.texture_size)
            self.backdrop = self._own(backdrop_pass.Backdrop(device, grid))
        size, count = self.view.window[2:], levels(self.prepared.largest, self.view.resolution)
        self._lent = self.renderer.pool.borrow(plan, passes, size, count)
        self.targets = self._lent[1]
        if self.targets.sums:
            device.clear(self.targets.sum_target)
        if not self.everywhere:
            # Two pixels of the coarsest level on either side.
            threshold = self.request.settings.adaptive_threshold
            shown = self.presented and not plan.defocus and self.targets.surfels is not None
            place = _bound(self.targets.surfels).get("ps_place") if shown else None
            self.adaptive = self._own(Adaptive(device, self.targets.sums[0], threshold, 2 << count, place))
        self.averages: tuple[Interface, ...] = ()
        if plan.painter and plan.points and shade_pass.averaged(passes):
            self.averages = (
                shade_pass.shade_program(
                    plan.data_variant, (), plan.materials, passes, lines=plan.lines, combined=False
                ),
                shade_pass.background_program((), True, passes, combined=False),
            )
            passes = frozenset({"combined"})
        self.shade = shade_pass.shade_program(
            plan.variant, plan.lighting, plan.materials, passes, self.request.samples, plan.ewa is not None,
            plan.lines, plan.defocus, plan.picture,
        )  # fmt: skip
        self.background = shade_pass.background_program(
            plan.behind, self.scene.transparent, passes, plan.ewa is not None, everywhere=not plan.shaded.solid,
            combined=plan.picture,
        )  # fmt: skip
        self.lit: translucent_pass.LitSplats | None = None
        self.tiles: defocus_pass.Defocus | None = None
        if plan.translucent is not None and plan.defocus:
            program = translucent_pass.light_program(plan.translucent, plan.lighting, plan.materials)
            listed = self.uploads.listed
            self.lit = self._own(translucent_pass.LitSplats(device, plan.translucent, program, listed))
        elif plan.translucent is not None:
            program = translucent_pass.light_program(
                plan.translucent, plan.lighting, plan.materials, self.uploads.reach_lights
            )
            variant = plan.variant
            channels = variant.samplers(only=("place", "shape", "normal") if variant.normal else ("place",))
            self.add_program = translucent_pass.add_program(plan.translucent)
            self.depth_program = translucent_pass.depth_program(channels, variant.normal)
            listed, samples = self.uploads.listed, self.request.samples
            self.lit = self._own(translucent_pass.LitSplats(device, plan.translucent, program, listed, samples))

    # Drawing

    def sample(self) -> bool:
        """Draw one more sample; False when there were enough."""
        if self.complete:
            return False
        if not self._trivial:
            if self.lens is not None:
                self.view = self.lens.view(self.done, self.uploads)
            device, record = self.device, self._record(self.done)
            if self.plan.defocus:
                record["lens"][0, :2] = self.in_focus
            region = self.adaptive.gathered if self.adaptive else EVERYWHERE
            projection, uploads = self.targets.projection, self.uploads
            first = self.done == 0
            if first and self.backdrop is not None:
                self.clock.run("backdrop", self._draw_backdrop)
            for lines in uploads.lines:
                lines.list_thin(float(self._turns[self.done]))
            beside = first or self._wants_identities or bool(self.averages)
            if projection is not None and (beside or not self.plan.painter):
                self.clock.run("project", lambda: projection.run(uploads.draws, record.copy(), uploads.shared))
            shown = None if self.plan.painter else projection
            surfels, data_surfels = self.targets.surfels, self.targets.data_surfels
            if surfels is not None:
                surfels.draw(uploads, shown, record, self.clock.run, region)
            if beside and data_surfels is not None and data_surfels is not surfels:
                data_surfels.draw(uploads, projection, record, self.clock.run)
            if self.lens is not None and first and self.presented and data_surfels is not None:
                self.lens.keep(data_surfels.buffer.textures["place"], record)
            if self.plan.data and (first or self._wants_identities):
                self.clock.run("data", lambda: self._draw_data(record))
                self._read_data(first)
            if self.averages:
                self.clock.run("averages", lambda: self._average(record))
            if self.lit is not None and not self.plan.defocus:
                device.clear(self.targets.layer_target)
            if surfels is not None and self.plan.shades:
                self.clock.run("shade", lambda: self._shade(record))
            if self.plan.background and self.plan.shades:
                self.clock.run("background", lambda: self._draw_background(record))
            if self.lit is not None and not self.plan.defocus:
                self._draw_translucent(self.lit, record.copy(), first)
            if self.beside is not None:
                self.beside.sample()
        self.done += 1
        if self.adaptive is not None and self.done < self.request.samples:
            adaptive = self.adaptive
            self.clock.run("adapt", lambda: self._adapt(adaptive))
        if self.plan.defocus and self.presented and (self.complete or checkpoint(self.done)) and not self.hurried:
            self._defocus()
        return not self.complete

    def _adapt(self, adaptive: Adaptive) -> None:
        """Leave out what no tile needs any more."""
        record, projection, uploads = self._record(0), self.targets.projection, self.uploads
        if adaptive.check(self.done, record) and projection is not None and not adaptive.finished:
            uploads.narrow(projection.within(uploads.draws, record, uploads.shared, adaptive.gathered))

    def end(self) -> None:
        """There are enough samples."""
        self._ended = True
        if self.plan.defocus and self.presented:
            self._defocus()

    def other(self, request: Request, samples: int) -> np.ndarray | None:
        """The mean (H, W, 4) of so many samples of the same scene by another request; None where it draws the same."""
        frame = Frame(self.renderer, self.whole, request, self.clock.cancelled)
        try:
            if (frame.splats, frame.segments, frame.triangles) == (self.splats, self.segments, self.triangles):
                return None
            while frame.done < samples and frame.sample():
                frame.clock.settle()
                frame.clock.check()
            return frame.mean()
        finally:
            frame.release()

    @property
    def splats(self) -> int:
        """In the cut, of all kinds."""
        prepared = self.prepared
        layers = (*(() if self.plan.painter else (prepared,)), prepared.translucent, prepared.spheres)
        return sum(layer.cut.splats for layer in layers)

    @property
    def blends(self) -> bool:
        """Whether each sample draws translucent splats."""
        return not self._trivial and self.lit is not None and not self.plan.defocus

    @property
    def segments(self) -> int:
        """Of strands."""
        return sum(map(len, self.prepared.lines.values()))

    @property
    def triangles(self) -> int:
        """That are drawn."""
        prepared, geometries = self.prepared, self.scene.geometries
        return sum(
            triangles_of(mesh, prepared.parts.get(instance))
            for instance in prepared.polygons.tolist()
            if (mesh := geometries[int(self.scene.instances.geometry[instance])].mesh) is not None
        )

    @property
    def complete(self) -> bool:
        """No sample is missing."""
        return (
            self._ended or self.done >= self.request.samples or (self.adaptive is not None and self.adaptive.finished)
        )

    @property
    def color(self) -> Texture:
        """Sum of the samples so far, premultiplied, scene-linear; `present` averages."""
        return self.targets.seen if self.plan.defocus else self.targets.sums[0]

    def _record(self, index: int) -> np.ndarray:
        camera, mist = self.view, self.scene.mist
        x, y = offsets(self.request.samples)[index] if self.request.samples > 1 else (0.0, 0.0)
        record = frame_record(camera, (float(x), float(y)))
        record["mist"][0] = mist.start, 1 / max(mist.depth, 1e-6), shade_pass.MIST_EXPONENT[mist.falloff], 0.0
        record["page"][0, 3] = len(self.scene.lights)
        if self.backdrop is not None:
            record["previous"][0, :2] = self.backdrop.texels
        if self.plan.defocus:
            blur, aperture = blur_of(camera), camera.aperture
            assert blur is not None
            assert aperture is not None
            record["focus"][0] = blur.scale, 1 / blur.focus, 0.0, 1 / aperture.ratio
        return record

    def _shade(self, record: np.ndarray) -> None:
        record = record.copy()
        record["size"][0, 2] = self.done
        self._add(self.shade, record, _bound(self.targets.surfels) | self.uploads.shading)

    def _average(self, record: np.ndarray) -> None:
        """Passes of what is painted that are averaged: of its G-buffer, without light."""
        textures = _bound(self.targets.data_surfels) | self.uploads.shading
        for program in self.averages:
            self.device.draw(
                program, self.targets.averages_target, uniforms=record.copy(), textures=textures, blend=True
            )

    def _draw_backdrop(self) -> None:
        backdrop, uploads = self.backdrop, self.uploads
        assert backdrop is not None
        assert uploads.levels is not None
        record = self._record(0)
        record["focal"][0] = self.view.pixel_from_view()
        backdrop.draw(record, {**uploads.shading, "ps_levels": uploads.levels})

    @property
    def _behind(self) -> dict[str, Texture]:
        """The world out of focus, by sampler name."""
        return {} if self.backdrop is None else {"ps_backdrop": self.backdrop.texture}

    def _draw_background(self, record: np.ndarray) -> None:
        textures = _bound(self.targets.surfels) | self.uploads.shading | self._behind
        self._add(self.background, record.copy(), textures)

    def _add(self, program: Interface, record: np.ndarray, textures: dict[str, Texture]) -> None:
        region = self.adaptive.shown if self.adaptive else EVERYWHERE
        region.draw(self.device, program, self.targets.shade_target, uniforms=record, textures=textures, blend=True)

    def _draw_translucent(self, lit: translucent_pass.LitSplats, record: np.ndarray, first: bool) -> None:
        """Over the opaque picture of this sample, which is then added to the sums."""
        targets, run = self.targets, self.clock.run
        assert targets.layer is not None

        def draw(program: Interface, target: Target, textures: dict[str, Texture], mode: str = "") -> None:
            self.device.draw(
                program, target, uniforms=record, textures=textures, blend=mode == "blend", over=mode == "over"
            )

        # The same for all samples, but for the shadows of wide lamps, which splats blur among each other, and the lens.
        wide = self.shadows is not None and self.shadows.wide
        tap = self._lighting(self.done) if wide else 0
        if first or tap != self._tap or self.lens is not None:
            self._tap = tap
            centred = self._record(0)
            centred["focal"][0] = self.view.pixel_from_view()
            centred["size"][0, 2] = tap
            textures = {**self.uploads.splats, **self.uploads.shading}
            if self.uploads.reach_lights:
                textures |= self.uploads.reach(tap, centred, run)
            run("light", lambda: lit.light(centred, textures))
        if targets.depth is not None:
            surfels = _bound(targets.surfels)
            run("opaque depth", lambda: draw(self.depth_program, targets.depth_target, surfels))
        if self.plan.coarse and first:
            self.device.clear(targets.coarse_target)
            coarse = record.copy(), targets.depth, translucent_pass.COARSE
            run("translucent", lambda: lit.draw(targets.coarse_target, *coarse))
            run(
                "enlarge",
                lambda: draw(translucent_pass.ENLARGE, targets.layer_target, {"ps_coarse": targets.coarse}, "over"),
            )
        else:
            run("translucent", lambda: lit.draw(targets.layer_target, record.copy(), targets.depth))
        layer = {"ps_layer": targets.layer, **({} if targets.cut is None else {"ps_cut": targets.cut})}
        run("add", lambda: draw(self.add_program, targets.combined_target, layer, "blend"))

    def _lighting(self, sample: int) -> int:
        """Which points of wide lamps light translucent splats in a sample: RELIT times in a picture; where an error
        decides how many samples there are, for each pair."""
        if self.request.settings.budget == "ERROR":
            return (sample + 1) // 2
        return sample // max(self.request.samples // RELIT, 1)

    def _defocused(self) -> Request:
        """What is out of focus goes to the pass of its own name. Passes that know no blur are another picture's;
        returns what is left for this one."""
        self.prepared = defocused(self.prepared)
        if self.technique.name == "PAINTER":
            self.technique = Technique("IMAGE_SPACE", "the pass defocus paints")
        return replace(self.request, passes=frozenset({"combined"}))

    def _others(self, scene: Scene, asked: Request) -> Frame | None:
        """The picture of the passes that know no blur, without light; None where none of them is asked for."""
        others = asked.passes - {"combined"}
        averaged = shade_pass.averaged(others) or others & set(CRYPTO)
        if not (self.presented or averaged or shade_pass.data(others)):
            return None
        settings = replace(asked.settings, use_shadows=False, use_adaptive_sampling=False)
        camera = replace(asked.camera, aperture=None)
        unlit = replace(scene, lights=(), world=World(), transparent=True)
        samples = asked.samples if averaged else 1
        beside = replace(asked, camera=camera, settings=settings, passes=others, samples=samples)
        frame = Frame(self.renderer, unlit, beside, self.clock.cancelled, self.presented, picture=False)
        frame.clock.slow = False
        return frame

    @property
    def in_focus(self) -> tuple[float, float]:
        """Depths between which something may be; in image space, that shows of points what is beside them, too."""
        blur = blur_of(self.view)
        assert blur is not None
        near, far = blur.depths(BLURRED)
        if self.plan.points and self.plan.ewa is None:
            beside = (NEIGHBOURS - 1) * self.prepared.largest / abs(self.view.pixel_from_view()[0])
            near -= beside * (near if self.view.perspective else 1.0)
            far += beside * (far if self.view.perspective else 1.0)
        return max(self.view.near, near), min(self.view.far, far)

    def _defocus(self) -> None:
        """The picture from what is in focus, so far, and all that is not."""
        plan, targets, run = self.plan, self.targets, self.clock.run
        sampled = plan.points or plan.polygons or plan.spheres or plan.lines  # something is in focus
        if self._gathered == self.done or (self._gathered and not sampled):
            return
        self._gathered = self.done
        assert plan.translucent is not None
        record = self._record(0)
        record["focal"][0] = self.view.pixel_from_view()
        record["mist"][0, 3] = 1 / self.done
        lit = self.lit
        if self.tiles is None:
            assert lit is not None
            run("light", lambda: lit.light(record.copy(), {**self.uploads.splats, **self.uploads.shading}))
            run("tiles", lambda: self._list_tiles(lit, record))
        tiles = self.tiles
        assert lit is not None
        assert tiles is not None
        adaptive = self.adaptive
        program = defocus_pass.defocus_program(
            plan.behind, self.scene.transparent, plan.translucent.tint, plan.translucent.holdout,
            adaptive is not None, tiles.tile,
        )  # fmt: skip
        textures = {**self.uploads.shading, **self._behind, "ps_focused": targets.sums[0], "ps_focus": targets.focus}
        if adaptive is not None:
            textures["ps_counts"] = adaptive.known
        run("defocus", lambda: tiles.draw(program, targets.seen_target, record, lit.textures, textures))

    def _list_tiles(self, lit: translucent_pass.LitSplats, record: np.ndarray) -> None:
        place, shape = (
            self.device.read(lit.textures[name]).reshape(-1, 4)[: lit.count] for name in ("ps_place", "ps_shape")
        )
        lists = defocus_pass.tile_lists(place, shape, record["focal"][0].astype(np.float64), self.view.window[2:])
        self.tiles = self._own(defocus_pass.Defocus(self.device, lists))

    def _draw_data(self, record: np.ndarray) -> None:
        camera = self.view
        record = record.copy()
        x0, y0, _, _ = camera.window
        record["previous"][0] = *camera.resolution, x0, y0
        textures = _bound(self.targets.data_surfels)
        if self.uploads.previous is not None:
            textures["ps_previous"] = self.uploads.previous
        program = shade_pass.data_program(self.plan.data_variant, self.request.passes)
        self.device.draw(program, self.targets.data_target, uniforms=record, textures=textures)

    @property
    def _wants_identities(self) -> bool:
        return bool(self.request.passes & set(CRYPTO))

    def _read_data(self, first: bool) -> None:
        for name, texture in zip(shade_pass.data(self.request.passes), self.targets.data, strict=True):
            if first or name == "index":
                array = self._cropped(texture)
                if first:
                    self._data[name] = array
                if name == "index" and self._wants_identities:
                    self._identities.append(array[..., :2].astype(np.int32))

    def _cropped(self, texture: Texture) -> np.ndarray:
        return self._window(self.device.read(texture))

    def _window(self, picture: np.ndarray) -> np.ndarray:
        """The camera's window of what is drawn."""
        _, _, width, height = self.request.camera.window
        x, y = self.corner
        return picture[y : y + height, x : x + width]

    def present(self) -> None:
        """Draw the average so far and its depth into the framebuffer that is bound, in the viewport that is set."""
        if self._trivial:
            self._present_constant()
            return
        m = self.request.camera.clip_from_view
        record = self._record(0)
        record["size"][0, :2] = self.request.camera.window[2:]
        record["page"][0, :2] = self.corner
        record["mist"][0, 3] = 1 / max(self.done, 1)
        record["previous"][0] = m[2, 2], m[2, 3], m[3, 2], m[3, 3]
        place = _bound(self.targets.data_surfels).get("ps_place")
        if self.beside is not None and not self.beside._trivial:
            place = _bound(self.beside.targets.data_surfels).get("ps_place")
        textures = {"ps_combined": self.color}
        adaptive = None if self.plan.defocus else self.adaptive
        if self.plan.defocus:
            record["mist"][0, 3] = 1.0
        elif adaptive is not None:
            textures["ps_counts"], place = adaptive.known, adaptive.place
        if self.lens is not None and self.lens.place is not None:
            place = self.lens.place
        if place is not None:
            textures["ps_place"] = place
        program = shade_pass.present_program(place is not None, adaptive is not None)
        self.device.draw(program, None, uniforms=record, textures=textures)

    def _present_constant(self) -> None:
        """A world of one colour needs no picture: one texel does."""
        color = self._constant()
        texel = self.device.texture((1, 1), "RGBA32F", color.astype(np.float32))
        record = self._record(0)
        record["mist"][0, 3] = 1.0
        record["size"][0, :2] = 1, 1
        program = shade_pass.present_program(False)
        self.device.draw(program, None, uniforms=record, textures={"ps_combined": texel})
        texel.release()

    # Results

    def _constant(self) -> np.ndarray:
        return np.zeros(4) if self.scene.transparent else np.append(np.asarray(self.scene.world.color), 1.0)

    def mean(self) -> np.ndarray:
        """(H, W, 4) float32: the picture so far."""
        if self._trivial:
            _, _, width, height = self.request.camera.window
            return self._empty_pixels(frozenset({"combined"}), width, height)["combined"]
        if self.plan.defocus:
            self._defocus()
            return self._cropped(self.targets.seen)
        return self._cropped(self.targets.sums[0]) / self.counts()

    def counts(self) -> np.ndarray | int:
        """(H, W, 1) float32, or one for all pixels: how many samples each of them has."""
        return max(self.done, 1) if self.adaptive is None else self._window(self.adaptive.samples(self.done))

    def hold(self, squares: np.ndarray, limit: float) -> None:
        """Adaptive sampling goes on where the root mean of these squared errors (H, W) exceeds `limit` in a tile."""
        if self.adaptive is not None:
            x, y = self.corner
            columns, rows = self.view.window[2:]
            height, width = squares.shape
            self.adaptive.hold(np.pad(squares, [(y, rows - y - height), (x, columns - x - width)]), limit)

    def pixels(self) -> dict[str, np.ndarray]:
        """Every requested pass."""
        _, _, width, height = self.request.camera.window
        wanted = self.request.passes | (frozenset({"combined"}) if self.plan.picture else frozenset())
        if self._trivial:
            return self._empty_pixels(wanted, width, height)
        if self.plan.defocus:
            self._defocus()
        out: dict[str, np.ndarray] = {}
        first = ("combined",) if self.plan.picture else ()
        names = (*first, *(() if self.plan.defocus else shade_pass.averaged(self.request.passes)))
        samples = self.counts()
        sums = [self.color] if self.plan.defocus else self.targets.sums
        for name, texture in zip(names, sums, strict=True):
            mean = self._cropped(texture) / (1 if self.plan.defocus else samples)
            out[name] = np.ascontiguousarray(mean[..., : BY_KEY[name].channels])
        data = self._data
        if "position" in data:
            out["depth"], out["position"] = data["position"][..., 3:], data["position"][..., :3]
        if "vector" in data:
            out["vector"] = data["vector"]
        if "index" in data:
            instance, material = (data["index"][..., i].astype(np.int64) for i in range(2))
            out["object_index"] = _looked_up(self.scene.instances.pass_index, instance)
            out["material_index"] = _looked_up(self.scene.materials.pass_index, material)
        if self._identities:
            for key, column, table in (
                ("crypto_object", 0, self.scene.instances.object_hash),
                ("crypto_material", 1, self.scene.materials.hash),
            ):
                if key in wanted:
                    out |= self._cryptomatte(key, column, table)
        found = {key: array for key, array in out.items() if key in wanted or key.startswith(CRYPTO)}
        missing = frozenset(key for key in wanted if not {key, f"{key}00"} & found.keys())
        found |= self._empty_pixels(missing, width, height)
        if self.beside is not None:
            found |= self.beside.pixels()
        return found

    def _cryptomatte(self, key: str, column: int, table: np.ndarray | None) -> dict[str, np.ndarray]:
        known = np.zeros(len(self.scene.instances), np.uint32) if table is None else table.astype(np.uint32)
        padded = np.append(known, np.uint32(0))  # -1, and what is no row, look up the last: no identity
        hashes = padded[np.minimum(np.stack([ids[..., column] for ids in self._identities]), len(known))]
        pictures = cryptomatte(hashes, self.request.crypto_levels)
        return {f"{key}{i:02d}": picture for i, picture in enumerate(pictures)}

    def _empty_pixels(self, wanted: frozenset[str], width: int, height: int) -> dict[str, np.ndarray]:
        out = {}
        for key in wanted:
            channels = BY_KEY[key].channels
            if key in CRYPTO:
                for i in range((self.request.crypto_levels + 1) // 2):
                    out[f"{key}{i:02d}"] = np.zeros((height, width, 4), np.float32)
                continue
            # What is filled at once is not zeroed first: that takes several times as long.
            if key == "combined":
                out[key] = np.empty((height, width, channels), np.float32)
                out[key].reshape(height, -1)[:] = np.tile(self._constant().astype(np.float32), width)
            elif key in ("depth", "mist"):
                out[key] = np.full((height, width, channels), BACKGROUND_DEPTH if key == "depth" else 1.0, np.float32)
            else:
                out[key] = np.zeros((height, width, channels), np.float32)
        return out

    def report(self, seconds: float) -> dict[str, Any]:
        """What was done, as scripts/render.py writes it."""
        prepared, cut = self.prepared, self.splats
        spent = self._spent()
        return {
            "device": f"{self.device.name}: {self.device.limits.renderer}",
            "seconds": seconds,
            "passes": [{"name": name, "ms": round(ms, 3)} for name, ms in spent.items()],
            "skipped": [{"name": name, "because": why} for name, why in self._skipped(spent.keys())],
            "points": {"total": prepared.total, "cut": cut, "drawn": cut * self.done},
            "technique": {"name": self.technique.name, "because": self.technique.because},
            "triangles": self.triangles,
            "lines": self._lines_drawn(),
            "bytes": {"cpu": STORE.nbytes, "gpu": self.device.bytes_allocated()},
            "warnings": [*self._warnings, *prepared.warnings, *(self.shadows.warnings if self.shadows else ())],
        }

    def _spent(self) -> dict[str, float]:
        """Milliseconds by pass, with those of the passes beside what is out of focus."""
        self.clock.settle()
        beside = {} if self.beside is None else self.beside._spent()
        return self.clock.spent | {name: ms + self.clock.spent.get(name, 0.0) for name, ms in beside.items()}

    def _lines_drawn(self) -> dict[str, int]:
        """Strands and segments that the view shows, and segments that all samples drew."""
        segments = self.prepared.lines.values()
        drawn = 0 if self._trivial else sum(lines.drawn for lines in self.uploads.lines)
        return {"strands": sum(s.strands for s in segments), "segments": self.segments, "drawn": drawn}

    def _skipped(self, ran: Set[str]) -> list[tuple[str, str]]:
        """Passes that did not run, and why."""
        found = [entry for entry in (*self.plan.skipped, *self._faint) if entry[0] not in ran]
        known = {name for name, _ in found} | ran
        late = dict(LATE)
        if self._trivial:
            late = {"background": "one colour fills the picture", "adapt": "one colour fills the picture"}
        elif self.plan.translucent is not None and not self.uploads.reach_lights:
            late["reach"] = "several of its instances share splats, or lamps are too many"
        if self.everywhere:
            late["adapt"] = self.everywhere
        found += [(name, late.get(name, UNKNOWN)) for name in PASSES if name not in known]
        if self._ended:
            found.append(("samples", f"the budget asks for no more than {self.done}"))
        elif not self._trivial and not self.everywhere and self.adaptive is not None:
            mean = float(self._window(self.adaptive.samples(self.done)).mean())
            if mean < self.request.samples:
                found.append(("samples", f"pixels have {mean:.1f} of {self.request.samples}: the others would agree"))
        return found

    def release(self) -> None:
        """Free what only this picture needed."""
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


def _bound(surfels: Surfels | None) -> dict[str, Texture]:
    """Textures of a G-buffer by sampler name; none where there is no G-buffer."""
    return {} if surfels is None else surfels.buffer.bound()


def _widened(camera: Camera, radius: float, most: int) -> tuple[Camera, tuple[int, int]]:
    """The camera with a window that also holds the centres of splats which reach into its own, and where in it that
    lies. A border shows the pixels of the full frame: it is widened by what the pyramid gathers from, and its corner
    keeps its place in there. Where more than `most` pixels would come of it, which no texture holds, it is widened by
    what is left."""
    if radius <= 0.0:
        return camera, (0, 0)
    margin = min(math.ceil(radius), MOST_MARGIN)
    step = 1 << levels(radius, camera.resolution)
    corner, lows, sizes = camera.window[:2], [], []
    for at, size, full in zip(corner, camera.window[2:], camera.resolution, strict=True):
        spare = max(most - size, 0)
        low = max((at - 2 * step + margin) // step * step - margin, -margin, at - spare // 2)
        high = max(min(at + size + 2 * step, full + margin, min(low, at) + most), at + size)
        lows.append(min(low, at))
        sizes.append(high - lows[-1])
    region = (lows[0], lows[1], sizes[0], sizes[1])
    return replace(camera, region=region), (corner[0] - lows[0], corner[1] - lows[1])


def _looked_up(table: np.ndarray | None, index: np.ndarray) -> np.ndarray:
    """(H, W, 1) float32: table[index], 0 where the index is negative or no row of the table."""
    if table is None or len(table) == 0:
        return np.zeros((*index.shape, 1), np.float32)
    there = (index >= 0) & (index < len(table))
    return np.where(there, table[np.where(there, index, 0)], 0).astype(np.float32)[..., None]
