"""The picture of a small scene of opaque splats and triangles, slow and exact, in float64: what error is measured
against.

A pixel shows what the ray through its centre meets first. A splat is met where the ray crosses its plane inside its
ellipse; balls are disks that face the eye. Splats whose extents in depth overlap that of the nearest one are one
surface, and their attributes are averaged with elliptical Gaussian weights whose rim lies at 2 sigma
(Zwicker et al. 2001, equation 10, normalised). Triangles are met exactly, and their material graphs evaluated there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np

from pointsplat_addon.core.light import environment
from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.materials import MaterialTable
from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.scene.scene import Scene
from pointsplat_addon.core.scene.valid.geometry import valid_points, valid_triangles
from pointsplat_addon.core.surface.appearance import CLIP, at_samples, corner_normals
from pointsplat_addon.core.surface.evaluation import Evaluated
from pointsplat_addon.core.surface.samples import Samples
from tests.reference import environment_lookup
from tests.reference.lighting import Surface, diffuse_color, shade

BACKGROUND_DEPTH = 1e10
_PAIRS = 1 << 20  # pixels times primitives that are met together


@dataclass(frozen=True, eq=False)
class Picture:
    """What each pixel shows, (H, W, ...), bottom row first."""

    combined: np.ndarray  # (H, W, 4) float64, premultiplied scene-linear
    depth: np.ndarray  # (H, W) float64 along the view axis, BACKGROUND_DEPTH where there is nothing
    position: np.ndarray  # (H, W, 3) float64, world space
    normal: np.ndarray  # (H, W, 3) float64, world space, unit, of the side that is seen
    diffuse_color: np.ndarray  # (H, W, 3) float64
    instance: np.ndarray  # (H, W) int, -1: none
    material: np.ndarray  # (H, W) int, -1: none


@dataclass(eq=False)
class _Hit:
    """What P rays meet, in world space; `depth` is infinite where they meet nothing."""

    depth: np.ndarray  # (P,)
    normal: np.ndarray  # (P, 3)
    plane: np.ndarray  # (P, 3) normals of the planes that are met
    base: np.ndarray  # (P, 3)
    emission: np.ndarray  # (P, 3)
    surface: np.ndarray  # (P, 2) roughness, metallic
    material: np.ndarray  # (P,) int
    instance: np.ndarray  # (P,) int

    @classmethod
    def none(cls, count: int) -> _Hit:
        normal, plane, base, emission = np.zeros((4, count, 3))
        material, instance = np.full((2, count), -1)
        return cls(np.full(count, np.inf), normal, plane, base, emission, np.zeros((count, 2)), material, instance)

    def merge(self, other: _Hit) -> None:
        """Keep the nearer of the two for each ray."""
        nearer = other.depth < self.depth
        for f in fields(self):
            getattr(self, f.name)[nearer] = getattr(other, f.name)[nearer]


def picture(scene: Scene, camera: Camera) -> Picture:
    """The picture that `camera` sees: clouds as splats, meshes as triangles. Motion and mist are left out."""
    _, _, width, height = camera.window
    fx, fy, cx, cy = camera.pixel_from_view()
    x, y = (a.ravel() for a in np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5))
    across = np.stack([(x - cx) / fx, (y - cy) / fy], axis=1)
    # Rays in view space, start + depth * direction: the parameter is the depth along the view axis.
    flat, zero = np.zeros((len(x), 1)), np.zeros_like(across)
    start = np.column_stack([zero if camera.perspective else across, flat])
    direction = np.column_stack([across if camera.perspective else zero, flat - 1])

    hit = _Hit.none(len(x))
    for instance, row in enumerate(scene.instances.geometry.tolist()):
        geometry = scene.geometries[row]
        matrix = camera.view_from_world @ scene.instances.world_from_object[instance]
        if not np.isfinite(matrix).all():
            continue
        for rays in _blocks(len(x), _count(geometry.cloud, geometry.mesh)):
            if geometry.cloud is not None:
                cloud = valid_points(geometry.cloud)[0]
                found = _splats(cloud, matrix, start[rays], direction[rays], camera, scene.materials)
            elif geometry.mesh is not None:
                found = _triangles(geometry.mesh, matrix, start[rays], direction[rays], camera, scene.materials)
            else:
                continue
            found.instance[:] = instance
            part = _Hit(*(getattr(hit, f.name)[rays] for f in fields(hit)))
            part.merge(found)
    return _shaded(scene, camera, hit, start, direction, (height, width))


def _count(cloud: PointCloud | None, mesh: Mesh | None) -> int:
    return len(cloud) if cloud is not None else len(mesh.triangles) if mesh is not None else 0


def _blocks(rays: int, primitives: int) -> Iterator[slice]:
    step = max(1, _PAIRS // max(primitives, 1))
    return (slice(i, i + step) for i in range(0, rays, step))


def _splats(
    cloud: PointCloud,
    view_from_object: np.ndarray,
    start: np.ndarray,
    direction: np.ndarray,
    camera: Camera,
    table: MaterialTable,
) -> _Hit:
    """What rays (P, 3) meet of N splats."""
    hit = _Hit.none(len(start))
    if len(cloud) == 0:
        return hit
    if cloud.normal is None:
        return _balls(cloud, view_from_object, start, direction, camera, table)
    linear = view_from_object[:3, :3]
    centre = (cloud.position.astype(np.float64) + cloud.origin) @ linear.T + view_from_object[:3, 3]
    a, b, stored = _half_axes(cloud, linear)
    plane = np.cross(a, b)
    rows = np.zeros(len(cloud), int) if cloud.material is None else cloud.material.astype(int)

    # Where the ray crosses the splat's plane, in the splat's own coordinates: its rim lies at 1.
    with np.errstate(all="ignore"):
        depth = ((centre * plane).sum(axis=1) - start @ plane.T) / (direction @ plane.T)  # (P, N)
        from_centre = start[:, None] + depth[..., None] * direction[:, None] - centre
        area2 = (plane**2).sum(axis=1)
        u = np.einsum("pnc,nc->pn", from_centre, np.cross(b, plane)) / area2
        v = np.einsum("pnc,nc->pn", from_centre, np.cross(plane, a)) / area2
        rim = u**2 + v**2
        met = (rim <= 1) & (depth > camera.near) & (depth < camera.far)
    met &= ~(table.cull[rows] & ((stored * centre).sum(axis=1) > 0 if camera.perspective else stored[:, 2] < 0))

    extent = np.hypot(a[:, 2], b[:, 2])
    front = np.where(met, -centre[:, 2] - extent, np.inf)
    first = np.where(met, depth, np.inf).argmin(axis=1)
    end = (-centre[:, 2] + extent)[first]
    weight = np.where(met & (front <= end[:, None]), np.exp(-2 * np.where(met, rim, 0)), 0)
    total = weight.sum(axis=1)
    some = total > 0
    weight = weight[some] / total[some, None]

    def mean(values: np.ndarray) -> np.ndarray:
        return weight @ values

    hit.depth[some] = (weight * np.where(met[some], depth[some], 0)).sum(axis=1)
    hit.material[some] = rows[first[some]]
    hit.base[some] = mean(table.base_color[rows] if cloud.color is None else cloud.color)
    hit.emission[some] = mean(table.emission[rows] if cloud.emission is None else cloud.emission)
    constants = np.stack([table.roughness[rows], table.metallic[rows]], axis=1)
    hit.surface[some] = mean(constants if cloud.surface is None else cloud.surface)
    shading = stored if cloud.shading_normal is None else _turned(cloud.shading_normal, linear)
    hit.normal[some] = _unit(mean(shading)) @ camera.view_from_world[:3, :3]
    hit.plane[some] = _unit(mean(stored)) @ camera.view_from_world[:3, :3]
    return hit


def _balls(
    cloud: PointCloud,
    view_from_object: np.ndarray,
    start: np.ndarray,
    direction: np.ndarray,
    camera: Camera,
    table: MaterialTable,
) -> _Hit:
    """Where rays (P, 3) enter N balls, ellipsoids under the transform; those that hold the near plane show their
    inside."""
    hit = _Hit.none(len(start))
    linear = view_from_object[:3, :3]
    radius = np.zeros(len(cloud)) if cloud.radii is None else cloud.radii[:, 0].astype(np.float64)
    if abs(np.linalg.det(linear)) < 1e-30:
        return hit
    # Where the balls are balls: object space, (P, N).
    inverse = np.linalg.inv(linear)
    centre = cloud.position.astype(np.float64) + cloud.origin + inverse @ view_from_object[:3, 3]
    along = direction @ inverse.T
    eye = (start @ inverse.T)[:, None] - centre
    with np.errstate(all="ignore"):
        a = (along**2).sum(axis=1)[:, None]
        middle = -np.einsum("pnc,pc->pn", eye, along) / a
        nearest = eye + middle[..., None] * along[:, None]
        half_chord = np.sqrt((radius**2 - (nearest**2).sum(axis=2)) / a)
        depth = np.where(middle - half_chord < camera.near, middle + half_chord, middle - half_chord)
        depth = np.where((depth >= camera.near) & (depth <= camera.far), depth, np.inf)
    ball = depth.argmin(axis=1)
    some = np.isfinite(depth.min(axis=1))
    ball, ray = ball[some], np.flatnonzero(some)
    rows = np.zeros(len(cloud), int) if cloud.material is None else cloud.material.astype(int)
    hit.depth[some] = depth[ray, ball]
    hit.material[some] = rows[ball]
    hit.base[some] = (table.base_color[rows] if cloud.color is None else cloud.color)[ball]
    hit.emission[some] = (table.emission[rows] if cloud.emission is None else cloud.emission)[ball]
    constants = np.stack([table.roughness[rows], table.metallic[rows]], axis=1)
    hit.surface[some] = (constants if cloud.surface is None else cloud.surface)[ball]
    outwards = eye[ray, ball] + depth[ray, ball][:, None] * along[some]
    hit.normal[some] = hit.plane[some] = _unit(outwards @ inverse) @ camera.view_from_world[:3, :3]
    return hit


def _half_axes(cloud: PointCloud, linear: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Conjugate half-axes (N, 3) of the ellipses in view space, and their normals there (N, 3), unit."""
    radii = np.zeros((len(cloud), 1)) if cloud.radii is None else cloud.radii.astype(np.float64)
    major, minor = radii[:, :1], radii[:, 1:2] if radii.shape[1] > 1 else radii[:, :1]
    assert cloud.normal is not None
    normal = _unit(cloud.normal.astype(np.float64))
    helper = np.where(np.abs(normal[:, 2:]) < 0.9, [0.0, 0, 1], [1.0, 0, 0])
    axis = _unit(np.cross(helper, normal)) if cloud.axis is None else _unit(cloud.axis.astype(np.float64))
    a, b = major * axis, minor * np.cross(normal, axis)
    return a @ linear.T, b @ linear.T, _turned(normal, linear)


