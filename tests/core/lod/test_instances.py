"""Facts about instances that share cuts: levels are cuts, fine enough where they are drawn; thinning keeps the mean."""

from __future__ import annotations

import numpy as np
import pytest

from pointsplat_addon.core.lod import cut as cut_module
from pointsplat_addon.core.lod import hierarchy, instances, node_splats, node_table
from pointsplat_addon.core.lod import levels as levels_module
from pointsplat_addon.core.numeric import linear
from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.splat import ellipsoids


def ball(n: int = 6000) -> PointCloud:
    rng = np.random.default_rng(5)
    p = rng.standard_normal((n, 3))
    p = (p / np.linalg.norm(p, axis=1, keepdims=True)).astype(np.float32)
    return PointCloud(p, origin=np.array([0.5, -2.0, 1.0]), normal=p, radii=np.full((n, 1), 0.02, np.float32))


def box(n: int, half: tuple[float, float, float]) -> PointCloud:
    """Points spread evenly over the six sides of a box, with normals outwards."""
    rng = np.random.default_rng(6)
    area = np.prod(half) / np.array(half)
    face, sign = rng.choice(3, n, p=area / area.sum()), rng.choice([-1.0, 1.0], n)
    p, normal = rng.uniform(-1, 1, (n, 3)), np.zeros((n, 3), np.float32)
    p[np.arange(n), face] = normal[np.arange(n), face] = sign
    radii = np.full((n, 1), np.sqrt(8 * area.sum() / n / np.pi), np.float32)
    return PointCloud((p * half).astype(np.float32), normal=normal, radii=radii)


def lens(perspective: bool = True, size: tuple[int, int] = (640, 480), region: tuple | None = None) -> Camera:
    near, far = 0.1, 1e5
    clip = np.diag([1.5, 2.0, -2 / far, 1.0])
    if perspective:
        clip[2:] = [[0, 0, -(far + near) / (far - near), -2 * far * near / (far - near)], [0, 0, -1, 0]]
    return Camera(np.eye(4), clip, size, region, near=near, far=far)


def field(count: int, seed: int = 0) -> np.ndarray:
    """Matrices (count, 4, 4) before the camera, at 10 to 10,000 units, turned, sheared and mirrored."""
    rng = np.random.default_rng(seed)
    matrix = np.tile(np.eye(4), (count, 1, 1))
    matrix[:, :3, :3] = np.linalg.qr(rng.standard_normal((count, 3, 3)))[0] * rng.uniform(0.3, 2, (count, 1, 3))
    depth = 10 ** rng.uniform(1, 4, count)
    matrix[:, :3, 3] = np.stack([*(rng.uniform(-0.5, 0.5, (2, count)) * depth), -depth], axis=1)
    return matrix


@pytest.fixture(scope="module")
def built() -> hierarchy.Hierarchy:
    return hierarchy.build(ball())


@pytest.fixture(scope="module")
def levels(built: hierarchy.Hierarchy) -> levels_module.Levels:
    made = levels_module.make_levels(built)
    assert made is not None
    return made


def test_each_level_is_the_cut_of_a_parallel_view(built: hierarchy.Hierarchy, levels: levels_module.Levels) -> None:
    place = np.eye(4)
    place[2, 3] = -100.0
    camera = Camera(np.eye(4), np.diag([1e-2, 1e-2, -2e-5, 1.0]), (640, 480), near=0.1, far=1e5)
    focal = max(camera.pixel_from_view()[:2])
    every = node_splats.points_and_nodes(built)
    for size, first, count, nodes in zip(levels.size, levels.first, levels.count, levels.nodes, strict=True):
        found = cut_module.select_cut(
            node_table.node_table({0: built}), np.zeros(1, int), place[None], camera, 2 * focal * size * (1 + 1e-12)
        )
        rows = np.concatenate([np.arange(a, a + n) for a, n in zip(found.first, found.count, strict=True)])
        assert count == found.splats
        assert nodes == found.nodes
        held = levels.cloud.take(slice(first, first + count))
        wanted = every.take(rows)
        # The same splats, points first.
        for name, theirs in wanted.arrays().items():
            np.testing.assert_array_equal(getattr(held, name), theirs)


def test_levels_go_from_a_few_splats_to_half_the_points(levels: levels_module.Levels) -> None:
    assert levels_module.MIN_LEVEL_SPLATS <= levels.count[0] < 4 * levels_module.MIN_LEVEL_SPLATS
    assert 6000 / 5 < levels.count[-1] <= 3000
    np.testing.assert_allclose(levels.size[1:] / levels.size[:-1], 2 ** (-1 / levels_module.LEVELS_PER_OCTAVE))
    assert not levels.cut_short


