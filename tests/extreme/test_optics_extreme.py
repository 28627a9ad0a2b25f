"""Stiff media: extinctions of sixteen decades side by side, optical depths of a million, a hundred thousand layers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.core.shadow import builder
from pointsplat_addon.core.splat.kernel import PEAK
from scripts.common.shadow_truth import optical_depth, transmittance
from scripts.scenes.build import moved, points, scene
from scripts.scenes.cameras import camera
from scripts.scenes.case import Case
from tests.support.extremes import TECHNIQUES, picture

WHITE = World(np.ones(3))
UNLIT = Settings(use_shadows=False)
DOWN = np.array([0.0, 0, -1])


def media(position, radius, extinction) -> PointCloud:
    """Black balls, whose kernels have half their radius as standard deviation."""
    position = np.asarray(position, np.float32).reshape(-1, 3)
    count = len(position)
    radii = np.broadcast_to(np.float32(radius), (count,))[:, None].copy()
    strength = np.broadcast_to(np.asarray(extinction, np.float32), (count,)).copy()
    return PointCloud(position, radii=radii, extinction=strength, color=np.zeros((count, 3), np.float32))


def through(cloud: PointCloud, key: str, eye, technique: str = "IMAGE_SPACE") -> np.ndarray:
    """(H, W) of white light that passes through."""
    made = scene((points(key, cloud), moved()), lights=(), world=WHITE)
    return picture(Case(made, eye, UNLIT), technique)[..., 0]


@pytest.mark.parametrize("technique", TECHNIQUES)
def test_extinctions_from_1e_8_to_1e8_side_by_side(technique, within):
    """Each ball lets exp(-depth) through its middle, whatever its neighbours are; the low-pass takes a thousandth."""
    strength = 10.0 ** np.arange(-8, 9)
    x = np.arange(17) - 8.0
    cloud = media(np.stack([x, 0 * x, 0 * x], axis=1), 0.3, strength)
    eye = camera((0, -40, 0), resolution=(17 * 31, 31), parallel=17.0)
    seen = through(cloud, "decades", eye, technique)[15, 15::31]
    exact = np.exp(-PEAK * 16 / 3 * 0.15 * strength)
    within("extinction 1e-8 to 1e8 side by side", "error of the transmittance", np.abs(seen - exact).max(), 2e-3)
    within("extinction 1e-8 to 1e8 side by side", "rise from thin to thick", np.diff(seen).max(), 0.0)


@given(seed=st.integers(0, 2**31), count=st.integers(1, 60))
def test_depths_of_stiff_media_add_up(seed, count, within):
    """On one ray, in any order: transmittances multiply, as in float64."""
    rng = np.random.default_rng(seed)
    strength = (10.0 ** rng.uniform(-8, 8, count) * np.where(rng.random(count) < 0.8, 1e-6, 1)).astype(np.float32)
    radius = rng.uniform(0.2, 0.4, count).astype(np.float32)
    position = np.zeros((count, 3))
    position[:, 1] = rng.uniform(-3, 3, count)
    eye = camera((0, -10, 0), resolution=(9, 7), parallel=0.3)
    seen = through(media(position, radius, strength), f"stiff {seed} {count}", eye)[3, 4]
    exact = np.exp(-np.sum(PEAK * 16 / 3 * radius / 2 * strength.astype(np.float64)))
    within("up to 60 stiff media on a ray", "error of the transmittance", abs(seen - exact), 3e-3)


@pytest.mark.parametrize("depth", [1e-6, 1e-3, 1.0, 30.0, 1e3, 1e6])
@pytest.mark.parametrize("technique", TECHNIQUES)
def test_optical_depths_up_to_a_million(depth, technique, within):
    cloud = media([0, 0, 0], 0.5, depth / (PEAK * 16 / 3 * 0.25))
    seen = through(cloud, f"depth {depth}", camera((0, -10, 0), resolution=(9, 7), parallel=0.3), technique)[3, 4]
    within("optical depths of 1e-6 to 1e6", "error of the transmittance", abs(seen - np.exp(-depth)), 1e-3)


@pytest.mark.parametrize("depth", [1e-2, 1.0, 10.0])
def test_a_hundred_thousand_layers(depth, within):
    """On one ray, each of a hundred thousandth of the depth: what float16 or a sum in the wrong order would lose."""
    count = 100_000
    position = np.zeros((count, 3))
    position[:, 1] = np.random.default_rng(0).uniform(-1, 1, count)
    cloud = media(position, 0.5, depth / count / (PEAK * 16 / 3 * 0.25))
    seen = through(cloud, f"layers {depth}", camera((0, -10, 0), resolution=(3, 3), parallel=0.1))[1, 1]
    within("1e5 layers on a ray, depth 0.01 to 10", "error of the transmittance", abs(seen - np.exp(-depth)), 5e-3)


@pytest.mark.parametrize("depth", [1e-8, 1.0, 1e6])
def test_shadows_of_a_hundred_thousand_layers(depth, within):
    """A table's depth along the ray through all of them is that of one layer of all their extinction, and only grows.
    Depths beyond a hundred count as a hundred, of which exp(-100) is left."""
    count = 100_000
    position = np.zeros((count, 3))
    position[:, 2] = np.linspace(-1, 1, count)
    sun = Light("SUN", np.ones(3), np.zeros(3), DOWN)
    z = np.linspace(2, -2, 41)

    def depths(cloud: PointCloud) -> np.ndarray:
        found = optical_depth(
            builder.build_table(sun, [builder.casters(cloud, np.eye(4))], 256), np.stack([0 * z, 0 * z, z], 1)
        )
        assert np.isfinite(found).all()
        return found.astype(np.float64)

    found, one = depths(media(position, 0.5, depth / count)), depths(media([0, 0, 0], 0.5, depth))
    case = "shadow of 1e5 layers, depth 1e-8 to 1e6"
    within(case, "fall of the depth along the ray, of all", -np.diff(found).min() / found[-1], 1e-6)
    within(case, "relative error of the depth", abs(found[-1] / one[-1] - 1), 1e-6)


@given(
    exponent=st.lists(st.floats(-8, 8), min_size=2, max_size=40),
    seed=st.integers(0, 2**31),
    lamp=st.sampled_from(["SUN", "POINT"]),
)
def test_shadows_of_stiff_media_are_finite_and_only_grow(exponent, seed, lamp, within):
    rng = np.random.default_rng(seed)
    position = np.zeros((len(exponent), 3))
    position[:, 2] = rng.uniform(-1, 1, len(exponent))
    cloud = media(position, 0.3, 10.0 ** np.array(exponent))
    light = Light(lamp, np.ones(3), np.array([0.0, 0, 5]), DOWN)
    built = builder.build_table(light, [builder.casters(cloud, np.eye(4))], 64)
    z = np.linspace(1.9, -1.9, 39)
    found = transmittance(built, np.stack([0 * z, 0 * z, z], axis=1)).astype(np.float64)
    assert np.isfinite(found).all()
    assert found.min() >= 0
    assert found.max() <= 1 + 1e-6
    within("shadows of stiff media", "rise of the transmittance along a ray", np.diff(found, axis=0).max(), 1e-6)