def _triangles(
    mesh: Mesh,
    view_from_object: np.ndarray,
    start: np.ndarray,
    direction: np.ndarray,
    camera: Camera,
    table: MaterialTable,
) -> _Hit:
    """What rays (P, 3) meet of a mesh (Möller and Trumbore 1997)."""
    hit = _Hit.none(len(start))
    ok = np.flatnonzero(valid_triangles(mesh)[0])
    if len(ok) == 0:
        return hit
    linear = view_from_object[:3, :3]
    corner = mesh.position[mesh.triangles[ok]].astype(np.float64) @ linear.T + view_from_object[:3, 3]
    rows = np.full(len(ok), mesh.materials[0]) if mesh.material is None else mesh.material[ok].astype(int)
    edge1, edge2 = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    plane = np.cross(edge1, edge2)
    with np.errstate(all="ignore"):
        offset = start[:, None] - corner[:, 0]
        facing = direction @ plane.T
        across = np.cross(offset, direction[:, None])
        u = np.einsum("ptc,tc->pt", across, edge2) / -facing
        v = np.einsum("ptc,tc->pt", across, edge1) / facing
        depth = np.einsum("ptc,tc->pt", offset, plane) / -facing
        met = (u >= 0) & (v >= 0) & (u + v <= 1) & (depth > camera.near) & (depth < camera.far)
    # A mirror turns the corners' order; the side that faces outwards stays.
    outward = np.sign(np.linalg.det(linear))
    met &= ~(table.cull[rows] & (facing * outward > 0))
    some, depth = _opaque(mesh, table, ok, rows, met, depth, u, v)
    first = depth.argmin(axis=1)[some]
    nearest = some, first

    samples = _places(ok[first], u[nearest], v[nearest])
    look = at_samples(mesh, samples, _evaluated(mesh, samples), table)
    row = rows[first]
    hit.depth[some] = depth[nearest]
    hit.material[some] = row
    hit.base[some] = table.base_color[row] if look.color is None else look.color
    hit.emission[some] = table.emission[row] if look.emission is None else look.emission
    constants = np.stack([table.roughness[row], table.metallic[row]], axis=1)
    hit.surface[some] = constants if look.surface is None else look.surface
    normal = _evaluated(mesh, samples).normal if look.normal is None else look.normal
    hit.normal[some] = _turned(normal, linear) @ camera.view_from_world[:3, :3]
    hit.plane[some] = _unit(plane[first]) @ camera.view_from_world[:3, :3]
    return hit


