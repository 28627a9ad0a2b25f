"""Prepares a view: chooses points or polygons, sorts by focus, and cuts hierarchies.

Clouds and hierarchies depend on the geometry, its materials and an octave of spacing; a `Store` keeps them for all
views and frames. Only the cut depends on the view.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from ...core.lod.balls.tree import BallTree
from ...core.lod.cost import DEFAULT, Costs
from ...core.lod.cut import cut_of_all_points
from ...core.numeric.lattice import lattice_for
from ...core.numeric.record import record
from ...core.scene.camera import Camera
from ...core.scene.mesh import Mesh
from ...core.scene.scene import Geometry, Instances, Scene
from ...core.scene.settings import Settings
from ...core.scene.validation import drawable_transforms
from ...core.splat.blur import COARSEST_TOLERANCE, NODE_SIZE, defocus_blur
from ...core.strand.preparation import with_levels
from ...core.strand.segments import Segments, concatenate_segments
from ...core.strand.selection import select
from ..cache.keys import Key, Kind
from ..cache.store import Store
from .captured import CapturedNodes, captured_instances, captured_nodes
from .hierarchies import ball_tree_if_it_pays, with_even_blocks, with_hierarchy_for_defocus, with_hierarchy_if_it_pays
from .layers import cut_layer, with_ball_nodes, with_page_nodes
from .meshes.coarse import coarse_mesh
from .meshes.far import far_nodes
from .meshes.hybrid import InstanceChoice, choose_parts, primitives_by_part
from .meshes.panes import pane_rows
from .meshes.points import (
    Primitives,
    is_chosen_by_buffer,
    measured_mesh,
    points_or_polygons,
    sample_area_function,
    spacing_allowed_by_bounds,
)
from .out_of_focus import FocusSorter, OutOfFocusLayer
from .point_sets import Layer, PointSet, cloud_points, largest_radius, point_counts, set_ball, typical_diameter
from .separation import is_translucent
from .view import View

WIDE_BALL = 2.0  # pixels of radius: means of wider balls that overlap would show


@record
class Prepared(Layer):
    """What one view draws: opaque points (the layer itself), translucent points, spheres, polygons and strands."""

    translucent: Layer
    spheres: Layer  # balls so wide on the screen that each is drawn by itself
    nodes: Layer  # that stand for several balls (core/lod/balls), in the visibility buffer
    polygons: np.ndarray  # (P,) int: instances that are drawn as polygons
    view_from_object: np.ndarray  # (I, 4, 4) float64
    largest: float  # upper bound of a drawn splat's projected radius in pixels
    total: int  # points of all instances, before any cut
    warnings: tuple[str, ...] = ()
    # By instance: the parts (core/surface/density.py) that are drawn as polygons, rising; absent: all.
    parts: dict[int, np.ndarray] = field(default_factory=dict)
    strands: dict[int, Segments] = field(default_factory=dict)  # segments of strands, by geometry row
    captured: tuple[int, ...] = ()  # instances of captured splats, those of one geometry together
    captured_nodes: dict[int, CapturedNodes] = field(default_factory=dict)  # by row of geometries
    out_of_focus: OutOfFocusLayer | None = None  # then all other primitives are those in focus
    widest_translucent: float = math.inf  # as `largest`, of translucent splats
    panes: np.ndarray = field(
        default_factory=lambda: np.empty(0, np.int64)
    )  # (P,): instances drawn as layers of triangles
    coarse: dict[int, Mesh] = field(default_factory=dict)  # by row of geometries, drawn in place of its mesh
    # If `translucent` also holds splats out of focus: by key of its sets, the covered fraction of each splat's ellipse.
    shares: dict[int, np.ndarray | float] = field(default_factory=dict)

    @property
    def all_polygons(self) -> np.ndarray:
        """(P,) int64: instances that are drawn as triangles, opaque or not."""
        return np.concatenate([self.polygons, self.panes]) if len(self.panes) else self.polygons


def prepare(
    scene: Scene,
    camera: Camera,
    settings: Settings,
    samples: int,
    store: Store,
    *,
    interactive: bool = False,
    moving: bool = False,
    check: Callable[[], None] = lambda: None,
    costs: Costs = DEFAULT,
    node: float = NODE_SIZE,
    coarse: bool = False,
    few: bool = False,
) -> Prepared:
    """Chooses, samples and cuts everything that `camera` sees.

    `samples`: how often the result will be drawn. `interactive`: it is drawn many times, the first time at once;
    hierarchies are built on another thread and used once they are ready. `moving`: and finely once nothing moves.
    `check` is called between geometries, and may raise to stop. `costs`: of drawing on the device. `node`: size of
    out-of-focus nodes, see core/splat/blur.py. `coarse`: there is no time for one sample at the tolerance that was
    asked for. `few`: see lattice_for.
    """
    view_from_object, usable = _transforms(scene.instances, camera)
    blur = defocus_blur(camera, node) if settings.dof_method == "SPLAT" else None
    view = View(scene, camera, settings, samples, interactive, moving, store, check, costs, few, blur, coarse)
    focus = None
    if blur is not None:
        focus = FocusSorter(scene, camera, blur, min(settings.tolerance, COARSEST_TOLERANCE), store, view_from_object)
    # Parts of meshes are all points or all polygons where either may be out of focus.
    divided = {} if focus else choose_parts(view, view_from_object, usable)
    strands = _strand_segments(view, view_from_object, usable, focus)
    drawn = _drawn_primitives(view, view_from_object, usable, divided, focus)
    kinds = (drawn.opaque, drawn.translucent, drawn.spheres)
    captured = captured_instances(scene, usable)
    total = sum(int(point_counts(kind.sets)[kind.set_of_instance].sum()) for kind in kinds)
    total += sum(len(scene.geometries[scene.instances.geometry[row]].captured or ()) for row in captured)
    if focus is not None:
        _sort_by_focus(view, focus, drawn)
    largest = largest_radius(drawn.opaque.sets, drawn.opaque.set_of_instance, view_from_object, camera, store)
    opaque, trees = drawn.opaque, _ball_trees(view, drawn, view_from_object)
    others = {key: points for key, points in opaque.sets.items() if key not in trees}
    of_others = np.where(np.isin(opaque.set_of_instance, list(trees)), -1, opaque.set_of_instance)
    layer = cut_layer(view, others, of_others, view_from_object, "SHARP", drawn.ranges)
    layer, nodes = with_ball_nodes(view, layer, trees, opaque.set_of_instance, view_from_object)
    layer, nodes = with_page_nodes(layer, nodes)
    behind = cut_layer(view, drawn.translucent.sets, drawn.translucent.set_of_instance, view_from_object, "ALL", {})
    balls = drawn.spheres
    return Prepared(
        layer.point_sets,
        layer.set_of_instance,
        layer.cut,
        behind,
        Layer(balls.sets, balls.set_of_instance, cut_of_all_points(point_counts(balls.sets), balls.set_of_instance)),
        nodes,
        drawn.polygons,
        view_from_object,
        max(largest, settings.tolerance if layer.cut.nodes or nodes.cut.nodes else 0.0),
        total,
        tuple(dict.fromkeys(view.warnings)),
        drawn.parts,
        strands,
        captured=captured,
        captured_nodes=captured_nodes(view, captured, view_from_object),
        widest_translucent=_widest_translucent(view, behind, view_from_object),
        panes=drawn.panes,
        coarse=drawn.coarse,
        out_of_focus=_out_of_focus(focus, behind),
    )


def _widest_translucent(view: View, behind: Layer, view_from_object: np.ndarray) -> float:
    """Returns an upper bound of the radius of translucent splats, in pixels."""
    if not behind.point_sets:
        return 0.0
    points = largest_radius(behind.point_sets, behind.set_of_instance, view_from_object, view.camera, view.store)
    return max(points, view.settings.tolerance if behind.cut.nodes else 0.0)


def with_coarse_meshes(scene: Scene, prepared: Prepared) -> Scene:
    """Returns a scene with the coarser meshes that a view draws: shadows are theirs, too, for a surface would lie in
    those of another."""
    if not prepared.coarse:
        return scene
    geometries = list(scene.geometries)
    for row, mesh in prepared.coarse.items():
        geometries[row] = replace(geometries[row], key=f"{geometries[row].key} as {mesh.key}", mesh=mesh)
    return replace(scene, geometries=tuple(geometries))


def _transforms(instances: Instances, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Returns the transforms of what the camera sees to its space, (I, 4, 4), zeros of the rest; and which of them can
    be drawn, (I,) bool."""
    seen = slice(None) if instances.seen is None else np.flatnonzero(instances.seen)
    # Memory of zeros that nothing touches costs nothing: of a crowd a view sees little.
    view_from_object, usable = np.zeros((len(instances), 4, 4)), np.zeros(len(instances), bool)
    with np.errstate(all="ignore"):
        view_from_object[seen] = matrices = camera.view_from_world @ instances.world_from_object[seen]
    usable[seen] = drawable_transforms(matrices)
    return view_from_object, usable


