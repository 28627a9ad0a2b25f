"""Captured splats of a view: which instances are drawn, and which of them by nodes that stand for many splats."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...core.lod.captured.cut import CapturedCut, cut_captured
from ...core.lod.captured.gain import splats_a_pixel
from ...core.lod.captured.tree import CapturedTree, build_captured_tree
from ...core.numeric.record import record
from ...core.scene.scene import Geometry, Scene
from ...core.splat.captured import bounds_of_scales
from ..cache.keys import Key, Kind
from .view import View

MIN_SPLATS = 1 << 15  # fewer are drawn as soon as they are cut
# Small ones, of which nodes are drawn: a pixel shows four cells of each surface, and cells hold four splats and more.
SPLATS_PER_PIXEL = 100.0
BUILD_COST = 3  # building costs about as much as drawing the splats this many times, at most
WORTHWHILE = 0.5  # of the splats: a cut of more is not drawn
# Pixels of tolerance up to which pictures that stand still show what the formula shows of all splats. Nodes cannot:
# where a pixel shows hundreds of splats, the first few of these decide what it shows (docs/notes/splats.md).
EXACT = 1.0
MANY_SPLATS = 1 << 22  # of all instances, in dense pixels: more would take seconds and gigabytes


@record
class CapturedNodes:
    """The instances of one geometry that are drawn by nodes."""

    tree: CapturedTree
    cuts: dict[int, CapturedCut]  # by instance


def captured_instances(scene: Scene, usable: np.ndarray) -> tuple[int, ...]:
    """Returns the instances of captured splats, (I,) bool of which may be drawn, those of one geometry together."""
    of_each = scene.instances.of_each(len(scene.geometries), usable)
    shown = (
        rows.tolist()
        for geometry, rows in zip(scene.geometries, of_each, strict=True)
        if geometry.captured is not None and len(geometry.captured)
    )
    return tuple(row for rows in shown for row in rows)


def lit_captured(scene: Scene, instances: tuple[int, ...]) -> tuple[int, ...]:
    """Returns the rows of the geometries of these instances whose splats light changes."""
    rows = dict.fromkeys(scene.instances.geometry[list(instances)].tolist())
    return tuple(row for row in rows if scene.geometries[row].lighting != "CAPTURED")


def casting_on_captured(scene: Scene, row: int) -> Scene:
    """Returns a scene whose shadows are those that fall on the captured splats of a geometry: captured light has those
    of the capture itself. Mattes stand for captured surfaces."""
    instances = scene.instances
    own = scene.geometries[row].lighting == "SHADOWED"
    return casting_alone(scene, instances.geometry != row if own else np.ones(len(instances), bool))


def casting_alone(scene: Scene, which: np.ndarray) -> Scene:
    """Returns a scene in which of some instances, (I,) bool, those cast shadows that did, and are no mattes."""
    instances = scene.instances
    casts = which if instances.casts is None else which & instances.casts.astype(bool)
    casts = casts if instances.matte is None else casts & ~instances.matte
    return replace(scene, instances=replace(instances, casts=casts))


def captured_nodes(view: View, instances: tuple[int, ...], view_from_object: np.ndarray) -> dict[int, CapturedNodes]:
    """Returns, by row of geometries, what is drawn by nodes: instances that show many splats in each pixel, where
    pictures are to be quick rather than exact.

    In an interactive view nodes are built on another thread, and all splats are drawn until they are there. In other
    views they are built where they are wanted a second time, or for many instances: building takes as long as
    drawing all splats one to two and a half times.
    """
    quick = view.moving or view.settings.tolerance > EXACT
    splats_of = {i: view.scene.geometries[view.scene.instances.geometry[i]].captured for i in instances}
    if not quick and sum(len(splats or ()) for splats in splats_of.values()) <= MANY_SPLATS:
        return {}
    dense: dict[int, dict[int, np.ndarray]] = {}
    for i in instances:
        row = int(view.scene.instances.geometry[i])
        matrix = _where_dense(view, view.scene.geometries[row], view_from_object[i])
        if matrix is not None:
            dense.setdefault(row, {})[i] = matrix
    if not quick and sum(len(splats_of[i] or ()) for views in dense.values() for i in views) <= MANY_SPLATS:
        return {}
    found = {row: _nodes_of(view, view.scene.geometries[row], views) for row, views in dense.items()}
    return {row: nodes for row, nodes in found.items() if nodes is not None}


def _where_dense(view: View, geometry: Geometry, view_from_object: np.ndarray) -> np.ndarray | None:
    """(4, 4): view from the splats' origin, of an instance that shows many splats in each pixel; None: it does not."""
    splats = geometry.captured
    assert splats is not None
    if len(splats) < MIN_SPLATS:
        return None
    largest = view.store.lookup(Key(Kind.LARGEST_SCALES, geometry.key), lambda: bounds_of_scales(splats))
    matrix = view_from_splats(view_from_object, splats.origin)
    many = splats_a_pixel(splats, largest, matrix, view.camera, view.settings.tolerance) > SPLATS_PER_PIXEL
    return matrix if many else None


def _nodes_of(view: View, geometry: Geometry, dense: dict[int, np.ndarray]) -> CapturedNodes | None:
    """dense: of some instances, (4, 4) float64 that take the splats to the view."""
    splats, store, tolerance = geometry.captured, view.store, view.settings.tolerance
    assert splats is not None
    view.check()
    trained = view.settings.captured_blending == "TRAINED"
    key, asked = (Key(kind, geometry.key, other=trained) for kind in (Kind.CAPTURED_TREE, Kind.CAPTURED_TREE_ASKED_FOR))
    if view.interactive and key not in store:
        store.make_later(key, lambda: build_captured_tree(splats, trained))
        return None
    if key not in store and asked not in store and len(dense) < BUILD_COST:
        store.lookup(asked, tuple)
        return None
    tree = store.lookup(key, lambda: build_captured_tree(splats, trained))
    cuts = {i: cut_captured(tree, matrix, view.camera, tolerance) for i, matrix in dense.items()}
    cuts = {i: cut for i, cut in cuts.items() if len(cut) <= WORTHWHILE * len(splats)}
    return CapturedNodes(tree, cuts) if cuts else None


def view_from_splats(view_from_object: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """(4, 4) float64 that takes positions relative to the splats' origin to view space."""
    view = view_from_object.copy()
    view[:3, 3] += view[:3, :3] @ origin
    return view


def count_captured(scene: Scene, instances: tuple[int, ...], nodes: dict[int, CapturedNodes]) -> int:
    """Returns how many splats and nodes all instances draw."""
    total = 0
    for instance in instances:
        row = int(scene.instances.geometry[instance])
        splats = scene.geometries[row].captured
        cut = nodes[row].cuts.get(instance) if row in nodes else None
        total += len(splats or ()) if cut is None else len(cut)
    return total
