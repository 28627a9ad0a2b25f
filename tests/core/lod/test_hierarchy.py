"""Facts about the point-octree: its partition, moments, bounds, cones and averages."""

# pyright: reportOptionalSubscript=false, reportOptionalMemberAccess=false, reportOptionalOperand=false
# pyright: reportArgumentType=false, reportCallIssue=false
# Attributes may be None by type; the clouds here have those that are asked for.
from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from pointsplat_addon.core.lod import hierarchy, node_splats
from pointsplat_addon.core.lod.nodes import octree
from pointsplat_addon.core.lod.nodes import tree as tree_module
from pointsplat_addon.core.lod.nodes.merging import merge_nodes
from pointsplat_addon.core.lod.nodes.tree import MAX_DEPTH, Tree
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.splat import ellipsoids


def unit(v: np.ndarray) -> np.ndarray:
    return (v / np.linalg.norm(v, axis=1, keepdims=True)).astype(np.float32)


def sphere_cloud(n: int = 3000, seed: int = 1, **attributes: np.ndarray) -> PointCloud:
    """Disks of random size and colour on the unit sphere."""
    rng = np.random.default_rng(seed)
    p = unit(rng.standard_normal((n, 3)))
    radii = rng.uniform(0.005, 0.05, (n, 1)).astype(np.float32)
    given = {"normal": p, "radii": radii, "color": rng.random((n, 3), np.float32)} | attributes
    return PointCloud(p, **given)


def ellipse_cloud(n: int = 2000, seed: int = 2) -> PointCloud:
    """Ellipses in every direction inside a box that is much longer than thick."""
    rng = np.random.default_rng(seed)
    normal = unit(rng.standard_normal((n, 3)))
    axis = unit(np.cross(normal, rng.standard_normal((n, 3))))
    radii = np.sort(rng.uniform(0.001, 0.1, (n, 2)).astype(np.float32), axis=1)[:, ::-1].copy()
    return PointCloud((rng.random((n, 3)) * [10, 3, 0.1]).astype(np.float32), normal=normal, axis=axis, radii=radii)


def ball_cloud(n: int = 1500, seed: int = 3) -> PointCloud:
    rng = np.random.default_rng(seed)
    return PointCloud(rng.random((n, 3), np.float32), radii=rng.uniform(0, 0.02, (n, 1)).astype(np.float32))


CLOUDS = {"sphere": sphere_cloud, "ellipses": ellipse_cloud, "balls": ball_cloud}


@pytest.fixture(params=CLOUDS, scope="module")
def built(request: pytest.FixtureRequest) -> hierarchy.Hierarchy:
    return hierarchy.build(CLOUDS[request.param]())


def check_links(tree: Tree, points: int) -> None:
    """Children follow each other breadth first, their ranges tile the parent's, and the leaves tile the points."""
    inner = np.flatnonzero(tree.child_count)
    children = np.concatenate([[0], *(np.arange(c, c + k) for c, k in zip(
        tree.first_child[inner], tree.child_count[inner], strict=True))])  # fmt: skip
    np.testing.assert_array_equal(children, np.arange(len(tree)))
    for node in inner:
        a, k = tree.first_child[node], tree.child_count[node]
        first, count = tree.first_point[a : a + k], tree.point_count[a : a + k]
        assert first[0] == tree.first_point[node]
        np.testing.assert_array_equal(first[1:], (first + count)[:-1])
        assert count.sum() == tree.point_count[node]
    leaf = tree.child_count == 0
    assert tree.point_count[leaf].sum() == points
    assert tree.levels[-1] == len(tree)


def descendants(tree: Tree, node: int) -> slice:
    return slice(tree.first_point[node], tree.first_point[node] + tree.point_count[node])


def rims(cloud: PointCloud, which: slice, steps: int = 24) -> np.ndarray:
    """Points (n * steps, 3) on the rims of disks and ellipses, or on the surface of balls."""
    normal, axis, radii = (a.T for a in ellipsoids.splat_frames(cloud, which))
    third = np.cross(normal, axis)
    t = np.linspace(0, 2 * np.pi, steps, endpoint=False)[:, None, None]
    p = cloud.position[which].astype(np.float64)
    if cloud.normal is None:
        directions = unit(np.random.default_rng(0).standard_normal((steps, 3))).astype(np.float64)
        return (p + radii[:, :1] * directions[:, None, :]).reshape(-1, 3)
    return (p + np.cos(t) * axis * radii[:, :1] + np.sin(t) * third * radii[:, 1:2]).reshape(-1, 3)


