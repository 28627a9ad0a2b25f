"""Cases whose light differs: from surfaces that emit, from an environment picture, from lights of every kind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pointsplat_addon.core.material.graph import MaterialGraph
from pointsplat_addon.core.material.nodes.input_nodes import Constant
from pointsplat_addon.core.material.nodes.normal_nodes import Tangent
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.world import World
from scripts.scenes.build import materials, mesh, moved, points, scene, sun
from scripts.scenes.cameras import camera
from scripts.scenes.case import Case
from scripts.scenes.clouds import sphere_cloud, sphere_points
from scripts.scenes.meshes import cube_mesh, plane_mesh, sphere_mesh


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


def reflections() -> Case:
    """Spheres of all kinds of reflection below a sun and an area light.

    Tinted metal, sheen, a toon, one that is cut out in part, a stretched highlight, and rough diffuse points.
    """
    f = np.float32
    table = materials(
        6,
        base_color=[[0.7, 0.5, 0.3]] * 6,
        metallic=[1, 0, 0, 0, 1, 0],
        roughness=[0.4, 0.5, 0.5, 0.5, 0.5, 0.5],
        tint=np.array([[0.2, 0.9, 0.4], *[[1, 1, 1]] * 5], f),
        sheen=np.array([[0, 0, 0, 0.5], [1, 0.5, 0.2, 0.5], *[[0, 0, 0, 0.5]] * 4], f),
        toon=np.array([[-1, -1], [-1, -1], [0.5, 0.3], *[[-1, -1]] * 3], f),
        holdout=np.array([0, 0, 0, 0.4, 0, 0], f),
        diffuse_roughness=np.array([0, 0, 0, 0.5, 0, 1], f),
    )
    tangent = Tangent(Constant((0.6,)), Constant((0.1,)))
    table = replace(table, graphs=(*(None,) * 4, MaterialGraph(tangent=tangent), None))
    things = []
    for row in range(5):
        ball = replace(sphere_mesh(f"reflecting {row}", 24), materials=(row,))
        things.append((mesh(ball, "POLYGONS"), moved((row % 3 - 1.0, 0, 0.5 - row // 3), 0.4)))
    count = 2000
    cloud = replace(sphere_cloud(count), material=np.full(count, 5, np.uint16))
    things.append((points("reflecting points", cloud), moved((1, 0, -0.5), 0.4)))
    lamp = Light(
        "AREA", np.full(3, 4.0), np.array([0.5, -2.0, 2.0]), np.array([0.0, 0.7, -0.7]),
        axis_u=np.array([0.4, 0, 0]), axis_v=np.array([0, 0.3, 0.3]),
    )  # fmt: skip
    return Case(scene(*things, lights=(sun(), lamp), table=table, transparent=True), camera())


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
