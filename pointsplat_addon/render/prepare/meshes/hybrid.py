"""Chooses, for one view, which parts of a mesh are drawn as points and which as triangles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ....core.lod.cost import Costs, PrimitiveChoice, choose_primitives
from ....core.numeric.record import record
from ....core.scene.bounds import mesh_centre
from ....core.scene.camera import Camera
from ....core.scene.cloud import PointCloud
from ....core.scene.materials import MaterialTable
from ....core.scene.scene import Geometry
from ....core.surface.appearance import digest, point_cloud
from ....core.surface.density import part_spacings
from ....core.surface.evaluation import evaluate
from ...cache.keys import Key, Kind
from ..hierarchies import points_once_they_have_nodes
from ..layers import MANY_INSTANCES
from ..point_sets import PointSet
from ..separation import is_translucent
from ..view import View
from .parts import DividedMesh, PartSamples, sample_parts
from .points import (
    VERTEX_PIXELS,
    MeasuredMesh,
    Primitives,
    fewest_samples,
    max_samples,
    measured_mesh,
    points_of_instances,
)

NODES_PER_SQUARE = (
    16.0  # of a cut, for each square of the tolerance that a curved surface holds: measured 13 to 16.5 of scans
)
MIN_TRIANGLES = 1 << 12  # triangles of a mesh: fewer are drawn in no time
MAX_EDGE_OVER_SPACING = (
    2.0  # typical edge of the triangles in view, over the spacing that is typically needed: splats of wider ones show
)
NODE_COST = (
    2.0  # what a splat of a cut costs of one that is drawn with all others: it is found, and drawn in short blocks
)


@record
class InstanceChoice:
    """Which parts of one instance are drawn as points and which as polygons in one view."""

    spacing: float  # of its points
    choice: PrimitiveChoice
    whole: bool  # all parts are points, also those out of view, as dense as the nearest part needs
    nodes: bool = False  # its points are nodes of an octree over the fewest samples that cover the mesh

    def as_polygons(self) -> InstanceChoice:
        """Returns this choice with polygons instead of points for all parts in view."""
        c = self.choice
        every = replace(c, points=np.zeros_like(c.points), polygons=c.points | c.polygons, cost=c.triangles_cost)
        return replace(self, choice=every, whole=False, nodes=False)


def choose_for_instance(
    divided: DividedMesh,
    costs: Costs,
    view_from_object: np.ndarray,
    camera: Camera,
    tolerance: float,
    slack: float,
    most: int,
    nodes: bool = False,
) -> InstanceChoice | None:
    """Returns the cheapest way to draw one instance; None if nothing of it is in view.

    `view_from_object`: (4, 4). `tolerance`: pixels. `slack`: see DividedMesh.samples_of_whole_mesh. `most`: how many
    samples the mesh may have. `nodes`: an octree over the fewest samples may be drawn instead.
    """
    needed = part_spacings(divided.parts, view_from_object, camera, tolerance)
    visible = np.isfinite(needed)
    if not visible.any():
        return None
    finest = float(needed.min())
    octaves = np.ldexp(0.5, np.frexp(needed[visible])[1])  # as quantise_spacing has it
    spacing = np.unique(np.minimum(octaves, divided.coarsest))
    worth_sampling = np.array([divided.worth_sampling(costs, s, most) for s in spacing.tolist()])
    samples = np.array([divided.samples(s) for s in spacing.tolist()])
    choice = choose_primitives(
        costs, needed, spacing, np.where(worth_sampling, samples, np.inf), divided.parts.counts, divided.part_area
    )
    every = divided.samples_of_whole_mesh(finest, slack)
    whole = every * (costs.point + costs.prepared)
    if every <= most and whole <= choice.cost:
        choice = replace(choice, points=visible, polygons=np.zeros_like(visible), cost=whole)
        shown = InstanceChoice(divided.octave(finest), choice, whole=True)
    else:
        shown = InstanceChoice(float(spacing[choice.octave]), choice, whole=False)
    edge = np.sqrt(2 * divided.part_area[visible].sum() / divided.parts.counts[visible].sum())
    if (
        nodes
        and len(divided.measures.triangle) >= MIN_TRIANGLES
        and edge <= MAX_EDGE_OVER_SPACING * np.median(needed[visible])
    ):
        cut = np.minimum(NODES_PER_SQUARE * divided.part_area / needed**2, divided.fewest_samples_by_part)[
            visible
        ].sum()
        if (cost := float(cut) * NODE_COST * costs.point) < shown.choice.cost:
            choice = replace(choice, points=visible, polygons=np.zeros_like(visible), cost=cost)
            return InstanceChoice(divided.coarsest, choice, whole=True, nodes=True)
    return shown


def choose_parts(
    view: View, view_from_object: np.ndarray, usable: np.ndarray
) -> dict[int, list[InstanceChoice | None]]:
    """Chooses points or polygons part by part, and returns the choices of each such mesh's instances by geometry row.

    `view_from_object`: (I, 4, 4). `usable`: (I,) bool, instances that can be drawn; the choices are in their order, and
    None for an instance that is out of view. If points would save less than their passes over all pixels cost, all
    parts are polygons.
    """
    found: dict[int, list[InstanceChoice | None]] = {}
    if view.settings.technique == "VISIBILITY":
        return found
    scene, others = view.scene, False
    of_each = scene.instances.of_each(len(scene.geometries), usable)
    for row, (geometry, where) in enumerate(zip(scene.geometries, of_each, strict=True)):
        views = view_from_object[where]
        mesh = geometry.mesh
        if len(views) == 0 or geometry.strands is not None or (mesh is not None and len(mesh.triangles) == 0):
            continue
        measured, points = _mesh_to_choose_for(view, geometry, len(views))
        others |= points
        if measured is None:
            continue
        view.check()
        found[row] = _choose_for_instances(view, measured, views)
    choices = [s.choice for some in found.values() for s in some if s is not None]
    pixels = _costs(view, 1).pixel * float(np.prod(view.camera.window[2:]))
    if not others and sum(c.triangles_cost - c.cost for c in choices) < pixels:
        found = {row: [None if s is None else s.as_polygons() for s in some] for row, some in found.items()}
    return found


def _mesh_to_choose_for(view: View, geometry: Geometry, instances: int) -> tuple[MeasuredMesh | None, bool]:
    """Returns the mesh of a geometry, or None if it is not chosen for part by part; and whether it has opaque points
    in any case."""
    through = is_translucent(geometry, view.scene.materials)
    if geometry.primitive != "AUTO" or geometry.spacing > 0 or instances >= MANY_INSTANCES:
        return None, geometry.primitive != "POLYGONS" and not through
    measured = measured_mesh(view, geometry)
    if measured is None or through:
        return None, geometry.mesh is None and not through
    # Leaves are polygons, which need none of the passes that points do.
    return (None if measured.is_drawable_foliage(instances) else measured), False


def _divided_mesh(measured: MeasuredMesh) -> DividedMesh:
    return measured.store.lookup(
        Key(Kind.DIVIDED_MESH, measured.geometry.key),
        lambda: DividedMesh(measured.mesh, measured.parts, measured.measures),
    )


def _costs(view: View, instances: int) -> Costs:
    """Returns the costs of drawing one sample of a mesh with this many instances, preparation being amortised."""
    if view.interactive:
        return view.costs.again_and_again()
    return view.costs.of_picture(view.samples, instances)


def _choose_for_instances(
    view: View, measured: MeasuredMesh, view_from_object: np.ndarray
) -> list[InstanceChoice | None]:
    """Returns the cheapest choice for each instance, (I, 4, 4) view from object; None for one that is out of view."""
    divided, tolerance = _divided_mesh(measured), view.settings.tolerance
    most = max_samples(tolerance)
    slack = 1.0 if digest(measured.mesh, view.scene.materials) else VERTEX_PIXELS
    costs = _costs(view, len(view_from_object))

    def every(nodes: bool) -> list[InstanceChoice | None]:
        return [
            choose_for_instance(divided, costs, matrix, view.camera, tolerance, slack, most, nodes)
            for matrix in view_from_object
        ]

    if not view.coarse:
        return every(nodes=False)
    # There is too little time for the tolerance in the settings: instances that need few samples use nodes.
    found = every(nodes=True)
    wanted = any(one is not None and one.nodes for one in found)
    return every(nodes=False) if wanted and _points_with_nodes(view, measured) is None else found


def _points_with_nodes(view: View, measured: MeasuredMesh) -> PointSet | None:
    """Returns the fewest samples that cover a mesh, with an octree; None until the octree is built."""
    name = Key(Kind.MESH_POINTS, measured.geometry.key, digest(measured.mesh, view.scene.materials))
    return points_once_they_have_nodes(view, name, lambda: fewest_samples(view, measured))


def primitives_by_part(
    view: View, measured: MeasuredMesh, shown: list[InstanceChoice | None], view_from_object: np.ndarray
) -> Primitives:
    """Returns the points and polygons of instances that were chosen for part by part.

    `shown`: the choice of each instance. `view_from_object`: (I, 4, 4). Point sets of parts come first, by ascending
    spacing, then nodes, then those of instances that are all points.
    """
    divided, table = _divided_mesh(measured), view.scene.materials
    polygons, parts, ranges = [], {}, {}
    by_spacing: dict[float, list[int]] = {}
    for i, one in enumerate(shown):
        if one is None or one.whole:
            continue
        if one.choice.polygons.any():
            polygons.append(i)
            if not one.choice.polygons.all():
                parts[i] = np.flatnonzero(one.choice.polygons)
        if one.choice.points.any():
            by_spacing.setdefault(one.spacing, []).append(i)
    found, costs = [], _costs(view, len(view_from_object))
    for spacing, some in sorted(by_spacing.items()):
        worth_sampling = divided.worth_sampling(costs, spacing, max_samples(view.settings.tolerance))
        points, sampled = _part_points(measured, divided, spacing, worth_sampling, table)
        for i in some:
            one = shown[i]
            if one is not None and len(points) == len(sampled.samples) and not one.choice.points[worth_sampling].all():
                ranges[i] = sampled.ranges(one.choice.points)
        found.append((points, np.array(some)))
    nodes = np.flatnonzero([one is not None and one.nodes for one in shown])
    if len(nodes):
        found.append((fewest_samples(view, measured), nodes))
    whole = np.flatnonzero([one is not None and one.whole and not one.nodes for one in shown])
    if len(whole):
        found += [
            (points, whole[some]) for points, some in points_of_instances(view, measured, view_from_object[whole])
        ]
    return Primitives(found, np.array(polygons, int), parts, ranges)


def _part_points(
    measured: MeasuredMesh, divided: DividedMesh, spacing: float, worth_sampling: np.ndarray, table: MaterialTable
) -> tuple[PointSet, PartSamples]:
    """Returns the samples of all parts that are points in some view, as a point set and part by part.

    `worth_sampling`: (B,) bool, which parts these are. `spacing`: object units.
    """
    mesh, store = measured.mesh, measured.store
    look, first = digest(mesh, table), mesh_centre(mesh)
    # If all parts are sampled, in the mesh's own order, the samples depend on its topology alone.
    same = (
        measured.sampling_key
        if worth_sampling.all() and divided.parts.order is None
        else (measured.geometry.key, worth_sampling.tobytes())
    )
    sampled, origin = store.lookup(
        Key(Kind.SAMPLES_OF_PARTS, same, spacing=spacing),
        lambda: (sample_parts(divided, spacing, worth_sampling), first),
    )
    key = Key(Kind.POINTS_OF_PARTS, (measured.geometry.key, same), look, spacing=spacing)

    def make() -> PointCloud:
        evaluated = evaluate(mesh, sampled.samples, origin)
        return point_cloud(mesh, sampled.samples, evaluated, table)

    family = Key(Kind.SHARED_HIERARCHY, same, look, "PARTS", spacing)
    return PointSet(key, store.lookup(key, make), family=family), sampled