def moments(built: hierarchy.Hierarchy) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Zeroth, first and second moments of each node: weight (M,), mean (M, 3), covariance (M, 3, 3), float64."""
    nodes = merge_nodes(built.cloud, built.tree)
    xx, xy, xz, yy, yz, zz = nodes.second / np.maximum(nodes.weight, np.finfo(float).tiny)
    covariance = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=-1).reshape(-1, 3, 3)
    return nodes.weight, nodes.mean.T, covariance


def test_partition_is_a_breadth_first_tree_over_a_permutation(built: hierarchy.Hierarchy) -> None:
    n = len(built.cloud)
    np.testing.assert_array_equal(np.sort(built.order), np.arange(n))
    check_links(built.tree, n)
    assert built.tree.point_count[built.tree.child_count == 0].max() <= 12


def test_children_lie_in_different_octants_about_the_mean() -> None:
    built = hierarchy.build(sphere_cloud())
    tree = built.tree
    for node in np.flatnonzero(tree.child_count)[:50]:
        mean = built.cloud.position[descendants(tree, node)].mean(axis=0)
        seen = set()
        for child in range(tree.first_child[node], tree.first_child[node] + tree.child_count[node]):
            octants = np.unique(built.cloud.position[descendants(tree, child)] > mean, axis=0)
            assert len(octants) == 1
            seen.add(tuple(octants[0]))
        assert len(seen) == tree.child_count[node]


def test_blocks_join_into_the_same_tree_as_one_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    position = sphere_cloud(5000).position

    order, tree = octree.partition(position, 8)
    monkeypatch.setattr(octree, "BLOCK", 300)
    order2, tree2 = octree.partition(position, 8)
    np.testing.assert_array_equal(order, order2)
    for f in fields(Tree):
        np.testing.assert_array_equal(getattr(tree, f.name), getattr(tree2, f.name))


def test_chunks_do_not_change_the_nodes(monkeypatch: pytest.MonkeyPatch) -> None:
    built = hierarchy.build(sphere_cloud())
    monkeypatch.setattr(tree_module, "CHUNK", 50)
    again = hierarchy.build(sphere_cloud())
    for name in ("center", "radii", "bound", "cone", "color"):
        np.testing.assert_array_equal(getattr(again, name), getattr(built, name))


@pytest.mark.parametrize("points", [0, 1, 2, 12, 13])
def test_small_clouds(points: int) -> None:
    built = hierarchy.build(sphere_cloud(points))
    check_links(built.tree, points) if points else None
    # A leaf holds up to twelve.
    assert len(built) == {0: 0, 1: 1, 2: 1, 12: 1, 13: 6}[points]
    assert len(node_splats.points_and_nodes(built)) == points + len(built)


def test_one_point_is_its_own_node() -> None:
    cloud = sphere_cloud(1)
    built = hierarchy.build(cloud)
    np.testing.assert_allclose(built.center, cloud.position)
    np.testing.assert_allclose(built.normal, cloud.normal, atol=1e-7)  # measured 0
    np.testing.assert_allclose(built.radii[:, :2], cloud.radii.repeat(2, 1), rtol=1e-6)  # measured 0
    np.testing.assert_allclose(built.color, cloud.color, rtol=1e-6)


def test_coincident_points_stop_the_split() -> None:
    cloud = PointCloud(np.full((1000, 3), 0.3, np.float32), radii=np.full((1000, 1), 0.1, np.float32))
    built = hierarchy.build(cloud)
    assert len(built) == 1
    np.testing.assert_allclose(built.radii, 0.1, rtol=1e-5)  # measured 2e-7
    for array in (built.bound, built.sphere, built.cone, built.smallest):
        assert np.isfinite(array).all()


def test_collinear_points_make_a_line() -> None:
    p = np.zeros((1024, 3), np.float32)
    p[:, 1] = np.linspace(-1, 1, 1024)
    built = hierarchy.build(PointCloud(p))
    check_links(built.tree, 1024)
    assert built.tree.child_count.max() == 2
    np.testing.assert_allclose(np.abs(built.axis[0]), [0, 1, 0], atol=1e-6)
    # The variance of a uniform segment of half length 1 is 1/3.
    np.testing.assert_allclose(built.radii[0], [2 / np.sqrt(3), 0, 0], rtol=2e-3, atol=1e-6)  # 1/n of sampling


def test_depth_is_capped_on_geometric_sequences() -> None:
    p = np.zeros((140, 3), np.float32)
    p[:, 0] = 0.5 ** np.arange(140)
    built = hierarchy.build(PointCloud(p), leaf_size=1)
    check_links(built.tree, 140)
    assert len(built.tree.levels) - 2 <= MAX_DEPTH
    np.testing.assert_array_equal(np.sort(built.order), np.arange(140))


@pytest.mark.parametrize("name", ["position", "normal", "radii", "color"])
def test_bad_values_are_refused(name: str) -> None:
    cloud = sphere_cloud(20)
    bad = getattr(cloud, name).copy()
    bad[7, 0] = np.nan
    with pytest.raises(ValueError, match=name):
        hierarchy.build(replace(cloud, **{name: bad}))


def test_negative_radii_are_refused() -> None:
    with pytest.raises(ValueError, match="negative"):
        hierarchy.build(sphere_cloud(2, radii=np.array([[1], [-1]], np.float32)))


def direct_covariance(cloud: PointCloud, which: slice) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of disks, summed about their own mean in extended precision."""
    normal, axis, radii = (a.T.astype(np.longdouble) for a in ellipsoids.splat_frames(cloud, which))
    third = np.cross(normal, axis)
    w = ellipsoids.splat_weight(cloud, which).astype(np.longdouble)
    p = cloud.position[which].astype(np.longdouble)
    mean = (w[:, None] * p).sum(axis=0) / w.sum()
    d = p - mean
    frames = [(d, np.ones_like(w)), (axis, radii[:, 0] ** 2 / 4), (third, radii[:, 1] ** 2 / 4),
              (normal, radii[:, 2] ** 2 / 4)]  # fmt: skip
    return mean, sum(np.einsum("n,ni,nj->ij", w * s, v, v) for v, s in frames) / w.sum()


