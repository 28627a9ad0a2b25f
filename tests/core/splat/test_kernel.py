"""Profiles of splats: all weigh the same, none is negative, and all end at the rim."""

from __future__ import annotations

import numpy as np

from pointsplat_addon.core.lod import hierarchy, node_splats
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.splat.kernel import MASS, PROFILES, STEPS, SUPPORT, kernel


def test_every_profile_weighs_as_much_as_a_gaussian():
    """Over the plane, of which dA = pi dq: 2 pi, in the units of a Gaussian's middle."""
    q = np.linspace(0, SUPPORT, 20 * (STEPS - 1) + 1)
    at = np.linspace(0, SUPPORT, STEPS)
    for row in PROFILES:
        value = np.interp(q, at, row)
        integral = (value.sum() - (value[0] + value[-1]) / 2) * q[1]
        np.testing.assert_allclose(integral, 2, rtol=1e-6)  # measured 2e-8
        assert row[-1] == 0
        assert row.min() >= 0
    assert MASS == 2


def test_the_first_profile_is_the_kernel_itself():
    q = np.linspace(0, SUPPORT, 1000)
    found = np.interp(q, np.linspace(0, SUPPORT, STEPS), PROFILES[0])
    np.testing.assert_allclose(found, kernel(q), atol=5e-4)  # measured 4e-4, between the steps


def test_nodes_of_a_hierarchy_have_the_default_kernel():
    rng = np.random.default_rng(4)
    cloud = PointCloud(
        rng.random((200, 3), np.float32), radii=np.full((200, 1), 0.05, np.float32),
        extinction=np.ones(200, np.float32), kernel=rng.integers(0, 4, 200).astype(np.uint8),
    )  # fmt: skip
    built = hierarchy.build(cloud)
    found = node_splats.points_and_nodes(built).kernel
    assert cloud.kernel is not None
    assert found is not None
    np.testing.assert_array_equal(found[:200], cloud.kernel[built.order])
    assert len(found) > 200
    assert not found[200:].any()
