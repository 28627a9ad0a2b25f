"""The light tree: nodes hold what their surfels do, and tell their two sides apart."""

import numpy as np
import pytest

from pointsplat_addon.core.indirect.surfels import ARRAYS, Surfels
from pointsplat_addon.core.indirect.tree import LightTree, build_tree


def random_surfels(count: int, seed: int = 1) -> Surfels:
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    f = np.float32
    none = np.zeros((count, 3), f)
    return Surfels(
        np.zeros(3), rng.normal(size=(count, 3)).astype(f), normal.astype(f), rng.uniform(0.5, 2, count).astype(f),
        np.ones(count, bool), rng.uniform(size=count) < 0.3, none, none, none, np.zeros(count, bool),
    )  # fmt: skip


def descendants(tree: LightTree) -> np.ndarray:
    """(M, M) bool: which leaves lie below each node, by following first children and octants."""
    below = np.zeros((len(tree), len(tree)), bool)
    below[np.arange(len(tree)), np.arange(len(tree))] = tree.first < 0
    for nodes, _, _ in tree.levels:
        for node in nodes.tolist():
            children = tree.first[node] + np.arange(int(tree.octants[node]).bit_count())
            below[node] = below[children].any(axis=0)
    return below


@pytest.mark.parametrize("count", [1, 2, 9, 300])
def test_nodes_hold_their_surfels(count):
    """Worst: 6e-8 of the areas, 1.2e-7 of places and normals, 1.2e-7 of the radius outside of it."""
    surfels = random_surfels(count)
    tree = build_tree(surfels)
    below = descendants(tree)
    assert below[-1][tree.leaf].all()
    held = below[:, tree.leaf]
    area = surfels.area.astype(float)
    np.testing.assert_allclose(tree.area, held @ area, rtol=5e-7)
    for found, of in ((tree.position, surfels.position), (tree.facing, surfels.normal)):
        np.testing.assert_allclose(found, held @ (area[:, None] * of) / (held @ area)[:, None], atol=5e-7)
    away = np.linalg.norm(surfels.position[None] - tree.position[:, None], axis=2) + np.sqrt(area / np.pi)
    assert (np.where(held, away, 0) <= tree.radius[:, None] * (1 + 1e-6)).all()


@pytest.mark.parametrize(("flat", "thickest"), [(1.0, 1.0), (0.01, 0.06)])
def test_no_disk_reaches_beyond_a_nodes_thickness(flat, thickest):
    """Of surfels turned at random, and of a sheet a hundredth as thick, whose root is thin: 0.0500 of its radius."""
    surfels = random_surfels(300)
    normal = surfels.normal * np.array([flat, flat, 1], np.float32)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    position = surfels.position * np.array([1, 1, flat], np.float32)
    area = np.full(300, 1e-4, np.float32)
    names = [name for name in NAMES if name not in ("normal", "area")]
    surfels = Surfels(surfels.origin, position, normal, area, *(getattr(surfels, name) for name in names))
    tree = build_tree(surfels)
    held = descendants(tree)[:, tree.leaf]
    away = np.abs(np.einsum("mni,mi->mn", position[None] - tree.position[:, None], tree.axis))
    sine = np.sqrt(np.maximum(1 - (tree.axis @ normal.T) ** 2, 0))
    reach = np.where(held, away + np.sqrt(area / np.pi) * sine, 0).max(axis=1)
    assert (reach <= tree.thickness + 1e-5).all()
    assert (tree.thickness <= tree.radius * (1 + 1e-6)).all()
    assert tree.thickness[-1] <= thickest * tree.radius[-1]


def test_surfels_in_one_place_share_a_leaf():
    surfels = random_surfels(5)
    tree = build_tree(Surfels(surfels.origin, surfels.position * 0, *(getattr(surfels, name) for name in NAMES)))
    assert len(tree) == 1
    assert tree.first[0] == -1
    np.testing.assert_allclose(tree.area[0], surfels.area.sum(), rtol=1e-6)


NAMES = ARRAYS[1:]