def test_moments_equal_direct_sums_about_each_nodes_mean(built: hierarchy.Hierarchy) -> None:
    weight, mean, covariance = moments(built)
    worst = 0.0
    for node in range(len(built)):
        expected_mean, expected = direct_covariance(built.cloud, descendants(built.tree, node))
        np.testing.assert_allclose(mean[node], expected_mean.astype(float), rtol=0, atol=1e-13)  # measured 2e-15
        worst = max(worst, float(np.abs(covariance[node] - expected).max() / np.abs(expected).max()))
    assert worst < 1e-9  # measured 4e-15
    assert (weight > 0).all()


def test_far_coordinates_keep_their_moments() -> None:
    """Map coordinates near 1e7 with an extent of 1: float64 positions become an origin and float32 offsets."""
    far = np.array([1e7, -2e7, 3e6]) + sphere_cloud().position.astype(np.float64)
    origin = far.mean(axis=0)
    cloud = replace(sphere_cloud(), position=(far - origin).astype(np.float32), origin=origin)
    built = hierarchy.build(cloud)
    _, mean, covariance = moments(built)
    worst = 0.0
    for node in range(0, len(built), 7):
        which = descendants(built.tree, node)
        world = built.cloud.position[which].astype(np.longdouble) + origin
        _, expected = direct_covariance(built.cloud, which)
        w = ellipsoids.splat_weight(built.cloud, which).astype(np.longdouble)
        np.testing.assert_allclose(mean[node] + origin, ((w @ world) / w.sum()).astype(float), rtol=1e-15)
        worst = max(worst, float(np.abs(covariance[node] - expected).max() / np.abs(expected).max()))
    assert worst < 1e-9  # measured 2e-15


def test_kernel_of_a_filled_square() -> None:
    """A uniform square of half side a has the variance a^2 / 3 in its plane; its kernel is the disk 2 a / sqrt(3)."""
    g = (np.arange(64) + 0.5) / 32 - 1
    p = np.stack([*np.meshgrid(g, g), np.zeros((64, 64))], axis=-1).reshape(-1, 3).astype(np.float32)
    normal = np.broadcast_to(np.array([0, 0, 1], np.float32), p.shape).copy()
    built = hierarchy.build(
        PointCloud(p, normal=normal, radii=np.full((len(p), 1), 1 / 64 / np.sqrt(3) * 2, np.float32))
    )
    # Each sample's disk has the variance of its own cell, so the sum is exact at any depth.
    np.testing.assert_allclose(built.radii[0], [2 / np.sqrt(3)] * 2 + [0], rtol=1e-6, atol=1e-7)  # measured 1e-7
    np.testing.assert_allclose(built.cone[0], [1, 0], atol=1e-4)


