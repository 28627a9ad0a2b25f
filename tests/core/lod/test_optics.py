"""Facts about light through hierarchies: as much of it passes coarse cuts as passes the points."""

# pyright: reportOptionalSubscript=false, reportOptionalMemberAccess=false, reportOptionalOperand=false
# pyright: reportArgumentType=false, reportCallIssue=false
# Attributes may be None by type; the clouds here have those that are asked for.
from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.lod import hierarchy, node_splats
from pointsplat_addon.core.lod.nodes import optics
from pointsplat_addon.core.lod.nodes import rows as rows_module
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.splat.kernel import EVEN_SPACING, SUPPORT, kernel
from tests.support.transmittance import cards, levels, mean_transmittance, medium, voxel_ball

VIEWS = ((0.0, 0.0, 1.0), (1.0, 0.4, 0.7))


def worst_change(cloud: PointCloud, half: float, least: int) -> float:
    """How far the mean transmittance of any cut is from that of the points."""
    built = hierarchy.build(cloud, 8)
    splats, worst = node_splats.points_and_nodes(built), 0.0
    cuts = list(levels(built, least))
    assert cuts
    for view in VIEWS:
        near = mean_transmittance(cloud, half, view)
        worst = max(worst, *(abs(mean_transmittance(splats.take(cut), half, view) - near) for cut in cuts))
    return worst


# Cloud, least splats of a cut, tolerance: one percent, but where the outlines of opaque voxels are Gaussians, too.
MEDIA: dict[str, tuple[Callable[[], PointCloud], int, float]] = {
    "thin": (lambda: medium(voxel_ball(24), 0.3 / 24), 64, 0.01),
    "even": (lambda: medium(voxel_ball(24), 1 / 24), 64, 0.01),
    "thick": (lambda: medium(voxel_ball(24), 3 / 24), 256, 0.01),
    "opaque": (lambda: medium(voxel_ball(32), 50.0), 4000, 0.02),  # measured 0.015
    "sparse": (lambda: medium(voxel_ball(40, 0.03), 1.0), 200, 0.01),
    "sparse and thick": (lambda: medium(voxel_ball(40, 0.03), 10.0), 200, 0.01),
    "sparse and opaque": (lambda: medium(voxel_ball(40, 0.03), 50 * 2 * np.pi * EVEN_SPACING**2), 200, 0.01),
    "half full": (lambda: medium(voxel_ball(32, 0.2), 1.0), 1000, 0.01),
}


@pytest.mark.parametrize("name", MEDIA)
def test_media_let_as_much_light_through_from_afar(name: str) -> None:
    make, least, tolerance = MEDIA[name]
    cloud = make()
    half = 1.1 * float(np.abs(cloud.position).max())
    assert worst_change(cloud, half, least) < tolerance


@pytest.mark.parametrize("alpha", [0.3, 0.9])
def test_a_tree_of_translucent_cards_is_as_dark_from_afar(alpha: float) -> None:
    assert worst_change(cards(3000, alpha, 0.06, 3), 1.15, 1000) < 0.01


# Masses and colours


def test_where_a_medium_is_even_its_mass_is_kept_in_what_is_drawn() -> None:
    rng = np.random.default_rng(0)
    cloud = medium(
        voxel_ball(20),
        1e-4 * rng.random((len(voxel_ball(20)), 3)),
        emission=rng.random((len(voxel_ball(20)), 3), np.float32),
    )
    built = hierarchy.build(cloud)
    splats = node_splats.points_and_nodes(built)
    volume = 4 / 3 * np.pi * splats.radii[:, :1].astype(np.float64) ** 3
    mass, emission = volume * np.asarray(splats.extinction), volume * np.asarray(splats.emission)
    n, tree = len(cloud), built.tree
    for node in range(len(built)):
        below = slice(tree.first_point[node], tree.first_point[node] + tree.point_count[node])
        np.testing.assert_allclose(built.mass[node], mass[below].sum(axis=0), rtol=1e-6)  # measured 2e-7
        np.testing.assert_allclose(
            mass[n + node], mass[below].sum(axis=0), rtol=1e-3
        )  # measured 3e-4: what is absorbed
        np.testing.assert_allclose(emission[n + node], emission[below].sum(axis=0), rtol=1e-6)  # measured 3e-7


