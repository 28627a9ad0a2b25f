"""The surfels of a scene, as dense as `density.py` says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ...core.indirect.captured import captured_surfels
from ...core.indirect.closed import is_closed, is_inside_out, is_solid, winding_number
from ...core.indirect.sampling import LightSamples, light_samples
from ...core.indirect.sheets import WIDE, Sheets, sheets
from ...core.indirect.surfels import Surfels, joined
from ...core.light.bsdf import relative_index, sample_reflectance_table
from ...core.lod.foliage import is_foliage
from ...core.numeric.vectors import each_block
from ...core.scene.camera import Camera
from ...core.scene.captured import CapturedSplats
from ...core.scene.cloud import PointCloud
from ...core.scene.materials import MaterialTable
from ...core.scene.mesh import Mesh
from ...core.scene.scene import Geometry, Scene
from ...core.scene.strands import Strands
from ...core.surface.appearance import CLIP, passing, scattered_at, shown_by
from ...core.surface.samples import material_ids
from ..cache.keys import Key, Kind
from ..cache.store import Store
from ..prepare.separation import is_translucent
from ..shadow.casting import cached_bounding_box
from .density import Density, Spacing, view_begins

TYPICAL_COSINE = 0.6  # of directions in which surfels are seen
FEWEST_IN_FOLIAGE = 2000  # triangles: with fewer, open edges are those of floors and walls
DEFAULT_RADIUS = 0.01  # of points without one, as in Blender
BLOCK = 1 << 18  # points of a cloud whose places are known at once: scans would double in memory
MOST_IN_SHEETS = 1 << 18  # balls of a cloud by which its sheets are found
# How many times as many pieces of hairs there are as squares of what they show would be: one that stands for many
# others is a lump, beside which light passes.
FINER_HAIRS = 6
MANY_INSTANCES = 16  # of a geometry, from which on they share samples
AS_ONE = 0.01  # of half a mesh's box: places that lie nearer to each other are in it, or out of it, together


class MeshKind(NamedTuple):
    """What surfels of a mesh have in common."""

    hidden: bool  # nobody sees its backs
    leaves: bool
    turned: bool  # its backs are its outside


def scene_density(scene: Scene, camera: Camera, store: Store) -> tuple[Density, np.ndarray]:
    """Returns how dense the surfels of a scene are, and what their places are to be relative to, (3,) float64: the
    middle of everything, so that it does not move with the camera."""
    matrices = scene.instances.world_from_object
    count = len(scene.geometries)
    low, high = np.zeros((2, count, 3))
    for row in np.unique(scene.instances.geometry).tolist():
        low[row], high[row] = cached_bounding_box(scene.geometries[row], store)
    low, high = np.nan_to_num(low), np.nan_to_num(high)
    empty = (low > high).any(axis=1)
    low[empty] = high[empty] = 0
    middle, half = (0.5 * (high + sign * low)[scene.instances.geometry] for sign in (1, -1))
    with np.errstate(all="ignore"):
        world = np.einsum("iab,ib->ia", matrices[:, :3, :3], middle) + matrices[:, :3, 3]
        around = np.einsum("iab,ib->ia", np.abs(matrices[:, :3, :3]), half)
    usable = usable_instances(scene) & np.isfinite(world).all(axis=1) & np.isfinite(around).all(axis=1)
    world[~usable], around[~usable] = 0, 0
    shown = usable & ~empty[scene.instances.geometry]
    origin = np.zeros(3)
    if shown.any():
        origin = 0.5 * ((world - around)[shown].min(axis=0) + (world + around)[shown].max(axis=0))
    begins = view_begins(camera)
    holds_eye = np.zeros(len(world), bool)
    within = (np.abs(begins[:, None] - world) <= around).all(axis=2)
    for row in np.flatnonzero(shown & within.any(axis=0)).tolist():
        mesh, matrix = scene.geometries[scene.instances.geometry[row]].mesh, matrices[row]
        if mesh is not None and _is_closed(mesh, store) and np.linalg.det(matrix[:3, :3]) != 0:
            places = begins[within[:, row]]
            places = places[: 1 if np.ptp(places, axis=0).max() < AS_ONE * around[row].max() else None]
            places = np.linalg.solve(matrix[:3, :3], (places - matrix[:3, 3]).T).T
            holds_eye[row] = (np.abs(winding_number(mesh, places)) > 0.5).any()
    return Density(camera, world, around, holds_eye), origin


def _is_closed(mesh: Mesh, store: Store) -> bool:
    return store.lookup(Key(Kind.IS_CLOSED, mesh.key), lambda: is_closed(mesh))


def usable_instances(scene: Scene) -> np.ndarray:
    """(I,) bool: instances that hide or scatter light, and whose transforms are finite."""
    sound, scatters = np.isfinite(scene.instances.world_from_object).all(axis=(1, 2)), scene.instances.scatters
    return sound if scatters is None else sound & scatters


def scene_surfels(
    scene: Scene, density: Density, origin: np.ndarray, store: Store, check: Callable[[], None]
) -> Surfels:
    """Returns the surfels of everything that hides or scatters light, but of media and translucent things."""
    found: list[Surfels] = []
    rows_of = scene.instances.of_each(len(scene.geometries), usable_instances(scene))
    for geometry, rows in zip(scene.geometries, rows_of, strict=True):
        check()
        if len(rows) == 0:
            continue
        matrices = scene.instances.world_from_object[rows].copy()
        matrices[:, :3, 3] -= origin
        for part in _surfels(scene, geometry, rows, matrices, origin, density, store):
            if len(part):
                found.append(part)
    if not found:
        return replace(_none(), origin=origin)
    whole = replace(joined(found), origin=origin)
    sound = np.isfinite(whole.position).all(axis=1) & np.isfinite(whole.area) & (whole.area > 0)
    sound &= np.isfinite(whole.normal).all(axis=1)
    return whole if sound.all() else whole.take(np.flatnonzero(sound))


def _surfels(
    scene: Scene,
    geometry: Geometry,
    rows: np.ndarray,
    matrices: np.ndarray,
    origin: np.ndarray,
    density: Density,
    store: Store,
) -> list[Surfels]:
    """The surfels of instances `rows` of a geometry; `matrices` (I, 4, 4): to world space from `origin`."""
    table = scene.materials
    spacings = (density.spacing(row, origin) for row in rows.tolist())
    if geometry.mesh is not None and len(geometry.mesh.triangles):
        mesh = geometry.mesh
        if passing(mesh, table) is not None:
            return []
        closed = _is_closed(mesh, store)
        leaves = len(mesh.triangles) * len(matrices) >= FEWEST_IN_FOLIAGE and store.lookup(
            Key(Kind.IS_FOLIAGE, mesh.key), lambda: is_foliage(mesh.position, mesh.triangles)
        )
        solid = leaves and not closed and store.lookup(Key(Kind.IS_SOLID, mesh.key), lambda: is_solid(mesh))
        inwards = closed and store.lookup(Key(Kind.IS_INSIDE_OUT, mesh.key), lambda: is_inside_out(mesh))
        # Rooms are closed meshes, too, whose insides are seen from there, beside other parts of them from outside.
        inside = density.holds_eye[rows]
        hidden = np.full(len(rows), closed or solid) & (~inside | inwards)
        other = ~inside & inwards  # is seen from outside, where backs are
        scattered = leaves and not closed
        if len(matrices) < MANY_INSTANCES:
            shown = (shown_by(mesh, scene.instances, row) for row in rows.tolist())
            each = zip(shown, matrices, spacings, hidden.tolist(), other.tolist(), strict=True)
            return [
                _of_mesh(own, table, one, at, MeshKind(back, scattered, turned)) for own, one, at, back, turned in each
            ]
        found = []
        for back, turned in np.unique(np.stack([hidden, other], axis=1), axis=0).tolist():
            some = (hidden == back) & (other == turned)
            kind = MeshKind(back, scattered, turned)
            found += _of_instances(mesh, table, matrices[some], density.apart[rows[some]], kind)
        return found
    if geometry.cloud is not None and len(geometry.cloud) and not is_translucent(geometry, table):
        cloud = geometry.cloud
        each = zip(matrices, spacings, strict=True)
        return [part for one, at in each for part in _of_cloud(cloud, table, one, at)]
    if geometry.strands is not None and len(geometry.strands):
        strands = geometry.strands
        return [_of_strands(strands, table, one, at) for one, at in zip(matrices, spacings, strict=True)]
    if geometry.captured is not None and len(geometry.captured):
        splats, relit = geometry.captured, geometry.lighting == "RELIT"
        return [_of_captured(splats, relit, one, at) for one, at in zip(matrices, spacings, strict=True)]
    return []


def _of_mesh(mesh: Mesh, table: MaterialTable, matrix: np.ndarray, spacing: Spacing, kind: MeshKind) -> Surfels:
    """The surfels of one instance, each as far from the next as it is to be where it lies."""
    moved = replace(mesh, position=(mesh.position @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32))
    made = light_samples(moved, spacing)
    if np.linalg.det(matrix[:3, :3]) < 0:
        made = _turned(made)  # mirrored triangles run the other way round
    return _with_look(mesh, table, made, kind)


def _turned(made: LightSamples) -> LightSamples:
    """Samples whose backs are their fronts: their other side comes first."""
    other = np.cross(made.normal, made.edge)
    length = np.maximum((made.edge**2).sum(axis=1), 1e-300)
    other *= (made.area * np.where(made.half, 2, 1) / length)[:, None]
    return replace(made, normal=-made.normal, edge=other)


def _of_instances(
    mesh: Mesh, table: MaterialTable, matrices: np.ndarray, apart: np.ndarray, kind: MeshKind
) -> list[Surfels]:
    """The surfels of many instances, (I,) apart: those of about one distance share samples."""
    scale = _scale(matrices)
    octave = np.floor(np.log2(np.maximum(apart, 1e-30) / np.maximum(scale, 1e-30)))
    found = []
    for one in np.unique(octave).tolist():
        apart = 2.0**one
        made = light_samples(mesh, lambda at, apart=apart: (np.full(at.shape[1], apart), np.full(at.shape[1], np.inf)))
        local = _with_look(mesh, table, made, kind)
        found.append(_moved(local, matrices[octave == one]))
    return found


def _moved(surfels: Surfels, matrices: np.ndarray) -> Surfels:
    """Surfels of object space in world space, for each of the transforms (I, 4, 4) one after the other."""
    linear, count = matrices[:, :3, :3], len(matrices)
    # Cofactors turn areas times normals.
    cofactors = np.stack([np.cross(linear[:, :, (k + 1) % 3], linear[:, :, (k + 2) % 3]) for k in range(3)], axis=2)
    flip = np.where(np.linalg.det(linear) < 0, -1.0, 1.0)
    position = surfels.position @ linear.transpose(0, 2, 1) + matrices[:, None, :3, 3]
    normal = surfels.normal @ cofactors.transpose(0, 2, 1)
    length = np.sqrt((normal**2).sum(axis=2))
    grown = np.where(surfels.normal.any(axis=1), length, _scale(matrices)[:, None] ** 2)
    normal *= (flip[:, None] / np.maximum(length, 1e-300))[..., None]
    closed, scattered = (np.tile(flags, count) for flags in (surfels.closed, surfels.scattered))
    return Surfels(
        surfels.origin, position.reshape(-1, 3).astype(np.float32), normal.reshape(-1, 3).astype(np.float32),
        (surfels.area * grown).reshape(-1).astype(np.float32), closed, scattered,
        np.tile(surfels.albedo, (count, 1)), np.tile(surfels.emission, (count, 1)),
        (surfels.edge @ linear.transpose(0, 2, 1)).reshape(-1, 3).astype(np.float32), np.tile(surfels.half, count),
        fine=None if surfels.fine is None else np.tile(surfels.fine, count),
    )  # fmt: skip


def _with_look(mesh: Mesh, table: MaterialTable, made: LightSamples, kind: MeshKind) -> Surfels:
    """Surfels at samples that were taken of the mesh, or of it where it stands."""
    samples = made.samples
    look = scattered_at(mesh, samples, table)
    rows = np.minimum(material_ids(mesh, samples), len(table) - 1)
    albedo, emission = _look(rows, look.color, look.surface, look.emission, table)
    closed, scattered = np.full(len(samples), kind.hidden), np.full(len(samples), kind.leaves)
    if kind.turned:
        made = _turned(made)
    position, normal, area, edge = (of.astype(np.float32) for of in (made.position, made.normal, made.area, made.edge))
    fine = ~edge.any(axis=1) & ~scattered
    surfels = Surfels(
        np.zeros(3), position, normal, area, closed, scattered, albedo, emission, edge, made.half,
        fine=fine if fine.any() else None,
    )  # fmt: skip
    return surfels if look.alpha is None else surfels.take(np.flatnonzero(look.alpha >= CLIP))


def _of_cloud(cloud: PointCloud, table: MaterialTable, matrix: np.ndarray, spacing: Spacing) -> list[Surfels]:
    """The surfels of a cloud of balls or disks; of dense ones some stand for all, and flat ones for sheets of balls."""
    flat = cloud.normal is not None and bool(cloud.normal.any())
    sides, scale = 1.0 if flat else 4.0, float(_scale(matrix))

    def positions(rows: slice | np.ndarray) -> np.ndarray:
        return cloud.position[rows].astype(np.float64) + cloud.origin

    def in_world(rows: slice | np.ndarray) -> np.ndarray:
        return positions(rows) @ matrix[:3, :3].T + matrix[:3, 3]

    def areas(rows: slice | np.ndarray) -> np.ndarray:
        if cloud.radii is None:
            return np.full(len(cloud.position[rows]), sides * np.pi * DEFAULT_RADIUS**2)
        radii = cloud.radii[rows]
        return sides * np.pi * radii[:, 0].astype(np.float64) * radii[:, -1]

    worth, total = np.empty(len(cloud)), 0.0
    for begin in range(0, len(cloud), BLOCK):
        block = slice(begin, begin + BLOCK)
        area = areas(block)
        apart, _ = spacing(in_world(block).T)
        worth[block] = np.minimum(area / sides * (scale / apart) ** 2, 1.0)
        total += float(area.sum())
    ends = np.cumsum(worth)
    count = max(round(float(ends[-1])), 1)
    rows = np.minimum(np.searchsorted(ends, (np.arange(count) + 0.5) * ends[-1] / count), len(cloud) - 1)
    stands_for = areas(rows) / worth[rows]
    stands_for *= total / stands_for.sum()
    parts = []
    if not flat:

        def cells(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            place, picture = in_world(rows), areas(rows) / sides * scale**2
            apart = np.maximum(spacing(place.T)[0], WIDE * np.sqrt(picture / np.pi))
            return place, picture, apart

        some = np.arange(0, len(cloud), -(-len(cloud) // MOST_IN_SHEETS))
        place, picture, apart = cells(some)
        look = np.column_stack(_look_of(cloud.take(some), table))
        made = sheets(place, picture, look, apart, len(cloud) / len(some))
        parts.append(_of_sheets(made))
        place, _, apart = cells(rows)
        share = made.shares(place, apart)
        rows, stands_for = rows[share > 0], (stands_for * share)[share > 0]
    thinned = cloud.take(rows)
    albedo, emission = _look_of(thinned, table)
    no = np.zeros(len(rows), bool)
    normal = np.zeros((len(rows), 3), np.float32) if thinned.normal is None else thinned.normal
    local = Surfels(
        np.zeros(3), positions(rows).astype(np.float32), normal, stands_for.astype(np.float32),
        np.full(len(rows), not flat), no, albedo, emission, np.zeros((len(rows), 3), np.float32), no,
    )  # fmt: skip
    return [*parts, _moved(local, matrix[None])]


def _of_sheets(made: Sheets) -> Surfels:
    """The surfels of sheets of balls, in world space."""
    f, count = np.float32, len(made.area)
    no, look = np.zeros(count, bool), made.look.astype(f)
    return Surfels(
        np.zeros(3), made.position.astype(f), made.normal.astype(f), made.area.astype(f), no, no, look[:, :3],
        look[:, 3:], np.zeros((count, 3), f), no, raised=made.height.astype(f), returned=made.returned.astype(f),
    )  # fmt: skip


def _of_strands(strands: Strands, table: MaterialTable, matrix: np.ndarray, spacing: Spacing) -> Surfels:
    """The surfels of strands: pieces of tubes."""
    ends = np.ones(len(strands.position), bool)
    ends[strands.start[1:] - 1] = False
    first = np.flatnonzero(ends)
    a, b = (strands.position[first + k].astype(np.float64) + strands.origin for k in (0, 1))
    radius = 0.5 * (strands.radius[first] + strands.radius[first + 1]).astype(np.float64)
    length = np.linalg.norm(b - a, axis=1)
    area = 2 * np.pi * radius * length
    middle = 0.5 * (a + b)
    apart, _ = spacing((middle @ matrix[:3, :3].T + matrix[:3, 3]).T)
    scale = float(_scale(matrix))
    worth = np.minimum(FINER_HAIRS * area / 4 * scale**2 / apart**2, 1.0)
    total = np.cumsum(worth)
    if len(total) == 0 or not total[-1] > 0:
        return _none()
    count = max(round(float(total[-1])), 1)
    rows = np.minimum(np.searchsorted(total, (np.arange(count) + 0.5) * total[-1] / count), len(first) - 1)
    owner = np.searchsorted(strands.start, first[rows], side="right") - 1
    material = np.full(count, strands.materials[0], np.uint16) if strands.material is None else strands.material[owner]
    color = None if strands.color is None else strands.color[first[rows]]
    cloud = PointCloud(middle[rows].astype(np.float32), material=material, color=color)
    albedo, emission = _look_of(cloud, table)
    stands_for = area[rows] / worth[rows]
    stands_for = (stands_for * (area.sum() / stands_for.sum())).astype(np.float32)
    local = Surfels(
        np.zeros(3),
        cloud.position,
        np.zeros((count, 3), np.float32),
        stands_for,
        np.ones(count, bool),
        np.ones(count, bool),
        albedo,
        emission,
        ((b - a) / np.maximum(length, 1e-300)[:, None])[rows].astype(np.float32),
        np.zeros(count, bool),
    )
    return _moved(local, matrix[None])


def _of_captured(splats: CapturedSplats, relit: bool, matrix: np.ndarray, spacing: Spacing) -> Surfels:
    """The surfels of captured splats, which shine, or scatter what falls on them where they are `relit`."""
    made = captured_surfels(splats, matrix, spacing)
    count = len(made.area)
    none, no, yes = np.zeros((count, 3), np.float32), np.zeros(count, bool), np.ones(count, bool)
    normal, albedo, emission = made.normal, none, made.color
    if relit:
        length = np.sqrt((normal**2).sum(axis=1, keepdims=True))
        normal = normal / np.maximum(length, np.float32(1e-30))
        albedo, emission = np.minimum(made.color, 1), none
    return Surfels(np.zeros(3), made.position, normal, made.area, no, no, albedo, emission, none, no, yes)


def _scale(matrices: np.ndarray) -> np.ndarray:
    """(...): by how much transforms (..., 4, 4) make things larger, on average; exact where that is a power of two."""
    return np.sqrt((matrices[..., :3, :3] ** 2).sum(axis=(-2, -1)) / 3)


def _none() -> Surfels:
    f = np.float32
    empty, no = np.zeros((0, 3), f), np.zeros(0, bool)
    return Surfels(np.zeros(3), empty, empty, np.zeros(0, f), no, no, empty, empty, empty, no)


def _look_of(cloud: PointCloud, table: MaterialTable) -> tuple[np.ndarray, np.ndarray]:
    """See _look."""
    rows = np.zeros(len(cloud), np.uint16) if cloud.material is None else np.minimum(cloud.material, len(table) - 1)
    return _look(rows, cloud.color, cloud.surface, cloud.emission, table)


def _look(
    rows: np.ndarray,
    color: np.ndarray | None,
    surface: np.ndarray | None,
    emission: np.ndarray | None,
    table: MaterialTable,
) -> tuple[np.ndarray, np.ndarray]:
    """What points of materials `rows` (N,) scatter of light, and what they emit, (N, 3) float32 each: the diffuse lobe
    alone, as of surfaces that are seen by way of others. The others: as of PointCloud."""
    constant = np.stack([table.roughness, table.metallic], axis=1)
    albedo, shines = np.empty((2, len(rows), 3), np.float32)

    def look(block: slice) -> None:
        own = rows[block]
        base = table.base_color[own] if color is None else color[block]
        rough, metallic = (constant[own] if surface is None else surface[block]).T
        scattered = (1 - np.clip(metallic, 0, 1)) * (1 - _reflected(rough, own, table))
        albedo[block] = np.minimum(np.maximum(base, 0) * scattered[:, None], 1)
        shines[block] = np.maximum(table.emission[own] if emission is None else emission[block], 0)

    each_block(len(rows), look)
    return albedo, shines


def _reflected(roughness: np.ndarray, rows: np.ndarray, table: MaterialTable) -> np.ndarray:
    """(N,): what the dielectric lobe reflects, by Schlick's approximation."""
    eta = relative_index(table.ior, table.specular)[rows]
    f0 = ((eta - 1) / (eta + 1)) ** 2
    albedo, _, share, _ = sample_reflectance_table(np.full(len(rows), TYPICAL_COSINE), np.clip(roughness, 0, 1)).T
    return np.where(eta == 1, 0.0, (f0 * (1 - share) + share) * albedo)
