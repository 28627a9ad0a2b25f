"""Small analytic scenes that the tests of rendering share: each a `Case` of a scene and a camera that sees it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from pointsplat_addon.core.lod.cost import FEWER, Costs
from pointsplat_addon.core.material import expressions as ex
from pointsplat_addon.core.material.graph import MaterialGraph
from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.materials import MaterialTable, default_materials
from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.scene.scene import Geometry, Instances, Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.strands import Lines
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.devices.opengl import OpenGLDevice
from pointsplat_addon.render.passes.outputs import PASSES
from pointsplat_addon.render.plan.request import Request, Result
from pointsplat_addon.render.renderer import Renderer
from scripts.tower import COLORS, tower
from tests.support.store import STORE

ALL_PASSES = frozenset(p.key for p in PASSES)
RESOLUTION = (48, 40)
Vector = Sequence[float] | np.ndarray


@dataclass(frozen=True, eq=False)
class Case:
    """A scene, and how it is seen."""

    scene: Scene
    camera: Camera
    settings: Settings = field(default_factory=lambda: Settings(use_shadows=False))  # the reference has none

    def request(self, passes: frozenset[str] = ALL_PASSES, samples: int = 1) -> Request:
        return Request(self.camera, self.settings, passes, samples)


# Pictures of tests are small and of few samples: meshes are points in them where they are in large ones of many.
FREE_POINTS = replace(Costs(), prepared=1e-3, uploaded=1e-3)  # to prepare; what else they cost counts FEWER times
CHEAP_POINTS = replace(FREE_POINTS, point=FREE_POINTS.point / FEWER, pixel=FREE_POINTS.pixel / FEWER)


@cache
def _renderer() -> Renderer:
    """One renderer for all tests of a process, since compiling shaders takes most of their time."""
    renderer = Renderer(OpenGLDevice(), STORE)
    renderer.costs = CHEAP_POINTS
    return renderer


def opengl() -> Renderer:
    """That one, with its context made current: other tests of the process may have made another."""
    renderer = _renderer()
    assert isinstance(renderer.device, OpenGLDevice)
    renderer.device.context.__enter__()
    return renderer


def render(case: Case, passes: frozenset[str] = ALL_PASSES, samples: int = 1) -> Result:
    return opengl().render(case.scene, case.request(passes, samples))


# Cameras


def look_at(eye: Vector, target: Vector, up: Vector = (0, 0, 1)) -> np.ndarray:
    """view_from_world (4, 4)."""
    origin, back = np.asarray(eye, float), np.subtract(eye, target).astype(float)
    back /= np.linalg.norm(back)
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = right, np.cross(back, right), back
    matrix[:3, 3] = -matrix[:3, :3] @ origin
    return matrix


def camera(
    eye: Vector = (0, -4, 0),
    target: Vector = (0, 0, 0),
    resolution: tuple[int, int] = RESOLUTION,
    field_of_view: float = 40.0,
    near: float = 0.1,
    far: float = 100.0,
    region: tuple[int, int, int, int] | None = None,
    parallel: float | None = None,
    shift: tuple[float, float] = (0.0, 0.0),
) -> Camera:
    """`field_of_view` in degrees, or the width `parallel` in world units, spans the larger side; so does `shift`."""
    width, height = resolution
    largest = max(resolution)
    scale = 2 / parallel if parallel else 1 / np.tan(np.radians(field_of_view) / 2)
    clip = np.zeros((4, 4))
    clip[0, 0], clip[1, 1] = scale * largest / width, scale * largest / height
    column = 3 if parallel else 2
    sense = -1 if parallel else 1
    clip[:2, column] = sense * 2 * shift[0] * largest / width, sense * 2 * shift[1] * largest / height
    if parallel:
        clip[2, 2:] = -2 / (far - near), -(far + near) / (far - near)
        clip[3, 3] = 1
    else:
        clip[2, 2:] = -(far + near) / (far - near), -2 * far * near / (far - near)
        clip[3, 2] = -1
    return Camera(look_at(eye, target), clip, resolution, region, near, far)


# Shapes


def cube_mesh(key: str, size: float = 1.0) -> Mesh:
    """A cube from -size to size with flat normals, turned outwards."""
    corner = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], np.float32) * np.float32(size)
    quads = np.array([[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]], np.int32)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return flat_mesh(key, corner, triangles)


def flat_mesh(key: str, position: np.ndarray, triangles: np.ndarray, **more) -> Mesh:
    """A mesh whose corners have the normals of their triangles."""
    with np.errstate(all="ignore"):
        a, b, c = position[triangles].transpose(1, 0, 2)
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.nan_to_num(np.repeat(normal[:, None], 3, axis=1)).astype(np.float32)
    return Mesh(key, key, position, triangles.astype(np.int32), corner_normal=normal, **more)


def plane_mesh(key: str, size: float = 1.0, cells: int = 1) -> Mesh:
    """A square in XZ from -size to size that faces -Y, with its unit square as the UV map "UV"."""
    grid = np.linspace(0, 1, cells + 1)
    u, v = (a.ravel() for a in np.meshgrid(grid, grid))
    position = np.stack([(2 * u - 1) * size, np.zeros_like(u), (2 * v - 1) * size], axis=1).astype(np.float32)
    low = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    quad = np.stack([low, low + 1, low + cells + 2, low + cells + 1], axis=1)
    triangles = np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]])
    uv = np.stack([u, v], axis=1).astype(np.float32)[triangles]
    return flat_mesh(key, position, triangles, uv={"UV": uv}, active_uv="UV")


def sphere_mesh(key: str, rings: int = 24) -> Mesh:
    """A unit sphere with smooth normals: its vertices."""
    polar, around = np.meshgrid(
        np.pi * np.arange(rings + 1) / rings, np.pi * np.arange(2 * rings) / rings, indexing="ij"
    )
    position = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], -1)
    position = position.reshape(-1, 3).astype(np.float32)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(rings), np.arange(2 * rings), indexing="ij"))
    row, right = 2 * rings * i, (j + 1) % (2 * rings)
    a, b, c, d = row + j, row + 2 * rings + j, row + 2 * rings + right, row + right
    triangles = np.concatenate([np.stack([a, b, c], 1)[i > -1], np.stack([a, c, d], 1)[i > 0]])
    triangles = triangles[~np.isin(np.arange(len(triangles)), np.flatnonzero(i == rings - 1))]
    return Mesh(key, key, position, triangles.astype(np.int32), vertex_normal=position)


def sphere_points(count: int = 400, size: float = 1.0) -> np.ndarray:
    """(count, 3) float64: a spiral of nearly equal spacing (Fibonacci)."""
    i = np.arange(count) + 0.5
    polar, around = np.arccos(1 - 2 * i / count), np.pi * (1 + 5**0.5) * i
    return size * np.stack([np.cos(around) * np.sin(polar), np.sin(around) * np.sin(polar), np.cos(polar)], axis=1)


def sphere_cloud(count: int = 400, **more) -> PointCloud:
    """A unit sphere of disks that cover it."""
    position = sphere_points(count).astype(np.float32)
    radii = np.full((count, 1), 1.5 * np.sqrt(4 / count), np.float32)
    return PointCloud(position, normal=position.copy(), radii=radii, **more)


def plane_cloud(cells: int = 20, size: float = 1.0, **more) -> PointCloud:
    """A square in XZ from -size to size that faces -Y, of disks that cover it."""
    grid = ((np.arange(cells) + 0.5) / cells * 2 - 1) * size
    x, z = (a.ravel() for a in np.meshgrid(grid, grid))
    position = np.stack([x, np.zeros_like(x), z], axis=1).astype(np.float32)
    normal = np.tile(np.array([0, -1, 0], np.float32), (len(x), 1))
    radii = np.full((len(x), 1), np.sqrt(2) * size / cells, np.float32)
    return PointCloud(position, normal=normal, radii=radii, **more)


# Scenes


def sun(strength: float = 3.0, direction: Vector = (0.4, 0.7, -0.5)) -> Light:
    return Light("SUN", np.full(3, strength), np.zeros(3), np.asarray(direction) / np.linalg.norm(direction))


def materials(count: int = 1, **columns) -> MaterialTable:
    """Rows like the default one, of which `columns` replace some."""
    table = default_materials()
    names = {f: np.repeat(getattr(table, f), count, axis=0) for f in table.__dataclass_fields__ if f not in FIELDS}
    hashes = np.arange(1, count + 1, dtype=np.uint32) * np.uint32(0x01234567)
    names |= {"pass_index": np.arange(10, 10 + count, dtype=np.int32), "hash": hashes}
    given = {name: np.asarray(value, names[name].dtype) for name, value in columns.items() if name in names}
    rest = {name: value for name, value in columns.items() if name not in names}
    return replace(
        table, **{**names, "names": tuple(map(str, range(count))), "graphs": (None,) * count, **given, **rest}
    )


FIELDS = ("names", "graphs", "anisotropy", "translucent", "media", "hair")


def moved(offset: Vector = (0, 0, 0), scale: float | Vector = 1.0) -> np.ndarray:
    matrix = np.diag(np.append(np.broadcast_to(np.asarray(scale, float), 3), 1.0))
    matrix[:3, 3] = offset
    return matrix


def scene(
    *things: tuple[Geometry, np.ndarray],
    lights: Sequence[Light] | None = None,
    world: World | None = None,
    table: MaterialTable | None = None,
    transparent: bool = False,
    holdout: Sequence[bool] | None = None,
    **more,
) -> Scene:
    """Instances (geometry, world_from_object) lit by one sun and a weak world."""
    geometries = tuple(dict.fromkeys(geometry for geometry, _ in things))
    count = len(things)
    instances = Instances(
        np.array([geometries.index(geometry) for geometry, _ in things], np.int32),
        np.array([matrix for _, matrix in things], float).reshape(count, 4, 4),
        pass_index=np.arange(1, count + 1, dtype=np.int32),
        holdout=None if holdout is None else np.asarray(holdout, bool),
        object_hash=np.arange(1, count + 1, dtype=np.uint32) * np.uint32(0x02468ACE),
        names=tuple(f"{geometry.name} {i}" for i, (geometry, _) in enumerate(things)),
    )
    return Scene(
        geometries,
        instances,
        table or materials(),
        tuple([sun()] if lights is None else lights),
        world or World(np.array([0.1, 0.12, 0.15])),
        transparent,
        **more,
    )


def points(key: str, cloud: PointCloud) -> Geometry:
    return Geometry(key, key, cloud=cloud)


def mesh(of: Mesh, primitive: str = "AUTO", spacing: float = 0.0) -> Geometry:
    return Geometry(of.key, of.name, mesh=of, primitive=primitive, spacing=spacing)


def empty() -> Case:
    return Case(scene(), camera())


def cube() -> Case:
    return Case(scene((mesh(cube_mesh("cube")), moved())), camera((2, -4, 1.5)))


def sphere() -> Case:
    color = (sphere_points() * 0.4 + 0.5).astype(np.float32)
    return Case(scene((points("sphere", sphere_cloud(color=color)), moved())), camera())


def plain_sphere() -> Case:
    """Nothing varies: material constants only."""
    return Case(scene((points("plain sphere", sphere_cloud()), moved())), camera())


def mixed() -> Case:
    """A cube that cuts through a sphere of points."""
    return Case(
        scene(
            (points("mixed sphere", sphere_cloud()), moved((-0.4, 0, 0))),
            (mesh(cube_mesh("mixed cube", 0.7), "POLYGONS"), moved((0.5, 0, 0))),
        ),
        camera((1, -4, 1)),
    )


def picture(width: int = 16, height: int = 8) -> ex.Image:
    """Smooth colours, so that a texel's share of a pixel matters little."""
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    texels = np.stack([u, v, 1 - u * v, np.ones_like(u)], axis=-1)
    return ex.Image(texels.astype(np.float32))


