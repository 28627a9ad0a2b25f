"""Branches and leaves of meshes as tubes and ribbons."""

from __future__ import annotations

import numpy as np
import pytest

from pointsplat_addon.core.strand.fit.from_mesh import fit_strands
from pointsplat_addon.core.strand.fit.graph import connected_parts


def branch(sides, rings, *, tip=False, bend=0.0):
    """Vertices and triangles of a tapering tube along z, and its rings' middles."""
    angle = np.arange(sides) * 2 * np.pi / sides
    at = np.arange(rings)
    radius = 0.1 - 0.05 * at / rings
    middle = np.stack([bend * at**2, 0 * at, 0.3 * at], axis=1)
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    vertices = (middle[:, None] + radius[:, None, None] * circle).reshape(-1, 3)
    low = (at[:-1, None] * sides + np.arange(sides)).ravel()
    after = (at[:-1, None] * sides + (np.arange(sides) + 1) % sides).ravel()
    faces = np.concatenate([
        np.stack([low, after, after + sides], axis=1),
        np.stack([low, after + sides, low + sides], axis=1),
    ])  # fmt: skip
    if tip:
        middle = np.concatenate([middle, middle[-1:] + np.array([0, 0, 0.3])])
        vertices = np.concatenate([vertices, middle[-1:]])
        ring = (rings - 1) * sides + np.arange(sides)
        faces = np.concatenate([faces, np.stack([ring, np.roll(ring, -1), np.full(sides, len(vertices) - 1)], axis=1)])
    return vertices, faces, middle


def joined(*parts):
    vertices = np.concatenate([p[0] for p in parts])
    first = np.cumsum([0, *[len(p[0]) for p in parts[:-1]]])
    return vertices, np.concatenate([p[1] + f for p, f in zip(parts, first, strict=True)])


QUAD = np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 1, 0], [0, 1, 0]], float), np.array([[0, 1, 2], [0, 2, 3]])
CUBE = (
    np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float),
    np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
              [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]),
)  # fmt: skip


@pytest.mark.parametrize("sides", [3, 6, 11])
@pytest.mark.parametrize("tip", [False, True])
def test_rings_become_a_tube_through_their_middles(sides, tip):
    vertices, faces, middle = branch(sides, 7, tip=tip, bend=0.01)
    found = fit_strands(vertices, faces)
    assert len(found) == found.parts == 1
    assert not found.remaining.any()
    assert not found.ribbon.any()
    order = slice(None) if np.allclose(found.position[0], middle[0]) else slice(None, None, -1)
    np.testing.assert_allclose(found.position[order], middle, atol=1e-12)
    # A polygon's mean width over a circle's: its length over that of a circle
    expected = (0.1 - 0.05 * np.arange(7) / 7) * sides * np.sin(np.pi / sides) / np.pi
    np.testing.assert_allclose(found.radius[order][:7], expected, rtol=1e-12)
    assert not tip or found.radius[order][7] == 0


def test_leaves_of_two_to_four_triangles_become_ribbons_of_their_area():
    four = np.concatenate([QUAD[0], [[0.1, 2, 0.1], [0, 2, 0.1]]])
    kite = np.concatenate([QUAD[0], [[0.05, 1.5, 0]]])
    parts = QUAD, (four, np.array([[0, 1, 2], [0, 2, 3], [3, 2, 4], [3, 4, 5]])), (kite, np.array(
        [[0, 1, 2], [0, 2, 3], [3, 2, 4]]))  # fmt: skip
    found = fit_strands(*joined(*parts))
    assert found.ribbon.tolist() == [True] * 3
    assert not found.remaining.any()
    points = [found.position[a:b] for a, b in zip(found.start[:-1], found.start[1:], strict=True)]
    assert sorted(len(p) for p in points) == [2, 3, 3]
    for p in points:
        np.testing.assert_allclose(p[:, 0], 0.05, atol=1e-15)
    area = sum(
        (np.linalg.norm(np.diff(p, axis=0), axis=1) * (r[1:] + r[:-1])).sum()
        for p, r in zip(points, np.split(found.radius, found.start[1:-1]), strict=True)
    )
    assert area == pytest.approx(0.1 + 0.1 + 0.1 * np.hypot(1, 0.1) + 0.125, rel=1e-12)
    np.testing.assert_allclose(np.linalg.norm(found.normal, axis=1), 1, atol=1e-12)


def test_what_has_no_structure_stays_and_is_counted():
    single = np.eye(3), np.array([[0, 1, 2]])
    found = fit_strands(*joined(CUBE, QUAD, single, branch(5, 4)[:2]))
    assert found.parts == 4
    assert len(found) == 2
    assert found.remaining.sum() == 12 + 1
    assert found.remaining[:12].all()


