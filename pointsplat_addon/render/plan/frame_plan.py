"""What one picture shows, and how it is drawn: all that is decided before anything of it is on the device."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np

from ...core.lens.backdrop import why_not_blurred
from ...core.lens.thin_lens import uses_lens_samples
from ...core.lod.cost import Costs
from ...core.scene.camera import Camera
from ...core.scene.scene import Scene
from ...core.scene.validation import validate
from ...core.splat.blur import defocus_blur
from ..cache.keys import Key, Kind
from ..cache.store import Store
from ..device.clock import Clock
from ..device.protocol import Limits
from ..passes.image_space.pyramid import levels
from ..passes.output.adaptive import why_everywhere
from ..passes.outputs import CRYPTO
from ..passes.shading.averages import averaged
from ..passes.shading.data import data
from ..prepare.in_view import without_invisible_layers
from ..prepare.mesh_parts import count_triangles
from ..prepare.negligible import without_negligible
from ..prepare.painter import with_defocus_among_translucent, with_opaque_among_translucent
from ..prepare.prepare import Prepared, prepare
from ..prepare.separation import separate_translucent
from ..shadow.shadows import Shadows, make_shadows
from .auxiliary import beside
from .lens_view import prepared_for
from .plan import Plan, make_plan
from .request import Request
from .technique import NAMES, NO_BLENDING, Technique, choose, reconsidered

MOST_MARGIN = 64  # pixels around the window in which the centres of wide splats are looked for


@dataclass(frozen=True, eq=False)
class Shot:
    """One view of a scene, prepared and planned."""

    scene: Scene  # in parts, without what adds nothing measurable
    request: Request  # what is left of it for this picture
    technique: Technique
    prepared: Prepared
    shadows: Shadows | None
    plan: Plan
    view: Camera  # everything is drawn for it; the camera's window is a part of its own
    corner: tuple[int, int]  # pixels: where in the view's window that part lies
    through_lens: bool  # each sample sees through a place on the lens
    beside: tuple[Scene, Request] | None  # the picture of the passes that know no blur, which is drawn along with it
    everywhere: str  # why all pixels get all samples; empty where some may not
    left_out: tuple[tuple[str, str], ...]  # (pass, or what of the scene; because)
    warnings: tuple[str, ...]

    @property
    def trivial(self) -> bool:
        """One colour fills the picture."""
        drawn = self.plan.solid or self.plan.translucent is not None
        return not drawn and (self.scene.world.image is None or self.scene.transparent)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the picture."""
        return self.request.camera.window[2:]

    @property
    def constant(self) -> np.ndarray:
        """(4,) float64: the colour where nothing is before a world of one colour."""
        return np.zeros(4) if self.scene.transparent else np.append(np.asarray(self.scene.world.color), 1.0)

    @property
    def splats(self) -> int:
        """In the cut, of all kinds."""
        prepared = self.prepared
        layers = (*(() if self.plan.painter else (prepared,)), prepared.translucent, prepared.spheres)
        return sum(layer.cut.splats for layer in layers)

    @property
    def strands(self) -> int:
        """That the view shows."""
        return sum(segments.strands for segments in self.prepared.strands.values())

    @property
    def segments(self) -> int:
        """Of strands."""
        return sum(map(len, self.prepared.strands.values()))

    @property
    def triangles(self) -> int:
        """That are drawn."""
        return self._triangles()

    def _triangles(self, primitives: tuple[str, ...] = ()) -> int:
        """Of geometries that are to be drawn as `primitives`; of all where none are named."""
        prepared, instances = self.prepared, self.prepared.polygons.tolist()
        of = [self.scene.geometries[int(self.scene.instances.geometry[instance])] for instance in instances]
        return sum(
            count_triangles(geometry.mesh, prepared.parts.get(instance))
            for geometry, instance in zip(of, instances, strict=True)
            if geometry.mesh is not None and (not primitives or geometry.primitive in primitives)
        )

    def work(self, costs: Costs) -> float:
        """What a coarser cut has less of, in splats: those, and triangles of meshes that may be points instead."""
        return self.splats + self._triangles(("AUTO",)) * costs.triangle / costs.point

    def cropped(self, picture: np.ndarray) -> np.ndarray:
        """The camera's window of a picture (H, W, ...) of the view."""
        width, height = self.size
        x, y = self.corner
        return picture[y : y + height, x : x + width]

    def padded(self, picture: np.ndarray) -> np.ndarray:
        """The reverse: a picture (H, W) of the camera's window in one of the view, with zeros around it."""
        x, y = self.corner
        columns, rows = self.view.window[2:]
        height, width = picture.shape
        return np.pad(picture, [(y, rows - y - height), (x, columns - x - width)])


