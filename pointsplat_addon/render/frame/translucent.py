"""Lights translucent splats for the samples of a picture, and draws them over the opaque picture of each sample."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from ...shading.interface import Interface
from ..device.protocol import Device, Target, Texture
from ..indirect.light import IndirectLight
from ..passes.translucent.blend import COARSE, ENLARGE, SHOW, add_program, depth_program
from ..passes.translucent.light import light_program
from ..passes.translucent.lit_splats import LitSplats
from ..passes.uniforms import SampleView
from ..plan.plan import Plan
from ..plan.request import Request
from .targets import Targets
from .uploads.captured import CapturedUploads
from .uploads.uploads import Uploads

LIGHTINGS = 4  # how often translucent splats are lit in one picture, if lights have a size


def lighting_of_sample(request: Request, sample: int) -> int:
    """Returns the index of the points on lights with a size that light translucent splats in a sample.

    It changes LIGHTINGS times in a picture; if an error decides how many samples there are, with each pair of samples.
    """
    if request.settings.budget == "ERROR":
        return (sample + 1) // 2
    return sample // max(request.samples // LIGHTINGS, 1)


class LitTranslucent:
    """The translucent splats of one picture, lit as they are when they are drawn."""

    def __init__(
        self,
        device: Device,
        plan: Plan,
        uploads: Uploads,
        samples: int,
        run: Callable[[str, Callable[[], None]], None],
        indirect: IndirectLight | None = None,
    ) -> None:
        """Makes the program that lights the splats.

        `samples`: of the picture. `run` times each pass. `indirect`: light that falls on media. Raises DeviceError if
        there are more splats than a texture holds.
        """
        assert plan.translucent is not None
        self._uploads, self._run, self._indirect = uploads, run, indirect
        self.splats = splats = uploads.translucent
        self.lit_by: int | None = None  # which points of wide lights; None: they are not lit yet
        program, count, options = None, 0, plan.translucent
        if options.gathered and (indirect is None or indirect.media is None):
            options = replace(options, gathered=False)  # what is drawn of media hides and sends nothing
        if splats is not None:
            program = light_program(options, plan.lighting, plan.materials, splats.shared_lights)
            count = splats.count
        captured = 0 if uploads.captured is None or uploads.captured.picture is not None else uploads.captured.most
        self.lit = LitSplats(device, plan.translucent, program, count, samples, captured, plan.widest_translucent)
        self.captured = uploads.captured

    def light(self, points: int, view: SampleView) -> None:
        """Lights the splats from the points with the index `points` on lights with a size.

        `view`: of rays through pixel centres.
        """
        self.lit_by = points
        view = replace(view, sample=points)
        if self.splats is not None:
            textures = {**self.splats.textures, **self._uploads.shading}
            if self.splats.shared_lights:
                textures |= self.splats.light_shares(points, view, self._run)
            lights, gathered = len(self._uploads.scene.lights), {}
            if self._indirect is not None and (on := self._indirect.on_media(view.camera.view_from_world)) is not None:
                gathered, textures["ps_medium_light_of"] = on
            self._run("light", lambda: self.lit.light(view, lights, textures, **gathered))
        captured = self._uploads.captured
        if captured is not None and captured.picture is None:
            self._run("captured", lambda: captured.project(self.lit, view))

    def release(self) -> None:
        self.lit.release()


class Translucent:
    """Blends the translucent splats of one picture over each of its samples."""

    def __init__(
        self,
        device: Device,
        plan: Plan,
        lit: LitTranslucent,
        targets: Targets,
        run: Callable[[str, Callable[[], None]], None],
    ) -> None:
        """Makes the programs that draw the splats. `run` times each pass."""
        assert plan.translucent is not None
        self.device, self.targets, self.lit, self._run = device, targets, lit.lit, run
        self._kept = lit.captured if lit.captured is not None and lit.captured.keeps_picture else None
        variant = plan.variant
        channels = variant.samplers(only=("centre", "shape", "normal") if variant.normal else ("centre",))
        self._add = add_program(plan.translucent)
        self._depth = depth_program(channels, variant.normal)

    def draw(self, view: SampleView, surfels: dict[str, Texture], coarse: bool) -> None:
        """Blends the splats over the opaque picture and adds the sample to the sums.

        `surfels`: textures of the opaque G-buffer by sampler name. `coarse`: draw the splats at a lower resolution, and
        enlarge them.
        """
        targets, run, lit = self.targets, self._run, self.lit
        assert targets.layer is not None
        # Captured splats have the pixel filter in them.
        centred = replace(view, offset=(0.0, 0.0)) if lit.captured else view

        def draw(program: Interface, target: Target, textures: dict[str, Texture], mode: str = "") -> None:
            record = None if program.block is None else view.record(program.block)
            self.device.draw(
                program, target, uniforms=record, textures=textures, blend=mode == "blend", over=mode == "over"
            )

        if targets.depth is not None:
            run("opaque depth", lambda: draw(self._depth, targets.depth_target, surfels))
        if coarse:
            self.device.clear(targets.coarse_target)
            few = view, targets.depth, COARSE
            run("translucent", lambda: lit.draw(targets.coarse_target, *few))
            run("enlarge", lambda: draw(ENLARGE, targets.layer_target, {"ps_coarse": targets.coarse}, "over"))
        elif self._kept is not None:
            picture = self._kept.picture or self._draw_kept(self._kept, centred)
            run("translucent", lambda: draw(SHOW, targets.layer_target, {"ps_picture": picture}, "over"))
        else:
            run("translucent", lambda: lit.draw(targets.layer_target, centred, targets.depth))
        layer = {"ps_layer": targets.layer, **({} if targets.cut is None else {"ps_cut": targets.cut})}
        run("add", lambda: draw(self._add, targets.combined_target, layer, "blend"))

    def _draw_kept(self, captured: CapturedUploads, view: SampleView) -> Texture:
        """Draws captured splats by themselves; the same view shows that picture again."""
        assert self.targets.layer is not None
        picture = self.device.texture(self.targets.layer.size, "RGBA32F")
        try:
            target = self.device.target([picture])
            try:
                self.device.clear(target)
                self._run("translucent", lambda: self.lit.draw(target, view, None))
            finally:
                target.release()
        except BaseException:
            picture.release()
            raise
        captured.keep(picture)
        return picture