def split_edge(vertices, faces, a, b):
    """The mesh with a vertex in the middle of an edge."""
    new = len(vertices)
    vertices = np.concatenate([vertices, vertices[[a, b]].mean(axis=0, keepdims=True)])
    on = (faces == a).any(axis=1) & (faces == b).any(axis=1)
    halves = [np.where(faces[on] == end, new, faces[on]) for end in (a, b)]
    return vertices, np.concatenate([faces[~on], *halves])


def sleeve(sides):
    """A tube whose vertices make no rings, and its rings' middles without some of them."""
    vertices, faces, middle = branch(sides, 6)
    for ring, side in ((1, 0), (2, 2), (1, sides - 1)):
        at = ring * sides + side
        vertices, faces = split_edge(vertices, faces, at, at + sides)
    return vertices, faces, middle


def test_a_sleeve_whose_vertices_make_no_rings_is_cut_across():
    vertices, faces, middle = sleeve(8)
    found = fit_strands(vertices, faces)
    assert len(found) == 1
    assert not found.remaining.any()
    ends = found.position[[0, -1]]
    np.testing.assert_allclose(ends[np.argsort(ends[:, 2])], middle[[0, -1]], atol=1e-12)
    assert np.abs(found.position[:, :2]).max() < 1e-12  # measured 4e-18
    expected = np.interp(found.position[:, 2], middle[:, 2], 0.1 - 0.05 * np.arange(6) / 6)
    expected *= 8 * np.sin(np.pi / 8) / np.pi
    assert np.abs(found.radius / expected - 1).max() < 1e-6  # measured 1.7e-8
    # Pressed flat it is no tube
    assert fit_strands(vertices * np.array([1, 0.01, 1]), faces).ribbon.tolist() == [True]


def test_a_sleeve_with_angular_sections_is_a_tube_only_where_it_is_thin_beside_the_mesh():
    vertices, faces, _ = sleeve(3)
    alone = fit_strands(vertices, faces)
    assert alone.remaining.all()
    assert alone.remaining_parts == 1
    far = QUAD[0] + np.array([200.0, 0, 0]), QUAD[1]  # the tube's radius is 0.06
    assert fit_strands(*joined((vertices, faces), far)).ribbon.tolist() == [False, True]


@pytest.mark.parametrize("sides", [3, 4, 7])
def test_a_tube_that_is_closed_at_its_ends_and_within_is_the_same_tube(sides):
    vertices, faces, middle = branch(sides, 5)
    fan = np.stack([np.zeros(sides - 2, int), np.arange(1, sides - 1), np.arange(2, sides)], axis=1)
    walls = [fan + sides * ring for ring in ((0, 2, 4) if sides == 3 else (0, 4))]
    found, open_ = fit_strands(vertices, np.concatenate([faces, *walls])), fit_strands(vertices, faces)
    assert len(found) == 1
    assert not found.remaining.any()
    np.testing.assert_allclose(found.radius, open_.radius, rtol=1e-12)
    order = slice(None) if np.allclose(found.position[0], middle[0]) else slice(None, None, -1)
    np.testing.assert_allclose(found.position[order], middle, atol=1e-12)


def test_parts_are_found_in_any_order_of_triangles():
    random = np.random.default_rng(0)
    chains = [np.stack([np.arange(n - 2), np.arange(1, n - 1), np.arange(2, n)], axis=1) for n in (3, 500, 40)]
    first = np.cumsum([0, 3, 500])
    triangles = np.concatenate([c + f for c, f in zip(chains, first, strict=True)])
    shuffled = random.permutation(543)
    triangles = shuffled[triangles][random.permutation(len(triangles))]
    label = connected_parts(triangles, 543)
    groups = [np.unique(label[shuffled[f : f + n]]) for f, n in zip(first, (3, 500, 40), strict=True)]
    assert [len(g) for g in groups] == [1, 1, 1]
    assert len(np.unique(label)) == 3


def star(lobes, sides=1):
    """A flat leaf of lobes about its middle, in a slanted plane; of two sides: one each way."""
    angle = np.arange(2 * lobes) * np.pi / lobes
    rim = np.where(np.arange(2 * lobes) % 2, 0.55, 1.0) * (1 + 0.6 * np.cos(angle) ** 2)
    flat = np.stack([rim * np.cos(angle), rim * np.sin(angle), 0 * angle], axis=1)
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    vertices = np.concatenate([np.zeros((1, 3)), flat]) @ turn + 3.0
    one = np.arange(2 * lobes)
    faces = np.stack([0 * one, 1 + one, 1 + (one + 1) % (2 * lobes)], axis=1)
    return vertices, np.concatenate([faces, faces[:, ::-1]][:sides])