def test_few_points_have_no_levels() -> None:
    assert levels_module.make_levels(hierarchy.build(ball(12))) is None
    assert levels_module.make_levels(hierarchy.build(ball(0))) is None


@pytest.mark.parametrize("perspective", [True, False])
def test_a_level_is_the_first_that_is_fine_enough(levels: levels_module.Levels, perspective: bool) -> None:
    camera, matrix = lens(perspective), field(4000)
    if not perspective:
        matrix[:, :3, 3] *= [1e-3, 1e-3, 1]
        matrix[:, :3, :3] *= np.logspace(-4, -1, 4000)[:, None, None]
    choice = instances.choose_levels(levels, matrix, np.arange(4000), camera, 1.0)
    some = np.flatnonzero(choice.level >= 0)
    assert len(some) > 500
    assert len(np.unique(choice.level[some])) > 10
    stretch = np.linalg.norm(matrix[some, :3, :3], 2, axis=(1, 2))
    middle = matrix[some, :3, :3] @ levels.center + matrix[some, :3, 3]
    focal, size = max(camera.pixel_from_view()[:2]), levels.size[choice.level[some]]
    reach = levels.radius * stretch
    # A ball of that size, where on the instance it is seen largest: nearest, and farthest from the axis.
    near = -middle[:, 2] - reach if perspective else np.ones(len(some))
    slope = np.hypot(1, (np.hypot(*middle[:, :2].T) + reach) / near) if perspective else 1.0
    pixels = 2 * focal * size * stretch / near * slope
    assert (pixels <= 1 + 1e-6).all()
    coarser = choice.level[some] > 0
    assert (pixels[coarser] * 2 ** (1 / levels_module.LEVELS_PER_OCTAVE) > 1 - 1e-6).all()


def test_what_is_near_has_a_cut_of_its_own_or_all_points(levels: levels_module.Levels) -> None:
    matrix = np.tile(np.eye(4), (3, 1, 1))
    matrix[:, 2, 3] = [-3.5, -8.0, -800.0]
    choice = instances.choose_levels(levels, matrix, np.arange(3), lens(), 1.0)
    assert choice.level[0] == instances.OWN_CUT
    assert choice.level[1] == instances.ALL_POINTS
    assert choice.level[2] >= 0


def test_what_is_broken_or_out_of_view_draws_nothing(levels: levels_module.Levels) -> None:
    good = field(1)[0]
    bad = np.tile(good, (7, 1, 1))
    bad[0, 0, 3] = np.nan
    bad[1, 1, 1] = np.inf
    bad[2, :3, :3] = 0
    bad[3, 2, 3] *= -1
    bad[4, 0, 3] = 1e6
    bad[5, :3, :3] *= 1e-300  # squares underflow
    bad[6, :3, 0] = 0  # flat, but not nothing
    with np.errstate(all="raise", under="ignore"):
        choice = instances.choose_levels(levels, bad, np.zeros(7, int), lens(), 1.0)
    assert (choice.level[:5] == instances.NOTHING).all()
    assert choice.level[6] != instances.NOTHING
    assert np.isfinite(choice.scale).all()


def test_visible_leaves_out_no_point_in_the_window() -> None:
    matrix, cloud = field(3000, 3), ball(200)
    matrix[:, :2, 3] *= 3
    for camera in (lens(), lens(region=(100, 200, 80, 60))):
        kept = instances.visible_instances(matrix, cloud.origin, 1.0, camera)
        view = (cloud.position + cloud.origin) @ matrix[:, :3, :3].transpose(0, 2, 1) + matrix[:, None, :3, 3]
        fx, fy, cx, cy = camera.pixel_from_view()
        x, y = cx - fx * view[..., 0] / view[..., 2], cy - fy * view[..., 1] / view[..., 2]
        inside = (view[..., 2] < -0.1) & (x >= 0) & (x < camera.window[2]) & (y >= 0) & (y < camera.window[3])
        assert kept[inside.any(axis=1)].all()
        assert kept.mean() < 0.9


@pytest.mark.parametrize("share", [1.0, 0.9, 0.5, 0.3, 0.01, 1e-6])
def test_thinning_keeps_the_area(share: float) -> None:
    at = (np.arange(1_000_000) + 0.5) / 1e6
    factor = instances.area_factor(np.full(len(at), share), at)
    # The middle of each of a million steps: 4e-7 off at 1e-6, where two of them stay.
    assert abs(factor.mean() - 1) < 1e-6 if share > 1e-5 else abs(factor.mean() - 1) < 0.2
    assert factor.max() <= (1 - instances.FADE) / (1 - instances.FADE / 2) / share + instances.FADE