def test_kernel_axes_are_principal_axes(built: hierarchy.Hierarchy) -> None:
    _, _, covariance = moments(built)
    axis, normal = built.axis.astype(np.float64), built.normal.astype(np.float64)
    third = np.cross(normal, axis)
    scale = np.maximum(built.radii.max(axis=1).astype(np.float64) ** 2 / 4, 1e-30)
    for a, column in ((axis, 0), (third, 1), (normal, 2)):
        along = np.einsum("mi,mij,mj->m", a, covariance, a)
        variance = built.radii[:, column].astype(np.float64) ** 2 / 4
        assert (np.abs(along - variance) / scale).max() < 1e-6  # measured 1.7e-7
    across = np.einsum("mi,mij,mj->m", axis, covariance, third)
    assert (np.abs(across) / scale).max() < 1e-6  # measured 4e-8
    assert (built.radii[:, 0] >= built.radii[:, 1]).all()


def test_bounds_contain_every_descendant_disk(built: hierarchy.Hierarchy) -> None:
    third = np.cross(built.normal, built.axis).astype(np.float64)
    for node in range(len(built)):
        d = rims(built.cloud, descendants(built.tree, node)) - built.center[node].astype(np.float64)
        b = np.maximum(built.bound[node].astype(np.float64), 1e-30)
        base = np.hypot(d @ built.axis[node] / b[0], d @ third[node] / b[1])
        assert base.max() <= 1 + 1e-6  # measured 1 - 3e-7
        assert np.abs(d @ built.normal[node]).max() <= b[2] * (1 + 1e-6) + 1e-9
        assert np.linalg.norm(d, axis=1).max() <= built.size[node] * (1 + 1e-7)


def test_bounds_are_not_loose() -> None:
    """The ball of a node of the sphere is at most twice the farthest of its disks' rims."""
    built = hierarchy.build(sphere_cloud())
    ratio = []
    for node in range(len(built)):
        d = rims(built.cloud, descendants(built.tree, node)) - built.center[node].astype(np.float64)
        ratio.append(built.size[node] / np.linalg.norm(d, axis=1).max())
    assert max(ratio) < 2  # measured 1.86
    assert np.median(ratio) < 1.05  # measured 1.001


def test_cones_contain_every_descendant_normal() -> None:
    built = hierarchy.build(sphere_cloud())
    for node in range(len(built)):
        n = built.cloud.normal[descendants(built.tree, node)].astype(np.float64)
        angle = 2 * np.arcsin(np.minimum(np.linalg.norm(n - built.normal[node], axis=1) / 2, 1))
        half = np.arctan2(*built.cone[node].astype(np.float64)[::-1])
        half = np.pi if built.cone[node, 0] <= -1 else half
        assert angle.max() <= half + 2e-7
    leaf = built.tree.child_count == 0
    assert np.median(built.cone[leaf, 0]) > 0.9


def test_opposite_normals_fall_back_to_principal_axes() -> None:
    p = np.random.default_rng(5).random((8, 3)).astype(np.float32) * np.array([1, 1, 1e-3], np.float32)
    normal = np.tile(np.array([[1, 0, 0], [-1, 0, 0]], np.float32), (4, 1))
    built = hierarchy.build(PointCloud(p, normal=normal))
    np.testing.assert_allclose(np.abs(built.normal[0]), [0, 0, 1], atol=0.01)
    assert built.cone[0, 0] == -1


def test_averages_are_weighted_by_area() -> None:
    cloud = sphere_cloud(
        700, value=np.arange(700, dtype=np.float32), surface=np.random.default_rng(0).random((700, 2), np.float32)
    )
    built = hierarchy.build(cloud)
    w = cloud.radii[:, 0].astype(np.float64) ** 2
    for name in ("color", "surface", "value"):
        expected = np.average(getattr(cloud, name).astype(np.float64), axis=0, weights=w)
        np.testing.assert_allclose(getattr(built, name)[0], expected, rtol=1e-5)  # measured 5e-8
    assert built.mass is None
    assert built.covered is None
    assert built.material is None


