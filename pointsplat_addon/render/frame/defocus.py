"""Gathers the splats of a picture that are out of focus, once for all samples, over the mean of those in focus.

Passes that are not blurred come from an auxiliary picture without a lens.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...core.lod.criteria import NEIGHBOUR_EXTENT
from ...core.scene.camera import Camera
from ...core.splat.blur import OUT_OF_FOCUS, defocus_blur
from ..device.protocol import Device, Texture
from ..passes.defocus.gather import Defocus, defocus_program
from ..passes.defocus.tile_lists import tile_lists
from ..passes.output.adaptive import Adaptive
from ..passes.translucent.light import light_program
from ..passes.translucent.lit_splats import LitSplats
from ..passes.uniforms import SampleView
from ..plan.plan import Plan
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
    ) -> None:
        """Prepares to light the splats.

        `transparent`: whether the film is. `run` times each pass. Raises DeviceError if there are more splats than a
        texture holds.
        """
        assert plan.translucent is not None
        assert uploads.translucent is not None
        self.splats = uploads.translucent
        self.device, self.plan, self.uploads, self.targets = device, plan, uploads, targets
        self.transparent, self._run = transparent, run
        self.gathered = 0  # samples in the picture
        self.tiles: Defocus | None = None
        program = light_program(plan.translucent, plan.lighting, plan.materials)
        self.lit = LitSplats(device, plan.translucent, program, self.splats.count)

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
            self.plan.background_defines, self.transparent, self.plan.translucent.tint, self.plan.translucent.holdout,
            adaptive is not None, tiles.tile, self.plan.term,
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
        self.lit.light(view, len(self.uploads.scene.lights), {**self.splats.textures, **self.uploads.shading})

    def _list(self, view: SampleView) -> None:
        """Lists the lit splats by the tiles of the picture that they overlap."""
        lit = self.lit
        centre, shape = (
            self.device.read(lit.textures[name]).reshape(-1, 4)[: lit.count] for name in ("ps_centre", "ps_shape")
        )
        focal = np.array([*view.camera.pixel_from_view()[:2], *view.principal_point], np.float32).astype(np.float64)
        self.tiles = Defocus(self.device, tile_lists(centre, shape, focal, self.targets.seen.size))

    def release(self) -> None:
        self.lit.release()
        if self.tiles is not None:
            self.tiles.release()
