"""Cases of much that is small: strands, leaves, a field of towers, a mesh of points and of triangles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pointsplat_addon.core.scene.settings import Settings
from scripts.common.tower import COLORS
from scripts.scenes.build import materials, mesh, moved, points, scene, strand_lines
from scripts.scenes.cameras import camera
from scripts.scenes.case import Case
from scripts.scenes.clouds import leaves, sphere_cloud
from scripts.scenes.meshes import cube_mesh, plane_mesh, small_tower


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
        Settings(technique="IMAGE_SPACE", shadow_resolution=64),
    )


def foliage() -> Case:
    """A crown of small leaves before a ball, and a few wide ones."""
    crown, wide = points("crown", leaves(3000, 0.7)), points("wide leaves", leaves(60, 0.4))
    trunk = points("trunk", sphere_cloud(2000))
    things = ((crown, moved()), (wide, moved((0.9, 0, 0.6), 0.5)), (trunk, moved((0, 1.5, -0.5), 0.6)))
    return Case(scene(*things), camera((0, -5, 0)))


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
