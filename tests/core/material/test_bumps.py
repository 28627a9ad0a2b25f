"""Bump nodes against closed forms: normals of surfaces whose heights are known, at points and in baked pictures."""

import numpy as np

from pointsplat_addon.core.material.baking import bake, bakeable, split_bumps
from pointsplat_addon.core.material.expression import Expression, SampleInputs, evaluate
from pointsplat_addon.core.material.graph import MaterialGraph, needs
from pointsplat_addon.core.material.nodes.color_nodes import Component
from pointsplat_addon.core.material.nodes.input_nodes import UV, Constant, Coordinates
from pointsplat_addon.core.material.nodes.math_nodes import Math
from pointsplat_addon.core.material.nodes.normal_nodes import Bump

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