def test_material_is_that_of_the_heaviest_splat() -> None:
    radii = np.full((9, 1), 0.01, np.float32)
    radii[4] = 0.1
    cloud = sphere_cloud(9, radii=radii, material=np.arange(9, dtype=np.uint16))
    assert hierarchy.build(cloud).material[0] == 4


def test_nodes_of_sheer_surfaces_are_as_sheer() -> None:
    g = (np.arange(32) + 0.5) / 16 - 1
    p = np.stack([*np.meshgrid(g, g), np.zeros((32, 32))], axis=-1).reshape(-1, 3).astype(np.float32)
    normal = np.broadcast_to(np.array([0, 0, 1], np.float32), p.shape).copy()
    # Disks of the area of the square's kernel ellipse together.
    r = np.full((len(p), 1), np.sqrt(4 / 3 / len(p)), np.float32)
    sheer = hierarchy.build(PointCloud(p, normal=normal, radii=r, opacity=np.full(len(p), 0.3, np.float32)))
    assert sheer.opacity[0] == pytest.approx(0.3, rel=2e-3)


def test_optical_mass_is_kept_on_every_level() -> None:
    rng = np.random.default_rng(0)
    cloud = replace(ball_cloud(), extinction=rng.random(1500, np.float32))
    built = hierarchy.build(cloud)
    r, s = cloud.radii[:, 0].astype(np.float64), cloud.extinction.astype(np.float64)
    total = (4 / 3 * np.pi * r**3 * s).sum()
    np.testing.assert_allclose(built.mass[0], total, rtol=1e-6)
    for node in np.flatnonzero(built.tree.child_count):
        a = built.tree.first_child[node]
        children = built.mass[a : a + built.tree.child_count[node]].astype(float).sum()
        np.testing.assert_allclose(built.mass[node], children, rtol=1e-6)  # measured 1e-7


def test_refit_of_the_same_points_changes_nothing() -> None:
    cloud = sphere_cloud()
    built = hierarchy.build(cloud)
    again = hierarchy.refit(built, cloud)
    for name in ("center", "normal", "axis", "radii", "bound", "sphere", "cone", "smallest", "color"):
        np.testing.assert_array_equal(getattr(again, name), getattr(built, name))
    with pytest.raises(ValueError, match="points"):
        hierarchy.refit(built, sphere_cloud(10))


def test_refit_after_a_rotation_rotates_the_nodes() -> None:
    cloud = sphere_cloud()
    built = hierarchy.build(cloud)
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]], np.float32)
    moved = hierarchy.refit(built, replace(cloud, position=cloud.position @ turn.T, normal=cloud.normal @ turn.T))
    np.testing.assert_allclose(moved.center, built.center @ turn.T, atol=1e-7)  # measured 0
    np.testing.assert_allclose(moved.radii[:, 0], built.radii[:, 0], rtol=1e-5)  # measured 1.2e-7
    np.testing.assert_allclose(moved.sphere, built.sphere, rtol=1e-5)  # measured 1.2e-7


def test_splats_are_points_then_nodes() -> None:
    built = hierarchy.build(sphere_cloud(100))
    all_ = node_splats.points_and_nodes(built)
    assert all_.normal is not None
    assert all_.axis is not None
    assert all_.radii is not None
    np.testing.assert_array_equal(all_.position[:100], built.cloud.position)
    np.testing.assert_array_equal(all_.position[100:], built.center)
    np.testing.assert_array_equal(all_.radii[:100], built.cloud.radii.repeat(2, 1))
    assert np.abs(np.einsum("ni,ni->n", all_.axis, all_.normal)).max() < 1e-6


def test_smallest_is_the_least_size_below() -> None:
    built = hierarchy.build(sphere_cloud())
    tree = built.tree
    size = np.where(tree.point_count > 1, built.size, np.inf)
    for node in range(len(built) - 1, -1, -1):
        a = tree.first_child[node]
        below = built.smallest[a : a + tree.child_count[node]].min(initial=np.inf)
        np.testing.assert_allclose(built.smallest[node], min(size[node], below), rtol=1e-6)