@pytest.mark.parametrize("sides", [1, 2])
def test_a_flat_leaf_of_many_triangles_becomes_a_ribbon_of_its_area(sides):
    vertices, faces = star(7, sides)
    found = fit_strands(vertices, faces)
    assert found.ribbon.tolist() == [True]
    assert not found.remaining.any()
    corner = vertices[faces[: len(faces) // sides]]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = np.linalg.norm(normal, axis=1).sum() / 2
    length = np.linalg.norm(np.diff(found.position, axis=0), axis=1)
    assert (length * (found.radius[1:] + found.radius[:-1])).sum() == pytest.approx(area, rel=1e-12)
    # In its plane, from end to end
    plane = normal[0] / np.linalg.norm(normal[0])
    assert np.abs((found.position - vertices[0]) @ plane).max() < 1e-12  # measured 1e-15
    assert np.abs(np.abs(found.normal @ plane) - 1).max() < 1e-12
    assert length.sum() > 0.9 * np.ptp(vertices, axis=0).max()


def finer(vertices, faces):
    """Each triangle in four."""
    pairs = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, row = np.unique(pairs, axis=0, return_inverse=True)
    a, b, c = (len(vertices) + row.reshape(-1, 3)).T
    faces = np.concatenate([
        np.stack(corners, axis=1)
        for corners in ((faces[:, 0], a, c), (a, faces[:, 1], b), (c, b, faces[:, 2]), (a, b, c))
    ])  # fmt: skip
    return np.concatenate([vertices, vertices[edges].mean(axis=1)]), faces


@pytest.mark.parametrize("lobes", [3, 5, 7])
@pytest.mark.parametrize("sides", [1, 2])
def test_a_leaf_with_lobes_becomes_a_ribbon_for_each_and_one_between_them(lobes, sides):
    flat = finer(*star(lobes))
    vertices, faces = flat[0], np.concatenate([flat[1], flat[1][:, ::-1]][:sides])
    found = fit_strands(vertices, faces)
    assert found.ribbon.tolist() == [True] * (lobes + 1)
    assert (np.diff(found.start) == 2).all()
    assert not found.remaining.any()
    assert found.remaining_parts == 0
    points, radius = found.position.reshape(-1, 2, 3), found.radius.reshape(-1, 2)
    # All its area, in its plane
    corner = vertices[flat[1]]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    covered = np.linalg.norm(points[:, 1] - points[:, 0], axis=1) * radius.sum(axis=1)
    # Triangles lean a little where their base is not square to their axis
    assert covered.sum() == pytest.approx(np.linalg.norm(normal, axis=1).sum() / 2, rel=0.015)  # measured 0.9 %
    plane = normal[0] / np.linalg.norm(normal[0])
    assert np.abs((found.position - vertices[0]) @ plane).max() < 1e-12  # measured 2e-15
    assert np.abs(np.abs(found.normal @ plane) - 1).max() < 1e-12
    # As pointed as the leaf, at its tips
    assert (radius[:-1, 1] == 0).all()
    tips = vertices[1 : 1 + 2 * lobes : 2]
    away = np.linalg.norm(points[:-1, 1][:, None] - tips, axis=2).min(axis=0)
    assert away.max() < 1e-12  # measured 1e-15


def test_what_is_thick_or_full_of_gaps_is_no_leaf():
    vertices, faces = star(7)
    thick = np.concatenate([vertices, vertices + 0.8 * np.cross(vertices[1] - vertices[0], vertices[3] - vertices[0])])
    rim = 1 + np.arange(14)
    after = 1 + (np.arange(14) + 1) % 14
    wall = np.concatenate([np.stack([rim, after, rim + 15], axis=1), np.stack([after, after + 15, rim + 15], axis=1)])
    assert fit_strands(thick, np.concatenate([faces, faces[:, ::-1] + 15, wall])).remaining.all()
    # A ring, most of whose breadth is empty
    angle = np.arange(24) * 2 * np.pi / 24
    inner, outer = (r * np.stack([2 * np.cos(angle), np.sin(angle), 0 * angle], axis=1) for r in (0.9, 1.0))
    low, following = np.arange(24), (np.arange(24) + 1) % 24
    band = [np.stack([low, following, low + 24], axis=1), np.stack([following, following + 24, low + 24], axis=1)]
    assert fit_strands(np.concatenate([inner, outer]), np.concatenate(band)).remaining.all()
