"""Prepares and plans one view of a scene: all that is decided before anything of it is on the device."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Set
from dataclasses import replace

import numpy as np

from ...core.lens.backdrop import why_not_blurred
from ...core.lens.thin_lens import uses_lens_samples
from ...core.lod.cost import Costs
from ...core.numeric.lattice import FEW, lattice_for
from ...core.numeric.pixel_filter import filter_reach
from ...core.numeric.record import record
from ...core.scene.camera import Camera
from ...core.scene.scene import Scene
from ...core.scene.settings import Settings
from ...core.splat.blur import defocus_blur
from ..cache.on_disk import NOWHERE, OnDisk
from ..cache.store import Store
from ..device.clock import Clock
from ..device.protocol import Limits
from ..passes.image_space.pyramid import levels
from ..passes.output.adaptive import why_everywhere
from ..passes.outputs import CRYPTO
from ..passes.shading.averages import averaged
from ..passes.shading.data import data
from ..passes.shading.terms import ENVIRONMENT, OCCLUSION
from ..prepare.captured import casting_on_captured, count_captured, lit_captured
from ..prepare.in_view import without_invisible_layers
from ..prepare.mattes import casting_on_mattes, with_mattes
from ..prepare.meshes.parts import count_triangles
from ..prepare.negligible import without_negligible
from ..prepare.painter import with_defocus_among_translucent, with_opaque_among_translucent
from ..prepare.prepare import Prepared, prepare, with_coarse_meshes
from ..prepare.separation import separate_translucent
from ..prepare.streamed import Streamed, with_pages
from ..shadow.nested import with_nested
from ..shadow.shadows import Shadows, make_shadows
from .auxiliary import auxiliary_picture
from .lens_view import camera_of_whole_lens
from .make_plan import ViewToPlan, make_plan, sends_light
from .plan import Plan
from .reasons import Absences, why_no_eye_dome, why_no_indirect, why_not_trained
from .request import Request
from .technique import Technique, TechniqueInput, confirm_technique, decide_technique, shown_alike
from .valid import validated

MOVING_SHADOWS, LEAST_SHADOWS = 4, 64  # part of the resolution of shadows while a view of scans read by pages moves
MOST_MARGIN = 64  # pixels around the window in which the centres of wide splats are looked for
UNLIT = "Indirect light is left out: "  # and why
LENS_SAMPLES_BLUR = "each sample sees it through a point on the lens"  # the reason why the world has no picture


@record
class FramePlan:
    """One view of a scene, prepared and planned."""

    scene: Scene  # its meshes in parts, without lights and emission that add nothing measurable
    request: Request  # with the passes that this picture draws, without those of the auxiliary picture
    technique: Technique
    prepared: Prepared
    shadows: Shadows | None
    captured_shadows: dict[int, Shadows | None]  # that captured splats receive, by row of geometries
    matte_shadows: Shadows | None  # that mattes receive
    plan: Plan
    view: Camera  # what is drawn: the window of request.camera with a margin
    corner: tuple[int, int]  # pixels: the corner of the camera's window in the view's
    through_lens: bool  # each sample sees through another point on the lens
    auxiliary: tuple[Scene, Request] | None  # the picture without depth of field that is drawn along with this one
    not_adaptive: str  # why all pixels get all samples; empty where some may not
    left_out: tuple[tuple[str, str], ...]  # (pass, or part of the scene; reason)
    warnings: tuple[str, ...]
    streamed: Streamed | None = None  # what is read by pages
    followed: bool = False  # by a picture that draws more sub-samples at once, see Request

    @property
    def trivial(self) -> bool:
        """Whether one colour fills the picture."""
        drawn = self.plan.solid or self.plan.translucent is not None
        return not drawn and self.scene.world.fog is None and self._one_color

    @property
    def _one_color(self) -> bool:
        """Whether one colour is behind everything."""
        return self.scene.world.behind.image is None or self.scene.transparent

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the picture."""
        return self.request.camera.window[2:]

    @property
    def world_color(self) -> np.ndarray:
        """(4,) float64: RGBA of pixels that show nothing but a world of one colour."""
        if self.scene.transparent:
            return np.zeros(4)
        shown = self.plan.term is None or self.plan.term.light == ENVIRONMENT
        return np.append(np.asarray(self.scene.world.behind.color) * shown, 1.0)

    @property
    def splats(self) -> int:
        """The number of splats in the cut, of all kinds."""
        prepared = self.prepared
        opaque = () if self.plan.painter else (prepared, prepared.nodes)
        layers = (*opaque, prepared.translucent, prepared.spheres)
        captured = count_captured(self.scene, prepared.captured, prepared.captured_nodes)
        return sum(layer.cut.splats for layer in layers) + captured

    @property
    def strands(self) -> int:
        """The number of strands that the view shows."""
        return sum(segments.strands for segments in self.prepared.strands.values())

    @property
    def segments(self) -> int:
        """The number of segments of the strands that the view shows."""
        return sum(map(len, self.prepared.strands.values()))

    @property
    def triangles(self) -> int:
        """The number of triangles that are drawn."""
        return self._triangles()

    def _triangles(self, primitives: tuple[str, ...] = ()) -> int:
        """The number of triangles of geometries whose setting is one of `primitives`; of all where none are named."""
        prepared, geometry_of = self.prepared, self.scene.instances.geometry
        counted = np.array([
            len(geometry.mesh.triangles)
            if geometry.mesh is not None and (not primitives or geometry.primitive in primitives) else 0
            for geometry in self.scene.geometries
        ], np.int64)  # fmt: skip
        shown = prepared.all_polygons
        if not prepared.parts:
            return int(counted[geometry_of[shown]].sum())
        divided = {instance: prepared.parts[instance] for instance in shown.tolist() if instance in prepared.parts}
        whole = shown[~np.isin(shown, list(divided))]
        return int(counted[geometry_of[whole]].sum()) + sum(
            count_triangles(mesh, parts)
            for instance, parts in divided.items()
            if counted[row := int(geometry_of[instance])] and (mesh := self.scene.geometries[row].mesh) is not None
        )

    def reducible_work(self, costs: Costs) -> float:
        """Returns what a coarser cut reduces, in splats: these, and triangles of meshes that may be points instead."""
        return self.splats + self._triangles(("AUTO",)) * costs.triangle / costs.point

    def cropped(self, picture: np.ndarray) -> np.ndarray:
        """Returns the camera's window of a picture (H, W, ...) of the view."""
        width, height = self.size
        x, y = self.corner
        return picture[y : y + height, x : x + width]

    def padded(self, picture: np.ndarray) -> np.ndarray:
        """Returns a picture (H, W) of the camera's window as one of the view, with zeros around it."""
        x, y = self.corner
        columns, rows = self.view.window[2:]
        height, width = picture.shape
        return np.pad(picture, [(y, rows - y - height), (x, columns - x - width)])


