"""Curves to polylines against closed forms, cleaning of bad input, and what colours hair."""

# pyright: reportOptionalSubscript=false, reportOptionalMemberAccess=false, reportArgumentType=false
# pyright: reportCallIssue=false
# Attributes may be None by type; what is tested here has those that are asked for.
from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from pointsplat_addon.core.material import hair_color
from pointsplat_addon.core.scene.strands import Strands
from pointsplat_addon.core.scene.valid.geometry import valid_strands
from pointsplat_addon.core.strand import curves, evaluation, normals
from pointsplat_addon.core.strand.preparation import with_levels


def curve(points, kind, *, cyclic=False, resolution=12, **more):
    points = np.asarray(points, float)
    return curves.Curves(
        points,
        np.array([0, len(points)]),
        np.array([kind], np.uint8),
        np.array([cyclic]),
        np.array([resolution]),
        **more,
    )


def strands(*parts, radius: Any = 0.01, **more):
    position = np.concatenate([np.asarray(p, np.float32).reshape(-1, 3) for p in parts])
    start = np.concatenate([[0], np.cumsum([len(p) for p in parts])])
    width = np.full(len(position), radius, np.float32) if np.isscalar(radius) else np.asarray(radius, np.float32)
    return Strands("strands of test_lines", "Hair", position, start, width, **more)


def helix(n=1000, turns=3.0):
    t = np.linspace(0, 2 * np.pi * turns, n)
    return np.stack([np.cos(t), np.sin(t), 0.1 * t], axis=1)


# Evaluation


def test_a_nurbs_circle_is_a_circle():
    """Seven points of order 3 with Bezier knots, weights 1 and 1/2, on a triangle around it (Piegl and Tiller 7.5)."""
    root = np.sqrt(3)
    corner = np.array([[0, -1], [root, -1], [root / 2, 0.5], [0, 2], [-root / 2, 0.5], [-root, -1], [0, -1]])
    points = np.column_stack([corner, np.zeros(7)])
    weight = np.array([1, 0.5, 1, 0.5, 1, 0.5, 1])
    made = curve(points, curves.NURBS, order=np.array([3]), knots=np.array([3]), weight=weight, resolution=50)
    found = evaluation.evaluate_curves(made)
    assert len(found) == 3 * 50 + 1
    assert np.abs(np.linalg.norm(found.position, axis=1) - 1).max() < 1e-14  # measured 2.2e-16


def test_a_bezier_quarter_is_its_polynomial_and_vectors_are_straight():
    points = np.array([[0.0, 0, 0], [1, 1, 0], [2, 1, 0]])
    left, right = moved(points, -0.5), moved(points, 0.5)
    straight = np.array([False, True, True])
    made = curve(points, curves.BEZIER, handle_left=left, handle_right=right, vector_left=straight,
                 vector_right=straight, resolution=4)  # fmt: skip
    found = evaluation.evaluate_curves(made)
    t = np.arange(4)[:, None] / 4
    expected = 3 * t * (1 - t) ** 2 * right[0] + 3 * t**2 * (1 - t) * left[1] + t**3 * points[1]
    assert len(found) == 4 + 1 + 1
    np.testing.assert_allclose(found.position[:4], expected, atol=1e-15)
    np.testing.assert_array_equal(found.position[4:], points[1:])
    np.testing.assert_allclose(found.interpolate(np.array([1.0, 3.0, 4.0])), [1, 1.5, 2, 2.5, 3, 4], atol=1e-15)


def test_catmull_rom_goes_through_its_points_and_repeats_a_quadratic():
    x = np.arange(6.0)
    found = evaluation.evaluate_curves(curve(np.stack([x, x**2, 0 * x], axis=1), curves.CATMULL_ROM, resolution=8))
    np.testing.assert_allclose(found.position[::8, 0], x, atol=1e-15)
    inner = found.position[8:-8]
    np.testing.assert_allclose(inner[:, 1], inner[:, 0] ** 2, atol=1e-13)  # Catmull-Rom has quadratic precision


@pytest.mark.parametrize("kind", [curves.POLY, curves.CATMULL_ROM, curves.NURBS])
def test_cyclic_curves_end_as_they_begin_and_their_neighbours_do_not_matter(kind):
    random = np.random.default_rng(2)
    loop, other = random.random((7, 3)), random.random((4, 3))
    both = curves.Curves(
        np.concatenate([other, loop, other]),
        np.array([0, 4, 11, 15]),
        np.full(3, kind, np.uint8),
        np.array([False, True, False]),
        np.full(3, 5),
    )
    found, alone = (
        evaluation.evaluate_curves(both),
        evaluation.evaluate_curves(curve(loop, kind, cyclic=True, resolution=5)),
    )
    middle = slice(found.start[1], found.start[2])
    np.testing.assert_array_equal(found.position[middle], alone.position)
    np.testing.assert_array_equal(alone.position[0], alone.position[-1])
    np.testing.assert_allclose(found.interpolate(both.position)[middle], alone.position, atol=1e-14)  # measured 0


