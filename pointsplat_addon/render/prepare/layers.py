"""Cuts the hierarchies of a layer's point sets for one view, for each instance or for many instances together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...core.lens.thin_lens import uses_lens_samples
from ...core.lod.balls.cut import cut_balls
from ...core.lod.balls.tree import BallTree
from ...core.lod.criteria import transition_band
from ...core.lod.cut import Cut, cut_of_all_points, select_cut
from ...core.lod.instances import (
    ALL_POINTS,
    NOTHING,
    OWN_CUT,
    choose_levels,
    cut_from_levels,
    joined_cuts,
    scaled_about,
    visible_instances,
)
from ...core.lod.levels import Levels, make_levels
from ...core.lod.node_table import NodeTable, node_table
from ...core.numeric.lattice import MANY, lattice_for
from ...core.scene.scene import Geometry
from ..cache.keys import Key, Kind
from ..cache.store import Store
from .point_sets import Layer, PointSet, point_counts, set_ball
from .view import View

MOST_PRIMITIVES = 1 << 26  # of all instances, that the visibility buffer draws
NOTHING_DRAWN = Cut(np.empty(0, np.int32), np.empty(0, np.int64), np.empty(0, np.int64))
MANY_INSTANCES = 16  # of one geometry: from so many on, they share samples and cuts


def cut_layer(
    view: View,
    point_sets: dict[int, PointSet],
    set_of_instance: np.ndarray,
    view_from_object: np.ndarray,
    wanted: str,
    ranges: dict[int, tuple[np.ndarray, np.ndarray]],
) -> Layer:
    """Returns point sets with the cut that a view draws of them.

    Many instances of one set share cuts, which become sets of their own; instances out of view are left out.
    `set_of_instance` (I,) and `view_from_object` (I, 4, 4) are changed in place: matrices of instances that share
    coarser nodes are enlarged. `wanted`: see core/lod/cut.py, select_cut. `ranges`: by instance, first and count (R,)
    of the points to draw, if not all.
    """
    tolerance, camera = view.settings.tolerance, view.camera
    sets, shared = dict(point_sets), []
    own = set_of_instance.copy()
    for instance, (first, count) in ranges.items():
        row = int(own[instance])
        if row >= 0 and sets[row].hierarchy is None:
            own[instance] = -1
            at = np.full(len(first), instance, np.int32)
            shared.append(Cut(at, first, count, points=int(count.sum())))
    for key, points in point_sets.items():
        where = np.flatnonzero(set_of_instance == key)
        if len(where) < MANY_INSTANCES or view.blur is not None:
            continue
        views, levels = view_from_object[where], _levels(points, view.store)
        if levels is None:
            middle, far, radius = set_ball(points, view.store)
            gone = where[~visible_instances(views, middle, far + radius, camera)]
            set_of_instance[gone] = own[gone] = -1
            continue
        choice = choose_levels(levels, views, where, camera, tolerance, band=transition_band(tolerance))
        own[where[choice.level != OWN_CUT]] = -1
        set_of_instance[where[choice.level == NOTHING]] = -1
        every = where[choice.level == ALL_POINTS]
        shared.append(cut_of_all_points(np.array([len(points.cloud)]), np.zeros(len(every), int)).renumbered(every))
        some = np.flatnonzero(choice.level >= 0)
        if len(some):
            at = len(view.scene.geometries) + max(sets) + 1
            sets[at] = PointSet(Key(Kind.LEVEL_NODES, points.key), levels.drawn)
            set_of_instance[where[some]] = at
            view_from_object[where[some]] = scaled_about(views[some], levels.center, choice.scale[some])
            shared.append(cut_from_levels(levels, where[some], choice.level[some]))
        if not (set_of_instance == key).any():
            del sets[key]
    rest = {key: points for key, points in point_sets.items() if (own == key).any()}
    return Layer(sets, set_of_instance, joined_cuts([_cut(view, rest, own, view_from_object, wanted), *shared]))


def with_ball_nodes(
    view: View,
    layer: Layer,
    sets: dict[int, tuple[PointSet, BallTree]],
    set_of_instance: np.ndarray,
    view_from_object: np.ndarray,
) -> tuple[Layer, Layer]:
    """Returns the layer with the balls that a view draws of some more sets, and the nodes that it draws for the rest of
    them.

    `sets`: by key, with their trees; `set_of_instance` (I,): their keys, among others; `view_from_object` (I, 4, 4).
    Where too many are left to draw, the nodes are coarser.
    """
    nodes = Layer({}, np.full(len(set_of_instance), -1), NOTHING_DRAWN)
    if not sets:
        return layer, nodes
    # Few sub-samples show less than many of what nodes leave out, up to nodes of two pixels.
    spacing = lattice_for(view.samples, view.few).spacing
    tolerance = finest = view.settings.tolerance * min(spacing / MANY.spacing, 2.0)
    where = {key: np.flatnonzero(set_of_instance == key) for key in sets}
    while True:
        cuts = {
            key: cut_balls(tree, view_from_object[where[key]], view.camera, tolerance)
            for key, (_, tree) in sets.items()
        }
        if sum(cut.nodes.splats + cut.balls.splats for cut in cuts.values()) <= MOST_PRIMITIVES:
            break
        tolerance *= 2
    if tolerance > finest:
        view.warnings.append(f"so many points are in view that nodes are {tolerance:g} pixels wide")
    balls = Layer(dict(layer.point_sets), layer.set_of_instance.copy(), layer.cut)
    drawn: dict[str, list[Cut]] = {"nodes": [], "balls": [layer.cut]}
    for key, (points, tree) in sets.items():
        as_nodes = PointSet(Key(Kind.BALL_NODES, points.key), tree.nodes, shape=tree.shape, balls=points)
        as_balls = PointSet(Key(Kind.BALL_TREE, points.key), tree.cloud)
        for name, to, shown in (("nodes", nodes, as_nodes), ("balls", balls, as_balls)):
            cut = getattr(cuts[key], name).renumbered(where[key])
            if cut.splats:
                drawn[name].append(cut)
                to.point_sets[key] = shown
                to.set_of_instance[cut.instance] = key
    found = replace(nodes, cut=joined_cuts(drawn["nodes"])) if drawn["nodes"] else nodes
    return replace(balls, cut=joined_cuts(drawn["balls"])), found


def with_page_nodes(layer: Layer, nodes: Layer) -> tuple[Layer, Layer]:
    """Returns the layer without the nodes that pages of scans hold, and the nodes of a view with them.

    Techniques other than the visibility buffer draw them as the balls that the layer has in their place.
    """
    mine = [key for key, points in layer.point_sets.items() if points.shape is not None]
    if not mine:
        return layer, nodes
    moved = np.isin(layer.set_of_instance[layer.cut.instance], mine)
    cuts = [
        replace(
            layer.cut, instance=layer.cut.instance[which], first=layer.cut.first[which], count=layer.cut.count[which],
            nodes=0, points=int(layer.cut.count[which].sum()),
        )
        for which in (~moved, moved)
    ]  # fmt: skip
    rest = Layer(
        {key: points for key, points in layer.point_sets.items() if key not in mine},
        np.where(np.isin(layer.set_of_instance, mine), -1, layer.set_of_instance),
        cuts[0],
    )
    sets, of_instance = dict(nodes.point_sets), nodes.set_of_instance.copy()
    for key in mine:
        points = layer.point_sets[key]
        bare = replace(points.cloud, share=None)
        sets[key] = replace(points, key=Key(Kind.BALL_NODES, points.key), cloud=bare, balls=points)
        of_instance[layer.set_of_instance == key] = key
    drawn = replace(cuts[1], nodes=cuts[1].points, points=0)
    return rest, Layer(sets, of_instance, joined_cuts([nodes.cut, drawn]))


def _levels(points: PointSet, store: Store) -> Levels | None:
    hierarchy = points.hierarchy
    if hierarchy is None:
        return None
    return store.lookup(Key(Kind.LEVELS, points.key), lambda: make_levels(hierarchy))


def _cut(
    view: View,
    point_sets: dict[int, PointSet],
    set_of_instance: np.ndarray,
    view_from_object: np.ndarray,
    wanted: str,
) -> Cut:
    """Returns the cut of each instance by itself."""
    if not any(points.hierarchy for points in point_sets.values()):
        return cut_of_all_points(point_counts(point_sets), set_of_instance)
    key = Key(Kind.FOREST, tuple((row, points.key) for row, points in point_sets.items()))
    trees: NodeTable = view.store.lookup(
        key, lambda: node_table({row: p.hierarchy or p.cloud for row, p in point_sets.items()})
    )
    scene, tolerance = view.scene, view.settings.tolerance
    cull = np.array(
        [bool(scene.materials.cull.take(_material_rows(g), mode="clip").all()) for g in scene.geometries], bool
    )
    # What turns its back to the middle of the lens may face its rim.
    cull = cull[scene.instances.geometry] & (not uses_lens_samples(view.camera, view.settings))
    return select_cut(
        trees,
        set_of_instance,
        view_from_object,
        view.camera,
        tolerance,
        cull,
        band=transition_band(tolerance),
        blur=view.blur,
        wanted=wanted,
    )


def _material_rows(geometry: Geometry) -> list[int]:
    """Returns the rows of the material table that a geometry uses."""
    if geometry.mesh is not None:
        return list(geometry.mesh.materials)
    return [0] if geometry.cloud is None else geometry.cloud.material_rows().tolist()