def test_instances_fade_and_come_once() -> None:
    """As an instance grows, it appears once, from no area, and its size on the screen never jumps."""
    share, at = np.geomspace(1e-3, 1, 4000), np.linspace(0, 0.999, 50)
    drawn = share[:, None] * instances.area_factor(share[:, None], at)  # of the area at which thinning begins
    there = drawn > 0
    assert (there[1:] >= there[:-1]).all()
    assert (
        np.abs(np.diff(drawn, axis=0)).max() < 4e-3
    )  # 2.3e-3 measured, where the area on the screen grows by 1.7e-3 in each step
    np.testing.assert_allclose(drawn[-1], 1.0)


def test_the_number_of_an_instance_is_its_own_and_evenly_spread() -> None:
    found = instances.golden_ratio_sequence(np.arange(100_000))
    assert found.min() >= 0
    assert found.max() < 1
    # A hundred bins of a thousand, and of ten where a hundred instances follow one another.
    assert np.abs(np.histogram(found, 100, (0, 1))[0] - 1000).max() <= 2  # 1 measured
    for start in (0, 777, 54_321):
        assert np.abs(np.histogram(found[start : start + 100], 10, (0, 1))[0] - 10).max() <= 2  # 1 measured
    np.testing.assert_array_equal(found[500:600], instances.golden_ratio_sequence(np.arange(500, 600)))


def test_enlarged_instances_keep_their_middle() -> None:
    matrix, center, scale = field(20), np.array([1.0, 2.0, -0.5]), np.linspace(0.1, 3, 20)
    larger = instances.scaled_about(matrix, center, scale)
    middle = matrix[:, :3, :3] @ center + matrix[:, :3, 3]
    np.testing.assert_allclose(larger[:, :3, :3] @ center + larger[:, :3, 3], middle, rtol=1e-12)
    np.testing.assert_allclose(larger[:, :3, :3], matrix[:, :3, :3] * scale[:, None, None])


def test_joined_cuts_are_in_the_order_of_instances() -> None:
    one = cut_module.Cut(np.array([1, 1, 5], np.int32), np.array([0, 7, 3]), np.array([2, 1, 4]), nodes=3, points=4)
    two = cut_module.Cut(np.array([0, 3], np.int32), np.array([9, 9]), np.array([1, 2]), nodes=0, points=3, culled=6)
    cut = instances.joined_cuts([one, two])
    np.testing.assert_array_equal(cut.instance, [0, 1, 1, 3, 5])
    np.testing.assert_array_equal(cut.first, [9, 0, 7, 9, 3])
    np.testing.assert_array_equal(cut.count, [1, 2, 1, 2, 4])
    assert (cut.nodes, cut.points, cut.culled) == (3, 7, 6)


def test_singular_values_and_finite_matrices() -> None:
    rng = np.random.default_rng(0)
    matrix = rng.standard_normal((5000, 3, 3)) * 10.0 ** rng.uniform(-30, 30, (5000, 1, 1))
    matrix[:3] = np.zeros((3, 3)), np.eye(3), np.diag([1, 0, 0])
    exact = np.linalg.norm(matrix, 2, axis=(1, 2))
    found = linear.largest_singular_value(matrix)
    assert (found >= exact).all()
    assert (found <= exact * (1 + 1e-8)).all()  # measured 7e-9, which is added on purpose
    odd = np.zeros((4, 4, 4))
    odd[1, 2, 2], odd[2, 0, 3], odd[3] = np.nan, -np.inf, 1e308
    np.testing.assert_array_equal(linear.all_finite(odd), [True, False, False, True])
    assert linear.all_finite(np.zeros((0, 4, 4))).shape == (0,)


