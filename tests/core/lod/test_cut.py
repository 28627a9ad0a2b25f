"""Facts about cuts: partitions of what is visible, conservative culling, sizes within the tolerance."""

# pyright: reportOptionalSubscript=false, reportOptionalMemberAccess=false, reportOptionalOperand=false
# Attributes may be None by type; the clouds here have those that are asked for.
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.lod import criteria, hierarchy, node_table
from pointsplat_addon.core.lod import cut as cut_module
from pointsplat_addon.core.numeric import linear
from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.splat import ellipsoids


def sphere_cloud(n: int = 4000, seed: int = 1) -> PointCloud:
    rng = np.random.default_rng(seed)
    p = rng.standard_normal((n, 3))
    p = (p / np.linalg.norm(p, axis=1, keepdims=True)).astype(np.float32)
    return PointCloud(p, normal=p, radii=rng.uniform(0.01, 0.04, (n, 1)).astype(np.float32))


def shift(x: float, y: float, z: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def perspective(fov: float = 0.8, size: tuple[int, int] = (640, 480), offset: float = 0.0, **more: object) -> Camera:
    near, far = 0.1, 100.0
    f = 1 / np.tan(fov / 2)
    clip = np.array([
        [f * size[1] / size[0], 0, offset, 0],
        [0, f, -offset / 2, 0],
        [0, 0, (far + near) / (near - far), 2 * far * near / (near - far)],
        [0, 0, -1, 0],
    ])  # fmt: skip
    return Camera(np.eye(4), clip, size, near=near, far=far, **more)  # type: ignore[arg-type]


def parallel(half: float = 1.5, size: tuple[int, int] = (640, 480), **more: object) -> Camera:
    clip = np.diag([size[1] / size[0] / half, 1 / half, -2 / 100, 1.0])
    clip[2, 3] = -1.0
    return Camera(np.eye(4), clip, size, near=0.0, far=100.0, **more)  # type: ignore[arg-type]


CAMERAS = {
    "perspective": perspective(),
    "shifted": perspective(offset=0.4),
    "wide": perspective(fov=2.2),
    "parallel": parallel(),
    "close-up": parallel(0.3),
    "window": perspective(region=(200, 100, 90, 140)),
}
SHEAR = np.array([[1.0, 0.6, 0, 0], [0, 1.2, 0.3, 0], [0.2, 0, 0.7, 0], [0, 0, 0, 1]])
PLACES = {
    "in front": shift(0, 0, -4),
    "at the edge": shift(1.5, -1, -3),
    "inside": shift(0.2, 0.1, -0.5),
    "behind": shift(0, 0, 4),
    "mirrored": shift(0.3, 0, -4) @ np.diag([-1.0, 1, 1, 1]),
    "sheared": shift(0.3, 0.5, -4) @ SHEAR,
    "stretched and mirrored": shift(0, 0.5, -4) @ np.diag([3.0, 1, -0.2, 1]),
}


@pytest.fixture(scope="module")
def built() -> hierarchy.Hierarchy:
    return hierarchy.build(sphere_cloud())


def points_of(cut: cut_module.Cut, built: hierarchy.Hierarchy, instance: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """How often the cut represents each point (N,), and by how many points each is represented together (N,)."""
    n, tree = len(built.cloud), built.tree
    times, together = np.zeros(n, int), np.zeros(n, int)
    of = cut.instance == instance
    for first, count in zip(cut.first[of], cut.count[of], strict=True):
        points = slice(first, min(first + count, n))
        times[points] += 1
        together[points] = 1
        for node in range(max(first, n) - n, first + count - n):
            points = slice(tree.first_point[node], tree.first_point[node] + tree.point_count[node])
            times[points] += 1
            together[points] = tree.point_count[node]
    return times, together


def in_view(cloud: PointCloud, view: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions in view space (N, 3) and a radius around each that holds its disk."""
    p = cloud.position.astype(np.float64) + cloud.origin
    return p @ view[:3, :3].T + view[:3, 3], cloud.radii[:, 0] * np.linalg.svd(view[:3, :3])[1].max()


def disk_rims(cloud: PointCloud, view: np.ndarray, steps: int = 16) -> np.ndarray:
    """Rims (N, steps, 3) of the disks in view space."""
    normal, axis, radii = (a.T for a in ellipsoids.splat_frames(cloud, slice(None)))
    t = np.linspace(0, 2 * np.pi, steps, endpoint=False)[:, None]
    rim = np.cos(t) * axis[:, None] + np.sin(t) * np.cross(normal, axis)[:, None]
    p = cloud.position[:, None] + radii[:, None, :1] * rim + cloud.origin
    return p @ view[:3, :3].T + view[:3, 3]


def pixels(camera: Camera, p: np.ndarray) -> np.ndarray:
    """Pixel coordinates (..., 2) in the full frame, of points in front of the camera."""
    clip = np.concatenate([p, np.ones_like(p[..., :1])], axis=-1) @ camera.clip_from_view.T
    return (clip[..., :2] / clip[..., 3:] + 1) / 2 * camera.resolution


def visible(camera: Camera, rims: np.ndarray) -> np.ndarray:
    """Which disks have a sampled point inside the window and between the clip planes."""
    clip = np.concatenate([rims, np.ones_like(rims[..., :1])], axis=-1) @ camera.clip_from_view.T
    w = clip[..., 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        x, y = np.moveaxis((clip[..., :2] / w[..., None] + 1) / 2 * camera.resolution, -1, 0)
    x0, y0, width, height = camera.window
    good = (w > 0) & (np.abs(clip[..., 2]) <= w) & (x >= x0) & (x <= x0 + width) & (y >= y0) & (y <= y0 + height)
    return good.any(axis=1)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("camera", CAMERAS)
def test_every_visible_point_is_represented_once(built: hierarchy.Hierarchy, camera: str, place: str) -> None:
    view, lens = PLACES[place], CAMERAS[camera]
    seen = visible(lens, disk_rims(built.cloud, view))
    for tolerance in (0.5, 8.0, 60.0):
        cut = cut_module.select_cut(node_table.node_table({0: built}), np.zeros(1, int), view[None], lens, tolerance)
        times, _ = points_of(cut, built)
        assert times.max(initial=0) <= 1
        assert (times[seen] == 1).all()
        assert (times == 0).sum() == cut.culled
        assert cut.count.sum() == cut.splats


@pytest.mark.parametrize("camera", ["perspective", "parallel"])
def test_culling_leaves_out_most_of_what_is_invisible(built: hierarchy.Hierarchy, camera: str) -> None:
    """A sphere half out of view: what is kept beyond the visible is a fringe."""
    view, lens = shift(2.2, 0, -4), CAMERAS[camera]
    cut = cut_module.select_cut(node_table.node_table({0: built}), np.zeros(1, int), view[None], lens, 0.5)
    seen = visible(lens, disk_rims(built.cloud, view))
    assert len(built.cloud) - cut.culled < 1.5 * seen.sum() + 100


@pytest.mark.parametrize("place", ["in front", "at the edge", "mirrored", "sheared", "stretched and mirrored"])
@pytest.mark.parametrize("camera", ["perspective", "wide", "parallel"])
def test_drawn_nodes_project_within_the_tolerance(built: hierarchy.Hierarchy, camera: str, place: str) -> None:
    view, lens, n, tree = PLACES[place], CAMERAS[camera], len(built.cloud), built.tree
    flat = pixels(lens, disk_rims(built.cloud, view))
    for tolerance in (30.0, 90.0):
        cut = cut_module.select_cut(node_table.node_table({0: built}), np.zeros(1, int), view[None], lens, tolerance)
        assert cut.nodes > 0
        for first, count in zip(cut.first, cut.count, strict=True):
            for node in range(max(first, n) - n, first + count - n):
                q = flat[tree.first_point[node] : tree.first_point[node] + tree.point_count[node]].reshape(-1, 2)
                assert np.linalg.norm(q - q[0], axis=1).max() <= tolerance


@pytest.mark.parametrize("camera", ["perspective", "parallel"])
def test_nodes_of_one_level_change_over_a_band(camera: str) -> None:
    """Of a square that faces the camera: as drawn, or up to `band` octaves finer, each node at its own size."""
    grid = (np.stack(np.meshgrid(*[np.arange(128)] * 2), axis=-1).reshape(-1, 2) + 0.5) / 64 - 1
    position = np.column_stack([grid, np.zeros(len(grid))]).astype(np.float32)
    normal = np.tile(np.array([0, 0, 1], np.float32), (len(grid), 1))
    square = hierarchy.build(PointCloud(position, normal=normal, radii=np.full((len(grid), 1), 0.011, np.float32)))
    forest, place, lens = node_table.node_table({0: square}), shift(0, 0, -20)[None], CAMERAS[camera]

    def drawn(band: float) -> np.ndarray:
        tolerances = 4.0 * 2 ** np.linspace(0, 1, 41)
        return np.array(
            [cut_module.select_cut(forest, np.zeros(1, int), place, lens, t, band=band).splats for t in tolerances]
        )

    alike, spread = drawn(0.0), drawn(0.25)
    # Ten steps span the band: 0.11 of the nodes at the most are replaced in one, else all of them.
    assert (-np.diff(spread)).max() < 0.2 * (alike.max() - alike.min())
    assert (-np.diff(alike)).max() > 0.8 * (alike.max() - alike.min())
    assert (spread >= alike).all()
    assert (spread[10:] <= alike[:-10]).all()
    assert (np.diff(spread) <= 0).all()


def test_what_is_no_wider_than_a_pixel_changes_at_once() -> None:
    assert criteria.transition_band(0.5) == criteria.transition_band(1.0) == 0
    assert criteria.transition_band(2.0) == criteria.transition_band(64.0) == criteria.TRANSITION_BAND
    # Whatever the band is, a larger tolerance asks for no finer nodes.
    limits = np.array([t * 2.0 ** -criteria.transition_band(t) for t in np.linspace(0.5, 4, 50)])
    assert (np.diff(limits) > 0).all()


@pytest.mark.parametrize("camera", CAMERAS)
def test_larger_tolerance_never_refines(built: hierarchy.Hierarchy, camera: str) -> None:
    forest, view = node_table.node_table({0: built}), PLACES["in front"][None]
    before = np.zeros(len(built.cloud), int)
    splats = np.inf
    for tolerance in (0.1, 1, 3, 9, 27, 81, 1e4):
        cut = cut_module.select_cut(forest, np.zeros(1, int), view, CAMERAS[camera], tolerance)
        _, together = points_of(cut, built)
        assert (together >= before).all()
        assert cut.splats <= splats
        before, splats = together, cut.splats
    if camera != "window":
        assert splats == 1


def test_zero_tolerance_is_all_points(built: hierarchy.Hierarchy) -> None:
    cut = cut_module.select_cut(
        node_table.node_table({0: built}), np.zeros(1, int), PLACES["in front"][None], perspective(), 0.0
    )
    assert (cut.first.tolist(), cut.count.tolist(), cut.nodes) == ([0], [len(built.cloud)], 0)


@pytest.mark.parametrize("camera", CAMERAS)
def test_the_shortcut_to_all_points_changes_nothing(built: hierarchy.Hierarchy, camera: str) -> None:
    forest = node_table.node_table({0: built})
    long_way = replace(forest, smallest=np.zeros_like(forest.smallest))
    for view in PLACES.values():
        for tolerance in (1.0, 5.0, 12.0):
            a, b = (
                cut_module.select_cut(f, np.zeros(1, int), view[None], CAMERAS[camera], tolerance, cull)
                for f, cull in ((forest, None), (long_way, None))
            )
            np.testing.assert_array_equal(a.first, b.first)
            np.testing.assert_array_equal(a.count, b.count)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("camera", ["perspective", "wide", "parallel"])
def test_cones_cull_only_what_faces_away(built: hierarchy.Hierarchy, camera: str, place: str) -> None:
    view, lens = PLACES[place], CAMERAS[camera]
    forest = node_table.node_table({0: built})
    yes = np.ones(1, bool)
    cut = cut_module.select_cut(forest, np.zeros(1, int), view[None], lens, 2.0, yes)
    p, _ = in_view(built.cloud, view)
    normal = built.cloud.normal @ np.linalg.inv(view[:3, :3])  # rows: the inverse transpose, applied
    facing = np.einsum("ni,ni->n", normal, p if lens.perspective else np.tile([0.0, 0, -1], (len(p), 1))) < 0
    times, _ = points_of(cut, built)
    assert (times[facing & visible(lens, disk_rims(built.cloud, view))] == 1).all()
    if place in ("in front", "mirrored", "sheared"):
        assert cut.culled > 0.5 * (~facing).sum()
        assert cut_module.select_cut(forest, np.zeros(1, int), view[None], lens, 2.0).culled < cut.culled


def test_instances_do_not_disturb_each_other(built: hierarchy.Hierarchy) -> None:
    other = hierarchy.build(sphere_cloud(700, seed=4))
    forest = node_table.node_table({0: built, 3: other})
    geometry = np.array([3, 0, 1, 0, 3, 0])
    views = np.stack([shift(0, 0, -4), *list(PLACES.values())[:5]])
    cull = np.array([True, False, False, True, False, False])
    cut = cut_module.select_cut(forest, geometry, views, perspective(), 6.0, cull)
    assert np.all(np.diff(cut.instance) >= 0)
    totals = [0, 0, 0]
    for i, g in enumerate(geometry):
        of = cut.instance == i
        first, count = cut.first[of], cut.count[of]
        assert (first[1:] > (first + count)[:-1]).all()
        if g == 1:
            assert not of.any()
            continue
        alone = cut_module.select_cut(
            node_table.node_table({0: {0: built, 3: other}[g]}),
            np.zeros(1, int),
            views[i : i + 1],
            perspective(),
            6.0,
            cull[i : i + 1],
        )
        np.testing.assert_array_equal(first, alone.first)
        np.testing.assert_array_equal(count, alone.count)
        totals = [a + b for a, b in zip(totals, (alone.nodes, alone.points, alone.culled), strict=True)]
    assert totals == [cut.nodes, cut.points, cut.culled]


def test_chunks_do_not_change_the_cut(built: hierarchy.Hierarchy, monkeypatch: pytest.MonkeyPatch) -> None:
    forest, geometry = node_table.node_table({0: built}), np.zeros(4, int)
    views = np.stack(list(PLACES.values())[:4])
    one = cut_module.select_cut(forest, geometry, views, perspective(), 4.0)
    monkeypatch.setattr(cut_module, "CHUNK", 13)
    many = cut_module.select_cut(forest, geometry, views, perspective(), 4.0)
    for name in ("instance", "first", "count"):
        np.testing.assert_array_equal(getattr(one, name), getattr(many, name))


def test_zero_flat_and_broken_transforms(built: hierarchy.Hierarchy) -> None:
    views = np.stack([np.zeros((4, 4)), shift(0, 0, -4) @ np.diag([1.0, 1, 0, 1]), np.full((4, 4), np.nan)])
    cut = cut_module.select_cut(
        node_table.node_table({0: built}), np.zeros(3, int), views, perspective(), 1.0, np.ones(3, bool)
    )
    assert set(cut.instance) == {1}
    times, _ = points_of(cut, built, 1)
    assert (times == 1).all()


def test_nothing_gives_an_empty_cut(built: hierarchy.Hierarchy) -> None:
    none = np.empty(0, int), np.empty((0, 4, 4))
    empty = hierarchy.build(sphere_cloud(0))
    for hierarchies, geometry, views in (
        ({}, *none),
        ({0: built}, *none),
        ({}, np.zeros(1, int), np.eye(4)[None]),
        ({0: empty}, np.zeros(1, int), np.eye(4)[None]),
    ):
        cut = cut_module.select_cut(node_table.node_table(hierarchies), geometry, views, perspective())
        assert (len(cut.instance), len(cut.first), cut.splats) == (0, 0, 0)
    assert cut_module.cut_of_all_points(np.empty(0, int), np.empty(0, int)).splats == 0


def test_clouds_without_nodes_are_drawn_whole(built: hierarchy.Hierarchy) -> None:
    cloud = sphere_cloud(50)
    cut = cut_module.select_cut(
        node_table.node_table({0: cloud, 1: built}),
        np.array([0, 1]),
        np.stack([shift(0, 0, -4)] * 2),
        perspective(),
        1e4,
    )
    assert cut.first.tolist() == [0, len(built.cloud)]
    assert cut.count.tolist() == [50, 1]
    full = cut_module.cut_of_all_points(np.array([50, 0, 7]), np.array([2, 1, 0, 2]))
    assert full.instance.tolist() == [0, 2, 3]
    assert full.count.tolist() == [7, 50, 7]
    assert full.points == 64


def test_origin_is_part_of_the_transform() -> None:
    """Map coordinates: the cloud's origin and the camera are far away, the picture is that of the cloud at home."""
    cloud = sphere_cloud(900)
    far = np.array([1e7, -2e7, 3e6])
    here = cut_module.select_cut(
        node_table.node_table({0: hierarchy.build(cloud)}), np.zeros(1, int), shift(0, 0, -4)[None], perspective(), 9.0
    )
    there = cut_module.select_cut(
        node_table.node_table({0: hierarchy.build(replace(cloud, origin=far))}),
        np.zeros(1, int),
        (shift(0, 0, -4) @ shift(*-far))[None],
        perspective(),
        9.0,
    )
    np.testing.assert_array_equal(here.first, there.first)


def test_largest_singular_value() -> None:
    rng = np.random.default_rng(0)
    a = rng.standard_normal((500, 3, 3)) * 10.0 ** rng.uniform(-8, 8, (500, 1, 1))
    a[:3] = np.eye(3), np.diag([-2, 2, 2]), np.ones((3, 3))
    expected = np.linalg.svd(a, compute_uv=False)[:, 0]
    ratio = linear.largest_singular_value(a) / expected
    assert ratio.min() >= 1
    assert ratio.max() <= 1 + 1e-8  # measured 1 + 7e-9, the margin