def test_steps_follow_the_bend_and_the_radius():
    bent, straight = helix(16, 0.5), np.linspace([0, 0, 0], [1, 0, 0], 16)
    made = curves.Curves(
        np.concatenate([bent, straight, bent]),
        np.array([0, 16, 32, 48]),
        np.zeros(3, np.uint8),
        np.zeros(3, bool),
        np.zeros(3, int),
        radius=np.repeat([1e-3, 1e-3, 1e-1], 16),
    )
    found = evaluation.evaluate_curves(made)
    count = np.diff(found.start)
    assert count[1] == 16
    assert count[0] > count[2] > 16
    thick = found.position[found.start[2] :]
    assert (
        distance(evaluation.evaluate_curves(curve(bent, curves.CATMULL_ROM, resolution=200)).position, thick)
        < evaluation.SAG * np.pi / 15
    )
    fine = evaluation.evaluate_curves(curve(bent, curves.CATMULL_ROM, resolution=200)).position
    line = found.position[: found.start[1]]
    assert distance(fine, line) < evaluation.CHORD * 1e-3  # 2.5e-4; measured 2.3e-4


def moved(points, x):
    return np.asarray(points) + np.array([x, 0, 0])


def distance(points, line):
    """The largest distance of points from a polyline, by brute force."""
    a, b = line[:-1], line[1:]
    along = b - a
    t = np.clip(((points[:, None] - a) * along).sum(-1) / (along * along).sum(-1), 0, 1)
    return np.linalg.norm(points[:, None] - a - t[..., None] * along, axis=-1).min(axis=1).max()


def test_normals_do_not_twist_along_a_helix_and_close_on_a_loop():
    found = evaluation.evaluate_curves(curve(helix(), curves.POLY))
    normal = normals.curve_normals(found, np.array([False]), np.array([curves.MINIMUM_TWIST]))
    tangent = normals.curve_tangents(found.position, found.open, np.array([False]))
    assert np.abs(np.einsum("ij,ij->i", normal, tangent)).max() < 1e-12  # measured 2e-15
    # A sequential transport, one step after another
    expected = [normal[0]]
    for a, b in itertools.pairwise(tangent):
        v = expected[-1]
        axis = np.cross(a, b)
        expected.append(v + np.cross(axis, v) + np.cross(axis, np.cross(axis, v)) / (1 + a @ b))
    np.testing.assert_allclose(normal, expected, atol=1e-12)  # measured 3e-15
    t = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    knot = np.stack([np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t), -np.sin(3 * t)], axis=1)
    closed = evaluation.evaluate_curves(curve(knot, curves.POLY, cyclic=True))
    normal = normals.curve_normals(closed, np.array([True]), np.array([curves.MINIMUM_TWIST]))
    np.testing.assert_array_equal(normal[0], normal[-1])
    assert np.einsum("ij,ij->i", normal[1:], normal[:-1]).min() > 0.9  # measured 0.958; a jump of half a turn is -1


# Bad input


def test_what_cannot_be_drawn_is_left_out_and_counted():
    good = [[0, 0, 0], [0, 0, 1], [0, 0, 2]]
    lines = strands(
        good,
        [[1, 0, 0]],
        [[2, 0, 0], [2, 0, np.nan], [2, 0, 2]],
        [[3, 0, 0]] * 4,
        [[4, 0, 0], [4, 0, 1]],
        [[5, 0, 0], [5, 0, 0], [5, 0, 1]],
        [[np.inf] * 3] * 2,
        radius=np.repeat([0.1, 0.1, 0.1, 0.1, 0, 0.1, 0.1], [3, 1, 3, 4, 2, 3, 2]),
        uv=np.arange(14, dtype=np.float32).reshape(7, 2),
        material=np.arange(7, dtype=np.uint16),
    )
    found, messages = valid_strands(lines)
    assert messages == (
        "3 points are not finite and are left out",
        "4 strands have less than two positions and are left out",
        "1 strand has no radius and is left out",
    )
    np.testing.assert_array_equal(found.start, [0, 3, 5])
    np.testing.assert_array_equal(found.position[3:], [[5, 0, 0], [5, 0, 1]])
    np.testing.assert_array_equal(found.material, [0, 5])
    np.testing.assert_array_equal(found.position, lines.position[[0, 1, 2, 13, 15]])
    np.testing.assert_array_equal(found.uv, lines.uv[[0, 5]])


