"""Nodes over the surface of meshes: their moments, and how much of their ellipses is covered."""

import numpy as np

from pointsplat_addon.core.lod.nodes.surface import FULL, SPREAD, surface_nodes
from pointsplat_addon.core.scene.cloud import PointCloud


def square(side: int, z: float = 0.0, up: float = 1.0) -> tuple[PointCloud, np.ndarray]:
    """An even lattice of samples over the unit square, red on its left half, and the area of each."""
    at = (np.arange(side) + 0.5) / side
    x, y = (a.ravel() for a in np.meshgrid(at, at))
    position = np.stack([x, y, np.full_like(x, z)], axis=1).astype(np.float32)
    normal = np.tile(np.array([0, 0, up], np.float32), (len(x), 1))
    color = np.where((x < 0.5)[:, None], [1.0, 0, 0], [0, 0, 1.0]).astype(np.float32)
    return PointCloud(position, normal=normal, radii=np.full((len(x), 1), 1 / side, np.float32), color=color), (
        np.full(len(x), 1 / side**2)
    )


def joined(*parts: tuple[PointCloud, np.ndarray]) -> tuple[PointCloud, np.ndarray]:
    arrays = {name: np.concatenate([cloud.arrays()[name] for cloud, _ in parts]) for name in parts[0][0].arrays()}
    return PointCloud(**arrays), np.concatenate([area for _, area in parts])


def area_of(nodes: PointCloud) -> np.ndarray:
    """(M,) of their ellipses."""
    return np.pi * nodes.arrays()["radii"].astype(np.float64).prod(axis=1)


def test_even_squares_have_the_moments_of_squares_and_are_covered_whole():
    """A square of side e has the variance e^2 / 12 along each axis; worst of half-axes 1e-7."""
    nodes = surface_nodes(*square(32), edge=0.25)
    assert len(nodes) == 16
    np.testing.assert_allclose(nodes.arrays()["radii"], 0.25 * np.sqrt(SPREAD / 12), rtol=1e-5)
    np.testing.assert_allclose(nodes.arrays()["normal"], np.tile([0, 0, 1], (16, 1)), atol=1e-6)
    np.testing.assert_array_equal(nodes.arrays()["share"], 1)


def test_colours_are_means_by_area():
    cloud, area = square(32)
    wide = cloud.position[:, 0] > 0.5
    nodes = surface_nodes(cloud, np.where(wide, 3 * area, area), edge=2.0)
    np.testing.assert_allclose(nodes.arrays()["color"], [[0.25, 0, 0.75]], atol=1e-6)


def test_both_sides_of_a_thin_slab_stay_apart():
    nodes = surface_nodes(*joined(square(16), square(16, -0.001, -1.0)), edge=0.5)
    np.testing.assert_allclose(
        np.sort(nodes.arrays()["normal"][:, 2]), np.repeat([-1.0, 1.0], len(nodes) // 2), atol=1e-6
    )
    assert len(nodes) == 8


def test_what_is_not_filled_is_covered_by_its_share():
    """Scattered leaves in a plane: what nodes cover, of which FULL counts as all, is the area of the leaves; exact
    but for rounding, since none is filled."""
    rng = np.random.default_rng(2)
    position = np.concatenate([rng.random((4000, 2)), np.zeros((4000, 1))], axis=1).astype(np.float32)
    normal = np.tile(np.array([0, 0, 1], np.float32), (4000, 1))
    area = rng.uniform(0.2, 1.0, 4000) * 0.2 / 4000
    leaves = PointCloud(position, normal=normal, radii=np.full((4000, 1), 0.01, np.float32))
    nodes = surface_nodes(leaves, area, edge=0.2)
    assert nodes.arrays()["share"].max() < 1
    np.testing.assert_allclose((FULL * nodes.arrays()["share"] * area_of(nodes)).sum(), area.sum(), rtol=1e-6)


def test_normals_of_a_sphere_point_outwards():
    """Within what a cell spans: worst 0.98 of the cosine of 14 degrees, for cells of a quarter of the radius."""
    rng = np.random.default_rng(3)
    normal = rng.normal(size=(50_000, 3))
    normal = (normal / np.linalg.norm(normal, axis=1, keepdims=True)).astype(np.float32)
    sphere = PointCloud(normal.copy(), normal=normal, radii=np.full((50_000, 1), 0.01, np.float32))
    nodes = surface_nodes(sphere, np.full(50_000, 4 * np.pi / 50_000), edge=0.25)
    outwards = nodes.arrays()["position"] / np.linalg.norm(nodes.arrays()["position"], axis=1, keepdims=True)
    assert (outwards * nodes.arrays()["normal"]).sum(axis=1).min() > 0.99
    np.testing.assert_allclose(np.linalg.norm(nodes.arrays()["normal"], axis=1), 1, rtol=1e-6)


def test_one_sample_and_coincident_ones_stay_finite():
    one = PointCloud(np.zeros((1, 3), np.float32), normal=np.array([[0, 0, 1]], np.float32),
                     radii=np.ones((1, 1), np.float32))  # fmt: skip
    for cloud, area in ((one, np.ones(1)), joined((one, np.ones(1)), (one, np.zeros(1)))):
        nodes = surface_nodes(cloud, area, edge=1.0)
        assert len(nodes) == 1
        assert all(np.isfinite(array).all() for array in nodes.arrays().values())
