"""Cases that strain the arithmetic: an eye inside things, places far away, tiny and huge sizes, NaN."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.lights import Light
from scripts.scenes.build import mesh, moved, points, scene
from scripts.scenes.cameras import camera
from scripts.scenes.case import Case
from scripts.scenes.clouds import sphere_cloud
from scripts.scenes.meshes import cube_mesh, flat_mesh, plane_mesh


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
