"""What is drawn as points, how densely, and what is kept for the next view."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.lod.cost import DEFAULT
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.scene import Geometry
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.validation import validate
from pointsplat_addon.core.scene.volume import Transfer, Volume
from pointsplat_addon.render.cache.keys import Key, Kind
from pointsplat_addon.render.cache.store import Store
from pointsplat_addon.render.prepare.meshes import points as meshes
from pointsplat_addon.render.prepare.prepare import prepare
from pointsplat_addon.render.prepare.separation import separate_translucent
from scripts.scenes import build, cameras, clouds
from scripts.scenes.case import Case
from scripts.scenes.cases import CASES
from scripts.scenes.meshes import cube_mesh, flat_mesh, sphere_mesh


def prepared(case, store=None, samples=1, costs=DEFAULT, interactive=False):
    scene, camera = validate(case.scene, case.camera)
    store = Store() if store is None else store
    return prepare(scene, camera, case.settings, samples, store, costs=costs, interactive=interactive)


def at_distance(case, distance):
    camera = cameras.camera((0, -distance, 0), far=10 * distance)
    return replace(case, camera=camera)


def of(mesh, primitive="AUTO", distance=4.0, spacing=0.0):
    return at_distance(
        Case(build.scene((build.mesh(mesh, primitive, spacing), build.moved())), cameras.camera()), distance
    )


def test_auto_draws_large_triangles_as_polygons_and_small_ones_as_points():
    assert len(prepared(of(cube_mesh("auto cube"))).polygons) == 1
    fine = sphere_mesh("auto sphere", 200)
    assert len(prepared(of(fine)).polygons) == 0
    assert prepared(of(fine)).cut.splats > 0


def test_auto_draws_the_same_triangles_as_polygons_near_and_as_points_far_where_triangles_are_dear():
    dear, cube = replace(DEFAULT, triangle=1e5), cube_mesh("dear cube")
    assert len(prepared(of(cube), costs=dear).polygons) == 1
    assert len(prepared(of(cube, distance=2000), costs=dear).polygons) == 0


@pytest.mark.parametrize(("primitive", "polygons"), [("POINTS", 0), ("POLYGONS", 1)])
def test_an_objects_own_choice_wins(primitive, polygons):
    for distance in (4, 2000):
        assert len(prepared(of(cube_mesh("chosen cube"), primitive, distance)).polygons) == polygons


@pytest.mark.parametrize("interactive", [True, False])
def test_samples_follow_the_distance_in_octaves_and_viewports_only_refine_them(interactive):
    store, mesh = Store(), cube_mesh("refined cube")
    keys = {}
    for distance in (40.0, 39.0, 10.0, 38.0):
        found = prepared(of(mesh, "POINTS", distance), store, interactive=interactive)
        keys[distance] = found.point_sets[0].key, len(found.point_sets[0])
    assert keys[40.0] == keys[39.0]
    assert keys[10.0][1] > 4 * keys[40.0][1]  # a quarter of the spacing in two dimensions: 16 times, less rims
    assert keys[38.0] == keys[10.0 if interactive else 40.0]


def test_an_objects_spacing_is_used_as_it_is():
    mesh = cube_mesh("spaced cube")
    for spacing in (0.5, 0.3):
        cloud = prepared(of(mesh, "POINTS", spacing=spacing)).point_sets[0].cloud
        assert cloud.radii is not None
        assert cloud.radii.max() <= spacing / np.sqrt(2) * (1 + 1e-6)
        # 24 square units in cells of at most spacing x spacing; twice as many at the triangles' rims
        assert 24 / spacing**2 <= len(cloud) < 3 * 24 / spacing**2


def test_the_cut_of_small_clouds_is_all_of_each_usable_instance():
    case = CASES["instances"]()
    found = prepared(case)
    assert found.cut.splats == 5 * 200
    assert found.total == 5 * 200
    assert not np.isin(found.cut.instance, np.flatnonzero(~np.isfinite(found.view_from_object).all(axis=(1, 2)))).any()
    assert len(found.polygons) == 5


def test_a_tree_is_built_where_it_leaves_out_most_points_and_pays_by_many_samples():
    cloud = clouds.sphere_cloud(20000)
    cloud = replace(cloud, radii=np.full((20000, 1), 1e-2, np.float32))
    near = Case(build.scene((build.points("dense", cloud), build.moved())), cameras.camera())
    far = at_distance(near, 4000.0)
    assert prepared(near, samples=1000).point_sets[0].hierarchy is None
    assert prepared(far, samples=1).point_sets[0].hierarchy is None
    assert prepared(far, samples=1000).point_sets[0].hierarchy is not None
    assert prepared(far, samples=1000).cut.splats < 100


def test_a_tree_that_is_there_is_used_by_viewports_while_final_pictures_do_not_depend_on_those_before():
    store = Store()
    cloud = replace(clouds.sphere_cloud(20000), radii=np.full((20000, 1), 1e-2, np.float32))
    near = Case(build.scene((build.points("dense again", cloud), build.moved())), cameras.camera())
    prepared(at_distance(near, 4000.0), store, samples=1000)
    assert prepared(near, store, interactive=True).point_sets[0].hierarchy is not None
    assert prepared(near, store).point_sets[0].hierarchy is None


def test_what_is_translucent_in_final_pictures_does_not_depend_on_those_before():
    store, opacity = Store(), np.full(20000, 0.5, np.float32)
    cloud = replace(clouds.sphere_cloud(20000), radii=np.full((20000, 1), 1e-2, np.float32), opacity=opacity)
    near = Case(build.scene((build.points("dense fog", cloud), build.moved())), cameras.camera())
    prepared(at_distance(near, 4000.0), store, samples=1000)
    assert prepared(near, store, interactive=True).translucent.point_sets[0].hierarchy is not None
    assert prepared(near, store).translucent.point_sets[0].hierarchy is None


@pytest.mark.parametrize("name", CASES)
def test_no_drawn_splat_is_wider_than_what_the_pyramid_is_built_for(name):
    case = CASES[name]()
    found = prepared(case)
    assert np.isfinite(found.largest)
    camera = case.camera
    focal = max(abs(f) for f in camera.pixel_from_view()[:2])
    for row, points in found.point_sets.items():
        cloud = points.cloud
        assert cloud.radii is not None
        for instance in np.flatnonzero(case.scene.instances.geometry == row):
            matrix = found.view_from_object[instance]
            if not np.isfinite(matrix).all():
                continue
            view = (cloud.position + cloud.origin) @ matrix[:3, :3].T + matrix[:3, 3]
            seen = -view[:, 2] > camera.near
            scale = np.linalg.norm(matrix[:3, :3], 2)
            depth = -view[seen, 2] if camera.perspective else 1.0
            assert (cloud.radii[seen, 0] * scale * focal / depth <= found.largest * (1 + 1e-6)).all()


def test_an_instance_at_infinity_is_left_out():
    good, bad = build.moved(), build.moved(scale=np.inf)
    ball = build.points("ball at infinity", clouds.sphere_cloud())
    found = prepared(Case(build.scene((ball, good), (ball, bad)), cameras.camera()))
    assert found.cut.splats == 400
    assert np.isfinite(found.largest)


def test_what_is_dropped_is_said_once_with_the_objects_name():
    case = CASES["not_finite"]()
    warnings = validate(case.scene, case.camera)[0].warnings
    assert len(warnings) == 2
    assert warnings[0].startswith("broken sphere: 50 points")
    assert warnings[1].startswith("broken cube: 6 triangles")


def test_nothing_is_drawn_of_empty_things():
    nothing = PointCloud(np.zeros((0, 3), np.float32))
    flat = flat_mesh("no faces", np.zeros((3, 3), np.float32), np.zeros((0, 3), np.int32))
    case = Case(
        build.scene((build.points("no points", nothing), build.moved()), (build.mesh(flat), build.moved())),
        cameras.camera(),
    )
    found = prepared(case)
    assert found.cut.splats == 0
    assert len(found.polygons) == 0
    assert found.point_sets == {}


def test_a_coarser_tolerance_needs_fewer_samples():
    case = of(cube_mesh("tolerant cube"), "POINTS", 20.0)
    counts = [prepared(replace(case, settings=Settings(technique="IMAGE_SPACE", tolerance=t))).total for t in (1, 2, 4)]
    assert counts[0] > counts[1] > counts[2]


class Item:
    def __init__(self, nbytes):
        self.nbytes = nbytes


def test_a_finer_tolerance_may_have_more_samples(monkeypatch):
    monkeypatch.setattr(meshes, "MAX_SAMPLES", 3000)
    monkeypatch.setattr(meshes, "MOST_SAMPLES", 20_000)
    case = of(sphere_mesh("budget", 8), "POINTS", distance=1.6)
    counts = []
    for tolerance in (1.0, 0.5, 0.01):
        found = prepare(case.scene, case.camera, replace(case.settings, tolerance=tolerance), 1, Store())
        counts.append(len(found.point_sets[0]))
    # So many does one sample a pixel take: more than may be, at either tolerance.
    assert counts[0] <= 3000 < counts[1] <= 12_000 < counts[2] <= 20_000


def test_a_view_that_needs_nothing_finer_samples_nothing(monkeypatch):
    store, mesh = Store(), sphere_mesh("orbited", 64)
    first = prepared(of(mesh, "POINTS", distance=4.0), store)

    def unwanted(*args, **kwargs):
        raise AssertionError("nothing had to be looked at again")

    for name in ("measure_triangles", "sample_mesh", "evaluate", "limit_spacing"):
        monkeypatch.setattr(meshes, name, unwanted)
    second = prepared(of(mesh, "POINTS", distance=4.1), store)
    assert second.point_sets[0] is not None
    assert second.point_sets[0].cloud is first.point_sets[0].cloud


def named(name: str) -> Key:
    return Key(Kind.CLOUD, name)


def test_a_store_forgets_what_was_used_least_lately():
    store, made = Store(limit=30), []

    def get(name):
        return store.lookup(named(name), lambda: made.append(name) or Item(10))

    for name in "abcad":
        get(name)
    assert store.nbytes == 30
    for name in "acd":
        get(name)
    assert made == ["a", "b", "c", "d"]
    get("b")
    assert made[-1] == "b"


def test_a_store_keeps_what_is_too_large_for_it_until_the_next_one_comes():
    store = Store(limit=5)
    item = store.lookup(named("x"), lambda: Item(10))
    assert store.lookup(named("x"), lambda: Item(0)) is item
    store.lookup(named("y"), lambda: Item(1))
    assert named("x") not in store
    store.clear()
    assert store.nbytes == 0
    assert named("y") not in store


def test_another_transfer_function_keeps_the_tree_and_the_kernels():
    """Where earlier pictures may count, such as with a budget."""
    rng = np.random.default_rng(1)
    index = np.stack(np.meshgrid(*[np.arange(20)] * 3, indexing="ij"), -1).reshape(-1, 3).astype(np.int32)
    values = rng.random(len(index)).astype(np.float32)
    store, budgeted = Store(), Settings(technique="IMAGE_SPACE", budget="TIME")

    def seen(high):
        transfer = Transfer("density", 0.0, high, np.linspace([0, 0, 0, 0], [1, 1, 1, 1], 8).astype(np.float32))
        volume = Volume("lattice of noise", "Noise", index, np.eye(4), {"density": values}, transfer=transfer)
        made = build.scene((Geometry(f"noise up to {high}", "Noise", volume=volume), build.moved(scale=0.01)))
        made, _ = separate_translucent(made, store)
        layer = prepare(made, cameras.camera((0, -40, 0)), budgeted, 1000, store).translucent
        (points,) = layer.point_sets.values()
        assert points.hierarchy is not None
        return points.hierarchy

    first, second = seen(1.0), seen(0.5)
    assert second.tree is first.tree
    np.testing.assert_array_equal(second.radii, first.radii)
    assert first.extinction is not None
    assert second.extinction is not None
    assert not np.array_equal(second.extinction, first.extinction)


def test_a_mesh_whose_box_alone_reaches_into_the_picture_is_not_drawn():
    """A sphere beside the frustum, turned so that a corner of its box lies within."""
    mesh, turn = sphere_mesh("sphere beside the picture", 24), np.eye(4)
    turn[:3, :3] = [[np.sqrt(0.5), 0, -np.sqrt(0.5)], [0, 1, 0], [np.sqrt(0.5), 0, np.sqrt(0.5)]]
    beside = build.moved((12.0 * np.tan(np.radians(20)) + 1.15, 8.0, 0)) @ turn
    shown = build.points("sphere in the picture", clouds.sphere_cloud())
    case = Case(build.scene((build.mesh(mesh), beside), (shown, build.moved())), cameras.camera())
    found = prepared(case)
    assert set(found.cut.instance) == {1}
    assert len(found.polygons) == 0