def textured() -> Case:
    """A plane whose base colour is a picture, seen obliquely, beside the same as points."""
    graph = MaterialGraph(base_color=ex.Color(ex.ImageTexture(ex.UV(), picture())))
    return Case(
        scene(
            (mesh(plane_mesh("textured polygons"), "POLYGONS"), moved((-1.05, 0, 0))),
            (mesh(plane_mesh("textured points", cells=16), "POINTS"), moved((1.05, 0, 0))),
            table=materials(graphs=(graph,)),
        ),
        camera((0.5, -5, 1)),
    )


def instances() -> Case:
    """Points and polygons, each plain, mirrored, sheared, of zero scale, and nowhere."""
    cloud, block = points("instanced sphere", sphere_cloud(200)), mesh(cube_mesh("instanced cube"), "POLYGONS")
    sheared = moved((0, 0, 0), 0.3)
    sheared[0, 2] = 0.2
    lost = moved()
    lost[0, 3] = np.nan
    things = []
    for geometry, z in ((cloud, 0.6), (block, -0.6)):
        for x, matrix in (
            (-1.0, moved(scale=0.3)),
            (-0.3, moved(scale=(-0.3, 0.3, 0.2))),
            (0.4, sheared),
            (1.0, moved(scale=0.0)),
            (1.1, moved(scale=(0.3, 0.3, 0.0))),
            (0.0, lost),
        ):
            matrix = matrix.copy()
            matrix[:3, 3] += x, 0, z
            things.append((geometry, matrix))
    return Case(scene(*things), camera())


