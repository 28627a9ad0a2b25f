"""Journeys: scenes and the cameras that see them one after the other, near to far or back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pointsplat_addon.core.lod.cost import MAX_SAMPLES_RATIO, Costs
from pointsplat_addon.core.material.graph import MaterialGraph
from pointsplat_addon.core.material.image import Image
from pointsplat_addon.core.material.nodes import color_nodes, input_nodes, texture_nodes
from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.scene import Geometry, Instances, Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.prepare.prepare import prepare
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes import build, clouds, meshes
from scripts.scenes.cameras import Vector, camera
from scripts.scenes.changes import Change, changes
from scripts.scenes.meshes import bumpy, shape, with_smooth_normals

SHAPES = {
    "torus": lambda: shape("torus"),
    "spot": lambda: shape("spot"),
    "ball": lambda: bumpy("dense bumpy ball", 360),
}


def dolly(
    name: str, start: float, stop: float, step: float, size: int = 512, primitive: str = "AUTO"
) -> tuple[Scene, list[Camera]]:
    """A shape under a sun and a grey world, and cameras from the distance `start` to `stop`, a share `step` each."""
    cameras = along((0.5, -0.8, 0.35), start, stop, step, size)
    return lit(build.mesh(SHAPES[name](), primitive), cameras[0]), cameras


def along(direction: Vector, start: float, stop: float, step: float, size: int, **lens: Any) -> list[Camera]:
    """Cameras that look at the origin from distances between `start` and `stop`, a share `step` of the greater each."""
    lens = {"field_of_view": 35, "far": 1e5, **lens}
    unit = np.array(direction) / np.linalg.norm(direction)
    count = 1 + int(np.ceil(abs(np.log(start / stop)) / -np.log1p(-step)))
    ratio = 1 - step if stop < start else 1 / (1 - step)
    return [camera(unit * start * ratio**i, resolution=(size, size), **lens) for i in range(count)]


def lit(geometry: Geometry, camera: Camera, graph: MaterialGraph | None = None) -> Scene:
    """On a grey world, under a sun over the camera's left shoulder."""
    light = build.sun(2.5, camera.view_from_world[:3, :3].T @ (0.45, -0.5, -1.0))
    table = build.materials(base_color=[[0.55, 0.42, 0.30]], graphs=(graph,))
    return build.scene((geometry, build.moved()), lights=[light], world=World(np.full(3, 0.35)), table=table)


@dataclass(frozen=True, eq=False)
class Journey:
    """What cameras see one after the other, and what it is compared with."""

    scene: Scene
    cameras: list[Camera]
    whole: Scene | None = None  # clouds drawn with all their points; None: meshes as polygons
    costs: Costs | None = None  # None: the device's
    grown: bool = False  # the octree is there from the first frame, as in a viewport

    def changes(self, renderer: Renderer, settings: Settings, samples: int, floor: int = 0) -> list[Change]:
        renderer.store.clear()
        if self.grown:
            farthest = max(self.cameras, key=lambda c: np.abs(c.view_from_world[:3, 3]).max())
            prepare(self.scene, farthest, settings, 1000, renderer.store)
        reference = None if self.whole is None else (self.whole, replace(settings, tolerance=0.05))
        before, renderer.costs = renderer.costs, self.costs or renderer.costs
        try:
            return changes(renderer, self.scene, self.cameras, settings, samples, floor, reference)
        finally:
            renderer.costs = before


def pattern(p: np.ndarray) -> np.ndarray:
    """(N, 3) float32 colours of waves of four lengths, at places (N, 3)."""
    waves = [a * np.prod(np.sin(k * p * (2.1, 1.9, 2.3) + (0.3, 1.0, 0.7 + k)), axis=1)
             for k, a in ((3, 0.2), (9, 0.15), (27, 0.1), (81, 0.1))]  # fmt: skip
    level = np.clip(0.5 + np.sum(waves, axis=0), 0.02, 1.0)
    return np.stack([level, level**2, 0.6 * np.sqrt(level)], axis=1).astype(np.float32)


def lattice(start: float, stop: float, step: float, size: int) -> Journey:
    """A coloured square of points that faces the camera: all nodes of a level are equally large in the picture."""
    cloud = clouds.plane_cloud(400)
    cloud = replace(cloud, color=pattern(cloud.position + np.array([0, 0.4, 0])))
    cameras = along((1e-4, -1, 0), start, stop, step, size)
    scene, whole = (lit(build.points(key, cloud), cameras[0]) for key in ("lattice", "whole lattice"))
    return Journey(scene, cameras, whole, grown=True)


def field(direction: Vector, primitive: str = "AUTO", rings: int = 16, side: int = 6) -> Callable[..., Journey]:
    """Bumpy balls on the ground, each turned another way."""

    def journey(start: float, stop: float, step: float, size: int) -> Journey:
        cameras, rng = along(direction, start, stop, step, size), np.random.default_rng(3)
        turns = np.linalg.qr(rng.normal(size=(side**2, 3, 3)))[0]
        matrices = np.tile(np.eye(4), (side**2, 1, 1))
        matrices[:, :3, :3] = turns * np.sign(np.linalg.det(turns))[:, None, None]
        matrices[:, :2, 3] = 3.0 * (np.indices((side, side)).reshape(2, -1).T - (side - 1) / 2)
        scene = lit(build.mesh(bumpy(f"field of balls {rings}", rings), primitive), cameras[0])
        scene = replace(scene, instances=Instances(np.zeros(side**2, np.int32), matrices))
        return Journey(scene, cameras, grown=True)

    return journey


# Points in pictures of 16 samples are set against triangles of FEWER times less.
COSTS = Costs(point=20.0 / MAX_SAMPLES_RATIO, pixel=1e-3, prepared=1e-3, uploaded=1e-3)


def hills(start: float, stop: float, step: float, size: int) -> Journey:
    """Low over textured hills, where points cost so little that the far ones are points."""
    flat = meshes.plane_mesh("textured hills", 20.0, 160)
    x, y = flat.position.astype(np.float64)[:, [0, 2]].T
    position = np.stack([x, y, 0.5 * np.sin(1.3 * x) * np.sin(1.1 * y)], axis=1)
    mesh = with_smooth_normals("textured hills", position, flat.triangles.astype(int))
    mesh = replace(mesh, uv=flat.uv, active_uv="UV")
    v, u = (6.0 * a.ravel() / 512 for a in np.indices((512, 512)))
    texels = np.concatenate([pattern(np.stack([u, v, np.full_like(u, 0.4)], axis=1)), np.ones((512**2, 1))], axis=1)
    graph = MaterialGraph(
        base_color=color_nodes.Color(
            texture_nodes.ImageTexture(input_nodes.UV(), Image(texels.reshape(512, 512, 4).astype(np.float32)))
        )
    )
    cameras = along((0.2, -1, 0.25), start, stop, step, size, field_of_view=50, near=0.05)
    return Journey(lit(build.mesh(mesh), cameras[0], graph), cameras, costs=COSTS)


# By name: how it is made, and the distances between which something happens.
JOURNEYS: dict[str, tuple[Callable[..., Journey], float, float]] = {
    "lattice": (lattice, 14.0, 5.0),
    "field from above": (field((1e-4, -1e-4, 1)), 40.0, 600.0),
    "field": (field((0.3, -1, 0.8)), 16.0, 300.0),
    "field beside the eye": (field((0.3, -1, 0.8), "POINTS"), 9.5, 14.0),
    "hills": (hills, 20.0, 3.0),
}
