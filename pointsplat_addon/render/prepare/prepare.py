"""What of a scene is drawn as points and what as polygons, what of it is blurred, and which cut of it: numpy only.

Clouds and hierarchies depend on the geometry, its materials and an octave of spacing; they are kept in a `Store` that
all views and frames share. Only the cut depends on the view.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ...core.lod.cost import DEFAULT, Costs
from ...core.lod.cut import cut_of_all_points
from ...core.scene.camera import Camera
from ...core.scene.scene import Geometry, Scene
from ...core.scene.settings import Settings
from ...core.scene.validation import drawable_transforms
from ...core.splat.blur import COARSEST_TOLERANCE, NODE_SIZE, defocus_blur
from ...core.strand.preparation import with_levels
from ...core.strand.segments import Segments, concatenate_segments
from ...core.strand.selection import select
from ..cache.keys import Key, Kind
from ..cache.store import Store
from .hierarchies import with_hierarchy_for_defocus, with_hierarchy_if_it_pays
from .hybrid import InstanceChoice, choose_parts, primitives_by_part
from .layers import cut_layer
from .meshes import Primitives, measured_mesh, points_or_polygons, sample_area_function
from .out_of_focus import FocusSorter, OutOfFocusLayer
from .point_sets import Layer, PointSet, cloud_points, largest_radius, point_counts, set_ball, typical_diameter
from .separation import is_translucent
from .view import View

WIDE_BALL = 2.0  # pixels of radius: means of wider balls that overlap would show


@dataclass(frozen=True, eq=False)
class Prepared(Layer):
    """What one view draws: opaque points, polygons, and translucent points."""

    translucent: Layer
    spheres: Layer  # balls so wide on the screen that each is drawn by itself
    polygons: np.ndarray  # (P,) int: instances that are drawn as polygons
    view_from_object: np.ndarray  # (I, 4, 4) float64
    largest: float  # upper bound of a drawn splat's projected radius in pixels
    total: int  # points of all instances, before any cut
    warnings: tuple[str, ...] = ()
    # By instance: the parts (core/surface/density.py) that are drawn as polygons, rising; absent: all.
    parts: dict[int, np.ndarray] = field(default_factory=dict)
    lines: dict[int, Segments] = field(default_factory=dict)  # segments of strands, by geometry row
    blurred: OutOfFocusLayer | None = None  # what is out of focus; all else then holds what is not
    # Where `translucent` holds what is out of focus, too, of its sets what of its ellipse each splat covers.
    shares: dict[int, np.ndarray | float] = field(default_factory=dict)


def prepare(
    scene: Scene,
    camera: Camera,
    settings: Settings,
    samples: int,
    store: Store,
    *,
    interactive: bool = False,
    check: Callable[[], None] = lambda: None,
    costs: Costs = DEFAULT,
    node: float = NODE_SIZE,
    coarse: bool = False,
) -> Prepared:
    """Choose, sample and cut everything that `camera` sees.

    `samples` tells how often the result will be drawn. `interactive`: again and again, and at once; what takes long is
    then built on another thread and used when it is there. `check` is called between geometries, and may raise to stop.
    `costs`: what drawing costs on the device. `node`: of what is out of focus, see core/lens/kernel.py.
    `coarse`: there is no time for one sample at the tolerance that was asked for.
    """
    with np.errstate(all="ignore"):
        view_from_object = camera.view_from_world @ scene.instances.world_from_object
    usable = drawable_transforms(view_from_object)
    blur = defocus_blur(camera, node) if settings.dof_method == "SPLAT" else None
    view = View(scene, camera, settings, samples, interactive, store, check, costs, blur, coarse)
    focus = None
    if blur is not None:
        focus = FocusSorter(scene, camera, blur, min(settings.tolerance, COARSEST_TOLERANCE), store, view_from_object)
    # Parts of meshes are all points or all polygons where either may be out of focus.
    divided = {} if focus else choose_parts(view, view_from_object, usable)
    lines = _strand_segments(view, view_from_object, usable, focus)
    drawn = _drawn_primitives(view, view_from_object, usable, divided)
    kinds = (drawn.opaque, drawn.translucent, drawn.spheres)
    total = sum(int(point_counts(kind.sets)[kind.of_instance].sum()) for kind in kinds)
    if focus is not None:
        _sort_by_focus(view, focus, drawn)
    largest = largest_radius(drawn.opaque.sets, drawn.opaque.of_instance, view_from_object, camera, store)
    layer = cut_layer(view, drawn.opaque.sets, drawn.opaque.of_instance, view_from_object, "SHARP", drawn.ranges)
    behind = cut_layer(view, drawn.translucent.sets, drawn.translucent.of_instance, view_from_object, "ALL", {})
    balls = drawn.spheres
    return Prepared(
        layer.point_sets,
        layer.set_of_instance,
        layer.cut,
        behind,
        Layer(balls.sets, balls.of_instance, cut_of_all_points(point_counts(balls.sets), balls.of_instance)),
        drawn.polygons,
        view_from_object,
        max(largest, settings.tolerance if layer.cut.nodes else 0.0),
        total,
        tuple(dict.fromkeys(view.warnings)),
        drawn.parts,
        lines,
        _out_of_focus(focus, behind),
    )


@dataclass(frozen=True, eq=False)
class _LayerPoints:
    """Point sets that are drawn alike."""

    of_instance: np.ndarray  # (I,) int: key of sets; -1: none
    sets: dict[int, PointSet] = field(default_factory=dict)


@dataclass(eq=False)
class _DrawnPrimitives:
    """What a view draws, before any cut."""

    opaque: _LayerPoints
    translucent: _LayerPoints
    spheres: _LayerPoints
    polygons: np.ndarray  # (P,) int64: instances
    parts: dict[int, np.ndarray] = field(default_factory=dict)  # that are polygons, by instance; absent: all
    ranges: dict[int, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)  # of points, the same


def _drawn_primitives(
    view: View, view_from_object: np.ndarray, usable: np.ndarray, divided: dict[int, list[InstanceChoice | None]]
) -> _DrawnPrimitives:
    """Points and polygons of all geometries but strands, with hierarchies where these pay. `divided`: by row of those
    meshes that are chosen for part by part, the choices."""
    scene, instances = view.scene, view.scene.instances
    opaque, translucent, spheres = (_LayerPoints(np.full(len(instances), -1)) for _ in range(3))
    polygons = [np.empty(0, np.int64)]
    drawn = _DrawnPrimitives(opaque, translucent, spheres, polygons[0])
    for row, geometry in enumerate(scene.geometries):
        where = np.flatnonzero(usable & (instances.geometry == row))
        if len(where) == 0 or geometry.strands is not None:
            continue
        view.check()
        found = _primitives(view, geometry, view_from_object[where], divided.get(row))
        polygons.append(where[found.polygons])
        drawn.parts.update((int(where[i]), parts) for i, parts in found.parts.items())
        drawn.ranges.update((int(where[i]), ranges) for i, ranges in found.ranges.items())
        kind = drawn.translucent if is_translucent(geometry, scene.materials) else drawn.opaque
        for number, (points, rows) in enumerate(found.points):
            if len(points) == 0:
                continue
            some = where[rows]
            if kind is drawn.opaque:
                wide = _instances_of_wide_balls(view, points, view_from_object[some])
                if wide.any():
                    drawn.spheres.sets[row] = points
                    drawn.spheres.of_instance[some[wide]] = row
                    some = some[~wide]
            if len(some):
                key = row if number == 0 else len(scene.geometries) + len(kind.sets)
                if not any(instance in drawn.parts for instance in some.tolist()):
                    points = with_hierarchy_if_it_pays(view, points, view_from_object[some])
                kind.sets[key] = points
                kind.of_instance[some] = key
    drawn.polygons = np.concatenate(polygons)
    return drawn


def _primitives(
    view: View, geometry: Geometry, view_from_object: np.ndarray, shown: list[InstanceChoice | None] | None
) -> Primitives:
    """What instances (I, 4, 4) of a geometry are drawn as. `shown`: the choices where it is chosen for part by part."""
    none = np.empty(0, np.int64)
    if geometry.cloud is not None:
        every = np.arange(len(view_from_object))
        return Primitives([(cloud_points(view, geometry, geometry.cloud), every)], none)
    of = measured_mesh(view, geometry)
    if of is None:
        return Primitives([], none)
    return (
        points_or_polygons(view, of, view_from_object)
        if shown is None
        else primitives_by_part(view, of, shown, view_from_object)
    )


def _instances_of_wide_balls(view: View, points: PointSet, view_from_object: np.ndarray) -> np.ndarray:
    """(I,) bool: instances whose typical splat is a ball that is wide on the screen."""
    if points.cloud.normal is not None or points.cloud.radii is None:
        return np.zeros(len(view_from_object), bool)
    return typical_diameter(points, view_from_object, view.camera, view.store) > 2 * WIDE_BALL


def _strand_segments(
    view: View, view_from_object: np.ndarray, usable: np.ndarray, focus: FocusSorter | None
) -> dict[int, Segments]:
    """The segments of strands that this view draws, by geometry row; what is out of focus goes to `focus`."""
    found: dict[int, Segments] = {}
    for row, geometry in enumerate(view.scene.geometries):
        lines = geometry.strands
        where = np.flatnonzero(usable & (view.scene.instances.geometry == row))
        if lines is None or len(where) == 0:
            continue
        view.check()
        strands = view.store.lookup(Key(Kind.CLEAN_STRANDS, geometry.key), lambda lines=lines: with_levels(lines))
        if len(strands) == 0:
            continue
        tolerance = view.settings.tolerance
        parts = [select(strands, view_from_object[i], i, view.camera, tolerance) for i in where.tolist()]
        parts = [part for part in parts if len(part)]
        if parts:
            found[row] = concatenate_segments(parts)
            if focus is not None:
                found[row] = focus.add_lines(geometry, lines, strands, found[row])
                found = {row: segments for row, segments in found.items() if len(segments)}
    return found


def _sort_by_focus(view: View, focus: FocusSorter, drawn: _DrawnPrimitives) -> None:
    """Gives `focus` what may be out of focus of all that is opaque, and takes what is so as a whole out of `drawn`."""
    geometries, geometry_of = view.scene.geometries, view.scene.instances.geometry
    for kind in (drawn.opaque, drawn.spheres):
        for key, points in list(kind.sets.items()):
            where = np.flatnonzero(kind.of_instance == key)
            middle, far, radius = set_ball(points, view.store)
            inside, outside = focus.reaches(where, middle, far + radius)
            if outside.any() and kind is drawn.spheres:
                focus.add_balls(where[outside], points)
            elif outside.any():
                area = sample_area_function(view, geometries[geometry_of[where[0]]], points)
                kind.sets[key] = points = with_hierarchy_for_defocus(view, points, always=area is None)
                focus.add_points(where[outside], points, area)
            kind.of_instance[where[~inside]] = -1
            if not inside.any():
                del kind.sets[key]
    kept = [np.empty(0, np.int64)]
    for row in np.unique(geometry_of[drawn.polygons]).tolist():
        where, of = drawn.polygons[geometry_of[drawn.polygons] == row], measured_mesh(view, geometries[row])
        assert of is not None
        inside, outside = focus.reaches(where, *of.ball)
        view.check()
        focus.add_mesh(where[outside], of.geometry, of.mesh)
        kept.append(where[inside])
    drawn.polygons = np.concatenate(kept)


def _out_of_focus(focus: FocusSorter | None, behind: Layer) -> OutOfFocusLayer | None:
    """What is out of focus, if anything is, or what is translucent may be."""
    found = focus.layer() if focus is not None else None
    return found if found is not None and (found.cut.splats or behind.cut.splats) else None
