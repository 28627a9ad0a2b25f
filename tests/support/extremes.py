"""Scenes at other scales and places, and pictures of all techniques: what the extreme cases share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.scene import Geometry, Instances
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import Fog
from scripts.scenes import build, cameras, clouds, meshes
from scripts.scenes.build import moved, points, strand_lines
from scripts.scenes.cameras import camera
from scripts.scenes.case import Case
from scripts.scenes.drawing import render

TECHNIQUES = ("VISIBILITY", "IMAGE_SPACE", "EWA", "PAINTER")
COMBINED = frozenset({"combined"})
SHADOWED = Settings(shadow_resolution=64)
FEW = (32, 24)  # pixels


def picture(case: Case, technique: str = "IMAGE_SPACE", samples: int = 1) -> np.ndarray:
    """Combined (H, W, 4) float64, which is finite, not negative, and no more than opaque."""
    settings = replace(case.settings, technique=technique)
    found = render(replace(case, settings=settings), COMBINED, samples).pixels["combined"].astype(np.float64)
    assert np.isfinite(found).all()
    assert found.min() >= 0
    assert found[..., 3].max() <= 1 + 1e-5
    return found


def every_pass(case: Case, technique: str = "IMAGE_SPACE", samples: int = 1) -> dict[str, np.ndarray]:
    """All passes; those that are no identities are finite."""
    settings = replace(case.settings, technique=technique)
    pixels = render(replace(case, settings=settings), samples=samples).pixels
    for name, array in pixels.items():
        assert np.isfinite(array[..., 1::2] if name.startswith("crypto") else array).all(), name
    assert pixels["combined"].min() >= 0
    assert pixels["combined"][..., 3].max() <= 1 + 1e-5
    return pixels


def scaled(case: Case, s: float) -> Case:
    """All lengths of the world times `s`, and lamps as much stronger as makes the same light: the same picture."""
    scene, cam = case.scene, case.camera
    instances = replace(scene.instances, world_from_object=moved(scale=s) @ scene.instances.world_from_object)
    view, clip = cam.view_from_world.copy(), cam.clip_from_view.copy()
    view[:3, 3] *= s
    if cam.perspective:
        clip[2, 3] *= s
    else:
        clip[:3, :3] /= s
    eye = replace(cam, view_from_world=view, clip_from_view=clip, near=cam.near * s, far=cam.far * s)
    lights = tuple(_scaled_light(light, s) for light in scene.lights)
    world = replace(scene.world, fog=None if scene.world.fog is None else _scaled_fog(scene.world.fog, s))
    return replace(case, scene=replace(scene, instances=instances, lights=lights, world=world), camera=eye)


def _scaled_fog(fog: Fog, s: float) -> Fog:
    """Its coefficients are per unit of length."""
    return replace(fog, extinction=fog.extinction / s, scattering=fog.scattering / s, emission=fog.emission / s)


def _scaled_light(light: Light, s: float) -> Light:
    """Radiance and irradiance stay; radiant intensity is per distance squared."""
    found = replace(light, position=light.position * s)
    if light.kind == "SUN":
        return found
    if light.kind == "AREA":
        assert light.axis_u is not None
        assert light.axis_v is not None
        return replace(found, axis_u=light.axis_u * s, axis_v=light.axis_v * s)
    return replace(found, radius=light.radius * s, color=light.color * s**2)


def shifted(case: Case, offset: np.ndarray) -> Case:
    """All of the world elsewhere, and the camera with it: the same picture."""
    scene, cam = case.scene, case.camera
    to = moved(offset)
    instances = replace(scene.instances, world_from_object=to @ scene.instances.world_from_object)
    lights = tuple(replace(light, position=light.position + offset) for light in scene.lights)
    eye = replace(cam, view_from_world=cam.view_from_world @ moved(-offset))
    return replace(case, scene=replace(scene, instances=instances, lights=lights), camera=eye)


def lamp(kind: str, position: cameras.Vector, strength: float, size: float = 0.1) -> Light:
    """A lamp that shines down and to the back."""
    down = np.array([0, 0.6, -0.8])
    light = Light(kind, np.full(3, float(strength)), np.asarray(position, float), down, radius=size)
    if kind == "AREA":
        return replace(light, axis_u=np.array([size, 0, 0]), axis_v=np.array([0, 0.8, 0.6]) * size)
    return replace(light, spot_cos=0.5, spot_blend=0.3) if kind == "SPOT" else light


def all_kinds(key: str) -> Case:
    """Points, polygons, a mesh as points, smoke, a tube and a ribbon, lit by lamps of all kinds, with shadows."""
    u = np.linspace(-1.3, 1.3, 12)
    across = np.tile(np.array([0, 1, 0], np.float32), (24, 1))
    strands = [np.stack([u, 0 * u - 0.5, 0 * u + 1.0], 1), np.stack([0 * u + 1.2, 0 * u - 0.5, u], 1)]
    smoke = clouds.smoke_cloud(8, 2.0)
    things: tuple[tuple[Geometry, np.ndarray], ...] = (
        (points(f"{key} ball", clouds.sphere_cloud(400)), moved((-0.8, 0, 0.3), 0.7)),
        (build.mesh(meshes.cube_mesh(f"{key} block", 0.5), "POLYGONS"), moved((0.7, 0.2, 0))),
        (build.mesh(meshes.cube_mesh(f"{key} points", 0.4), "POINTS"), moved((0, -0.6, -0.7))),
        (points(f"{key} smoke", smoke), moved((0.2, -0.4, 0.8), 0.5)),
        (strand_lines(f"{key} tubes", strands, 0.05), moved()),
        (strand_lines(f"{key} ribbons", strands, 0.05, normal=across), moved((0, 0.3, -0.4))),
    )
    lights = (
        lamp("POINT", (-2, -3, 2), 20),
        lamp("SPOT", (0, -3, 3), 30),
        lamp("AREA", (2, -2, 2), 3, 0.5),
        build.sun(1.0),
    )
    return Case(build.scene(*things, lights=lights), camera((0.5, -4, 0.7), resolution=FEW), SHADOWED)


def without(case: Case, rows: list[int]) -> Case:
    """The case without some of its instances."""
    instances = case.scene.instances
    keep = np.setdiff1d(np.arange(len(instances)), rows)
    rest = Instances(instances.geometry[keep], instances.world_from_object[keep])
    return replace(case, scene=replace(case.scene, instances=rest))