def test_a_thin_wall_shines_by_each_side():
    """A wall of two sheets, one bright and one dark: no node that holds both mixes them."""
    y, z = (a.ravel() for a in np.meshgrid(np.arange(8.0), np.arange(8.0)))
    sheet = np.stack([0 * y, y, z], axis=1)
    position = np.concatenate([sheet + np.array([0.1, 0, 0]), sheet - np.array([0.1, 0, 0])]).astype(np.float32)
    normal = np.repeat(np.array([[1, 0, 0], [-1, 0, 0]], np.float32), 64, axis=0)
    zero, no = np.zeros((128, 3), np.float32), np.zeros(128, bool)
    surfels = Surfels(np.zeros(3), position, normal, np.ones(128, np.float32), ~no, no, zero, zero, zero, no)
    bright = np.repeat(np.array([[1.0], [0.0]]), 64, axis=0) * np.ones(3)
    tree = build_tree(surfels)
    before, behind, _ = tree.radiance(surfels, bright, zero)[:, -1]
    toward = tree.axis[-1] @ np.array([1, 0, 0])
    assert abs(toward) > 1 - 1e-6
    assert np.allclose([before, behind] if toward > 0 else [behind, before], [np.ones(3), np.zeros(3)])
    assert tree.along[-1] > 1 - 1e-6


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_radiance_keeps_what_leaves_in_all(seed):
    """Of surfels that send as much to either side, each mean of a node's two sides lies between its surfels'."""
    surfels = random_surfels(200, seed)
    value = np.random.default_rng(seed).uniform(size=(200, 3))
    tree = build_tree(surfels)
    before, behind, inside = tree.radiance(surfels, value, value)
    for side in (before, behind, inside):
        assert (side >= 0).all()
        assert (side <= value.max() + 1e-6).all()
    mean = (surfels.area[:, None] * value).sum(axis=0) / surfels.area.sum()
    np.testing.assert_allclose(inside[-1], mean, rtol=1e-5)


@pytest.mark.parametrize("count", [2, 9, 300])
def test_levels_and_the_cube_tell_where_octants_meet(count):
    """Whatever lies in an octant of a node lies on that side of the middle of its cell."""
    surfels = random_surfels(count)
    tree = build_tree(surfels)
    held = descendants(tree)[:, tree.leaf]
    low, side = tree.cube[:3].astype(float), float(tree.cube[3])
    for node in np.flatnonzero(tree.first >= 0).tolist():
        edge = side / 2 ** int(tree.level[node])
        middle = low + (np.floor((tree.position[node] - low) / edge) + 0.5) * edge
        octants = [octant for octant in range(8) if tree.octants[node] >> octant & 1]
        for child, octant in enumerate(octants, tree.first[node]):
            above = surfels.position[held[child]] >= middle
            assert (above == [octant & 1, octant >> 1 & 1, octant >> 2]).all()


def test_an_edge_of_a_slab_does_not_shine_on_its_sides():
    """A slab of two sheets and the strip between them, which alone is bright: seen from before its sheets are dark.
    Found: 1.2e-4 of it; 0.11, its share of the area, as long as it counted."""
    at = (np.arange(8.0) + 0.5) / 8
    y, z = (a.ravel() for a in np.meshgrid(at, at))
    thick = 0.125
    sheets = [np.stack([0 * y + x, y, z], axis=1) for x in (0, thick)]
    strip = np.stack([0 * at + 0.5 * thick, 0 * at + 1, at], axis=1)
    position = np.concatenate([*sheets, strip]).astype(np.float32)
    normal = np.repeat(np.array([[-1, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32), [64, 64, 8], axis=0)
    count = len(position)
    zero, no = np.zeros((count, 3), np.float32), np.zeros(count, bool)
    area = np.full(count, 1 / 64, np.float32)
    surfels = Surfels(np.zeros(3), position, normal, area, ~no, no, zero, zero, zero, no)
    tree = build_tree(surfels)
    bright = np.repeat([0.0, 0.0, 1.0], [64, 64, 8])[:, None] * np.ones(3)
    before, behind, _ = tree.radiance(surfels, bright, zero)[:, -1]
    assert abs(tree.axis[-1, 0]) > 1 - 1e-6
    assert max(before.max(), behind.max()) < 1e-3