def balls() -> Case:
    """A cloud without normals."""
    cloud = replace(sphere_cloud(60), normal=None, radii=np.full((60, 1), 0.25, np.float32))
    return Case(scene((points("balls", cloud), moved())), camera())


def wide_balls() -> Case:
    """Balls of many pixels that overlap, also turned to ellipsoids, mirrored, around the eye and beyond the frame."""
    rng = np.random.default_rng(5)
    color = rng.random((40, 3), np.float32)
    radius = rng.uniform(0.1, 0.5, (40, 1)).astype(np.float32)
    position = rng.uniform(-1, 1, (40, 3)).astype(np.float32)
    geometry = points("wide balls", PointCloud(position, radii=radius, color=color))
    sheared = moved((1, 1.5, 0.5), (0.6, -0.9, 0.4))
    sheared[0, 2] = 0.5
    around = points(
        "around the eye", PointCloud(np.array([[0.0, -4.5, 0.0]], np.float32), radii=np.full((1, 1), 2.0, "f4"))
    )
    block = mesh(cube_mesh("cut cube", 0.7), "POLYGONS")
    things = ((geometry, moved()), (geometry, sheared), (around, moved((-3, 0, 1))), (block, moved((-0.5, 0.3, -0.4))))
    return Case(scene(*things), camera())