def make_frame_plan(
    scene: Scene,
    request: Request,
    store: Store,
    limits: Limits,
    costs: Costs,
    clock: Clock,
    presented: bool,
    picture: bool,
    forget: Callable[[Set[str]], None] = lambda drawn: None,
) -> FramePlan:
    """Returns one view of a scene, prepared and planned.

    `limits`, `costs`: of the device. `clock`: is told what shadows take. `presented`: the picture is shown between
    samples, too. `picture`: Combined is drawn, not auxiliary passes alone. `forget`: see with_pages. Raises
    Cancelled where the clock says so.
    """
    scene, streamed = with_pages(
        scene,
        request.camera,
        request.settings,
        store,
        request.interactive,
        clock.check,
        moving=request.moving,
        of=request.pages_of,
        forget=forget,
    )
    if streamed is not None and request.moving:
        # What casts changes with each picture, and maps are drawn anew.
        coarse = max(request.settings.shadow_resolution // MOVING_SHADOWS, LEAST_SHADOWS)
        request = replace(request, settings=replace(request.settings, shadow_resolution=coarse))
    scene, camera = validated(scene, request.camera, store)
    warnings = scene.warnings
    scene, of_parts = separate_translucent(scene, store)
    request = request if camera is request.camera else replace(request, camera=camera)
    captured = any(geometry.captured is not None for geometry in scene.geometries)
    if captured and camera.aperture is not None:
        # The pass `defocus` has no captured splats.
        request = replace(request, settings=replace(request.settings, dof_method="LENS_SAMPLES"))
    lattice = FEW if request.moment[1] > 1 else lattice_for(request.samples, request.few)
    through_lens = uses_lens_samples(camera, request.settings) and request.samples > 1
    decided = decide_technique(
        TechniqueInput(request.settings, scene, request.samples, request.interactive, through_lens, limits.float_blend)
    )
    prepared = _prepared(scene, request, decided, through_lens, store, costs, clock)
    scene = with_coarse_meshes(scene, prepared)
    technique = confirm_technique(decided, prepared)
    auxiliary = None
    if prepared.out_of_focus is not None:
        # What is out of focus goes into Combined alone; the other passes are of the auxiliary picture.
        at_once = lattice.count if technique.name == "VISIBILITY" else 1
        auxiliary = auxiliary_picture(scene, request, presented, at_once)
        request = replace(request, passes=frozenset({"combined"}))
        prepared = with_defocus_among_translucent(prepared)

    prepared, mattes, unsupported = with_mattes(scene, prepared, technique.name)
    prepared, out_of_view = without_invisible_layers(
        scene, prepared, with_filter_margin(camera, neighbourhood(request.settings)), store
    )
    scene, reflects, negligible = without_negligible(scene, prepared, camera.view_from_world, store)
    settings = replace(request.settings, technique=technique.name)
    others = bool(prepared.translucent.point_sets)
    on_disk = NOWHERE if presented else store.on_disk
    shadows, unshadowed = None, "no light is drawn on which they fall"
    if request.term is None or request.term.lit:
        shadows, unshadowed = _shadows(
            scene, prepared, replace(request, settings=settings), store, on_disk, clock, limits
        )
    captured_shadows, matte_shadows = _captured_shadows(
        scene, prepared, settings, store, on_disk, clock, limits, mattes
    )
    linear = why_not_trained(
        settings, _has_opaque(prepared), others, bool(captured_shadows), camera.aperture is not None
    )
    painter = technique.name == "PAINTER" and prepared.cut.splats > 0
    if painter:
        prepared = with_opaque_among_translucent(
            prepared, keep=presented or bool(averaged(request.passes) or data(request.passes))
        )

    absences = Absences(
        unshadowed or ("" if shadows is None or shadows.tables is not None else "depth maps show all that casts"),
        unshadowed or ("" if shadows is None or shadows.maps or shadows.panes else "only tables hold what casts"),
        out_of_view,
        "" if defocus_blur(camera) is None or through_lens else "nothing is out of focus",
        LENS_SAMPLES_BLUR if through_lens else why_not_blurred(scene, camera),
        why_no_indirect(request.settings, technique.name),
        why_no_eye_dome(request.settings, technique.name, _has_opaque(prepared), prepared.out_of_focus is not None),
        linear,
    )
    ewa = technique.name == "EWA"
    sub_samples = 0
    # What is translucent alone takes all sub-samples at once, too, where there are several of them. But tables of
    # lights with a size are looked at from other points of these in each sample.
    several = picture and request.samples > 1
    hard = shadows is None or shadows.tables is None or shadows.tables.packed.no_light_has_size
    alone = bool(prepared.translucent.point_sets) and several and hard
    in_lattices = technique.name == "VISIBILITY" and (_has_opaque(prepared) or alone)
    followed = in_lattices and request.first and request.samples > lattice.count
    if followed:
        request = replace(request, samples=1)
    if in_lattices and (_has_opaque(prepared) or not request.few):
        sub_samples = lattice.count
        if request.moment[1] == 1:
            request = replace(request, samples=-(-request.samples // sub_samples))
    elif prepared.captured and not _has_opaque(prepared) and not through_lens:
        # Captured splats have the pixel filter in them.
        request = replace(request, samples=1)
    plan = make_plan(
        ViewToPlan(
            scene, prepared, request, shadows, mattes, matte_shadows, captured_shadows, ewa, painter, reflects,
            picture, sub_samples, presented, followed or (request.few and not request.first), absences,
        )
    )  # fmt: skip
    some = _has_opaque(prepared) or prepared.out_of_focus is not None
    lacks_eye_dome = request.settings.use_eye_dome and picture and some and not plan.eye_dome
    occlusion = request.term is not None and request.term.light == OCCLUSION
    lacks_indirect = request.settings.use_indirect and bool(absences.indirect) and picture and reflects and some
    lacks_indirect = lacks_indirect and sends_light(scene, request.settings.bounces) and not occlusion
    open_everywhere = absences.indirect or "something is out of focus"
    lacks_occlusion = occlusion and picture and some and not plan.indirect
    not_trained = settings.captured_blending == "TRAINED" and bool(prepared.captured) and picture and linear
    radius = filter_reach(neighbourhood(request.settings)) if sub_samples else plan.splat_radius(prepared.largest)
    view, corner = with_margin(camera, radius, limits.texture_size)
    return FramePlan(
        scene,
        request,
        technique,
        prepared,
        shadows,
        captured_shadows,
        matte_shadows,
        plan,
        view,
        corner,
        through_lens,
        auxiliary,
        _not_adaptive(request, prepared, plan, through_lens),
        left_out=(*plan.skipped, *negligible),
        warnings=(
            *warnings,
            *of_parts,
            *((technique.warning,) if technique.warning else ()),
            *shown_alike(scene, technique.name),
            *((f"Eye-dome lighting is left out: {absences.eye_dome}",) if lacks_eye_dome else ()),
            *((UNLIT + absences.indirect,) if lacks_indirect else ()),
            *((f"Ambient Occlusion is 1 wherever something is: {open_everywhere}",) if lacks_occlusion else ()),
            *((f"Captured splats are blended in linear light, not as trained: {linear}",) if not_trained else ()),
            *prepared.warnings,
            *unsupported,
            *dict.fromkeys(
                warning
                for one in (shadows, *captured_shadows.values(), matte_shadows)
                if one is not None
                for warning in one.warnings
            ),
            *(streamed.warnings if streamed else ()),
        ),
        streamed=streamed,
        followed=followed,
    )


def _prepared(
    scene: Scene,
    request: Request,
    technique: Technique,
    through_lens: bool,
    store: Store,
    costs: Costs,
    clock: Clock,
) -> Prepared:
    """What the camera, or any point on its lens, sees, prepared for a technique."""
    camera = with_filter_margin(request.camera, neighbourhood(request.settings))
    return prepare(
        scene,
        camera_of_whole_lens(scene, camera, store) if through_lens else camera,
        replace(request.settings, technique=technique.name),
        request.samples,
        store,
        interactive=request.interactive,
        moving=request.moving,
        check=clock.check,
        costs=costs,
        node=request.node,
        coarse=request.coarse,
        few=request.few,
    )


def _has_opaque(prepared: Prepared) -> bool:
    """Whether a view shows something opaque. What is translucent alone is blended in each sample."""
    splats = sum(layer.cut.splats for layer in (prepared, prepared.nodes, prepared.spheres))
    return splats > 0 or len(prepared.all_polygons) > 0 or len(prepared.strands) > 0


def _not_adaptive(request: Request, prepared: Prepared, plan: Plan, through_lens: bool) -> str:
    """Why all pixels get all samples; empty where adaptive sampling may leave some out."""
    if plan.sub_samples:
        return "all sub-samples of a pixel are drawn at once"
    return why_everywhere(
        request.settings,
        request.samples,
        plan.translucent is not None and not plan.defocus,
        bool(request.passes & set(CRYPTO)),
        any(len(segments.thin) for segments in prepared.strands.values()),
        through_lens,
    )


def _shadows(
    scene: Scene,
    prepared: Prepared,
    request: Request,
    store: Store,
    on_disk: OnDisk,
    clock: Clock,
    limits: Limits,
) -> tuple[Shadows | None, str]:
    """What casts the shadows of all lights on what is drawn; or None, and why."""
    layers = (prepared, prepared.translucent, prepared.spheres, prepared.nodes)
    if not (any(layer.cut.splats for layer in layers) or len(prepared.all_polygons) or prepared.strands):
        return None, "nothing is drawn"
    before = time.perf_counter()
    found, unshadowed = make_shadows(
        scene, request.settings, store, clock.check, limits.texture_size, request.camera, on_disk
    )
    if found is None:
        return None, unshadowed or "nothing casts shadows"
    if found.maps is not None and not request.interactive:
        found = replace(found, maps=with_nested(found.maps, scene, request.camera, store, limits.texture_size))
    if found.tables is not None:
        clock.spent["shadows"] = 1000 * (time.perf_counter() - before)
    return found, ""


def _captured_shadows(
    scene: Scene,
    prepared: Prepared,
    settings: Settings,
    store: Store,
    on_disk: OnDisk,
    clock: Clock,
    limits: Limits,
    mattes: bool,
) -> tuple[dict[int, Shadows | None], Shadows | None]:
    """What casts shadows on captured splats, by row of geometries, of those that light changes; and on mattes, if there
    are some."""
    before = time.perf_counter()

    def cast_by(casting: Scene) -> Shadows | None:
        return make_shadows(casting, settings, store, clock.check, limits.texture_size, on_disk=on_disk)[0]

    found = {row: cast_by(casting_on_captured(scene, row)) for row in lit_captured(scene, prepared.captured)}
    on_mattes = cast_by(casting_on_mattes(scene)) if mattes else None
    if any(one is not None and one.tables is not None for one in (*found.values(), on_mattes)):
        clock.spent["shadows"] = clock.spent.get("shadows", 0.0) + 1000 * (time.perf_counter() - before)
    return found, on_mattes


def neighbourhood(settings: Settings) -> float:
    """Returns how far what a pixel takes in lies from its centre, in pixels."""
    return max(settings.filter_size, settings.eye_dome_radius + 0.5 if settings.use_eye_dome else 0.0)


def with_filter_margin(camera: Camera, filter_size: float) -> Camera:
    """Returns the camera with a window that holds what its pixels take in, but for the pixel around it that whoever
    looks for what is in view adds (core/lod)."""
    more = filter_reach(filter_size) - 1
    if more == 0:
        return camera
    x, y, width, height = camera.window
    return replace(camera, region=(x - more, y - more, width + 2 * more, height + 2 * more))


def with_margin(camera: Camera, radius: float, most: int) -> tuple[Camera, tuple[int, int]]:
    """Returns the camera with a window that also holds the centres of splats that extend into its own window, and the
    corner of its own window in that one.

    `radius`: of the widest splat, in pixels. A border shows the same pixels as the full frame: the margin includes what
    the pyramid gathers from, and its corner is aligned to the pyramid's texels. `most`: pixels across that a texture
    holds at most; the margin is smaller where the window would exceed it.
    """
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
