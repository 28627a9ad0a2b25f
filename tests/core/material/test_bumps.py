"""Bump nodes against closed forms: normals of surfaces whose heights are known, at points and in baked pictures."""

import numpy as np
import pytest

from pointsplat_addon.core.material.baking import bake, bakeable, split_bumps
from pointsplat_addon.core.material.expression import Expression, SampleInputs, evaluate
from pointsplat_addon.core.material.graph import MaterialGraph, needs
from pointsplat_addon.core.material.levels import Stored, shown_normals, shown_slopes, smaller_levels
from pointsplat_addon.core.material.nodes.color_nodes import Component
from pointsplat_addon.core.material.nodes.input_nodes import UV, Constant, Coordinates
from pointsplat_addon.core.material.nodes.math_nodes import Math
from pointsplat_addon.core.material.nodes.normal_nodes import Bump
from tests.reference import textures

NORMAL, ZERO = Coordinates("normal"), Constant((0.0,))
FREQUENCY, DISTANCE = 7.0, 0.2


def wave(source) -> Math:
    """sin(FREQUENCY x)."""
    return Math(Math(Component(source, 0), Constant((FREQUENCY,)), ZERO, "MULTIPLY"), ZERO, ZERO, "SINE")


def bump(height, strength=1.0, distance=DISTANCE, normal: Expression = NORMAL) -> Bump:
    return Bump(height, Constant((strength,)), Constant((distance,)), normal)


def on_plane(expression, turn: np.ndarray, step: float = 5e-4) -> tuple[np.ndarray, np.ndarray]:
    """Normals (N, 3) on the plane z = 0, whose ways are turned by a matrix (2, 2), and the places' x."""
    x = np.random.default_rng(1).uniform(-2, 2, (500, 2))
    place = np.column_stack([x, 0 * x[:, 0]]).astype(np.float32)
    ways = np.zeros((2, len(x), 3), np.float32)
    ways[:, :, :2] = step * turn[:, None]
    normal = np.broadcast_to(np.array([0, 0, 1], np.float32), place.shape)
    moved = SampleInputs(position=place + ways[0], normal=normal), SampleInputs(position=place + ways[1], normal=normal)
    return evaluate(expression, SampleInputs(position=place, normal=normal, moved=moved, steps=ways)), x[:, 0]


def raised(x: np.ndarray, distance: float = DISTANCE, strength: float = 1.0) -> np.ndarray:
    """The normal of the plane raised by distance * sin(FREQUENCY x), in float64, blended with (0, 0, 1)."""
    slope = distance * FREQUENCY * np.cos(FREQUENCY * x)
    n = np.stack([-slope, 0 * x, np.ones_like(x)], axis=1) / np.sqrt(1 + slope**2)[:, None]
    n = strength * n + (1 - strength) * np.array([0, 0, 1.0])
    return n / np.linalg.norm(n, axis=1, keepdims=True)


def test_normals_are_those_of_the_raised_surface_along_any_two_ways():
    skewed = np.array([[0.8, 0.3], [-1.1, 0.9]])
    for turn in (np.eye(2), skewed, skewed[::-1]):  # the last turns the other way round
        for strength, distance in ((1.0, DISTANCE), (0.5, DISTANCE), (1.0, -DISTANCE)):
            found, x = on_plane(bump(wave(Coordinates("position")), strength, distance), turn)
            # Measured 0.004: a step forward, of 0.7 % of the wave.
            assert np.abs(found - raised(x, distance, strength)).max() < 0.006


def test_without_steps_the_normal_stays():
    normal = np.array([[0, 0.6, 0.8]], np.float32)
    inputs = SampleInputs(position=np.zeros((1, 3), np.float32), normal=normal)
    assert np.array_equal(evaluate(bump(wave(Coordinates("position"))), inputs), normal)


def test_baked_pictures_hold_heights_and_strengths():
    graph = MaterialGraph(normal=bump(wave(UV()), strength=0.25))
    assert needs(graph).heights
    assert bakeable(graph, unit_square=True, active_uv="UVMap")
    picture = bake(graph, (64, 2))
    u = (np.arange(64) + 0.5) / 64
    border = (picture["height"].shape[1] - 64) // 2
    height = picture["height"][border, border : border + 64]
    assert np.abs(height[:, 0] - DISTANCE * np.sin(FREQUENCY * u)).max() < 1e-6  # measured 6e-8
    assert (height[:, 1] == 0.25).all()
    assert "normal" not in picture