def parallel_balls() -> Case:
    """The same in a parallel view."""
    return replace(wide_balls(), camera=camera((0.5, -5, 1), parallel=4.0))


def emission() -> Case:
    """Light comes from the surfaces alone."""
    glow = np.abs(sphere_points()).astype(np.float32) * 3
    table = materials(2, base_color=np.zeros((2, 3)), emission=[[0, 0, 0], [0.2, 0.5, 1]], specular=[0, 0])
    block = replace(cube_mesh("glowing cube", 0.6), materials=(1,), material=np.full(12, 1, np.uint16))
    return Case(
        scene(
            (points("glowing sphere", sphere_cloud(emission=glow)), moved((-0.7, 0, 0))),
            (mesh(block, "POLYGONS"), moved((1, 0, 0))),
            lights=(),
            world=World(),
            table=table,
        ),
        camera(),
    )


def holdout() -> Case:
    """Spheres and cubes, of which one each cuts a hole, before a plane; on a transparent film."""
    ball, block = points("cut sphere", sphere_cloud(200)), mesh(cube_mesh("cut cube"), "POLYGONS")
    return Case(
        scene(
            (mesh(plane_mesh("cut plane", 1.2), "POLYGONS"), moved((0, 1, 0))),
            (ball, moved((-0.6, 0, 0.6), 0.4)),
            (ball, moved((0.6, 0, 0.6), 0.4)),
            (block, moved((-0.6, 0, -0.6), 0.3)),
            (block, moved((0.6, 0, -0.6), 0.3)),
            holdout=(False, True, False, False, True),
            transparent=True,
        ),
        camera(),
    )


