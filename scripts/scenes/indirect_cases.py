"""Cases with indirect light: in a corner by a sun and a sky; among balls and strands by what glows and by a picture;
under smoke, among mirrors, beside captured splats."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pointsplat_addon.core.scene.captured import CapturedSplats
from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.scene.scene import Geometry
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from scripts.scenes.build import captured, materials, mesh, moved, points, scene, strand_lines, sun
from scripts.scenes.cameras import camera
from scripts.scenes.case import Case
from scripts.scenes.clouds import smoke_cloud, sphere_cloud
from scripts.scenes.lit_cases import environment
from scripts.scenes.meshes import cube_mesh, plane_mesh, sphere_mesh

SETTINGS = Settings(technique="VISIBILITY", use_indirect=True, bounces=2)
LAID = np.array([[1.0, 0, 0, 0], [0, 0, -1, -0.8], [0, 1, 0, 0], [0, 0, 0, 1]])  # planes stand upright


def in_a_corner() -> Case:
    """A cube on a floor before a wall."""
    table = materials(2, base_color=[[0.7, 0.7, 0.7], [0.7, 0.1, 0.1]])
    block = replace(cube_mesh("red cube", 0.8), materials=(1,), material=np.full(12, 1, np.uint16))
    floor, wall = (mesh(plane_mesh(name, 4.0), "POLYGONS") for name in ("floor", "wall"))
    things = ((floor, LAID @ moved((0, 0, 0.4))), (wall, moved((0, 1.2, 0))), (mesh(block, "POLYGONS"), moved()))
    lit = scene(*things, lights=[sun(2.0)], world=World(np.array([0.3, 0.4, 0.6])), table=table)
    return Case(lit, camera((0.4, -3.0, 0.6)), SETTINGS)


def among_mirrors() -> Case:
    """A ball and a wall of metal, and a red cube, on a polished floor."""
    looks = {"base_color": [[0.2, 0.2, 0.25], [0.7, 0.1, 0.1], [0.9, 0.85, 0.8]], "metallic": [0, 0, 1]}
    table = materials(3, roughness=[0.15, 0.6, 0.0], **looks)

    def of(made: Mesh, row: int) -> Geometry:
        return mesh(replace(made, key=f"{made.key} of {row}", materials=(row,), material=None), "POLYGONS")

    things = (
        (of(plane_mesh("polished floor", 4.0), 0), LAID @ moved((0, 0, 0.4))),
        (of(plane_mesh("metal wall", 4.0), 2), moved((0, 1.2, 0))),
        (of(sphere_mesh("metal ball", 16), 2), moved((-0.6, -0.3, -0.35), 0.4)),
        (of(cube_mesh("mirrored cube", 0.5), 1), moved((0.5, 0, 0))),
    )
    lit = scene(*things, lights=[sun(2.0)], world=World(np.array([0.3, 0.4, 0.6])), table=table)
    return Case(lit, camera((0.4, -3.0, 0.6)), SETTINGS)


def beside_captured() -> Case:
    """A cube on a floor beside captured splats that glow in a circle."""
    turn = np.linspace(0, 2 * np.pi, 300)
    position = np.stack([0.5 * np.cos(turn), 0 * turn, 0.5 * np.sin(turn)], axis=1).astype(np.float32)
    count, f = len(position), np.float32
    splats = CapturedSplats(
        position, np.full((count, 3), 0.05, f), np.tile(np.array([[1, 0, 0, 0]], f), (count, 1)),
        np.tile(np.array([[1.5, 0.5, 0]], f), (count, 1)), np.full(count, 0.8, f),
    )  # fmt: skip
    things = (
        (mesh(plane_mesh("floor beside splats", 4.0), "POLYGONS"), LAID @ moved((0, 0, 0.4))),
        (mesh(cube_mesh("cube beside splats", 0.5), "POLYGONS"), moved((0.9, 0, 0))),
        (captured("circle of splats", splats), moved((-0.3, 0, 0))),
    )
    lit = scene(*things, lights=(), world=World(np.full(3, 0.2)), table=materials())
    return Case(lit, camera((0.4, -3.0, 0.6)), replace(SETTINGS, bounces=1))


def among_balls_and_strands() -> Case:
    """A glowing cube beside balls, under strands and a picture of the sky."""
    table = materials(2, emission=[[0, 0, 0], [2.0, 1.0, 0.3]], roughness=[0.3, 0.5])
    block = replace(cube_mesh("glowing cube", 0.5), materials=(1,), material=np.full(12, 1, np.uint16))
    x = np.linspace(-1.17, 1.21, 12)
    lines = strand_lines("strands over balls", [np.array([[a, -0.6, 0.7], [a, 0.6, 0.8]]) for a in x], 0.02)
    things = (
        (points("balls in a glow", replace(sphere_cloud(), normal=None)), moved((-0.5, 0, 0), 0.7)),
        (mesh(block, "POLYGONS"), moved((0.7, 0, -0.2))),
        (lines, moved()),
        (mesh(plane_mesh("floor under a glow", 4.0), "POLYGONS"), LAID),
    )
    lit = scene(*things, lights=(), world=environment().scene.world, table=table)
    return Case(lit, camera((0.4, -3.0, 0.8)), SETTINGS)


def under_smoke() -> Case:
    """A ball of smoke over a floor, beside a red cube, by a sun and a sky."""
    table = materials(2, base_color=[[0.7, 0.7, 0.7], [0.7, 0.1, 0.1]], anisotropy=np.array([0.3, 0], np.float32))
    block = replace(cube_mesh("cube beside smoke", 0.8), materials=(1,), material=np.full(12, 1, np.uint16))
    cloud = smoke_cloud(8, 3.0)
    things = (
        (
            points("smoke over a floor", replace(cloud, color=np.full_like(cloud.position, 0.9))),
            moved((-0.4, 0, 0), 0.7),
        ),
        (mesh(block, "POLYGONS"), moved((0.9, 0, -0.4))),
        (mesh(plane_mesh("floor under smoke", 4.0), "POLYGONS"), LAID),
    )
    lit = scene(*things, lights=[sun(2.0)], world=World(np.array([0.3, 0.4, 0.6])), table=table)
    return Case(lit, camera((0.4, -3.0, 0.6)), replace(SETTINGS, shadow_resolution=64))


def in_a_room() -> Case:
    """A closed room under a sky, whose light is a glowing block at its ceiling, with a red cube in it."""
    looks = {"base_color": [[0.7, 0.7, 0.65], [0.7, 0.1, 0.1], [0.8, 0.8, 0.8]]}
    table = materials(3, emission=[[0, 0, 0], [0, 0, 0], [3.0, 2.6, 2.0]], **looks)

    def block(name: str, row: int) -> Geometry:
        made = replace(cube_mesh(name, 0.5), materials=(row,), material=np.full(12, row, np.uint16))
        return mesh(made, "POLYGONS")

    def stretched(low: tuple[float, float, float], high: tuple[float, float, float]) -> np.ndarray:
        matrix = np.diag([*np.subtract(high, low), 1.0])
        matrix[:3, 3] = np.add(low, high) / 2
        return matrix

    walls = block("wall of a room", 0)
    sides = (
        ((-2.2, -2.2, -0.2), (2.2, 2.2, 0)), ((-2.2, -2.2, 2.4), (2.2, 2.2, 2.6)),
        ((-2.2, -2.2, 0), (-2, 2.2, 2.4)), ((2, -2.2, 0), (2.2, 2.2, 2.4)),
        ((-2, -2.2, 0), (2, -2, 2.4)), ((-2, 2, 0), (2, 2.2, 2.4)),
    )  # fmt: skip
    things = (
        *((walls, stretched(*one)) for one in sides),
        (block("block in a room", 1), stretched((-0.9, 0.2, 0), (-0.2, 0.9, 0.8))),
        (block("light of a room", 2), stretched((-0.1, -0.6, 2.2), (0.7, 0.2, 2.3))),
    )
    lit = scene(*things, lights=(), world=World(np.array([0.45, 0.6, 0.75])), table=table)
    return Case(lit, camera((0.9, -1.6, 1.2), (-0.3, 0.6, 0.9), (160, 120), 70.0), replace(SETTINGS, bounces=3))


EVERY = in_a_corner, among_balls_and_strands, under_smoke, among_mirrors
