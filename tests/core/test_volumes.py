"""Voxels as Gaussian splats: what they let through, where they lie, what media and transfer functions make of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core import volumes
from pointsplat_addon.core.scene import Medium, Volume

WHITE = Medium(color=np.ones(3))


def block(shape, matrix=None, density=1.0, **grids):
    index = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1).reshape(-1, 3)
    named = {"density": np.full(len(index), density, np.float32), **grids}
    return Volume("key", "Smoke", index.astype(np.int32), np.eye(4) if matrix is None else matrix, named)


def scaled(*edges, offset=(0, 0, 0)):
    matrix = np.diag([*edges, 1.0])
    matrix[:3, 3] = offset
    return matrix


def optical_mass(cloud):
    """(N,) or (N, 3): 4/3 pi a b c times extinction."""
    radii = cloud.radii.astype(np.float64)
    volume = 4 / 3 * np.pi * (radii[:, 0] ** 3 if radii.shape[1] == 1 else radii.prod(axis=1))
    return volume * cloud.extinction if cloud.extinction.ndim == 1 else volume[:, None] * cloud.extinction


def optical_depth(cloud, start, direction):
    """(R,) along lines through `start` (R, 3): sums of projected Gaussians, cut off at 3 sigma and renormalised."""
    center = cloud.position.astype(np.float64) + cloud.origin
    radii = cloud.radii.astype(np.float64)
    if radii.shape[1] == 1:
        covariance = (radii[0, 0] / 2) ** 2 * np.eye(3)
    else:
        axis, normal = cloud.axis[0].astype(np.float64), cloud.normal[0].astype(np.float64)
        frame = np.stack([axis, np.cross(normal, axis), normal], axis=1)
        covariance = frame @ np.diag((radii[0] / 2) ** 2) @ frame.T
    u = np.cross(direction, [0.3, 0.9, 0.1])
    u /= np.linalg.norm(u)
    plane = np.stack([u, np.cross(direction, u)])
    flat = plane @ covariance @ plane.T
    conic, mass = np.linalg.inv(flat), optical_mass(cloud)
    result = np.zeros(len(start))
    for r, row in enumerate(start):
        x = (center - row) @ plane.T
        q = np.einsum("ni,ij,nj->n", x, conic, x)
        inside = q < 9
        result[r] = (mass[inside] * np.exp(-q[inside] / 2)).sum()
    return result / (2 * np.pi * np.sqrt(np.linalg.det(flat)) * -np.expm1(-4.5))


def slab_depths(matrix, shape, angle, spacing=0.0, count=200):
    """Optical depths of rays at an angle through the middle of a slab of extinction 1, over the exact ones."""
    cloud, warnings = volumes.point_cloud(block(shape, matrix), WHITE, spacing=spacing)
    assert not warnings
    edges = np.diag(matrix)[:3]
    middle = matrix[:3, 3] + edges * (np.array(shape) - 1) / 2
    direction = np.array([np.sin(angle), 0.3 * np.sin(angle), np.cos(angle)])
    direction /= np.linalg.norm(direction)
    jitter = np.random.default_rng(1).uniform(-2, 2, (count, 3)) * edges * [1, 1, 0]
    return optical_depth(cloud, middle + jitter, direction) / (edges[2] * shape[2] / direction[2])


@pytest.mark.parametrize("angle", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("edges", [(1, 1, 1), (1e-3, 1e-3, 1e-3), (1.0, 1.5, 0.5)])
def test_a_slab_lets_through_what_beers_law_says(angle, edges):
    ratio = slab_depths(scaled(*edges), (44, 24, 6), angle)
    for depth in (0.01, 0.1, 1.0, 5.0):
        assert np.exp(-depth * ratio).mean() == pytest.approx(np.exp(-depth), rel=2e-3)  # measured 1.3e-3
    for depth in (5.0, 10.0, 20.0):
        assert -np.log(np.exp(-depth * ratio).mean()) == pytest.approx(depth, rel=5e-4)  # measured 2.5e-4
    assert np.abs(ratio - 1).max() < 0.01  # measured 0.0077: ripple of single rays along the lattice


@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_halving_the_spacing_keeps_what_is_let_through(angle):
    fine, coarse = (slab_depths(scaled(1, 1, 1), (64, 48, 8), angle, spacing).mean() for spacing in (0, 2))
    assert coarse == pytest.approx(fine, rel=2e-3)


def test_merging_keeps_mass_and_its_centre():
    random = np.random.default_rng(3)
    volume = block((7, 9, 5), scaled(0.1, 0.1, 0.1, offset=(1e6, 0, -5)), 0)
    keep = random.random(len(volume.index)) < 0.3
    density = random.random(np.count_nonzero(keep)).astype(np.float32)
    volume = replace(volume, index=volume.index[keep] - 3, grids={"density": density})
    medium = Medium(color=np.array([0.9, 0.5, 0.2]), absorption=np.array([0.0, 0.3, 0.6]))
    fine, _ = volumes.point_cloud(volume, medium)
    for spacing in (0.2, 0.41, 0.9):
        coarse, _ = volumes.point_cloud(volume, medium, spacing=spacing)
        assert len(coarse) < len(fine)
        mass, kept = optical_mass(fine), optical_mass(coarse)
        np.testing.assert_allclose(kept.sum(axis=0), mass.sum(axis=0), rtol=1e-6)  # measured 1e-7
        scattered = [(optical_mass(c) * c.color).sum(axis=0) for c in (fine, coarse)]
        np.testing.assert_allclose(scattered[1], scattered[0], rtol=1e-6)
        centers = [
            ((c.position + c.origin) * optical_mass(c).mean(axis=1)[:, None]).sum(axis=0)
            / optical_mass(c).mean(axis=1).sum()
            for c in (fine, coarse)
        ]
        np.testing.assert_allclose(centers[1], centers[0], rtol=0, atol=1e-6)
