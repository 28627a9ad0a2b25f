"""Draws points, polygons, spheres and strands into a G-buffer without holes."""

from __future__ import annotations

from collections.abc import Callable

from ..device.protocol import Device, Texture
from ..passes.ewa.ewa import Ewa
from ..passes.gbuffer import GBuffer, Variant
from ..passes.image_space.projection import Projection, programs
from ..passes.image_space.pyramid import Pyramid
from ..passes.image_space.resolve import resolve
from ..passes.strands import strands
from ..passes.tiles import EVERYWHERE, Region
from ..passes.uniforms import SampleView
from ..passes.visibility import polygons
from ..passes.visibility import spheres as sphere_pass
from ..plan.plan import Plan
from .uploads.uploads import Uploads


class Surfels:
    """A G-buffer of one variant, with the pyramid that fills the holes between points."""

    def __init__(self, device: Device, plan: Plan, variant: Variant, size: tuple[int, int], count: int) -> None:
        """Allocates a G-buffer of `size` (width, height) pixels; `count`: levels of the pyramid above it."""
        self.device, self.plan, self.variant = device, plan, variant
        self.buffer = GBuffer(device, variant, size, depth=plan.options.depth)
        self.pyramid = None
        if plan.points and plan.ewa is None:
            self.resolve_program = programs(variant, plan.options).resolve
            self.pyramid = Pyramid(device, variant, self.buffer, count)

    def draw(
        self,
        uploads: Uploads,
        projection: Projection | None,
        view: SampleView,
        run: Callable[[str, Callable[[], None]], None],
        region: Region = EVERYWHERE,
    ) -> None:
        """Draws one sample: resolves points, rasterises polygons, spheres and strands, and fills holes.

        `run` times each pass. Only pixels in `region` need to be valid.
        """

        def resolve_points(ids: Texture) -> None:
            self.buffer.clear()
            resolve(
                self.device,
                self.resolve_program,
                ids,
                uploads.points.draws,
                view,
                uploads.shared,
                self.buffer,
                region,
            )

        if projection is None:
            self.buffer.clear()
        else:
            run("resolve", lambda: resolve_points(projection.ids))
        self._draw_solids(uploads, view, run)
        if self.pyramid is not None:
            pyramid = self.pyramid
            run("pull", lambda: pyramid.pull(view, region))
            run("push", lambda: pyramid.push(view, region))

    def _draw_solids(self, uploads: Uploads, view: SampleView, run: Callable[[str, Callable[[], None]], None]) -> None:
        if self.plan.polygons:
            run("polygons", lambda: self._draw_polygons(uploads, view))
        if self.plan.spheres:
            run("spheres", lambda: self._draw_spheres(uploads, view))

        if self.plan.lines:
            run("lines", lambda: self._draw_lines(uploads, view))

    def _draw_lines(self, uploads: Uploads, view: SampleView) -> None:
        shared = {**uploads.shared, **uploads.strands.instances}
        strands.draw(self.device, self.variant, uploads.strands.draws, view, shared, self.buffer)

    def _draw_spheres(self, uploads: Uploads, view: SampleView) -> None:
        program = sphere_pass.program(self.variant, self.plan.options)
        sphere_pass.draw(self.device, program, uploads.points.balls, view, uploads.shared, self.buffer)

    def _draw_polygons(self, uploads: Uploads, view: SampleView) -> None:
        instances = uploads.scene.instances
        for instance in uploads.prepared.polygons.tolist():
            polygons.draw(
                self.device,
                self.variant,
                uploads.polygons.meshes[int(instances.geometry[instance])],
                uploads.prepared.view_from_object[instance],
                instance,
                bool(instances.holdout is not None and instances.holdout[instance]),
                view,
                uploads.shared,
                self.buffer,
                uploads.polygons.part_lists.get(instance),
            )

    def release(self) -> None:
        self.buffer.release()
        if self.pyramid is not None:
            self.pyramid.release()


class EwaSurfels(Surfels):
    """A G-buffer of one variant, without holes because splats are blended as Gaussians (EWA: Zwicker et al. 2001)."""

    def __init__(self, device: Device, plan: Plan, variant: Variant, size: tuple[int, int], count: int) -> None:
        super().__init__(device, plan, variant, size, count)
        assert plan.ewa is not None
        self.ewa = Ewa(device, variant, plan.options, plan.ewa, size)

    def draw(
        self,
        uploads: Uploads,
        projection: Projection | None,
        view: SampleView,
        run: Callable[[str, Callable[[], None]], None],
        region: Region = EVERYWHERE,
    ) -> None:
        """Draws one sample: blends and normalises splats, and rasterises polygons, spheres and strands."""
        ewa, shared = self.ewa, uploads.shared

        def normalise() -> None:
            self.buffer.clear()
            ewa.normalise(view, self.buffer, region)

        if ewa.draws is not uploads.points.draws:
            run("splats", lambda: ewa.project(uploads.points.draws, view, shared))
        ewa.narrow(region)
        run("visibility", lambda: ewa.see(view, shared))
        run("blend", lambda: ewa.blend(view, shared))
        run("normalise", normalise)
        self._draw_solids(uploads, view, run)

    def release(self) -> None:
        super().release()
        self.ewa.release()


def make_surfels(device: Device, plan: Plan, variant: Variant, size: tuple[int, int], count: int) -> Surfels:
    """Returns a G-buffer that is filled by the plan's technique."""
    return (EwaSurfels if plan.ewa else Surfels)(device, plan, variant, size, count)


def gbuffer_textures(surfels: Surfels | None) -> dict[str, Texture]:
    """Returns the textures of a G-buffer by sampler name; none where there is no G-buffer."""
    return {} if surfels is None else surfels.buffer.bound()
