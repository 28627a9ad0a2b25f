"""Draws pictures on one device: all samples at once, or as many as a budget allows, or one by one for a viewport."""

from __future__ import annotations

import time
from collections.abc import Callable, Set
from dataclasses import replace

import numpy as np

from ..core.lod.cost import DEFAULT
from ..core.scene.scene import Scene
from .budget import budgeted, pacing
from .budget.known_light import KnownLight
from .budget.watch import Watch
from .cache.device_cache import DeviceCache
from .cache.store import Store
from .device.clock import Cancelled
from .device.protocol import Device
from .frame.frame import Frame
from .frame.report import report
from .frame.targets import Pool
from .indirect.known_sites import Slices
from .indirect.light import IndirectLight
from .light_passes import Light, light_passes
from .passes.outputs import OF_LIGHT
from .passes.shading.terms import ENVIRONMENT, OCCLUSION, Term
from .plan.request import Request, Result

SLOW_SECONDS = 0.2  # a sample that takes longer is asked after each of its passes whether it is still wanted


class Renderer:
    """Draws scenes on one device and keeps there what the next frame can use."""

    def __init__(self, device: Device, store: Store | None = None) -> None:
        """`store`: for what is prepared of scenes; renderers may share one. None: the renderer has one of its own."""
        self.device = device
        self.store = Store() if store is None else store
        self.kept = DeviceCache(device)
        self.pool = Pool(device)
        self.costs = DEFAULT  # of this device
        self.pacers = pacing.Pacers()  # of the scenes that a budget of time was kept for
        self._of_moment: KnownLight | None = None  # for further moments of a picture

    def render(
        self,
        scene: Scene,
        request: Request,
        *,
        progress: Callable[[float, str], None] = lambda fraction, text: None,
        cancelled: Callable[[], bool] = lambda: False,
    ) -> Result:
        """Draws all samples of a picture, or what its budget allows. DeviceError, ShaderError: it cannot be drawn."""
        if request.settings.budget != "NONE":
            return budgeted.render_within_budget(self, scene, request, progress, cancelled)
        return self.draw(scene, request, progress, cancelled)

    def draw(
        self,
        scene: Scene,
        request: Request,
        progress: Callable[[float, str], None],
        cancelled: Callable[[], bool],
        watch: Watch | None = None,
    ) -> Result:
        """Draws a picture without regard to the request's budget: all its samples, or until `watch` has enough.

        Unlike `render`, it leaves budgets to the caller, who may stop early through `watch`. DeviceError, ShaderError:
        the device cannot draw it. A cancelled picture has no pixels, and `cancelled` set.
        """
        asked = request.passes & OF_LIGHT
        if asked:
            # All terms of the light have the same samples.
            settings = replace(request.settings, use_adaptive_sampling=False)
            request = replace(request, passes=request.passes - asked, settings=settings)
        started = time.perf_counter()
        progress(0.0, "Preparing points")
        if not request.known_light:
            self._forget_light()
        # Passes of light gather, and add up to Combined.
        known = None if self._of_moment is None or asked else self._of_moment.light
        try:
            frame = Frame(self, scene, request, cancelled, known=known)
        except Cancelled:
            return Result({}, {}, cancelled=True)
        light = Light.of(frame.frame_plan.plan, frame.frame_plan.scene, request.settings.bounces)
        if watch is not None:
            watch.ready(frame)
        try:
            if frame.drawn == ():
                return Result({}, report(frame, time.perf_counter() - started), drawn=())
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
            if frame.frame_plan.streamed is not None:
                frame.keep_shown()  # pages stay, and passes are copied several times until they are in a file
            pixels = frame.pixels()
            if request.moment[1] > 1 and known is None:
                self._keep_light(scene, frame)
            if watch is not None:
                watch.finished()
            result = Result(pixels, report(frame, time.perf_counter() - started), drawn=frame.drawn)
        except Cancelled:
            return Result({}, report(frame, time.perf_counter() - started), cancelled=True)
        finally:
            frame.release()
        if asked:
            try:
                result = self._with_light(scene, request, asked, light, frame.done, result, progress, cancelled)
            except Cancelled:
                return Result({}, result.report, cancelled=True)
        return result

    def _with_light(
        self,
        scene: Scene,
        request: Request,
        asked: Set[str],
        light: Light,
        samples: int,
        result: Result,
        progress: Callable[[float, str], None],
        cancelled: Callable[[], bool],
    ) -> Result:
        """Returns the result with the passes of light that are `asked` for, of so many samples. Raises Cancelled."""
        started = time.perf_counter()
        height, width = result.pixels["combined"].shape[:2]
        # Some pictures have no parts: the first is all of them.
        part = (0, 1) if result.drawn == ((0, 0, width, height),) else request.part
        warnings: list[str] = list(result.report["warnings"])

        def draw(term: Term, direct: bool) -> np.ndarray:
            name = term.light.lower()
            progress(1.0, f"Light: {name} color" if term.color else f"Light: {name}")
            occlusion = term.light == OCCLUSION
            settings = request.settings
            settings = replace(settings, bounces=0 if direct else settings.bounces,
                               use_indirect=settings.use_indirect or occlusion,
                               use_eye_dome=settings.use_eye_dome and not (term.color or occlusion))  # fmt: skip
            shown = replace(scene, transparent=scene.transparent and term.light != ENVIRONMENT)
            asked = replace(request, settings=settings, passes=frozenset({"combined"}), part=part, term=term)
            frame = Frame(self, shown, asked, cancelled)
            if occlusion:
                warnings.extend(frame.frame_plan.warnings)
            try:
                while frame.done < samples and frame.sample():
                    frame.clock.settle()
                    frame.clock.check()
                return frame.mean()[..., :3]
            finally:
                frame.release()

        found = light_passes(asked, light, result.pixels["combined"], scene.transparent, draw,
                             scene.world.occlusion_distance)  # fmt: skip
        seconds = time.perf_counter() - started
        report = {**result.report, "seconds": result.report["seconds"] + seconds}
        report["skipped"] = [one for one in report["skipped"] if one["name"] != "light passes"]
        report["warnings"] = list(dict.fromkeys(warnings))
        report["passes"] = [*report["passes"], {"name": "light passes", "ms": round(1000 * seconds, 3)}]
        return replace(result, pixels={**result.pixels, **found}, report=report)

    def start(
        self, scene: Scene, request: Request, slices: Slices | None = None, known: IndirectLight | None = None
    ) -> Frame:
        """Returns a frame without samples; the caller draws them one by one and releases it.

        `slices`: in which indirect light is gathered; None: all at once. Cancelled: gathering was put off; what was
        gathered is kept for the next frame. `known`: nothing is gathered, but estimated from this light of the scene.
        """
        frame = Frame(self, scene, request, presented=True, slices=slices, known=known)
        frame.clock.slow = False
        return frame

    def _keep_light(self, scene: Scene, frame: Frame) -> None:
        """Keeps the indirect light of a frame for further moments of its picture."""
        self._forget_light()
        found, plan = frame.indirect, frame.frame_plan
        if found is not None and found.tells and not plan.plan.mirrors:  # estimates blur what these show
            self._of_moment = KnownLight(self, scene, plan.request.settings, found)

    def _forget_light(self) -> None:
        if self._of_moment is not None:
            self._of_moment.release()
        self._of_moment = None

    def release(self) -> None:
        """Free everything that the renderer keeps on the device, not the device itself."""
        self._forget_light()
        self.kept.clear()
        self.pool.release()
