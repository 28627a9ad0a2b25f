"""Builds octrees of point sets where they pay for themselves, at once or on another thread."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ...core.lod.hierarchy import Hierarchy, recolor, refit
from ...core.scene.materials import MaterialTable
from ..cache.keys import Key, Kind
from ..cache.store import Store
from .layers import MANY_INSTANCES
from .point_sets import PointSet, typical_diameter
from .view import View

BUILD_COST = 80  # building costs about as much as drawing the points this many times
BLENDED_COST = 10  # times what a small splat costs in image space, it costs by EWA, where it covers more than its pixel
SMALL_SPLAT = 0.25  # of the tolerance: where typical splats are smaller, most of a cloud can be left out
# The same where instances are many, for finding what they draw costs nothing for each splat, and by EWA.
SMALL_SPLAT_SHARED = 0.5
MIN_POINTS_FOR_DEFOCUS = 1 << 12  # blurred points without nodes cost less than nodes do
MAX_POINTS_WITHOUT_HIERARCHY = 1 << 24  # splats of all instances together: what draws more waits for its hierarchy


def with_hierarchy_if_it_pays(view: View, points: PointSet, view_from_object: np.ndarray) -> PointSet:
    """The points of instances (I, 4, 4), with an octree where it is there, or can leave out most of them often enough
    to pay for itself. In an interactive view it is built on another thread, where so many points can be drawn."""
    plain, points, store = points, _with_material_constants(points, view.scene.materials, view.store), view.store
    key = Key(Kind.HIERARCHY, points.key)
    if key not in store:
        if not _pays(view, plain, view_from_object):
            return plain
        bare = len(plain.cloud) * len(view_from_object)
        if (
            view.interactive
            and (points.family is None or points.family not in store)
            and bare <= MAX_POINTS_WITHOUT_HIERARCHY
        ):
            store.make_later(key, lambda: _hierarchy(points, store))
            return plain
    return _with_hierarchy(points, store)


def points_once_they_have_nodes(view: View, name: Key, make: Callable[[], PointSet]) -> PointSet | None:
    """Points called `name`, once their octree is there. In an interactive view it is begun, on another thread, at the
    second time of asking: what changes from picture to picture would be gone when it is built."""
    store, known, asked = view.store, Key(Kind.NODES, name), Key(Kind.NODES_ASKED_FOR, name)

    def build() -> Key:
        return _with_hierarchy(_with_material_constants(make(), view.scene.materials, store), store).key

    if known in store:
        key = store.lookup(known, build)
        if key in store:
            return make()
        if view.interactive:  # there was no room for it
            store.make_later(
                key, lambda: _hierarchy(_with_material_constants(make(), view.scene.materials, store), store)
            )
    elif view.interactive and asked in store:
        store.make_later(known, build)
    elif view.interactive:
        store.lookup(asked, tuple)
    return None


def with_hierarchy_for_defocus(view: View, points: PointSet, always: bool) -> PointSet:
    """Points with a hierarchy, where they are so many that blurred ones are worth leaving out, or `always`."""
    if points.hierarchy is not None or (len(points.cloud) < MIN_POINTS_FOR_DEFOCUS and not always):
        return points
    return _with_hierarchy(_with_material_constants(points, view.scene.materials, view.store), view.store)


def _pays(view: View, points: PointSet, view_from_object: np.ndarray) -> bool:
    """Whether enough instances show this set's splats so small that a cut leaves most of them out."""
    blended = view.settings.technique in ("EWA", "PAINTER")
    limit = SMALL_SPLAT if len(view_from_object) < MANY_INSTANCES and not blended else SMALL_SPLAT_SHARED
    diameter = typical_diameter(points, view_from_object, view.camera, view.store)
    small = np.count_nonzero(diameter < limit * view.settings.tolerance)
    drawn = small * view.samples * (BLENDED_COST if blended else 1)
    return bool(small > 0) if view.interactive else bool(drawn >= BUILD_COST)


def _with_material_constants(points: PointSet, table: MaterialTable, store: Store) -> PointSet:
    """The points with the constants of their materials as attributes, where these differ: nodes hold the means."""
    cloud = points.cloud
    material = cloud.material
    if material is None:
        return points
    rows = store.lookup(Key(Kind.MATERIAL_ROWS, points.key), lambda: np.unique(material))
    rows = np.minimum(rows, len(table) - 1)  # what names no row has the last one's values
    constants = {
        "color": table.base_color,
        "surface": np.stack([table.roughness, table.metallic], axis=1),
        "emission": table.emission,
    }
    differ = {
        name: values
        for name, values in constants.items()
        if getattr(cloud, name) is None and (values[rows] != values[rows[0]]).any()
    }
    if not differ:
        return points
    held = tuple((name, values[rows].tobytes()) for name, values in differ.items())
    key = Key(Kind.FILLED, points.key, other=held)
    made = store.lookup(
        key,
        lambda: replace(cloud, **{n: v.take(material, axis=0, mode="clip") for n, v in differ.items()}),
    )
    family = None if points.family is None else Key(Kind.FILLED, points.family, other=held)
    return replace(points, key=key, cloud=made, family=family)


def _with_hierarchy(points: PointSet, store: Store) -> PointSet:
    key = Key(Kind.HIERARCHY, points.key)
    return replace(points, key=key, hierarchy=store.lookup(key, lambda: _hierarchy(points, store)))


def _hierarchy(points: PointSet, store: Store) -> Hierarchy:
    """The octree that another pose or colouring of the same points has, refitted; else a new one."""
    if points.family is None:
        return store.build_hierarchy(points.cloud)
    known, source = store.lookup(points.family, lambda: (store.build_hierarchy(points.cloud), points.cloud))
    if source is points.cloud:
        return known
    if len(source) != len(points.cloud):
        return store.build_hierarchy(points.cloud)
    return (recolor if points.is_lattice else refit)(known, points.cloud)