def test_albedo_is_weighted_by_mass() -> None:
    p = voxel_ball(3)
    extinction, color = np.zeros(len(p)), np.zeros((len(p), 3), np.float32)
    extinction[:2], color[0], color[1] = [1e6, 3e6], [1, 0, 0], [0, 1, 0]
    built = hierarchy.build(medium(p, extinction, color=color), 100)
    np.testing.assert_allclose(built.color[0], [0.25, 0.75, 0], rtol=1e-6)  # measured 6e-8


def test_cross_sections_of_kernels() -> None:
    """The integral of 1 - exp(-tau), in rings."""
    q = np.linspace(0, SUPPORT, 200_001)
    q = (q[1:] + q[:-1]) / 2
    for depth in (1e-8, 1e-3, 0.1, 1.0, 10.0, 1e3):
        rings = -np.expm1(-2 * depth * kernel(q)).sum() * (q[1] - q[0]) / 4
        assert optics.kernel_cross_section(depth) == pytest.approx(rings, rel=1e-5)  # measured 2e-6
        assert optics.kernel_cross_section(optics.kernel_depth(depth)) == pytest.approx(
            -np.expm1(-depth), rel=1e-5
        )  # measured 1e-7


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e4])
def test_extremes_stay_finite(scale: float) -> None:
    p = voxel_ball(6)
    strength = np.where(np.arange(len(p)) % 2, 1e6, 1e-6) / scale
    cloud = medium(p, strength)
    cloud = replace(cloud, position=cloud.position * np.float32(scale), radii=cloud.radii * np.float32(scale))
    built = hierarchy.build(cloud, 4)
    for array in (built.extinction, built.mass, built.covered, built.radii):
        assert np.isfinite(array).all()
    assert (built.extinction > 0).all()
    clear = hierarchy.build(medium(np.zeros((9, 3), np.float32), 0.0, color=np.full((9, 3), 0.5, np.float32)))
    np.testing.assert_array_equal(clear.extinction, 0)
    np.testing.assert_allclose(clear.color, 0.5)


# New colours for the same points


@pytest.mark.parametrize("kind", ["medium", "surface", "shells"])
def test_recoloured_equals_a_fresh_build(kind: str) -> None:
    rng = np.random.default_rng(1)
    if kind == "medium":
        p = voxel_ball(14)
        cloud = medium(p, rng.random((len(p), 3)), emission=rng.random((len(p), 3), np.float32))
        changed = {"extinction": rng.random((len(p), 3), np.float32), "emission": rng.random((len(p), 3), np.float32)}
    else:
        cloud = cards(200, 0.4, 0.1, 3)
        changed = {"opacity": rng.random(len(cloud), np.float32)}
        if kind == "surface":
            cloud, changed = replace(cloud, opacity=None), {}
    n = len(cloud)
    cloud = replace(
        cloud,
        color=rng.random((n, 3), np.float32),
        value=rng.random(n, np.float32),
        material=np.arange(n, dtype=np.uint16),
    )
    changed |= {"color": rng.random((n, 3), np.float32), "value": rng.random(n, np.float32)}
    old, new = hierarchy.build(cloud), replace(cloud, **changed)
    fresh = hierarchy.build(new)
    for found in (hierarchy.recolor(old, new),):
        for name in ("center", "radii", "bound", "smallest", "material"):
            np.testing.assert_array_equal(getattr(found, name), getattr(fresh, name))
        for name in (*rows_module.AVERAGED, "mass", "covered"):
            if getattr(fresh, name) is not None:
                np.testing.assert_allclose(getattr(found, name), getattr(fresh, name), rtol=2e-6)  # measured 3e-7
        np.testing.assert_array_equal(found.cloud.color, fresh.cloud.color)


def test_recolouring_with_other_attributes_or_points_is_refused() -> None:
    built = hierarchy.build(medium(voxel_ball(4), 1.0))
    with pytest.raises(ValueError, match="attributes"):
        hierarchy.recolor(built, replace(built.cloud, value=np.zeros(len(built.cloud), np.float32)))
    with pytest.raises(ValueError, match="points"):
        hierarchy.recolor(built, built.cloud.take(slice(3)))
    with pytest.raises(ValueError, match="NaN"):
        hierarchy.recolor(built, replace(built.cloud, extinction=built.cloud.extinction * np.float32(np.nan)))
