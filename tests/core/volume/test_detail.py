"""Even blocks of voxels merged into one splat each: what stays the same, and which are merged."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pointsplat_addon.core.scene.volume import Medium, Volume
from pointsplat_addon.core.splat.kernel import EVEN_SPACING
from pointsplat_addon.core.volume import detail, voxels
from pointsplat_addon.core.volume.detail import CONTRAST, MOST_DEPTH, voxel_edge, widened

# Attributes that may be absent are not in these tests.
volume_splats: Any = voxels.volume_splats


def merged_where_even(cloud, cells, levels, lamps=()) -> Any:
    return detail.merged_where_even(cloud, cells, levels, np.reshape(np.asarray(lamps, float), (-1, 4)))


def block(shape, density: Any = 1.0, matrix=None, low=(0, 0, 0), **grids):
    index = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1).reshape(-1, 3) + low
    named = {"density": np.broadcast_to(np.float32(density), len(index)).copy(), **grids}
    return Volume("key", "Smoke", index.astype(np.int32), np.eye(4) if matrix is None else matrix, named)


def moments(cloud):
    """Optical mass of each channel (C,), its mean place (3,), and its covariance (3, 3), of splats too."""
    radii = cloud.radii.astype(np.float64)
    half = np.broadcast_to(radii, (len(cloud), 3)) if radii.shape[1] == 1 else radii
    matter = cloud.extinction.astype(np.float64)
    mass = 4 / 3 * np.pi * half.prod(axis=1)[:, None] * (matter if matter.ndim == 2 else matter[:, None])
    place, total = cloud.position.astype(np.float64), mass.mean(axis=1)
    frame = np.tile(np.eye(3), (len(cloud), 1, 1))
    if cloud.axis is not None:
        frame = np.stack([cloud.axis, np.cross(cloud.normal, cloud.axis), cloud.normal], axis=2).astype(np.float64)
    own = np.einsum("nij,nj,nkj->nik", frame, (half / 2) ** 2, frame)
    middle = total @ place / total.sum()
    away = place - middle
    spread = own + away[:, :, None] * away[:, None]
    return mass.sum(axis=0), middle, np.einsum("n,nij->ij", total, spread) / total.sum()


@pytest.mark.parametrize("levels", [1, 2, 3])
@pytest.mark.parametrize("edges", [(1.0, 1.0, 1.0), (0.5, 1.0, 2.0)])
def test_an_even_block_becomes_one_splat_of_its_moments(levels, edges):
    """Mass, middle and covariance, of 2^levels voxels to a side."""
    side = 2**levels
    volume = block((side,) * 3, 1e-3, np.diag([*edges, 1.0]), low=(4 * side, -2 * side, 0))
    cloud, cells, _ = volume_splats(volume)
    merged = merged_where_even(cloud, cells, levels)
    assert len(merged) == 1
    for found, expected in zip(moments(merged), moments(cloud), strict=True):
        np.testing.assert_allclose(found, expected, rtol=2e-5, atol=2e-5)  # worst 7e-6: normals are float32
    assert widened(levels) * EVEN_SPACING == pytest.approx(np.sqrt(EVEN_SPACING**2 + (side**2 - 1) / 12))


def test_mass_color_and_emission_of_all_stay():
    """Whatever is merged, of coloured smoke that glows, within what float32 holds."""
    rng = np.random.default_rng(5)
    shape, count = (16, 12, 10), 16 * 12 * 10
    tint = rng.uniform(0.2, 0.9, (1, 3)) * (1 + 1e-3 * rng.standard_normal((count, 3)))
    volume = block(shape, rng.uniform(1e-3, 2e-3, count), color=tint.astype(np.float32))
    cloud, cells, _ = volume_splats(volume, Medium(color_grid="color", emission=np.array([1e-3, 0, 2e-3])))
    merged = merged_where_even(cloud, cells, 4)
    assert len(merged) < count / 100

    def total(of, values):
        return np.tensordot(4 / 3 * np.pi * of.radii[:, 0].astype(np.float64) ** 3, values, (0, 0))

    def scattered(of):
        return total(of, of.extinction[:, None] * of.color)

    for found, expected in (
        (total(merged, merged.extinction), total(cloud, cloud.extinction)),
        (total(merged, merged.emission), total(cloud, cloud.emission)),
        (
            total(merged, merged.extinction[:, None] * merged.color),
            total(cloud, cloud.extinction[:, None] * cloud.color),
        ),
    ):
        np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_blocks_that_differ_within_stay_as_they_are():
    """Half of a block has more than the other; and all of it where it is dense."""
    x = np.indices((4, 4, 4))[0].reshape(-1)
    for density, left in (
        (np.where(x < 1, 0.9 * CONTRAST, 0.0) + 1e-9, 8),
        (np.where(x < 1, 1.1 * CONTRAST, 0.0) + 1e-9, 4 * 8 + 4),
        (np.full(64, 0.45 * MOST_DEPTH), 8),
        (np.full(64, 0.55 * MOST_DEPTH), 64),
    ):
        cloud, cells, _ = volume_splats(block((4, 4, 4), density))
        assert len(merged_where_even(cloud, cells, 1)) == left
    cloud, cells, _ = volume_splats(block((4, 4, 4), 1e-3))
    assert len(merged_where_even(cloud, cells, 10)) == 1


def test_what_is_missing_counts_as_empty():
    """A voxel alone is merged where it is thin, with a block's mean, and stays where it is not."""
    for density, radius in ((0.9 * CONTRAST, widened(1)), (1.1 * CONTRAST, 1.0)):
        cloud, cells, _ = volume_splats(block((1, 1, 1), density))
        merged = merged_where_even(cloud, cells, 1)
        assert len(merged) == 1
        assert merged.radii[0, 0] / cloud.radii[0, 0] == pytest.approx(radius)
        np.testing.assert_allclose(moments(merged)[0], moments(cloud)[0], rtol=1e-5)


def test_a_block_above_others_that_stay_stays_too():
    """One voxel of 4^3 is dense: of its 2^3 none is merged, and neither are all 4^3."""
    density = np.full(64, 1e-3)
    density[0] = 1.0
    cloud, cells, _ = volume_splats(block((4, 4, 4), density))
    assert len(merged_where_even(cloud, cells, 2)) == 8 + 7


def test_edges_of_voxels():
    cloud, _, _ = volume_splats(block((2, 2, 2), matrix=np.diag([0.5, 1.0, 2.0, 1.0])))
    assert voxel_edge(cloud) == pytest.approx(1.0)
    assert voxel_edge(replace(cloud, radii=2 * cloud.radii)) == pytest.approx(2.0)


def test_blocks_beside_a_lamp_stay_as_they_are():
    """Of 2^3 voxels with edges of 1 those within four times 2 of the lamp, and its radius."""
    cloud, cells, _ = volume_splats(block((40, 2, 2), 1e-3))
    for radius in (0.0, 3.0):
        merged = merged_where_even(cloud, cells, 1, [[0.0, 0.5, 0.5, radius]])
        fine = merged.radii[:, 0] < 1.2 * cloud.radii[0, 0]
        place = merged.position[:, 0] + merged.origin[0]
        assert place[fine].max() < detail.NEAREST_LAMP * 2 + radius + 1.5 < place[~fine].min() + 1.5
        assert 0 < fine.sum() < len(cloud)