def environment() -> Case:
    """Light from a picture only: a bright patch on a gradient."""
    image = np.zeros((16, 32, 3), np.float32)
    image[:] = np.linspace(0.1, 1, 16)[:, None, None] * np.array([0.5, 0.7, 1.0], np.float32)
    image[10:13, 20:24] = 8.0
    table = materials(roughness=[0.3])
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    return Case(
        scene(
            (points("sphere in light", sphere_cloud()), moved()),
            lights=(),
            world=World(np.zeros(3), image, turn),
            table=table,
        ),
        camera(),
    )


def lights() -> Case:
    """Every kind of light on a sphere and a plane."""
    down = np.array([0.0, 0.0, -1.0])
    away = np.array([0.0, 1.0, 0.0])
    x, z = np.array([0.4, 0, 0]), np.array([0, 0, 0.3])
    kinds = (
        sun(0.5),
        Light("SUN", np.array([0.2, 0.4, 0.6]), np.zeros(3), away, radius=0.2),
        Light("POINT", np.array([2.0, 1, 1]), np.array([-2.0, -2, 1]), down),
        Light("POINT", np.array([1.0, 2, 1]), np.array([1.0, -2, 1]), down, radius=0.3, soft=False),
        Light("POINT", np.array([1.0, 1, 2]), np.array([1.0, -2, -1]), down, radius=0.3),
        Light("SPOT", np.array([9.0, 3, 3]), np.array([-1.0, -3, 1]), away, 0.1, np.cos(0.3), 0.5),
        Light("AREA", np.array([2.0, 4, 2]), np.array([0.0, -2, -1.5]), away, axis_u=x, axis_v=z),
        Light("AREA", np.array([3.0, 1, 4]), np.array([1.5, -2, 0]), away, axis_u=x, axis_v=z, ellipse=True),
        Light("AREA", np.array([9.0, 9, 2]), np.array([-1.5, -2, 0]), away, axis_u=x, axis_v=z, spread=0.8),
    )
    return Case(
        scene(
            (points("lit sphere", sphere_cloud()), moved((-1, 0, 0))),
            (mesh(plane_mesh("lit plane", 0.9), "POLYGONS"), moved((1, 0, 0))),
            lights=kinds,
            table=materials(roughness=[0.35]),
        ),
        camera((0, -5, 0)),
    )


def inside() -> Case:
    """The camera stands inside a sphere of points, a cube around it and a splat at the eye."""
    at_eye = PointCloud(
        np.zeros((1, 3), np.float32),
        normal=np.array([[0, 0, 1]], np.float32),
        radii=np.full((1, 1), 0.2, np.float32),
    )
    return Case(
        scene(
            (points("sphere around", sphere_cloud()), moved(scale=2)),
            (mesh(cube_mesh("cube around"), "POLYGONS"), moved(scale=1.6)),
            (points("at the eye", at_eye), moved()),
            lights=(Light("POINT", np.full(3, 5.0), np.array([0.3, 0, 0.2]), np.array([0.0, 0, -1]), 0.1),),
        ),
        camera((0, 0, 0), (0, 1, 0), field_of_view=90),
    )


def far_away() -> Case:
    """Ten million units from the origin: once by the instances' transforms, once by a cloud's own origin."""
    at = np.array([1e7, -2e7, 1e7])
    by_origin = sphere_cloud(200, origin=at)
    return Case(
        scene(
            (points("far sphere", by_origin), moved((-0.7, 0, 0))),
            (mesh(cube_mesh("far cube", 0.6), "POLYGONS"), moved(at + np.array([0.8, 0, 0]))),
            (points("far moved", sphere_cloud(200)), moved(at + np.array([0.8, -0.9, 0.3]), 0.3)),
        ),
        camera(at - np.array([0, 4, 0]), at),
    )