def test_heights_of_bumps_upon_bumps_add_up():
    first = bump(Constant((2.0,)), strength=0.5)
    below, height, strength = split_bumps(bump(Constant((3.0,)), normal=first))
    assert below is None
    assert height is not None
    assert strength is not None
    one = SampleInputs(count=1)
    assert np.isclose(evaluate(height, one)[0, 0], DISTANCE * (3 + 0.5 * 2))
    assert evaluate(strength, one)[0, 0] == 1


def test_bumps_that_read_positions_are_not_baked():
    assert not bakeable(MaterialGraph(normal=bump(wave(Coordinates("position")))), True, "UVMap")


def test_levels_of_heights_have_the_slopes_of_a_sine():
    """Sines of 32 texels a period, of known variance of slopes; across them there is none."""
    count, waves, amplitude = 256, 8, 0.01
    phase = 2 * np.pi * waves * (np.arange(count) + 0.5) / count
    heights = np.repeat((amplitude * np.sin(phase))[None].astype(np.float32), 64, axis=0)
    moments = shown_slopes(heights, 0, Stored(False, False, False, False, "wrap"))
    variance = (2 * np.pi * waves * amplitude) ** 2 / 2
    top = smaller_levels(moments, 0)[-1][0, 0]
    assert top[2] == pytest.approx(variance, rel=0.005)  # measured 0.32 %, of chords between texels
    np.testing.assert_allclose(top[[0, 1, 3]], 0, atol=1e-6)


def test_levels_of_normals_are_as_short_as_a_sine_of_slopes_makes_them():
    """The mean of 1 - z is that of float64; its length tells the variance of slopes."""
    count, waves, slope = 256, 8, 0.3
    slopes = slope * np.cos(2 * np.pi * waves * (np.arange(count) + 0.5) / count)
    n = np.stack([slopes, 0 * slopes, np.ones(count)], axis=1) / np.sqrt(1 + slopes**2)[:, None]
    picture = np.repeat(np.column_stack([n, np.zeros(count)])[None].astype(np.float32), 64, axis=0)
    top = smaller_levels(shown_normals(picture, Stored(False, False, False, False, "wrap")), 0)[-1][0, 0]
    assert top[2] == pytest.approx(1 - n[:, 2].mean(), rel=0.008)  # measured 0.64 %, of chords
    np.testing.assert_allclose(top[:2], 0, atol=1e-6)
    shorter = 2 * top[2] - top[2] ** 2  # 1 minus the squared length
    assert shorter / (1 - shorter) == pytest.approx(slope**2 / 2, rel=0.03)  # measured 2.3 %


@pytest.mark.parametrize("border", [0, 4])
def test_four_points_of_texels_have_the_mean_of_what_is_shown(border):
    """Of normals and heights that change from texel to texel without any order, beside 256 points in float64."""
    rng, size = np.random.default_rng(4), (24, 17)
    normals = np.dstack([rng.uniform(-0.5, 0.5, (*size[::-1], 2)), np.ones(size[::-1]), np.zeros(size[::-1])])
    heights = rng.uniform(0, 1, size[::-1])
    stored, ring = Stored(False, False, False, False, "edge" if border else "wrap"), slice(border, -border or None)

    def around(texels: np.ndarray) -> np.ndarray:
        return np.pad(texels, ((border, border), (border, border), (0, 0))[: texels.ndim], "wrap").astype(np.float32)

    found = shown_normals(around(normals), stored)[ring, ring, :3].mean(axis=(0, 1), dtype=float)
    truth = textures.mean_of_texels(lambda at: textures.shown_normals(normals[..., :3], at), size, 16).mean(axis=(0, 1))
    np.testing.assert_allclose(found, truth, rtol=0.012, atol=3e-5)  # measured 0.95 % of 1 - z, 1.5e-5 of x and y
    found = shown_slopes(around(heights), border, stored)[ring, ring].mean(axis=(0, 1), dtype=float)
    truth = textures.mean_of_texels(lambda at: textures.shown_slopes(heights, at), size, 16).mean(axis=(0, 1))
    np.testing.assert_allclose(found[:2], 0, atol=1e-6)  # measured 2.9e-8
    np.testing.assert_allclose(found[2:], truth[2:], rtol=2e-3)  # measured 1e-3, of the 256 points
