"""Levels of detail of point sets: octrees where they pay for themselves, at once or on another thread, and merged
voxels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ...core.light.light_shapes import area_axes
from ...core.lod.balls.tree import BallTree, build_ball_tree
from ...core.lod.hierarchy import Hierarchy, recolor, refit
from ...core.numeric.lattice import lattice_for
from ...core.numeric.vectors import column_ranges
from ...core.scene.cloud import PointCloud
from ...core.scene.materials import MaterialTable
from ...core.scene.scene import Geometry
from ...core.volume.detail import NEAREST_LAMP, merged_where_even, voxel_edge, widest_voxel
from ..cache.keys import Key, Kind
from ..cache.store import Store
from .layers import MANY_INSTANCES, MOST_PRIMITIVES
from .point_sets import PointSet, typical_diameter
from .view import View

BUILD_COST = 80  # building costs about as much as drawing the points this many times
BLENDED_COST = 10  # times what a small splat costs in image space, it costs by EWA, where it covers more than its pixel
SMALL_SPLAT = 0.25  # of the tolerance: where typical splats are smaller, most of a cloud can be left out
# As SMALL_SPLAT, for many instances, whose shared cuts cost nothing for each splat, and for EWA and the painter.
SMALL_SPLAT_SHARED = 0.5
MIN_POINTS_FOR_DEFOCUS = 1 << 12  # fewer out-of-focus points cost less without nodes
MAX_POINTS_WITHOUT_HIERARCHY = 1 << 24  # of all instances: with more, drawing waits for the hierarchy
# Of balls in the visibility buffer:
BALL_TREE_COST = 12  # building costs about as much as drawing the balls this many times, 17 sub-samples a pixel
MIN_BALLS = 1 << 20  # a viewport draws fewer in its frame time
BALLS_PER_PIXEL = 4  # of the picture: nodes are fewer only where balls are more
# Of voxels: pixels along the largest block, times a tolerance below 1. What wide splats of a lattice are uneven by, the
# pixel filter hides up to here.
WIDEST_BLOCK = 1.5
MIN_VOXELS = 1 << 14  # fewer are drawn in less time than they are merged
MOST_INSTANCES = 16  # whose voxels are looked at one by one; of more, all voxels are drawn
MOST_LEVELS = 10


def with_hierarchy_if_it_pays(view: View, points: PointSet, view_from_object: np.ndarray) -> PointSet:
    """Returns the points with an octree, if it would save more time than building it takes, or, in a view that
    remembers, is already built.

    `view_from_object`: (I, 4, 4) of the instances that draw the points. In an interactive view the octree is built on
    another thread and the points are returned without it, unless they are too many to be drawn.
    """
    plain, points, store = points, with_material_constants(points, view.scene.materials, view.store), view.store
    key = _key(points, view.remembers)
    opaque = plain.cloud.opacity is None and plain.cloud.extinction is None
    if opaque and view.settings.technique == "VISIBILITY":
        return plain
    if key not in store or not view.remembers:
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
    return _with_hierarchy(points, store, view.remembers)


def ball_tree_if_it_pays(view: View, points: PointSet, view_from_object: np.ndarray) -> BallTree | None:
    """Returns the nodes over opaque balls that the visibility buffer draws, if they would save more time than building
    them takes or, in a view that remembers, are already built.

    `view_from_object`: (I, 4, 4) of the instances that draw the points. In an interactive view the nodes are built on
    another thread, unless the balls are too many to be drawn without.
    """
    cloud, store = points.cloud, view.store
    if view.settings.technique != "VISIBILITY" or cloud.normal is not None or cloud.radii is None:
        return None
    points = with_material_constants(points, view.scene.materials, store)
    key = Key(Kind.BALL_TREE, points.key)
    if key not in store or not view.remembers:
        _, _, width, height = view.camera.window
        drawn = len(cloud) * len(view_from_object)
        if drawn < BALLS_PER_PIXEL * width * height:
            return None
        lattices = -(-view.samples // lattice_for(view.samples, view.few).count)
        if drawn <= MOST_PRIMITIVES:
            if view.interactive and len(cloud) >= MIN_BALLS:
                store.make_later(key, lambda: build_ball_tree(points.cloud))
            if view.interactive or lattices * len(view_from_object) < BALL_TREE_COST:
                return None
    return store.lookup(key, lambda: build_ball_tree(points.cloud))


def points_once_they_have_nodes(view: View, name: Key, make: Callable[[], PointSet]) -> PointSet | None:
    """Returns the points that `make` makes, which are cached as `name`, once their octree is built; until then None.

    In an interactive view the octree is begun on another thread at the second call: geometry that changes with each
    picture would be gone before it is built. In other views it is never begun.
    """
    store, known, asked = view.store, Key(Kind.NODES, name), Key(Kind.NODES_ASKED_FOR, name)

    def build() -> Key:
        return _with_hierarchy(with_material_constants(make(), view.scene.materials, store), store).key

    if known in store and view.remembers:
        key = store.lookup(known, build)
        if key in store:
            return make()
        if view.interactive:  # the octree was dropped from the store
            store.make_later(
                key, lambda: _hierarchy(with_material_constants(make(), view.scene.materials, store), store)
            )
    elif view.interactive and asked in store:
        store.make_later(known, build)
    elif view.interactive:
        store.lookup(asked, tuple)
    return None


def with_even_blocks(view: View, geometry: Geometry, points: PointSet, view_from_object: np.ndarray) -> PointSet:
    """Returns the points of a volume as coarse as the instances (I, 4, 4) that a view draws of it allow.

    In an interactive view they are its voxels, which have an octree there.
    """
    cloud, cells = geometry.cloud, geometry.cells
    assert cloud is not None
    assert cells is not None
    if view.interactive or len(cloud) < MIN_VOXELS or len(view_from_object) > MOST_INSTANCES:
        return points
    edge = widest_voxel(cloud, view_from_object, view.camera)
    wanted = WIDEST_BLOCK * min(view.settings.tolerance, 1.0)
    # What has no extent along an axis has no space of its own, in which lamps lie.
    if not 2 * edge <= wanted or (np.linalg.matrix_rank(view_from_object[:, :3, :3]) < 3).any():
        return points
    levels = min(int(np.log2(wanted / edge)), MOST_LEVELS) if edge > 0 else MOST_LEVELS
    lamps = _lamps_beside(view, cloud, view_from_object, 2**levels * voxel_edge(cloud))
    key = Key(Kind.EVEN_BLOCKS, geometry.key, other=(levels, lamps.tobytes()))
    merged = view.store.lookup(key, lambda: merged_where_even(cloud, cells, levels, lamps))
    return PointSet(key, merged, is_lattice=True)


def _lamps_beside(view: View, cloud: PointCloud, view_from_object: np.ndarray, block: float) -> np.ndarray:
    """Returns the lamps that are so near to some points of instances (I, 4, 4) that these are not merged into blocks
    with edges of `block`, (L, 4) float64: places in object space and radii, in steps that do not change with the
    camera."""
    lamps = [light for light in view.scene.lights if light.kind != "SUN"]
    if not lamps:
        return np.zeros((0, 4))
    place = np.array([[*light.position, 1.0] for light in lamps]) @ view.camera.view_from_world.T
    radius = np.array([
        np.linalg.norm(area_axes(light), axis=1).sum() if light.kind == "AREA" else light.radius for light in lamps
    ])  # fmt: skip
    low, high = (corner + cloud.origin for corner in column_ranges(cloud.position))
    found = [np.zeros((0, 4))]
    for matrix in view_from_object:
        own = (place @ np.linalg.inv(matrix).T)[:, :3]
        reach = radius / max(np.cbrt(abs(np.linalg.det(matrix[:3, :3]))), 1e-30)
        away = np.linalg.norm(np.maximum(np.maximum(low - own, own - high), 0), axis=1) - reach
        found.append(np.column_stack([own, reach])[away <= NEAREST_LAMP * block])
    step = block / 64
    return np.round(np.concatenate(found) / step) * step


def with_hierarchy_for_defocus(view: View, points: PointSet, always: bool) -> PointSet:
    """Returns points with a hierarchy, if they are so many that it saves time when out of focus, or if `always`."""
    if points.hierarchy is not None or (len(points.cloud) < MIN_POINTS_FOR_DEFOCUS and not always):
        return points
    filled = with_material_constants(points, view.scene.materials, view.store)
    return _with_hierarchy(filled, view.store, view.remembers)


def _pays(view: View, points: PointSet, view_from_object: np.ndarray) -> bool:
    """Tells whether enough instances show the splats so small that a cut would leave most of them out."""
    blended = view.settings.technique in ("EWA", "PAINTER")
    limit = SMALL_SPLAT if len(view_from_object) < MANY_INSTANCES and not blended else SMALL_SPLAT_SHARED
    diameter = typical_diameter(points, view_from_object, view.camera, view.store)
    small = np.count_nonzero(diameter < limit * view.settings.tolerance)
    drawn = small * view.samples * (BLENDED_COST if blended else 1)
    return bool(small > 0) if view.interactive else bool(drawn >= BUILD_COST)


def with_material_constants(points: PointSet, table: MaterialTable, store: Store) -> PointSet:
    """Returns points with their materials' constants as attributes, if these differ, so that nodes average them."""
    cloud = points.cloud
    material = cloud.material
    if material is None:
        return points
    rows = store.lookup(Key(Kind.MATERIAL_ROWS, points.key), cloud.material_rows)
    rows = np.minimum(rows, len(table) - 1)  # indices beyond the table use its last row
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


def _key(points: PointSet, remembers: bool) -> Key:
    """That of the octree of points: one that may come from another pose has another key than one of their own."""
    return Key(Kind.HIERARCHY, points.key, other=() if remembers or points.family is None else "own")


def _with_hierarchy(points: PointSet, store: Store, remembers: bool = True) -> PointSet:
    """Returns points with their octree, which is built now if it is not cached. `remembers`: see View."""
    key = _key(points, remembers)

    def make() -> Hierarchy:
        return _hierarchy(points, store) if remembers else store.build_hierarchy(points.cloud)

    return replace(points, key=key, hierarchy=store.lookup(key, make))


def _hierarchy(points: PointSet, store: Store) -> Hierarchy:
    """Returns an octree of points: a new one, or that of another pose or colouring of them, refitted or recoloured."""
    if points.family is None:
        return store.build_hierarchy(points.cloud)
    known, source = store.lookup(points.family, lambda: (store.build_hierarchy(points.cloud), points.cloud))
    if source is points.cloud:
        return known
    if len(source) != len(points.cloud):
        return store.build_hierarchy(points.cloud)
    return (recolor if points.is_lattice else refit)(known, points.cloud)
