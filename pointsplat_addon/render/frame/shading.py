"""Shades the G-buffers of each sample and draws the world behind them, into the sums of one picture."""

from __future__ import annotations

import numpy as np

from ...core.numeric.lattice import lattice_of
from ...core.scene.scene import Scene
from ...shading.interface import Interface
from ..device.protocol import Device, Target, Texture
from ..passes.gbuffer import GBuffer
from ..passes.shading.averages import averaged
from ..passes.shading.backdrop import Backdrop
from ..passes.shading.background import background_program
from ..passes.shading.shade import matte_program, shade_program, shade_values
from ..passes.shading.terms import OCCLUSION
from ..passes.tiles import Region
from ..passes.uniforms import SampleView
from ..passes.visibility.buffer import VisibilityBuffer
from ..plan.plan import Plan
from ..plan.request import Request
from .surfels import gbuffer_textures
from .targets import Targets
from .uploads.uploads import Uploads


class Shading:
    """The programs that shade one picture, and the textures that they read."""

    def __init__(
        self,
        device: Device,
        scene: Scene,
        plan: Plan,
        request: Request,
        uploads: Uploads,
        targets: Targets,
        backdrop: Backdrop | None,
    ) -> None:
        """Makes the programs of one picture; `backdrop`: the world out of focus, or None if it is in focus."""
        self._device, self._scene, self._uploads, self._targets, self._backdrop = (
            device, scene, uploads, targets, backdrop,
        )  # fmt: skip
        passes, coverage = request.passes, plan.ewa is not None
        # Averaged passes of painted splats come from a separate G-buffer, without light.
        self._averages: tuple[Interface, ...] = ()
        if plan.painter and plan.points and averaged(passes):
            self._averages = (
                shade_program(plan.data_variant, (), plan.materials, passes, lines=plan.lines, combined=False),
                background_program((), True, passes, combined=False),
            )
            passes = frozenset({"combined"})
        self._shade = shade_program(
            plan.variant, plan.lighting, plan.materials, passes, request.samples, coverage, plan.lines, plan.defocus,
            plan.picture, coarse=request.coarse, lattice=lattice_of(plan.sub_samples) if plan.sub_samples else None,
            indirect=plan.indirect, mattes=plan.matte_light.lit,
        )  # fmt: skip
        self._mattes = None
        if plan.matte_light.lit:
            occlusion = plan.term is not None and plan.term.light == OCCLUSION
            self._mattes = matte_program(
                plan.variant, plan.matte_light.names, request.samples, lattice_of(plan.sub_samples), plan.background,
                shadows=not occlusion,
            )  # fmt: skip
        self._background = background_program(
            plan.background_defines,
            scene.transparent,
            frozenset() if plan.sub_samples else passes,
            coverage,
            everywhere=not plan.shaded.solid,
            combined=plan.picture,  # other passes are spread over what lies behind groups
            grouped=plan.sub_samples > 0,
            mattes=plan.matte_light.lit,
            trained=plan.translucent is not None and plan.translucent.trained,
            term=plan.term,
        )

    @property
    def averages(self) -> bool:
        """Whether averaged passes come from a separate G-buffer."""
        return bool(self._averages)

    @property
    def backdrop_textures(self) -> dict[str, Texture]:
        """The texture of the world out of focus, by sampler name; empty if it is in focus."""
        return {} if self._backdrop is None else {"ps_backdrop": self._backdrop.texture}

    @property
    def backdrop_texels(self) -> tuple[float, float] | None:
        """How many texels of the world out of focus a pixel spans along each axis; None if it is in focus."""
        return None if self._backdrop is None else self._backdrop.texels

    def draw_backdrop(self, view: SampleView) -> None:
        """Draws the world out of focus; `view`: of rays through pixel centres."""
        levels = self._uploads.lighting.levels
        assert self._backdrop is not None
        assert levels is not None
        self._backdrop.draw(view, {**self._uploads.behind, "ps_levels": levels})

    def shade(self, view: SampleView, region: Region) -> None:
        """Adds the shaded G-buffer to the sums."""
        textures = gbuffer_textures(self._targets.surfels) | self._uploads.shading
        self._add(self._shade, view, region, textures)

    def draw_background(self, view: SampleView, region: Region) -> None:
        """Adds the world to the sums, where nothing is in front of it."""
        textures = gbuffer_textures(self._targets.surfels) | self._uploads.behind | self.backdrop_textures
        self._add(self._background, view, region, textures)

    def shade_groups(
        self,
        view: SampleView,
        surfaces: GBuffer,
        groups: dict[str, Texture],
        buffer: VisibilityBuffer,
        target: Target,
        received: dict[str, Texture],
    ) -> None:
        """Shades a list of groups of sub-samples: `surfaces` has their attributes, `groups` tells of which pixels they
        are, by sampler name, `buffer` has the sub-samples themselves, `received` what groups get of
        indirect light."""
        textures = surfaces.bound() | self._uploads.shading | groups | buffer.textures | received
        record = self._record(self._shade, view, **buffer.values)
        self._device.draw(self._shade, target, uniforms=record, textures=textures)

    def shade_mattes(
        self,
        view: SampleView,
        surfaces: GBuffer,
        groups: dict[str, Texture],
        buffer: VisibilityBuffer,
        target: Target,
    ) -> None:
        """Writes what shows through mattes among a list of groups, as `shade_groups` has them, and how much of their
        light shadows leave."""
        assert self._mattes is not None
        assert self._uploads.matte_lighting is not None
        textures = surfaces.bound() | self._uploads.matte_lighting.textures | groups | buffer.textures
        record = self._record(self._mattes, view, **buffer.values)
        self._device.draw(self._mattes, target, uniforms=record, textures=textures)

    def draw_open(self, view: SampleView, codes: dict[str, Texture], target: Target) -> None:
        """Draws the world where sub-samples are open; `codes`: the groups of sub-samples, by sampler name."""
        textures = codes | self._uploads.behind | self.backdrop_textures
        record = self._record(self._background, view)
        self._device.draw(self._background, target, uniforms=record, textures=textures)

    def average(self, view: SampleView) -> None:
        """Adds the averaged passes of painted splats to their sums."""
        textures = gbuffer_textures(self._targets.data_surfels) | self._uploads.shading
        target = self._targets.averages_target
        for program in self._averages:
            record = self._record(program, view)
            self._device.draw(program, target, uniforms=record, textures=textures, blend=True)

    def _add(self, program: Interface, view: SampleView, region: Region, textures: dict[str, Texture]) -> None:
        record = self._record(program, view)
        region.draw(self._device, program, self._targets.shade_target, uniforms=record, textures=textures, blend=True)

    def _record(self, program: Interface, view: SampleView, **own: object) -> np.ndarray:
        values = shade_values(self._scene)
        return view.record_of(program.block, backdrop_texels=self.backdrop_texels, **values, **own)
