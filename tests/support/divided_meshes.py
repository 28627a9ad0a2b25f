"""Meshes that reach from the camera to a horizon, so that near parts are triangles and far ones points."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from pointsplat_addon.core.lod.cost import Costs
from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.scene.scene import Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from scripts.scenes import build, cameras, meshes
from scripts.scenes.meshes import with_smooth_normals

SETTINGS = Settings(technique="IMAGE_SPACE", use_shadows=False, use_adaptive_sampling=False)
# Points need not pay for their passes and for being sampled: the pictures are small, and of few samples.
COSTS = Costs(pixel=1e-3, prepared=1e-3, uploaded=1e-3)
SIZE = 128


def plane() -> tuple[Mesh, Camera]:
    """A field of triangles that reaches from the camera's feet to a horizon."""
    camera = cameras.camera((0, -1.2, -19.5), resolution=(SIZE, SIZE), field_of_view=50, near=0.05)
    view = cameras.look_at((0, -1.2, -19.5), (0, 0, -10), (0, -1, 0))
    return meshes.plane_mesh("split plane", 20.0, 450), replace(camera, view_from_world=view)


def bumps() -> tuple[Mesh, Camera]:
    """The same, of hills and hollows."""
    mesh, camera = plane()
    p = mesh.position.astype(np.float64)
    p[:, 1] += 0.3 * np.sin(1.3 * p[:, 0]) * np.sin(1.1 * p[:, 2])
    return with_smooth_normals("split bumps", p, mesh.triangles.astype(int)), camera


def two_materials() -> tuple[Mesh, Camera]:
    mesh, camera = plane()
    material = (np.arange(len(mesh.triangles)) // 37 % 2).astype(np.uint16)
    return replace(mesh, key="striped plane", material=material, materials=(0, 1)), camera


def shuffled() -> tuple[Mesh, Camera]:
    """Triangles in no order: parts are made of those that lie together."""
    mesh, camera = plane()
    order = np.random.default_rng(0).permutation(len(mesh.triangles))
    normal = mesh.corner_normal
    assert normal is not None
    return replace(mesh, key="shuffled plane", triangles=mesh.triangles[order], corner_normal=normal[order],
                   uv={}, active_uv=None), camera  # fmt: skip


SHAPES = {f.__name__: cache(f) for f in (plane, bumps, two_materials, shuffled)}


def scene(name: str, primitive: str = "AUTO") -> Scene:
    mesh, camera = SHAPES[name]()
    light = build.sun(2.5, camera.view_from_world[:3, :3].T @ (0.45, -0.5, -1.0))
    table = build.materials(2, base_color=[[0.55, 0.42, 0.30], [0.2, 0.4, 0.5]])
    return build.scene(
        (build.mesh(mesh, primitive), build.moved()), lights=[light], world=World(np.full(3, 0.35)), table=table
    )
