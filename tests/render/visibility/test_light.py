"""Light on groups of sub-samples: shadows of wide lights are those of many samples, surfaces of disks are smooth."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from scripts.scenes import build, cameras, clouds, meshes
from scripts.scenes.case import Case
from scripts.scenes.drawing import render

COMBINED = frozenset({"combined"})


def under_a_sun(technique: str, radius: float) -> Case:
    """A cube over a plane; `radius`: angular, of the sun."""
    ground = build.mesh(meshes.plane_mesh("ground of shadows", 6.0, 2), "POLYGONS")
    cube = build.mesh(meshes.cube_mesh("cube of shadows"), "POLYGONS")
    things = (ground, build.moved((0, 0, -1))), (cube, build.moved((0, 0, 0), 0.7))
    eye = cameras.camera((2, -4, 3), (0, 0, -0.5), resolution=(80, 60))
    drawn = build.scene(*things, lights=[replace(build.sun(), radius=radius)])
    return Case(drawn, eye, Settings(technique=technique))


@pytest.mark.parametrize("radius", [0.0, 0.1, 0.3])
def test_shadows_are_those_of_many_samples(radius):
    truth = render(under_a_sun("IMAGE_SPACE", radius), COMBINED, 512).pixels["combined"][..., :3]
    found = render(under_a_sun("VISIBILITY", radius), COMBINED, 16).pixels["combined"][..., :3]
    assert np.sqrt(np.mean((found - truth) ** 2)) < 0.01  # measured 0.0062, 0.0047, 0.0077
    assert abs(found.mean() - truth.mean()) < 0.001  # measured at most 2.7e-4


def sphere_of_disks(side: int) -> Case:
    """A diffuse sphere of disks in parallel view; it fills a picture of `side` pixels."""
    ball = build.points("a sphere of disks to shade", clouds.sphere_cloud(16_000))
    table = build.materials(roughness=[1.0], specular=[0.0], base_color=[[0.5, 0.5, 0.5]])
    drawn = build.scene((ball, build.moved()), lights=[build.sun()], world=World(np.zeros(3)), table=table)
    eye = cameras.camera((0, -4, 0), resolution=(side, side), parallel=2.0)
    return Case(drawn, eye, Settings(technique="VISIBILITY", use_shadows=False))


def test_overlapping_disks_are_shaded_as_the_surface_through_them():
    """By Lambert's law: light goes with the cosine between the sphere's normal and the sun."""
    side = 96
    found = render(sphere_of_disks(side), COMBINED, 16).pixels["combined"][..., 0].astype(np.float64)
    x, z = np.meshgrid(*(2 * (np.arange(side) + 0.5) / side - 1,) * 2)
    y = -np.sqrt(np.maximum(1 - x * x - z * z, 0))
    toward_sun = -np.array(build.sun().direction)
    cosine = np.stack([x, y, z], axis=-1) @ toward_sun
    inner = (x * x + z * z < 0.8) & (cosine > 0.1)
    expected = cosine * (found[inner].sum() / cosine[inner].sum())
    error = (found - expected)[inner] / expected.max()
    # Measured 0.0011; 0.0058 with the normal of one disk in each pixel.
    assert np.sqrt(np.mean(error**2)) < 0.003