def scales() -> Case:
    """A sphere and a cube of a millionth, before a plane of a hundred thousand."""
    return Case(
        scene(
            (points("tiny sphere", sphere_cloud(200)), moved((-1e-6, 0, 0), 1e-6)),
            (mesh(cube_mesh("tiny cube"), "POLYGONS"), moved((1e-6, 0, 0), 6e-7)),
            (mesh(plane_mesh("huge plane"), "POLYGONS"), moved((2e4, 1e5, 0), 1e5)),
        ),
        camera((0, -5e-6, 0), near=1e-7, far=1e6),
    )


def not_finite() -> Case:
    """Points and vertices that are NaN or infinite beside good ones."""
    cloud, block = sphere_cloud(200), cube_mesh("broken cube", 0.6)
    position, radii = cloud.position.copy(), cloud.radii.copy() if cloud.radii is not None else None
    assert radii is not None
    position[:40:2] = np.nan
    position[1:40:2, 1] = np.inf
    radii[50:60] = np.nan
    corners = block.position.copy()
    corners[0] = np.nan, np.inf, 0
    return Case(
        scene(
            (points("broken sphere", replace(cloud, position=position, radii=radii)), moved((-0.7, 0, 0))),
            (mesh(flat_mesh("broken cube", corners, block.triangles), "POLYGONS"), moved((0.9, 0, 0))),
        ),
        camera(),
    )


def parallel() -> Case:
    """An orthographic camera within the scene, whose clip start lies behind it."""
    return Case(
        scene(
            (points("parallel sphere", sphere_cloud()), moved((-0.6, 0, 0))),
            (mesh(cube_mesh("parallel cube", 0.6), "POLYGONS"), moved((0.9, 0.5, 0))),
        ),
        camera((0.5, -0.2, 0.3), (0, 0.5, 0), parallel=4.0, near=-10.0, far=10.0, shift=(0.05, -0.1)),
    )


def region() -> Case:
    """A border around a part of `mixed`."""
    case = mixed()
    return replace(case, camera=replace(case.camera, region=(7, 9, 30, 21)))


def unlit() -> Case:
    """No light at all: everything is black, and there."""
    case = mixed()
    return replace(case, scene=replace(case.scene, lights=(), world=World()))


def moving() -> Case:
    """A cube of polygons, one of points and the camera, all in motion."""
    case = Case(
        scene(
            (mesh(plane_mesh("moving polygons", 0.8), "POLYGONS"), moved((-1, 0, 0))),
            (points("moving points", plane_cloud(12, 0.8)), moved((1, 0, 0))),
        ),
        camera(),
    )
    here = case.scene.instances
    before = here.world_from_object.copy()
    before[0, :3, 3] += 0.2, 0.1, -0.1
    before[1, :3, 3] -= 0.1, 0.3, 0.2
    previous = look_at((0.1, -4.2, 0.1), (0, 0, 0.2))
    return replace(
        case,
        scene=replace(case.scene, instances=replace(here, previous=before)),
        camera=replace(case.camera, previous_view_from_world=previous),
    )


def culled() -> Case:
    """Half a sphere of each kind, whose material hides back faces, seen from behind."""
    cloud = sphere_cloud(400)
    table = materials(cull=[True])
    return Case(
        scene(
            (points("open sphere", cloud.take(cloud.position[:, 1] > 0)), moved((-1, 0, 0))),
            (
                mesh(plane_mesh("back of a plane", 0.8), "POLYGONS"),
                moved((1, 0, 0), (1, -1, 1)) @ np.diag([-1.0, 1, 1, 1]),
            ),
            (mesh(cube_mesh("closed cube", 0.4), "POLYGONS"), moved((1, 1, 0))),
            table=table,
        ),
        camera(),
    )