def make_shot(
    scene: Scene,
    request: Request,
    store: Store,
    limits: Limits,
    costs: Costs,
    clock: Clock,
    presented: bool,
    picture: bool,
) -> Shot:
    """`limits`, `costs`: of the device. `clock`: is told what shadows take. `presented`: between samples too.
    `picture`: with Combined, not passes beside it alone. Cancelled: the clock says so."""
    scene, camera = validate(
        scene, request.camera, lambda content, make: store.lookup(Key(Kind.VALIDATED, content), make)
    )
    warnings = scene.warnings
    scene, of_parts = separate_translucent(scene, store)
    request = request if camera is request.camera else replace(request, camera=camera)
    technique = choose(request.settings, scene, request.samples, request.interactive, limits.float_blend)
    warnings += (*of_parts, *_not_blended(technique, request))
    through_lens = uses_lens_samples(camera, request.settings) and request.samples > 1
    prepared = prepare(
        scene,
        prepared_for(scene, camera, store) if through_lens else camera,
        replace(request.settings, technique=technique.name),
        request.samples,
        store,
        interactive=request.interactive,
        check=clock.check,
        costs=costs,
        node=request.node,
        coarse=request.coarse,
    )
    technique = reconsidered(technique, prepared)
    others = None
    if prepared.out_of_focus is not None:
        # It goes to the pass of its own name; passes that know no blur are another picture's.
        others = beside(scene, request, presented)
        request = replace(request, passes=frozenset({"combined"}))
        prepared = with_defocus_among_translucent(prepared)
        if technique.name == "PAINTER":
            technique = Technique("IMAGE_SPACE", "the pass defocus paints")

    prepared, unseen = without_invisible_layers(scene, prepared, camera, store)
    scene, reflects, faint = without_negligible(scene, prepared, camera.view_from_world, store)
    shadows, unshadowed = _shadows(scene, prepared, request, store, clock)
    paints = technique.name == "PAINTER" and prepared.cut.splats > 0
    if paints:
        prepared = with_opaque_among_translucent(
            prepared, keep=presented or bool(averaged(request.passes) or data(request.passes))
        )

    blended = (camera, request.samples) if technique.name == "EWA" else None
    in_focus = "" if defocus_blur(camera) is None or through_lens else "nothing is out of focus"
    sharp_world = "each sample sees it through a place on the lens" if through_lens else why_not_blurred(scene, camera)
    plan = make_plan(
        scene, prepared, request.passes, shadows, unshadowed, request.interactive, blended, paints,
        reflects, unseen, in_focus, sharp_world, picture,
    )  # fmt: skip
    if request.coarse and plan.ewa is None:
        plan = replace(plan, options=replace(plan.options, coarse=True))
    view, corner = with_margin(camera, plan.reach(prepared.largest), limits.texture_size)
    everywhere = why_everywhere(
        request.settings,
        request.samples,
        plan.translucent is not None and not plan.defocus,
        bool(request.passes & set(CRYPTO)),
        any(len(segments.thin) for segments in prepared.strands.values()),
        through_lens,
    )
    warnings += (*prepared.warnings, *(shadows.warnings if shadows else ()))
    return Shot(
        scene, request, technique, prepared, shadows, plan, view, corner, through_lens, others, everywhere,
        (*plan.skipped, *faint), warnings,
    )  # fmt: skip


def _not_blended(technique: Technique, request: Request) -> tuple[str, ...]:
    """A warning where the technique that is asked for cannot be had."""
    asked = request.settings.technique
    if technique.because != NO_BLENDING or asked not in NAMES:
        return ()
    return (f"{NAMES[asked]} needs blending of floats, which this GPU lacks: points are drawn in image space",)


def _shadows(
    scene: Scene, prepared: Prepared, request: Request, store: Store, clock: Clock
) -> tuple[Shadows | None, str]:
    """The tables of all lamps that cast shadows on what is drawn; or None, and why."""
    layers = (prepared, prepared.translucent, prepared.spheres)
    if not (any(layer.cut.splats for layer in layers) or len(prepared.polygons) or prepared.strands):
        return None, "nothing is drawn"
    before = time.perf_counter()
    found, unshadowed = make_shadows(scene, request.settings, store, clock.check)
    if found is not None:
        clock.spent["shadows"] = 1000 * (time.perf_counter() - before)
    return found, unshadowed


def with_margin(camera: Camera, radius: float, most: int) -> tuple[Camera, tuple[int, int]]:
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