def _opaque(
    mesh: Mesh,
    table: MaterialTable,
    ok: np.ndarray,
    rows: np.ndarray,
    met: np.ndarray,
    depth: np.ndarray,
    u: np.ndarray,
    v: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Rays that meet something, and depths (P, T): infinite where a triangle is missed or cut out there."""
    depth = np.where(met, depth, np.inf)
    ray, triangle = np.nonzero(met)
    samples = _places(ok[triangle], u[met], v[met])
    alpha = at_samples(mesh, samples, _evaluated(mesh, samples), table).alpha
    if alpha is not None:
        depth[ray[alpha < CLIP], triangle[alpha < CLIP]] = np.inf
    return np.flatnonzero(np.isfinite(depth).any(axis=1)), depth


def _places(triangle: np.ndarray, u: np.ndarray, v: np.ndarray) -> Samples:
    """Samples without extent at barycentric coordinates of triangles."""
    weights = np.stack([u, v], axis=1).astype(np.float32)
    return Samples("AREA", triangle.astype(np.int32), weights, np.zeros((len(weights), 2, 2), np.float32))


def _evaluated(mesh: Mesh, samples: Samples) -> Evaluated:
    """Positions and normals at places of a mesh's triangles, linear between the corners."""
    weights = np.column_stack([1 - samples.barycentric.sum(axis=1), samples.barycentric]).astype(np.float64)
    position = np.einsum("nk,nkc->nc", weights, mesh.position[mesh.triangles[samples.triangle]])
    normal = _unit(np.einsum("nk,nkc->nc", weights, corner_normals(mesh).reshape(-1, 3, 3)[samples.triangle]))
    single = normal.astype(np.float32)
    return Evaluated(np.zeros(3), position.astype(np.float32), single, single, np.zeros((len(samples), 1), np.float32))


def _shaded(
    scene: Scene,
    camera: Camera,
    hit: _Hit,
    start: np.ndarray,
    direction: np.ndarray,
    shape: tuple[int, int],
) -> Picture:
    table, world = scene.materials, scene.world
    there = np.isfinite(hit.depth)
    turn = camera.view_from_world[:3, :3]
    eye_from_world = camera.view_from_world[:3, 3]
    to_eye = _unit(-direction) @ turn
    view = start + np.where(there, hit.depth, 0)[:, None] * direction
    position = (view - eye_from_world) @ turn
    side = np.where((hit.plane * to_eye).sum(axis=1, keepdims=True) < 0, -1, 1)
    normal, plane = side * hit.normal, side * hit.plane
    atlas = None if world.image is None else environment.build_atlas(world.image)

    combined = np.zeros((len(start), 4))
    if not scene.transparent:
        away = -to_eye @ world.world_rotation.T
        combined[:, :3] = (
            world.color if atlas is None else environment_lookup.radiance(atlas, away, np.zeros(len(away)))
        )
        combined[:, 3] = 1
    row = hit.material[there]
    roughness, metallic = hit.surface[there].T
    surface = Surface(
        hit.base[there], hit.emission[there], roughness, metallic, table.ior[row], table.specular[row]
    )  # fmt: skip
    at, facing, toward = position[there], normal[there], to_eye[there]
    combined[there, :3] = shade(at, facing, toward, surface, scene.lights, world, atlas, plane[there])
    combined[there, 3] = 1
    diffuse = np.zeros((len(start), 3))
    diffuse[there] = diffuse_color(facing, toward, surface, plane[there])
    if scene.instances.holdout is not None:
        combined[there & scene.instances.holdout[hit.instance]] = 0
    only = there[:, None]
    return Picture(
        combined.reshape(*shape, 4),
        np.where(there, hit.depth, BACKGROUND_DEPTH).reshape(shape),
        np.where(only, position, 0).reshape(*shape, 3),
        np.where(only, normal, 0).reshape(*shape, 3),
        diffuse.reshape(*shape, 3),
        hit.instance.reshape(shape),
        hit.material.reshape(shape),
    )


def _turned(normal: np.ndarray, linear: np.ndarray) -> np.ndarray:
    """Unit normals (N, 3) under a linear map: by its cofactors, which singular and mirroring maps have as well."""
    cofactor = np.stack(
        [np.cross(linear[1], linear[2]), np.cross(linear[2], linear[0]), np.cross(linear[0], linear[1])]
    )
    return _unit(normal @ cofactor.T)


def _unit(v: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.divide(v, length, out=np.zeros(v.shape), where=length > 0)