def smoke_cloud(cells: int = 12, extinction: float | Vector = 2.0, **more) -> PointCloud:
    """A unit ball of voxels, each a Gaussian of 0.6 voxels' edges as its standard deviation."""
    edge = 2 / cells
    middle = (np.arange(cells) + 0.5) * edge - 1
    position = np.stack(np.meshgrid(middle, middle, middle, indexing="ij"), -1).reshape(-1, 3)
    position = position[(position**2).sum(axis=1) < 1].astype(np.float32)
    radius = 1.2 * edge
    share = np.asarray(extinction, np.float32) * np.float32(edge**3 / (4 / 3 * np.pi * radius**3))
    given = np.broadcast_to(share, (len(position), *share.shape)).copy()
    return PointCloud(position, radii=np.full((len(position), 1), radius, np.float32), extinction=given, **more)


def smoke() -> Case:
    """A ball of smoke with a lamp in it, through which a cube of polygons and a sphere of points stick."""
    cloud = smoke_cloud()
    lamp = Light("POINT", np.full(3, 3.0), np.array([0.1, -0.3, 0.2]), np.array([0.0, 0, -1]))
    return Case(
        scene(
            (points("smoke", replace(cloud, color=np.abs(cloud.position))), moved()),
            (mesh(cube_mesh("cube in smoke", 0.5), "POLYGONS"), moved((0.8, 0, 0))),
            (points("sphere in smoke", sphere_cloud(200)), moved((-0.8, 0, 0), 0.5)),
            lights=(lamp, sun(1.0)),
            table=materials(anisotropy=np.array([0.4], np.float32)),
        ),
        camera(),
        Settings(shadow_resolution=64),
    )


def tinted_smoke() -> Case:
    """A ball whose extinction is coloured and that glows, before a plane on which its shadow falls."""
    cloud = smoke_cloud(10, (0.5, 1.0, 3.0))
    return Case(
        scene(
            (points("tinted smoke", replace(cloud, emission=0.1 * np.abs(cloud.position))), moved()),
            (mesh(plane_mesh("plane behind smoke", 2.0), "POLYGONS"), moved((0, 1.5, 0))),
        ),
        camera(),
        Settings(shadow_resolution=64),
    )


def panes() -> Case:
    """Coloured panes of glass, one behind the other, and a cube of which half is glass."""
    colors, alphas = [[0.8, 0.8, 0.8], [0.9, 0.2, 0.1], [0.1, 0.3, 0.9]], [1.0, 0.4, 0.7]
    table = materials(3, base_color=colors, alpha=alphas, translucent=np.array([False, True, True]))
    half = replace(cube_mesh("half a cube", 0.4), material=np.repeat(np.array([0, 2], np.uint16), 6), materials=(0, 2))
    front, back = (replace(plane_mesh(f"pane {row}", 0.7), materials=(row,)) for row in (1, 2))
    return Case(
        scene(
            (mesh(front), moved((-0.3, -0.5, 0.2))),
            (mesh(back), moved((0.3, 0.5, -0.2))),
            (mesh(half, "POLYGONS"), moved((0.5, 0, 0.5))),
            table=table,
        ),
        camera((0.5, -4, 0.5)),
        Settings(shadow_resolution=64),
    )


def in_smoke() -> Case:
    """The camera stands in a ball of smoke."""
    return Case(scene((points("around the camera", smoke_cloud(10)), moved(scale=2))), camera((0.2, 0, 0), (0, 1, 0)))


def leaves(count: int, depth: float) -> PointCloud:
    """Disks in all directions, strewn over the unit ball; their seen areas add up to `depth` times its silhouette."""
    rng = np.random.default_rng(0)
    p, normal = rng.standard_normal((2, count, 3))
    p *= np.cbrt(rng.random((count, 1))) / np.linalg.norm(p, axis=1, keepdims=True)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    radii = np.full((count, 1), np.sqrt(2 * depth / count), np.float32)
    return PointCloud(p.astype(np.float32), normal=normal.astype(np.float32), radii=radii)


def strand_lines(key: str, strands: Sequence[np.ndarray], radius: float | np.ndarray, **more) -> Geometry:
    """Strands (n, 3) with a radius for all or one for each of their points."""
    position = np.concatenate(strands).astype(np.float32)
    start = np.concatenate([[0], np.cumsum([len(strand) for strand in strands])])
    radii = np.broadcast_to(np.asarray(radius, np.float32), len(position)).copy()
    return Geometry(key, key, lines=Lines(key, key, position, start, radii, **more), primitive="LINES")


