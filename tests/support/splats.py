"""Splats that glow over nothing, alone or few, where they lie in pixels, and pictures of shapes made of splats."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.scene import Geometry
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.plan.request import Request
from scripts.common.images import compare, directions, eroded
from scripts.scenes import build, cameras, clouds, drawing
from scripts.scenes.case import Case
from scripts.scenes.drawing import render
from scripts.scenes.store import STORE
from tests.reference import opaque

SIZE = 192
VIEWS = directions(2)
EWA = Settings(technique="EWA", use_shadows=False)
ONLY_COMBINED = frozenset({"combined"})
NORMALS = (0, -1, 0), (0.5, -1, 0.3), (0, -1, 3), (0.2, 1, 0.1)  # of lone splats


def splats(key: str, position, normal, radii, color=None, axis=None) -> Geometry:
    """Splats that glow in their colours."""
    position = np.atleast_2d(np.asarray(position, np.float32))
    count = len(position)
    normal = np.broadcast_to(np.asarray(normal, np.float32), (count, 3))
    normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    radii = np.broadcast_to(np.asarray(radii, np.float32), (count, np.shape(radii)[-1]))
    color = np.ones((count, 3)) if color is None else np.broadcast_to(np.asarray(color, float), (count, 3))
    axis = None if axis is None else np.broadcast_to(np.asarray(axis, np.float32), (count, 3)).copy()
    cloud = PointCloud(position, normal=normal.astype(np.float32).copy(), radii=radii.copy(), axis=axis,
                       emission=color.astype(np.float32))  # fmt: skip
    return build.points(key, cloud)


def dark(*things, camera, settings=EWA, transparent=True) -> Case:
    table = build.materials(base_color=[[0, 0, 0]], specular=[0])
    scene = build.scene(
        *((thing, build.moved()) for thing in things), lights=(), world=World(), table=table, transparent=transparent
    )
    return Case(scene, camera, settings)


def axes(case: Case) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres (N, 3) and half-axes (N, 3), twice, of the splats of the only cloud, in view space."""
    cloud = case.scene.geometries[0].cloud
    assert cloud is not None
    turn = case.camera.view_from_world
    a, b, _ = opaque._half_axes(cloud, turn[:3, :3])
    return cloud.position @ turn[:3, :3].T + turn[:3, 3], a, b


def on_screen(case: Case) -> tuple[np.ndarray, ...]:
    """Of the only cloud's splats: centres and half-axes (N, 3) in view space, centres (N, 2) in pixels; all pixels'
    centres (H * W, 2)."""
    fx, fy, cx, cy = case.camera.pixel_from_view()
    centre, a, b = axes(case)
    depth = np.negative(centre[:, 2:]) if case.camera.perspective else 1.0
    width, height = case.camera.resolution
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    return centre, a, b, centre[:, :2] / depth * (fx, fy) + (cx, cy), np.stack([x.ravel(), y.ravel()], axis=1)


def lone(key: str, normal, radii, parallel: float | None, settings=EWA) -> tuple[Case, np.ndarray]:
    """One splat and its colour."""
    axis = np.cross(normal, (0, 0.3, 1))
    axis /= np.linalg.norm(axis)
    color = np.array([0.9, 0.5, 0.2])
    thing = splats(f"{key} {normal} {radii}", (0.013, 0.02, -0.017), normal, radii, color, axis)
    return dark(thing, camera=cameras.camera(parallel=parallel), settings=settings), color


EXTREMES = {
    "edge-on": {"normal": (1, 0, 0), "radii": [0.5]},
    "edge-on, askew": {"normal": (1, 0, 0.7), "radii": [0.5]},
    "edge-on, askew and wide": {"normal": (1, 0, 0.7), "radii": [2.0]},
    "almost edge-on": {"normal": (1, -1e-6, 0), "radii": [0.5]},
    "through the near plane": {"position": (0, -3.9, 0), "normal": (0, 0.1, 1), "radii": [0.6]},
    "behind the eye": {"position": (0, -6, 0), "normal": (0, 0.1, 1), "radii": [0.6]},
    "around the eye": {"position": (0, -4, 0), "normal": (0, 0, 1), "radii": [0.6]},
    "of a millionth in width": {"normal": (0, -1, 0), "radii": [1.0, 1e-6], "axis": (0, 0, 1)},
    "tiny": {"normal": (0, -1, 0), "radii": [1e-9]},
    "without a radius": {"normal": (0, -1, 0), "radii": [0.0]},
}


def of_nodes(settings: Settings, tolerance: float) -> tuple[dict[str, float], float]:
    """A sphere of 200,000 points by nodes: figures against all of its points, and how much of 255 shines through the
    worst pixel within."""
    cloud = clouds.sphere_cloud(200000, color=(clouds.sphere_points(200000) * 0.4 + 0.5).astype(np.float32))
    scene = build.scene((build.points("nodes of a sphere", cloud), build.moved()), transparent=True)
    camera, found = cameras.camera(resolution=(96, 96)), []
    for t in (0.05, tolerance):
        STORE.clear()
        request = Request(camera, replace(settings, tolerance=t), ONLY_COMBINED, 16)
        found.append(drawing.opengl().render(scene, request))
    fine, coarse = found
    assert fine.report["points"]["cut"] == 200000
    assert coarse.report["points"]["cut"] < 0.6 * 200000
    alpha = coarse.pixels["combined"][..., 3][eroded(fine.pixels["combined"][..., 3] > 0.9999)]
    figures = compare(coarse.pixels["combined"], fine.pixels["combined"])
    return figures, 255 * float(1 - alpha.min())


def shape_picture(geometry, view: int, technique: str, samples: int, tolerance: float = 1.0, **more) -> np.ndarray:
    """As test_quality's, over nothing; `more`: settings."""
    eye = VIEWS[view] * 3.5
    camera = cameras.camera(eye, resolution=(SIZE, SIZE), field_of_view=35)
    sun = build.sun(4.0, camera.view_from_world[:3, :3].T @ (0.45, -0.5, -1.0))
    scene = build.scene(
        (geometry, build.moved()), lights=[sun], world=World(np.zeros(3)), table=build.materials(), transparent=True
    )
    settings = Settings(technique=technique, tolerance=tolerance, use_shadows=False, **more)
    return render(Case(scene, camera, settings), ONLY_COMBINED, samples).pixels["combined"]