@record
class _LayerPoints:
    """Point sets that are drawn in the same way, with the set of each instance."""

    set_of_instance: np.ndarray  # (I,) int: key of sets; -1: none
    sets: dict[int, PointSet] = field(default_factory=dict)


@dataclass(eq=False)
class _DrawnPrimitives:
    """The points and polygons that a view draws, before any cut."""

    opaque: _LayerPoints
    translucent: _LayerPoints
    spheres: _LayerPoints
    polygons: np.ndarray  # (P,) int64: instances
    panes: np.ndarray  # (P,) int64: instances
    # By instance, the parts that are polygons; absent: all.
    parts: dict[int, np.ndarray] = field(default_factory=dict)
    # By instance, first and count of the points that are drawn; absent: all.
    ranges: dict[int, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    coarse: dict[int, Mesh] = field(default_factory=dict)  # see Prepared.coarse


def _drawn_primitives(
    view: View,
    view_from_object: np.ndarray,
    usable: np.ndarray,
    divided: dict[int, list[InstanceChoice | None]],
    focus: FocusSorter | None,
) -> _DrawnPrimitives:
    """Returns the points and polygons of all geometries except strands, with hierarchies where they save time.

    `divided`: by geometry row of meshes that are chosen for part by part, the choice of each instance. `focus`: what
    sorts by focus, if something may be out of it; then translucent triangles become patches as large as their blur
    allows.
    """
    scene, instances = view.scene, view.scene.instances
    by_buffer = view.settings.technique == "VISIBILITY"  # which draws balls of all sizes
    opaque, translucent, spheres = (_LayerPoints(np.full(len(instances), -1)) for _ in range(3))
    polygons = [np.empty(0, np.int64)]
    of_each = instances.of_each(len(scene.geometries), usable)
    panes = pane_rows(view, of_each)
    of_panes = [of_each[row] for row in panes]
    drawn = _DrawnPrimitives(opaque, translucent, spheres, polygons[0], np.concatenate([polygons[0], *of_panes]))
    for row, (geometry, where) in enumerate(zip(scene.geometries, of_each, strict=True)):
        if len(where) == 0 or geometry.strands is not None or row in panes:
            continue
        view.check()
        seen_through = is_translucent(geometry, scene.materials)
        if seen_through and focus is not None and _is_diced(view, geometry, view_from_object[where]):
            assert geometry.mesh is not None
            for instance in where.tolist():
                key = len(scene.geometries) + len(translucent.sets)
                translucent.sets[key] = focus.diced(instance, geometry, geometry.mesh, seen_through=True)
                translucent.set_of_instance[instance] = key
            continue
        found = _primitives(view, geometry, view_from_object[where], divided.get(row))
        polygons.append(where[found.polygons])
        if found.coarse is not None:
            drawn.coarse[row] = found.coarse
        drawn.parts.update((int(where[i]), parts) for i, parts in found.parts.items())
        drawn.ranges.update((int(where[i]), ranges) for i, ranges in found.ranges.items())
        kind = translucent if seen_through else opaque
        for number, (points, rows) in enumerate(found.points):
            if len(points) == 0:
                continue
            some = where[rows]
            if kind is opaque and not by_buffer:
                wide = _instances_of_wide_balls(view, points, view_from_object[some])
                if wide.any():
                    drawn.spheres.sets[row] = points
                    drawn.spheres.set_of_instance[some[wide]] = row
                    some = some[~wide]
            if len(some):
                key = row if number == 0 else len(scene.geometries) + len(kind.sets)
                if not (drawn.parts and any(instance in drawn.parts for instance in some.tolist())):
                    points = with_hierarchy_if_it_pays(view, points, view_from_object[some])
                kind.sets[key] = points
                kind.set_of_instance[some] = key
    drawn.polygons = np.concatenate(polygons)
    return drawn


def _ball_trees(
    view: View, drawn: _DrawnPrimitives, view_from_object: np.ndarray
) -> dict[int, tuple[PointSet, BallTree]]:
    """Returns the opaque sets of balls that have nodes in the visibility buffer, with these, by key."""
    found, geometries = {}, view.scene.geometries
    for key, points in drawn.opaque.sets.items():
        view.check()
        if key < len(geometries) and geometries[key].streamed is not None:
            continue  # its pages are nodes already
        if view.interactive and key < len(geometries) and geometries[key].pixel_radius > 0:
            continue  # the next view would need others
        tree = ball_tree_if_it_pays(view, points, view_from_object[drawn.opaque.set_of_instance == key])
        if tree is not None:
            found[key] = points, tree
    return found


def _primitives(
    view: View, geometry: Geometry, view_from_object: np.ndarray, shown: list[InstanceChoice | None] | None
) -> Primitives:
    """Returns the points and polygons that instances of a geometry, (I, 4, 4) view from object, are drawn as.

    `shown`: the choice of each instance, if the mesh is chosen for part by part.
    """
    none = np.empty(0, np.int64)
    if geometry.cloud is not None:
        points = cloud_points(view, geometry, geometry.cloud)
        if geometry.cells is not None:
            points = with_even_blocks(view, geometry, points, view_from_object)
        return Primitives([(points, np.arange(len(view_from_object)))], none)
    measured = measured_mesh(view, geometry)
    if measured is None:
        return Primitives([], none)
    if shown is not None:
        return primitives_by_part(view, measured, shown, view_from_object)
    if is_chosen_by_buffer(view, geometry):
        points, rest = far_nodes(view, measured, view_from_object)
        return Primitives(points, rest, coarse=coarse_mesh(view, measured, view_from_object[rest]))
    return points_or_polygons(view, measured, view_from_object)


def _is_diced(view: View, geometry: Geometry, view_from_object: np.ndarray) -> bool:
    """Whether instances, (I, 4, 4), of a geometry have triangles that are larger than samples of it would be."""
    measured = measured_mesh(view, geometry)
    if measured is None:
        return False
    return bool(measured.typical_edge > spacing_allowed_by_bounds(view, measured, view_from_object).min())


def _instances_of_wide_balls(view: View, points: PointSet, view_from_object: np.ndarray) -> np.ndarray:
    """Returns (I,) bool: in which instances the typical splat is a ball that is wide on the screen."""
    if points.cloud.normal is not None or points.cloud.radii is None:
        return np.zeros(len(view_from_object), bool)
    return typical_diameter(points, view_from_object, view.camera, view.store) > 2 * WIDE_BALL


def _strand_segments(
    view: View, view_from_object: np.ndarray, usable: np.ndarray, focus: FocusSorter | None
) -> dict[int, Segments]:
    """Returns the strand segments that a view draws, by geometry row; adds those out of focus to `focus`."""
    found: dict[int, Segments] = {}
    of_each = view.scene.instances.of_each(len(view.scene.geometries), usable)
    for row, (geometry, where) in enumerate(zip(view.scene.geometries, of_each, strict=True)):
        strands = geometry.strands
        if strands is None or len(where) == 0:
            continue
        view.check()
        levels = view.store.lookup(Key(Kind.CLEAN_STRANDS, geometry.key), lambda strands=strands: with_levels(strands))
        if len(levels) == 0:
            continue
        tolerance = view.settings.tolerance
        lattice = lattice_for(view.samples, view.few) if view.settings.technique == "VISIBILITY" else None
        parts = [select(levels, view_from_object[i], i, view.camera, tolerance, lattice) for i in where.tolist()]
        parts = [part for part in parts if len(part)]
        if parts:
            found[row] = concatenate_segments(parts)
            if focus is not None:
                found[row] = focus.add_strands(geometry, strands, levels, found[row])
                found = {row: segments for row, segments in found.items() if len(segments)}
    return found


def _sort_by_focus(view: View, focus: FocusSorter, drawn: _DrawnPrimitives) -> None:
    """Adds to `focus` all opaque primitives that may be out of focus, and removes from `drawn` all that cannot be in
    focus."""
    geometries, geometry_of = view.scene.geometries, view.scene.instances.geometry
    by_buffer = view.settings.technique == "VISIBILITY"  # which draws the points in focus without nodes
    for kind in (drawn.opaque, drawn.spheres):
        for key, points in list(kind.sets.items()):
            where = np.flatnonzero(kind.set_of_instance == key)
            middle, far, radius = set_ball(points, view.store)
            inside, outside = focus.in_and_out_of_focus(where, middle, far + radius)
            wide = outside.copy()
            wide[outside] = _instances_of_wide_balls(view, points, focus.view_from_object[where[outside]])
            if wide.any():
                focus.add_balls(where[wide], points)
            if (outside & ~wide).any():
                area = sample_area_function(view, geometries[geometry_of[where[0]]], points)
                nodes = with_hierarchy_for_defocus(view, points, always=area is None)
                focus.add_points(where[outside & ~wide], nodes, area)
                if not by_buffer:
                    kind.sets[key] = nodes
            kind.set_of_instance[where[~inside]] = -1
            if not inside.any():
                del kind.sets[key]
    # Samples of translucent meshes, whose triangles are small, are as many for a wide blur as for none.
    for key, points in drawn.translucent.sets.items():
        where = np.flatnonzero(drawn.translucent.set_of_instance == key)
        middle, far, _ = set_ball(points, view.store)
        if points.cloud.opacity is not None and points.cloud.span is None:
            _, outside = focus.in_and_out_of_focus(where, middle, far)
            if outside.any():
                drawn.translucent.sets[key] = with_hierarchy_for_defocus(view, points, always=False)
    kept = [np.empty(0, np.int64)]
    for row in np.unique(geometry_of[drawn.polygons]).tolist():
        where, measured = drawn.polygons[geometry_of[drawn.polygons] == row], measured_mesh(view, geometries[row])
        assert measured is not None
        inside, outside = focus.in_and_out_of_focus(where, *measured.ball)
        view.check()
        focus.add_mesh(where[outside], measured.geometry, measured.mesh)
        kept.append(where[inside])
    drawn.polygons = np.concatenate(kept)


def _out_of_focus(focus: FocusSorter | None, behind: Layer) -> OutOfFocusLayer | None:
    """Returns what is out of focus; None if there is nothing out of focus and nothing translucent."""
    found = focus.layer() if focus is not None else None
    return found if found is not None and (found.cut.splats or behind.cut.splats) else None