def test_nodes_know_how_much_of_them_is_turned_where() -> None:
    """Opposite walls that share a node are kept apart there, and so are those that meet at a corner."""
    wall = box(20_000, (1.0, 0.01, 1.0))
    walls = wall.take(np.tile(np.arange(len(wall)), 2))
    walls.position[:, 1] += np.repeat(np.array([-1, 1], np.float32), len(wall))
    for cloud, sides in ((walls, 2), (box(20_000, (1.0, 1.0, 1.0)), 3)):
        made = levels_module.make_levels(hierarchy.build(cloud))
        assert made is not None
        assert made.drawn.facets is not None
        facets = made.drawn.facets[: made.count[0]].astype(float) / 127
        share = np.linalg.norm(facets, axis=2)
        assert (np.count_nonzero(share > 0.2, axis=1) == sides).all()  # measured: 0.47 and more, 0.32 and more
        # Each is along an axis, as the sides are.
        largest = facets[share > 0.2]
        assert (np.abs(largest).max(axis=1) == np.linalg.norm(largest, axis=1)).all()
        np.testing.assert_allclose(share.sum(axis=1), 1, atol=0.02)  # measured 0.016: steps of 1/127
        if sides == 2:  # the mean of their normals is none
            assert np.linalg.norm(facets.sum(axis=1), axis=1).max() < 0.1  # measured 0.03


def test_what_is_turned_to_one_side_has_no_facets() -> None:
    flat = box(4000, (1.0, 1.0, 1e-3))
    assert flat.normal is not None
    made = levels_module.make_levels(hierarchy.build(flat.take(np.flatnonzero(flat.normal[:, 2] > 0))))
    assert made is not None
    assert made.drawn.facets is None


def test_silhouettes_of_points_and_of_ellipses_have_their_area() -> None:
    """A ball's shadow is a disk; that of a box has half of what its sides have together."""
    off = []
    shapes = [(ball(60_000), lambda normal: np.pi)]
    for half in ((1.0, 1.0, 1.0), (0.3, 0.3, 1.5)):
        sides = 4 * np.prod(half) / np.array(half)
        shapes.append((box(60_000, half), lambda normal, sides=sides: float(np.abs(normal) @ sides)))
    for cloud, area in shapes:
        for plane in levels_module._view_planes():
            np.testing.assert_allclose(plane @ plane.T, np.eye(2), atol=1e-12)
            found = levels_module._silhouette_area(cloud, plane)
            off.append(found / area(np.cross(*plane)) - 1)
    assert np.abs(off).max() < 0.04  # measured 0.030
    one = np.zeros((3, 1))
    ends = np.array([[0.5, 0, 0], [0, 2.0, 0]])[:, :, None]
    plane = np.eye(3)[:2]
    np.testing.assert_allclose(levels_module._ellipses_area(one, ends, plane), np.pi, rtol=0.02)
    apart = np.array([[0.0, 0, 0], [0, 0, 5]]).T  # one behind the other: the same shadow
    np.testing.assert_allclose(levels_module._ellipses_area(apart, np.repeat(ends, 2, axis=2), plane), np.pi, rtol=0.02)


def test_coarse_levels_are_drawn_as_large_as_what_they_stand_for() -> None:
    cloud = box(60_000, (0.3, 0.3, 1.5))
    made = levels_module.make_levels(hierarchy.build(cloud))
    assert made is not None
    assert made.cloud.radii is not None
    assert made.drawn.radii is not None
    planes = levels_module._view_planes()
    covered = sum(levels_module._silhouette_area(cloud, plane) for plane in planes)
    worst = {}
    for name, splats in (("given", made.cloud), ("drawn", made.drawn)):
        ratio = []
        for first, count in zip(made.first, made.count, strict=True):
            if count > levels_module.MEASURED_SPLATS:
                break
            level = slice(first, first + count)
            normal, axis, radii = ellipsoids.splat_frames(splats, level)
            ends = np.stack([axis * radii[0], np.cross(normal, axis, axis=0) * radii[1]])
            at = splats.position[level].T.astype(np.float64)
            ratio.append(sum(levels_module._ellipses_area(at, ends, plane) for plane in planes) / covered)
        worst[name] = np.abs(np.array(ratio) - 1).max()
    assert worst["given"] > 0.1  # measured 0.14
    assert worst["drawn"] < 0.01  # measured 0.0024
    grown = made.drawn.radii / made.cloud.radii
    assert (grown >= 1).all()
    assert (grown <= levels_module.MAX_GROWTH * (1 + 1e-6)).all()


def test_levels_together_are_a_few_times_the_finest(levels: levels_module.Levels) -> None:
    """A quarter of an octave apart, levels of a surface shrink by 2^-0.5: together they are 3.4 times the finest."""
    finest = levels.drawn.take(slice(levels.first[-1], levels.first[-1] + levels.count[-1]))
    assert levels.nbytes < 5 * finest.nbytes  # measured 4.64: coarse levels of few splats are alike
    # What facets and sizes add to position, normal, axis and half-axes: measured 1.44 times.
    assert levels.nbytes < 1.5 * levels.cloud.nbytes
