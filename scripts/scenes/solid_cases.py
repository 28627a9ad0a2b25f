"""Cases of opaque points and polygons: plain, textured, instanced, held out, moving and culled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pointsplat_addon.core.material.graph import MaterialGraph
from pointsplat_addon.core.material.nodes import color_nodes, input_nodes, math_nodes, texture_nodes
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from scripts.scenes.build import materials, mesh, moved, picture, points, scene
from scripts.scenes.cameras import camera, look_at
from scripts.scenes.case import Case
from scripts.scenes.clouds import plane_cloud, sphere_cloud, sphere_points
from scripts.scenes.meshes import cube_mesh, plane_mesh, sphere_mesh

EXTENSIONS = "MIRROR", "CLIP"  # of the images of `cut_out_cards`


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


def textured() -> Case:
    """A plane whose base colour is a picture, seen obliquely, beside the same as points."""
    graph = MaterialGraph(base_color=color_nodes.Color(texture_nodes.ImageTexture(input_nodes.UV(), picture())))
    return Case(
        scene(
            (mesh(plane_mesh("textured polygons"), "POLYGONS"), moved((-1.05, 0, 0))),
            (mesh(plane_mesh("textured points", cells=16), "POINTS"), moved((1.05, 0, 0))),
            table=materials(graphs=(graph,)),
        ),
        camera((0.5, -5, 1)),
    )


def waves() -> Case:
    """A function of where things are as colour, roughness, light and normal, on a mesh with instances and on small ones
    that share a page."""
    zero = input_nodes.Constant((0.0,))

    def wave(axis: int, frequency: float) -> math_nodes.Math:
        place = color_nodes.Component(input_nodes.Coordinates("position"), axis)
        angle = math_nodes.Math(place, input_nodes.Constant((frequency,)), zero, "MULTIPLY")
        sine = math_nodes.Math(angle, zero, zero, "SINE")
        return math_nodes.Math(sine, sine, zero, "MULTIPLY")

    color = color_nodes.Color(wave(0, 2.0))
    graphs = (
        MaterialGraph(base_color=color, roughness=wave(1, 2.0), emission=color_nodes.Color(wave(2, 1.2))),
        MaterialGraph(base_color=color, normal=input_nodes.Coordinates("position")),
    )
    large, small = mesh(cube_mesh("waves"), "POLYGONS"), replace(cube_mesh("waves small", 0.5), materials=(1,))
    return Case(
        scene(
            (mesh(plane_mesh("waves floor", size=3.0), "POLYGONS"), moved((0, 0, -0.8))),
            (mesh(small, "POLYGONS"), moved((-0.9, -0.6, 0), 0.4)),
            (large, moved((0.6, 0.5, 0), 0.7)),
            (large, moved((1.8, 1.5, 0.4), 1.2)),
            table=materials(2, graphs=graphs),
        ),
        camera((0.5, -5, 2)),
        Settings(technique="VISIBILITY", use_shadows=False),
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


def many_balls() -> Case:
    """Sixteen clouds of balls, turned and stretched, of so many that the visibility buffer draws nodes."""
    rng = np.random.default_rng(3)
    direction = rng.normal(size=(3000, 3))
    position = (direction / np.linalg.norm(direction, axis=1, keepdims=True)).astype(np.float32)
    cloud = PointCloud(position, radii=np.full((3000, 1), 0.03, np.float32), color=np.abs(position))
    geometry, things = points("many balls", cloud), []
    for i in range(16):
        matrix = moved((1.1 * (i % 4) - 1.6, 0.3 * i, 1.1 * (i // 4) - 1.6), (0.5, 0.4, 0.3 + 0.02 * i))
        matrix[0, 1] = 0.1
        things.append((geometry, matrix))
    return Case(scene(*things), camera((0, -6, 0)))


def many_triangles() -> Case:
    """A ball of so many triangles that compute shaders draw them, and an instance of it."""
    geometry = mesh(sphere_mesh("many triangles", 120), "POLYGONS")
    return Case(scene((geometry, moved()), (geometry, moved((0.9, 0.5, 0.4), (-0.6, 0.5, 0.7)))), camera((0, -4, 0)))


def many_small_meshes() -> Case:
    """Different balls of one page, so many triangles that compute shaders draw them, half of them behind a wall."""
    balls = [mesh(sphere_mesh(f"one of many {i}", 20 + i % 3), "POLYGONS") for i in range(16)]
    places = [moved((0.4 * (i % 4) - 0.6, 1.0 + 0.2 * i, 0.4 * (i // 4) - 0.6), (0.15,) * 3) for i in range(16)]
    wall = mesh(plane_mesh("before many"), "POLYGONS")
    return Case(scene(*zip(balls, places, strict=True), (wall, moved((1.0, 0, 0)))), camera((0, -4, 0)))


def cut_out_cards() -> Case:
    """Cards with an alpha, instances of one mesh and one of another, that cast onto a cube under a sun."""
    images = [texture_nodes.ImageTexture(input_nodes.UV(), picture(), straight=True, extension=e) for e in EXTENSIONS]
    graphs = (MaterialGraph(base_color=color_nodes.Color(i), alpha=color_nodes.Component(i, 0)) for i in images)
    several, one = (replace(plane_mesh(f"cut out {row}"), materials=(row,)) for row in (1, 2))
    cards = [(mesh(several, "POLYGONS"), moved((0.3 * i - 0.4, -1.0 - 0.2 * i, 0.1 * i))) for i in range(3)]
    cards.append((mesh(one, "POLYGONS"), moved((0.5, -2.0, 0.4))))
    return Case(
        scene((mesh(cube_mesh("behind")), moved()), *cards, table=materials(3, graphs=(None, *graphs))), camera()
    )


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


def flowing() -> Case:
    """Points that move within objects which move, too: disks, balls, and disks that stand still."""
    square = plane_cloud(12, 0.5)
    assert square.radii is not None
    still = scene(
        (points("flowing disks", with_velocity(square, (0.1, 0.2, -0.15))), moved((-1.2, 0, 0), (1, 1, 1.4))),
        (points("resting disks", square), moved()),
        (points("flowing balls", with_velocity(replace(square, normal=None), (-0.3, 0, 0.1))), moved((1.2, 0, 0))),
    )
    case = moving()
    before = still.instances.world_from_object.copy()
    before[0, :3, 3] += 0.05, 0.1, 0.2
    return replace(case, scene=replace(still, instances=replace(still.instances, previous=before)))


def with_velocity(cloud: PointCloud, velocity: tuple[float, float, float]) -> PointCloud:
    """The cloud whose points all move so far in a frame, in object units."""
    return replace(cloud, velocity=np.tile(np.array(velocity, np.float32), (len(cloud), 1)))


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