def strands() -> Case:
    """A coloured tube about a cube, a twisted ribbon, hair thinner than a pixel, and what is no strand, in shadows."""
    turn = np.linspace(0, 3 * np.pi, 24)
    spring = np.stack([0.8 * np.cos(turn), 0.8 * np.sin(turn), 0.15 * turn - 0.7], axis=1)
    u = np.linspace(-1.3, 1.3, 30)
    normal = np.stack([0 * u, np.cos(3 * u), np.sin(3 * u)], axis=1).astype(np.float32)
    rng = np.random.default_rng(4)
    roots = rng.uniform(-1, 1, (400, 1, 3)) * [1.2, 0.3, 0.05] + [0, 0, -1.0]
    hair = roots + np.linspace(0, 0.5, 6)[:, None] * [0.1, 0, 1] + rng.normal(0, 0.01, (400, 6, 3))
    lost = np.array([[0, np.nan, 0], [1, 0, 1.0], [1, 0, 1.0], [0.5, 0, 1.0]])
    return Case(
        scene(
            (mesh(cube_mesh("cube in a spring", 0.4), "POLYGONS"), moved()),
            (strand_lines("spring", [spring, lost], 0.08, color=rng.random((28, 3), np.float32)), moved()),
            (strand_lines("ribbon", [np.stack([u, 0 * u, 0 * u + 1.1], axis=1)], 0.12, normal=normal), moved()),
            (strand_lines("hair", list(hair), 0.004), moved((0, -0.8, 0), (1, 1, 0.8))),
        ),
        camera((0.6, -4, 0.8)),
        Settings(shadow_resolution=64),
    )


def foliage() -> Case:
    """A crown of small leaves before a ball, and a few wide ones."""
    crown, wide = points("crown", leaves(3000, 0.7)), points("wide leaves", leaves(60, 0.4))
    trunk = points("trunk", sphere_cloud(2000))
    things = ((crown, moved()), (wide, moved((0.9, 0, 0.6), 0.5)), (trunk, moved((0, 1.5, -0.5), 0.6)))
    return Case(scene(*things), camera((0, -5, 0)))


def small_tower(key: str) -> Mesh:
    """A tower of 4,000 triangles in four materials."""
    position, triangles, kind = tower(((4, 6), (3, 6), (2, 5)), 4000)
    return flat_mesh(key, position, triangles, material=kind, materials=(0, 1, 2, 3))


def many_towers() -> Case:
    """Instances that share levels, some of them thinned away, of a body with edges."""
    block = small_tower("tower of a field")
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-2, 2, 16), np.geomspace(3, 2500, 40)))
    of = mesh(block, "POINTS")
    things = [(of, moved((a * max(b / 8, 1), b, 0))) for a, b in zip(x, y, strict=True)]
    table = materials(4, base_color=np.array(COLORS, np.float32))
    return Case(scene(*things, table=table), camera((0.3, -12, 4), (0, 4, 0), far=5000.0))


def split_mesh() -> Case:
    """A mesh whose near parts are triangles and whose far ones points."""
    eye, target = (0.0, -19.5, 1.2), (0.0, -10.0, 0.0)
    ground = plane_mesh("split ground", 20.0, 450)
    turned = moved()
    turned[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    ground = replace(ground, uv={}, active_uv=None)
    return Case(scene((mesh(ground), turned)), camera(eye, target, (128, 128), field_of_view=50, near=0.05))


CASES: dict[str, Callable[[], Case]] = {
    function.__name__: cache(function)
    for function in (
        empty,
        cube,
        sphere,
        plain_sphere,
        mixed,
        textured,
        instances,
        balls,
        wide_balls,
        parallel_balls,
        emission,
        holdout,
        environment,
        lights,
        inside,
        far_away,
        scales,
        not_finite,
        parallel,
        region,
        unlit,
        moving,
        culled,
        smoke,
        tinted_smoke,
        panes,
        in_smoke,
        foliage,
        many_towers,
        split_mesh,
        strands,
    )
}
