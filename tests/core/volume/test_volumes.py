"""Voxels as Gaussian splats: what they let through, where they lie, what media and transfer functions make of them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pointsplat_addon.core.material import blackbody
from pointsplat_addon.core.scene.volume import Medium, Transfer, Volume
from pointsplat_addon.core.splat.kernel import EVEN_SPACING, kernel
from pointsplat_addon.core.volume import normals, optics, voxels

WHITE = Medium(color=np.ones(3))
# Attributes that may be absent are not in these tests.
volume_splats: Any = voxels.volume_splats
voxel_optics: Any = optics.voxel_optics


def block(shape, matrix=None, density: Any = 1.0, **grids: Any):
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
    """(R,) along lines through `start` (R, 3): sums of projected kernels."""
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
        result[r] = (mass * kernel(q)).sum()
    return result / (2 * np.pi * np.sqrt(np.linalg.det(flat)))


def slab_depths(matrix, shape, angle, spacing=0.0, count=200):
    """Optical depths of rays at an angle through the middle of a slab of extinction 1, over the exact ones."""
    cloud, _, warnings = volume_splats(block(shape, matrix), WHITE, spacing=spacing)
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
    fine, _, _ = volume_splats(volume, medium)
    for spacing in (0.2, 0.41, 0.9):
        coarse, _, _ = volume_splats(volume, medium, spacing=spacing)
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


# Media


def test_scattering_and_absorption_are_cycles_principled_volume():
    density = np.array([0, 1, 2], np.float32)
    volume = block((3, 1, 1), density=density)
    gray, _ = voxel_optics(volume, Medium(density=2.0, color=np.array([0.2, 0.5, 0.9])))
    # Black absorption colour absorbs all that is not scattered: the same in all channels.
    np.testing.assert_allclose(gray.extinction, 2 * density)
    np.testing.assert_allclose(gray.albedo, np.tile([0.2, 0.5, 0.9], (3, 1)), rtol=1e-6)
    tinted, _ = voxel_optics(volume, Medium(color=np.zeros(3), absorption=np.array([0.0, 0.25, 1.0])))
    np.testing.assert_allclose(tinted.extinction, density[:, None] * [1, 0.5, 0], atol=1e-7)
    assert (tinted.albedo == 0).all()
    assert gray.emission is None


def test_voxels_without_optics_are_left_out_and_emission_is_not_scaled_by_density():
    volume = block((3, 1, 1), density=np.array([0, 1, 0], np.float32))
    cloud, _, _ = volume_splats(volume, WHITE)
    assert len(cloud) == 1
    glowing, _, _ = volume_splats(volume, Medium(emission=np.array([1.0, 0, 2])))
    share = glowing.emission * (4 / 3 * np.pi * glowing.radii.astype(np.float64) ** 3)
    np.testing.assert_allclose(share, np.tile([1.0, 0, 2], (3, 1)), rtol=1e-6)


def test_a_given_extinction_stands_in_for_the_mediums():
    volume = block((2, 1, 1), density=np.array([1, 0.5], np.float32))
    found, _ = voxel_optics(volume, Medium(density=7.0), extinction=3.0)
    np.testing.assert_array_equal(found.extinction, [3, 1.5])


def test_grids_of_colour_and_temperature_vary_the_medium():
    heat = np.array([0, 1000, 2000], np.float32)
    tint = np.array([[1, 1, 1], [1, 0, 0], [0.5, 0.5, 0.5]], np.float32)
    volume = block((3, 1, 1), density=1.0, color=tint, temperature=heat)
    medium = Medium(color=np.ones(3), color_grid="color", blackbody=1.0, temperature=1.0)
    found, warnings = voxel_optics(volume, medium)
    assert not warnings
    np.testing.assert_array_equal(found.albedo, tint)
    luminance = found.emission @ [0.2126, 0.7152, 0.0722]
    # Stefan and Boltzmann: double the temperature, sixteen times the radiance. Red is clamped into the gamut at 1000 K.
    assert luminance[0] == 0
    assert luminance[2] == pytest.approx(5.670374e-14 / np.pi * 2000**4, rel=1e-3)
    assert luminance[2] / luminance[1] == pytest.approx(16, rel=0.15)


def test_black_bodies_are_on_the_planckian_locus():
    # Chromaticities of the Planckian locus (Wyszecki & Stiles): x, y at 2000, 4000, 6500 and 10000 K
    kelvin = np.array([2000.0, 4000.0, 6500.0, 10000.0])
    locus = np.array([[0.5267, 0.4133], [0.3805, 0.3768], [0.3135, 0.3237], [0.2807, 0.2884]])
    xyz = blackbody.blackbody(kelvin) @ np.array([
        [0.4124564, 0.2126729, 0.0193339],
        [0.3575761, 0.7151522, 0.1191920],
        [0.1804375, 0.0721750, 0.9503041],
    ])  # fmt: skip
    np.testing.assert_allclose(xyz[:, 1], 1, rtol=1e-5)
    np.testing.assert_allclose(xyz[:, :2] / xyz.sum(axis=1, keepdims=True), locus, atol=0.003)
    np.testing.assert_array_equal(blackbody.blackbody(np.array([10.0])), blackbody.blackbody(np.array([800.0])))


# Transfer functions


RAMP = np.array([[1, 0, 0, 0], [0, 1, 0, 0.5], [0, 0, 1, 1]], np.float32)


def test_a_transfer_function_is_a_ramp_over_values():
    transfer = Transfer("density", -10.0, 10.0, RAMP, density=4.0)
    value = np.array([-99, -10, -5, 0, 10, 99], np.float32)
    alpha, albedo = optics.classify(value, transfer)
    np.testing.assert_allclose(alpha, [0, 0, 1, 2, 4, 4])
    np.testing.assert_allclose(albedo[2], [0.5, 0.5, 0])
    np.testing.assert_allclose(albedo[4], albedo[5])
    step = replace(transfer, low=1.0, high=1.0)
    np.testing.assert_allclose(optics.classify(np.array([0.9, 1.0, 1.1], np.float32), step)[0], [0, 0, 4])


def test_another_transfer_function_keeps_the_points():
    volume = block((4, 3, 2), density=np.arange(24, dtype=np.float32) - 5)
    first = replace(volume, transfer=Transfer("density", 0.0, 10.0, RAMP))
    second = replace(volume, transfer=Transfer("density", -5.0, 20.0, RAMP[::-1].copy(), density=9.0))
    clouds = [volume_splats(volume)[0] for volume in (first, second)]
    assert len(clouds[0]) == 24
    for name in ("position", "radii", "value"):
        np.testing.assert_array_equal(*(getattr(cloud, name) for cloud in clouds), err_msg=name)


def test_normals_point_away_from_what_is_dense():
    volume = block((9, 9, 9), scaled(1, 2, 0.5))
    gradient = np.array([3.0, -1.0, 2.0])
    place = volume.index * [1, 2, 0.5]
    volume = replace(volume, grids={"density": (100 + place @ gradient).astype(np.float32)})
    shuffled = np.random.default_rng(0).permutation(9**3)
    inner = ((volume.index > 0) & (volume.index < 8)).all(axis=1)
    expected = np.tile(-gradient / np.linalg.norm(gradient), (int(inner.sum()), 1))
    for order in (np.arange(9**3), shuffled):
        mixed = replace(volume, index=volume.index[order], grids={"density": volume.grids["density"][order]})
        found = np.empty((9**3, 3))
        found[order] = normals.gradient_normals(mixed, "density")
        np.testing.assert_allclose(found[inner], expected, atol=1e-5)  # measured 1.6e-6
        np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-6)
    # On its sides, a block of one value faces outwards; inside it faces nowhere.
    flat = normals.gradient_normals(block((5, 5, 5)), "density").reshape(5, 5, 5, 3)
    np.testing.assert_allclose(flat[4, 2, 2], [1, 0, 0])
    np.testing.assert_allclose(flat[2, 2, 2], [0, 0, 0])


# Bad input


@pytest.mark.parametrize("edge", [1e-6, 1e4])
def test_voxels_of_any_size_and_far_away(edge):
    volume = block((6, 6, 6), scaled(edge, edge, edge, offset=(1e7, -3e6, 0)), 1 / edge)
    cloud, _, warnings = volume_splats(volume, WHITE)
    assert not warnings
    assert all(np.isfinite(a).all() for a in cloud.arrays().values())
    np.testing.assert_allclose(optical_mass(cloud), edge**2, rtol=1e-5)
    place = (cloud.position.astype(np.float64) + (cloud.origin - volume.object_from_index[:3, 3])) / edge
    # float64 keeps 1e-9 of an origin at 1e7, which is 1/500 of the smallest voxel.
    np.testing.assert_allclose(place, volume.index, atol=2e-3)


def test_values_that_cannot_be_drawn_are_named_and_count_as_nothing():
    density = np.array([1, -1, np.nan, np.inf, -np.inf, 2], np.float32)
    cloud, _, warnings = volume_splats(block((6, 1, 1), density=density), WHITE)
    assert len(cloud) == 2
    assert warnings == ['Smoke: 4 voxels of the grid "density" are negative or not finite and count as 0']
    transfer = Transfer("density", -1.0, 2.0, RAMP)
    cloud, _, warnings = volume_splats(replace(block((6, 1, 1), density=density), transfer=transfer))
    assert len(cloud) == 3
    assert len(warnings) == 1


def test_a_missing_grid_is_named():
    cloud, _, warnings = volume_splats(block((2, 2, 2)), Medium(density_grid="smoke"))
    assert len(cloud) == 8
    assert warnings == ['Smoke: there is no grid "smoke", the density is the same everywhere']
    transfer = Transfer("heat", 0.0, 1.0, RAMP)
    cloud, _, warnings = volume_splats(replace(block((2, 2, 2)), transfer=transfer))
    assert len(cloud) == 0
    assert warnings == ['Smoke: there is no grid "heat" for the transfer function']


@pytest.mark.parametrize("transfer", [None, Transfer("density", 0.0, 1.0, RAMP)])
@pytest.mark.parametrize("spacing", [0.0, 4.0])
@pytest.mark.parametrize("count", [0, 1])
def test_none_and_one(count, spacing, transfer):
    volume = Volume("key", "Smoke", np.zeros((count, 3), np.int32), np.eye(4), {"density": np.ones(count, np.float32)})
    cloud, _, warnings = volume_splats(replace(volume, transfer=transfer), WHITE, spacing=spacing)
    assert len(cloud) == count
    assert not warnings
    assert all(np.isfinite(a).all() for a in cloud.arrays().values())


def test_optical_depth_beyond_opaque_stays_finite():
    volume = block((2, 1, 1), density=np.array([3e38, 1e-6], np.float32))
    cloud, _, _ = volume_splats(volume, Medium(density=1e6, color=np.ones(3)))
    assert np.isfinite(cloud.extinction).all()
    assert cloud.extinction[1] > 0


def test_shear_and_flat_voxels_make_ellipsoids_of_their_mass():
    matrix = np.eye(4)
    matrix[:3, :3] = [[1, 0.5, 0], [0, 1, 0], [0, 0, 3]]
    cloud, _, _ = volume_splats(block((3, 3, 3), matrix), WHITE)
    np.testing.assert_allclose(optical_mass(cloud), 3.0, rtol=1e-6)
    axes = cloud.radii[0] / 2
    frame = np.stack([cloud.axis[0], np.cross(cloud.normal[0], cloud.axis[0]), cloud.normal[0]], axis=1)
    linear = matrix[:3, :3]
    covariance = EVEN_SPACING**2 * linear @ linear.T
    np.testing.assert_allclose(frame @ np.diag(axes**2) @ frame.T, covariance, atol=1e-6)
    assert volume_splats(block((2, 2, 2), scaled(1, 1, 1.02)), WHITE)[0].normal is None
