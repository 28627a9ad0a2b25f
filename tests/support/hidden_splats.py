"""Scenes of which EWA leaves out splats that others hide: balls, closed or with a hole, and wires before them."""

from __future__ import annotations

import numpy as np

from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from scripts.scenes import build, cameras
from scripts.scenes.case import Case

COUNT = 60_000


def ball(radius: float, hole: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Positions, normals, radii and colours of splats that lie evenly on the unit sphere, but for a hole toward -Y."""
    i = np.arange(COUNT) + 0.5
    y, turn = 1 - 2 * i / COUNT, np.pi * (1 + 5**0.5) * i
    side = np.sqrt(1 - y * y)
    normal = np.stack([side * np.cos(turn), y, side * np.sin(turn)], axis=1)
    color = np.random.default_rng(5).random((COUNT, 3))
    kept = (normal[:, 1] > 0) | (np.hypot(normal[:, 0] - 0.2, normal[:, 2]) > hole)
    return normal[kept], normal[kept], np.full(kept.sum(), radius), color[kept]


def case(key: str, *things: tuple[np.ndarray, ...]) -> Case:
    """Splats that glow, over nothing."""
    position, normal, radii, color = (np.concatenate(part).astype(np.float32) for part in zip(*things, strict=True))
    cloud = PointCloud(position, normal=normal, radii=radii[:, None], emission=color)
    table = build.materials(base_color=[[0, 0, 0]], specular=[0])
    scene = build.scene((build.points(key, cloud), build.moved()), lights=(), world=World(), table=table,
                         transparent=True)  # fmt: skip
    camera = cameras.camera((0, -4, 0), resolution=(300, 300), parallel=2.3)
    return Case(scene, camera, Settings(technique="EWA", use_shadows=False, use_adaptive_sampling=False))


def wires() -> tuple[np.ndarray, ...]:
    """Rows of fine splats in front of the ball."""
    along = np.linspace(-0.8, 0.8, 400)
    position = np.concatenate(
        [np.stack([along, np.full(400, -1.2), np.full(400, z)], axis=1) for z in (-0.31, 0.02, 0.44)]
    )
    count = len(position)
    return position, np.tile([0.0, -1.0, 0.0], (count, 1)), np.full(count, 0.006), np.tile([1.0, 0.0, 0.0], (count, 1))


SCENES = {  # the things; the share of all splats that is blended at most, and drawn for visibility
    "closed": ((ball(0.014),), 0.66, 0.66),  # measured 0.63, 0.63
    "with a hole": ((ball(0.014, hole=0.3),), 0.68, 0.68),  # measured 0.65, 0.65
    "wide": ((ball(0.055),), 0.71, 0.63),  # measured 0.69, 0.61; with one sample 0.42
    "wide, with a hole": ((ball(0.055, hole=0.3),), 0.74, 0.65),  # measured 0.71, 0.63
    "wide, behind wires": ((ball(0.055), wires()), 0.72, 0.64),  # measured 0.69, 0.62
}