def test_a_wiggle_shorter_than_the_radius_does_not_turn_the_end_of_a_strand():
    straight = np.array([[0.0, 0, z] for z in (0, -0.01, 0.02, 0.5, 1, 1.5, 1.48, 1.51, 1.5)], np.float32)
    bent = np.array([[1.0, 0, 0], [1, 0.05, 0.05], [1, 0.3, 0.1], [1, 0.6, 0.1]], np.float32)
    lines = Strands(
        "ends", "ends", np.concatenate([straight, bent]), np.array([0, 9, 13]), np.full(13, 0.1, np.float32)
    )
    tangent = with_levels(lines).tangent
    np.testing.assert_array_equal(tangent[[0, 8]], [[0, 0, 1]] * 2)
    # Where the strand leads on it keeps its own direction
    np.testing.assert_allclose(tangent[9], [0, 0.5**0.5, 0.5**0.5], atol=1e-6)


def test_strands_that_cannot_be_drawn_leave_nothing_and_valid_ones_are_returned_themselves():
    assert len(valid_strands(strands([[1, 0, 0]]))[0]) == 0
    assert len(valid_strands(strands([[1, 0, 0], [1, 0, np.nan]]))[0]) == 0
    assert len(with_levels(valid_strands(strands(np.zeros((0, 3))))[0])) == 0
    lines = strands(helix())
    assert valid_strands(lines) == (lines, ())


def test_points_with_a_value_that_is_not_finite_are_left_out():
    color = np.full((5, 3), 0.5, np.float32)
    color[1] = np.nan
    given = strands(np.arange(15).reshape(5, 3), color=color)
    found, messages = valid_strands(given)
    np.testing.assert_array_equal(found.position, given.position[2:])
    assert messages == ("1 point is not finite and is left out",)


def test_a_strand_of_a_million_points_is_evaluated_and_cleaned():
    n = 1_000_000
    position = np.stack([np.linspace(0, 100, n), np.sin(np.linspace(0, 50, n)), np.zeros(n)], axis=1)
    found = evaluation.evaluate_curves(curve(position, curves.POLY))
    assert len(found) == n
    normal = normals.curve_normals(found, np.array([False]), np.array([curves.MINIMUM_TWIST]))
    assert np.abs(np.linalg.norm(normal, axis=1) - 1).max() < 1e-12  # measured 4.4e-16
    lines, messages = valid_strands(strands(found.position))
    assert len(with_levels(lines)) == n
    assert messages == ()


# Hair


def test_pigments_are_those_of_cycles():
    """Values of Cycles' source: a polynomial and the absorption of melanins."""
    assert hair_color.roughness_scale(0.0) == 5.969
    assert hair_color.roughness_scale(1.0) == pytest.approx(0.245 + 5.574 - 10.73 + 2.532 - 0.215 + 5.969, abs=1e-14)
    # Cycles' stand-in for missing settings is melanin 0.5541 with redness 1: a concentration of 0.8054375
    melanin = np.array([[1 - np.exp(-0.8054375)]])
    absorption = hair_color.absorption_from_melanin(melanin, np.ones((1, 1)))
    np.testing.assert_allclose(absorption, 0.8054375 * np.array([[0.343, 0.733, 1.924]]), rtol=1e-12)
    black = hair_color.absorption_from_melanin(np.ones((1, 1)), np.zeros((1, 1)))
    np.testing.assert_allclose(black, -np.log(1e-4) * np.array([[0.506, 0.841, 1.653]]), rtol=1e-12)


def test_colour_and_absorption_are_each_others_inverse():
    color = np.random.default_rng(1).uniform(1e-5, 1, (100, 3))
    radial = np.random.default_rng(2).random((100, 1))
    back = hair_color.color_from_absorption(hair_color.absorption_from_color(color, radial), radial)
    np.testing.assert_allclose(back, color, rtol=1e-12)  # measured 7e-16


def test_random_numbers_of_strands_are_jenkins():
    """Against the hash written with Python's integers."""

    def expected(x, y=0):
        mask = 0xFFFFFFFF
        rot = lambda v, k: (v << k | v >> (32 - k)) & mask  # noqa: E731
        a = b = c = 0xDEADBEEF + 8 + 13
        a, b = a + x & mask, b + y & mask
        c = (c ^ b) - rot(b, 14) & mask
        a = (a ^ c) - rot(c, 11) & mask
        b = (b ^ a) - rot(a, 25) & mask
        c = (c ^ b) - rot(b, 16) & mask
        a = (a ^ c) - rot(c, 4) & mask
        b = (b ^ a) - rot(a, 14) & mask
        return ((c ^ b) - rot(b, 24) & mask) / 0xFFFFFFFF

    found = hair_color.random_of_strands(200, 5)
    np.testing.assert_allclose(found, [expected(i) for i in range(5, 205)], atol=1e-7)  # measured 2.9e-8
    assert len(np.unique(found)) == 200
