"""Pictures and passes against geometry, optics and the reference in float64."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.numeric.cryptomatte import cryptomatte_hash
from pointsplat_addon.core.scene.world import Mist, World
from pointsplat_addon.devices.opengl import OpenGLDevice
from pointsplat_addon.render.frame.sample_positions import offsets
from pointsplat_addon.render.passes.outputs import BACKGROUND_DEPTH
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes import build, cameras, drawing, meshes, solid_cases
from scripts.scenes.case import ALL_PASSES, Case
from scripts.scenes.cases import CASES
from scripts.scenes.drawing import render
from scripts.scenes.store import STORE
from tests.reference import opaque

POLYGONS = ("cube", "culled")  # only polygons are seen


def flat(result, name):
    return result.pixels[name][..., 0]


def there(result):
    return flat(result, "depth") < BACKGROUND_DEPTH


# Everything


@pytest.mark.parametrize("name", CASES)
def test_every_pass_of_every_scene_is_finite(name):
    result = render(CASES[name]())
    for key, array in result.pixels.items():
        if key.startswith("crypto"):
            array = array[..., 1::2]  # identities are bits
        assert np.isfinite(array).all(), key
        assert array.dtype == np.float32
    alpha = result.pixels["combined"][..., 3]
    assert alpha.min() >= 0
    assert alpha.max() <= 1
    assert result.pixels["combined"].min() >= 0


@pytest.mark.parametrize("name", ["balls", "wide_balls", "parallel_balls"])
def test_wide_balls_are_what_the_rays_meet(name):
    case = CASES[name]()
    result, expected = render(case), opaque.picture(case.scene, case.camera)
    seen = there(result)
    np.testing.assert_array_equal(seen, expected.depth < BACKGROUND_DEPTH)
    np.testing.assert_array_equal(flat(result, "object_index")[seen], expected.instance[seen] + 1)
    assert np.abs(flat(result, "depth") / expected.depth - 1)[seen].max() < 2e-5  # measured 5.4e-6
    assert np.abs(result.pixels["normal"] - expected.normal).max() < 1e-3  # measured 3.3e-4: half floats
    assert np.abs(result.pixels["combined"] - expected.combined).max() < 1e-3  # measured 3.5e-4


@pytest.mark.parametrize("name", POLYGONS)
def test_polygons_are_where_the_reference_has_them(name):
    case = CASES[name]()
    result = render(case, ALL_PASSES | {"diffuse_color"})
    expected = opaque.picture(case.scene, case.camera)
    np.testing.assert_array_equal(there(result), expected.depth < BACKGROUND_DEPTH)
    seen = there(result)
    error = np.abs(flat(result, "depth") / expected.depth - 1)[seen]
    assert error.max() < 2e-6  # measured 6e-7
    assert np.abs(result.pixels["position"] - expected.position)[seen].max() < 1e-5  # measured 2.3e-6
    assert np.abs(result.pixels["normal"] - expected.normal).max() < 1e-3  # measured 2.9e-4: 24 bits, and half floats
    assert (
        np.abs(result.pixels["diffuse_color"] - expected.diffuse_color).max() < 1e-4
    )  # measured 4.3e-5: the table's rounding
    assert np.abs(result.pixels["combined"] - expected.combined).max() < 1e-3  # measured 1.7e-4
    np.testing.assert_array_equal(flat(result, "object_index")[seen], expected.instance[seen] + 1)
    np.testing.assert_array_equal(flat(result, "material_index")[seen], expected.material[seen] + 10)
    for name in ("object_index", "material_index", "diffuse_color", "normal", "position"):
        assert not result.pixels[name][~seen].any()


def inner(mask, pixels=2):
    """The mask without a rim."""
    for _ in range(pixels):
        padded = np.pad(mask, 1)
        mask = mask & padded[2:, 1:-1] & padded[:-2, 1:-1] & padded[1:-1, 2:] & padded[1:-1, :-2]
    return mask


@pytest.mark.parametrize("name", ["plain_sphere", "sphere", "environment"])
def test_splats_shade_as_in_the_reference(name):
    """Where the sphere is not steep; a splat's radius is 3 pixels. Splats that wide let a few pixels through."""
    case = CASES[name]()
    result, expected = render(case), opaque.picture(case.scene, case.camera)
    covered = expected.depth < BACKGROUND_DEPTH
    assert np.mean(there(result)[covered]) > 0.995  # measured 0.9989
    inside = inner(covered, 5)
    depth = np.abs(flat(result, "depth") - expected.depth)[inside]
    difference = np.abs(result.pixels["combined"] - expected.combined).max(axis=2)[inside]
    assert np.mean(depth > 0.3) < 0.015  # measured 0.010: what shows the sphere's other side
    assert np.quantile(depth, 0.95) < 0.06  # measured 0.044
    assert np.quantile(difference, 0.5) < 0.015  # measured 0.0103
    assert np.quantile(difference, 0.95) < 0.05  # measured 0.039


@pytest.mark.parametrize("samples", [1, 16])
def test_a_mesh_drawn_as_points_looks_as_its_polygons(samples):
    """Same shading: away from the silhouette the pictures agree, and there is no hole."""
    pictures = []
    for primitive in ("POINTS", "POLYGONS"):
        thing = build.mesh(meshes.sphere_mesh("compared sphere", 60), primitive)
        case = Case(build.scene((thing, build.moved()), transparent=True), cameras.camera(resolution=(96, 96)))
        pictures.append(render(case, frozenset({"combined"}), samples).pixels["combined"])
    points, polygons = pictures
    covered = polygons[..., 3] == 1
    assert (points[..., 3][inner(covered, 1)] == 1).all()
    inside = inner(covered, 4)
    error = (points - polygons)[inside][:, :3]
    assert np.sqrt((error**2).mean()) < 0.01  # measured 0.0078 and 0.0064: normals are those of a centre in the pixel


# Film


def test_a_transparent_film_is_empty_where_nothing_is_and_opaque_where_something_is():
    case = solid_cases.mixed()
    clear = replace(case, scene=replace(case.scene, transparent=True))
    result, solid = render(clear), render(case)
    combined, seen = result.pixels["combined"], there(result)
    np.testing.assert_array_equal(combined[..., 3], seen)
    assert not combined[~seen].any()
    np.testing.assert_allclose(combined[seen], solid.pixels["combined"][seen], atol=1e-6)
    np.testing.assert_allclose(
        solid.pixels["combined"][~seen], np.broadcast_to([*case.scene.world.color, 1], (np.sum(~seen), 4)), atol=1e-6
    )


@pytest.mark.parametrize("transparent", [True, False])
def test_a_holdout_hides_what_is_behind_it_and_leaves_alpha_empty(transparent):
    case = solid_cases.holdout()
    case = replace(case, scene=replace(case.scene, transparent=transparent))
    held = case.scene.instances.holdout
    assert held is not None
    result = render(case)
    owner = flat(result, "object_index").astype(int) - 1
    hole = (owner >= 0) & held[owner]
    assert hole.sum() > 100
    assert not result.pixels["combined"][hole].any()
    assert (flat(result, "depth")[hole] < BACKGROUND_DEPTH).all()
    assert (result.pixels["combined"][(owner >= 0) & ~hole][:, 3] == 1).all()


def test_a_world_without_objects_is_its_picture():
    image = np.zeros((8, 16, 3), np.float32)
    image[:] = np.linspace(0, 1, 16)[:, None]
    case = Case(build.scene(world=World(np.zeros(3), image)), cameras.camera())
    expected = opaque.picture(case.scene, case.camera)
    assert np.abs(render(case).pixels["combined"] - expected.combined).max() < 1e-5  # measured 2.8e-7


def test_an_empty_scene_has_every_pass():
    case = solid_cases.empty()
    result = render(case)
    np.testing.assert_allclose(result.pixels["combined"], np.broadcast_to([0.1, 0.12, 0.15, 1], (40, 48, 4)), atol=1e-7)
    assert (result.pixels["depth"] == BACKGROUND_DEPTH).all()
    assert (result.pixels["mist"] == 1).all()
    rest = set(result.pixels) - {"combined", "depth", "mist"}
    assert not any(result.pixels[key].any() for key in rest)


@pytest.mark.parametrize("name", ["cube", "mixed", "sphere", "textured", "balls", "holdout"])
@pytest.mark.parametrize("samples", [1, 3])
def test_a_border_shows_the_full_frames_pixels(name, samples):
    """Splats that reach into it from outside included, and whatever pixels the pyramid takes together."""
    case = CASES[name]()
    x0, y0, width, height = 7, 9, 30, 21
    part = replace(case, camera=replace(case.camera, region=(x0, y0, width, height)))
    whole, cropped = render(case, samples=samples).pixels, render(part, samples=samples).pixels
    for key, array in cropped.items():
        difference = np.abs(array - whole[key][y0 : y0 + height, x0 : x0 + width])
        values = difference[..., 1::2] if key.startswith("crypto") else difference
        assert values.max(initial=0) < 1e-3, key  # measured 2.9e-4: colours of corners are half floats


# Passes


def test_position_and_depth_are_of_one_point():
    for name in ("cube", "mixed", "parallel", "far_away"):
        case = CASES[name]()
        result = render(case)
        seen = there(result)
        position = result.pixels["position"].astype(np.float64)
        view = position @ case.camera.view_from_world[:3, :3].T + case.camera.view_from_world[:3, 3]
        scale = max(np.abs(position).max(), 1)
        error = np.abs(-view[..., 2] - flat(result, "depth"))[seen].max()
        assert error < 2e-6 * scale  # measured 4.8e-7
        fx, fy, cx, cy = case.camera.pixel_from_view()
        d = -view[..., 2] if case.camera.perspective else 1.0
        y, x = np.mgrid[: seen.shape[0], : seen.shape[1]] + 0.5
        assert np.abs(cx + fx * view[..., 0] / d - x)[seen].max() < 2e-5 * scale  # measured 4.9e-6
        assert np.abs(cy + fy * view[..., 1] / d - y)[seen].max() < 2e-5 * scale  # measured 5.6e-6


def test_normals_face_the_eye_and_are_unit_or_nothing():
    for name in ("cube", "mixed", "parallel", "instances"):
        result = render(CASES[name]())
        size = np.linalg.norm(result.pixels["normal"], axis=2)
        np.testing.assert_allclose(size[there(result)], 1, atol=1e-6)
        assert not size[~there(result)].any()


@pytest.mark.parametrize(("falloff", "power"), [("LINEAR", 1.0), ("QUADRATIC", 2.0), ("INVERSE_QUADRATIC", 0.5)])
def test_mist_follows_the_distance_to_the_eye(falloff, power):
    case = solid_cases.cube()
    case = replace(case, scene=replace(case.scene, mist=Mist(3.5, 2.0, falloff)))
    result, seen = render(case), there(render(case))
    eye = np.linalg.inv(case.camera.view_from_world)[:3, 3]
    distance = np.linalg.norm(result.pixels["position"] - eye, axis=2)
    expected = np.clip((distance - 3.5) / 2, 0, 1) ** power
    assert np.ptp(expected[seen]) > 0.3
    np.testing.assert_allclose(flat(result, "mist")[seen], expected[seen], atol=1e-5)
    assert (flat(result, "mist")[~seen] == 1).all()


def test_motion_is_in_pixels_from_now_to_before():
    """As Cycles has it: X, Y to where the point was a frame before; Z, W from where it will be, assumed alike."""
    case = solid_cases.moving()
    result = render(case)
    seen, owner = there(result), flat(result, "object_index").astype(int) - 1
    assert {0, 1} == set(owner[seen].tolist())
    camera, instances = case.camera, case.scene.instances
    assert instances.previous is not None
    assert camera.previous_view_from_world is not None
    before_from_now = instances.previous @ np.linalg.inv(instances.world_from_object)
    world = np.concatenate([result.pixels["position"], np.ones((*seen.shape, 1))], axis=2)[seen]
    moved = np.einsum("nab,nb->na", before_from_now[owner[seen]], world)
    clip = moved @ (camera.clip_from_view @ camera.previous_view_from_world).T
    before = (clip[:, :2] / clip[:, 3:] * 0.5 + 0.5) * camera.resolution
    y, x = np.nonzero(seen)
    expected = before - np.stack([x, y], axis=1) - 0.5
    vector = result.pixels["vector"]
    assert np.abs(expected).max() > 3
    np.testing.assert_allclose(vector[seen][:, :2], expected, atol=1e-3)
    np.testing.assert_array_equal(vector[..., :2], vector[..., 2:])
    assert not vector[~seen].any()


# Pixels, measured: 8.7e-6, 8.9e-6, 8.9e-6; EWA blends half floats, 3.1e-3.
MOTION = {"VISIBILITY": 1e-4, "IMAGE_SPACE": 1e-4, "PAINTER": 1e-4, "EWA": 5e-3}


@pytest.mark.parametrize("technique", MOTION)
def test_points_move_within_objects_that_move(technique):
    """A point that comes from p - v, in an object that comes from where it was, was a frame before where both say."""
    case = solid_cases.flowing()
    case = replace(case, settings=replace(case.settings, technique=technique))
    result = render(case)
    seen, owner = there(result), flat(result, "object_index").astype(int) - 1
    assert {0, 1, 2} == set(owner[seen].tolist())
    camera, instances, clouds = case.camera, case.scene.instances, [g.cloud for g in case.scene.geometries]
    assert instances.previous is not None
    assert camera.previous_view_from_world is not None
    velocity = np.array([np.zeros(3) if c is None or c.velocity is None else c.velocity[0] for c in clouds], float)
    world = np.concatenate([result.pixels["position"], np.ones((*seen.shape, 1))], axis=2)[seen]
    own = np.einsum("nab,nb->na", np.linalg.inv(instances.world_from_object)[owner[seen]], world)
    own[:, :3] -= velocity[instances.geometry][owner[seen]]
    moved = np.einsum("nab,nb->na", instances.previous[owner[seen]], own)
    clip = moved @ (camera.clip_from_view @ camera.previous_view_from_world).T
    before = (clip[:, :2] / clip[:, 3:] * 0.5 + 0.5) * camera.resolution
    y, x = np.nonzero(seen)
    expected = before - np.stack([x, y], axis=1) - 0.5
    assert np.abs(expected).max() > 3
    np.testing.assert_allclose(result.pixels["vector"][seen][:, :2], expected, atol=MOTION[technique])


def test_nothing_moves_where_nothing_is_said_to_move():
    result = render(solid_cases.mixed())
    assert np.abs(result.pixels["vector"]).max() < 1e-3


def test_a_border_moves_no_motion():
    case = solid_cases.moving()
    part = replace(case, camera=replace(case.camera, region=(5, 6, 20, 18)))
    whole, cropped = render(case).pixels["vector"][6:24, 5:25], render(part).pixels["vector"]
    same = (whole != 0).any(axis=2) & (cropped != 0).any(axis=2)
    np.testing.assert_allclose(cropped[same], whole[same], atol=1e-3)


def test_indices_are_the_instances_and_materials_own():
    case = solid_cases.mixed()
    indices = np.array([7, 32000], np.int32)
    table = build.materials(2, pass_index=[5, 30])
    block = case.scene.geometries[1]
    assert block.mesh is not None
    mesh = replace(block.mesh, key="second row", material=np.ones(12, np.uint16), materials=(1,))
    second = replace(block, key="second row", mesh=mesh)
    scene = replace(
        case.scene,
        geometries=(case.scene.geometries[0], second),
        materials=table,
        instances=replace(case.scene.instances, pass_index=indices),
    )
    result = render(replace(case, scene=scene))
    pairs = np.stack([flat(result, "object_index"), flat(result, "material_index")], axis=-1)
    assert set(map(tuple, pairs[there(result)].tolist())) == {(7.0, 5.0), (32000.0, 30.0)}
    assert not pairs[~there(result)].any()


def test_a_scene_without_indices_or_hashes_has_zeros():
    case = solid_cases.mixed()
    bare = replace(case.scene.instances, pass_index=None, object_hash=None)
    result = render(replace(case, scene=replace(case.scene, instances=bare)))
    assert not result.pixels["object_index"].any()
    assert not result.pixels["crypto_object00"].any()
    assert result.pixels["material_index"].any()


def test_cryptomatte_coverages_add_up_to_what_is_covered():
    case = solid_cases.mixed()
    hashes = np.array([cryptomatte_hash("Sphere"), cryptomatte_hash("Cube")], np.uint32)
    case = replace(
        case, scene=replace(case.scene, instances=replace(case.scene.instances, object_hash=hashes), transparent=True)
    )
    result = render(case, samples=8)
    ranks = np.concatenate([result.pixels[f"crypto_object{i:02d}"].reshape(40, 48, 2, 2) for i in range(3)], axis=2)
    identity, coverage = ranks[..., 0].copy().view(np.uint32), ranks[..., 1]
    np.testing.assert_allclose(coverage.sum(axis=2), result.pixels["combined"][..., 3], atol=1e-6)
    assert set(np.unique(identity[coverage > 0])) == set(hashes)
    assert (np.diff(coverage, axis=2) <= 0).all()
    assert ((coverage * 8) % 1 == 0).all()


# Samples


@pytest.mark.parametrize("name", ["mixed", "environment"])
def test_many_samples_are_the_mean_of_single_ones(name):
    """A sample `o` pixels beside the centre is a picture whose camera is shifted by `o` pixels."""
    case, samples = CASES[name](), 16
    case = replace(case, settings=replace(case.settings, use_adaptive_sampling=False))
    passes = frozenset({"combined", "normal", "diffuse_color", "mist"})
    together = render(case, passes, samples).pixels
    single = []
    for x, y in offsets(samples):
        clip = case.camera.clip_from_view.copy()
        clip[0, 2] += 2 * x / case.camera.resolution[0]
        clip[1, 2] += 2 * y / case.camera.resolution[1]
        single.append(render(replace(case, camera=replace(case.camera, clip_from_view=clip)), passes).pixels)
    for key in passes:
        mean = np.mean([p[key] for p in single], axis=0)
        assert np.abs(together[key] - mean).max() < 1e-6, key  # measured 0: the GPU sees the same numbers


def test_data_passes_are_those_of_the_pixels_centres():
    case = solid_cases.mixed()
    one, many = render(case).pixels, render(case, samples=4).pixels
    for key in ("depth", "position", "vector", "object_index", "material_index"):
        np.testing.assert_array_equal(one[key], many[key])


def test_a_render_is_repeatable():
    case = solid_cases.mixed()
    first, second = render(case, samples=3).pixels, render(case, samples=3).pixels
    for key in first:
        np.testing.assert_array_equal(first[key].view(np.uint32), second[key].view(np.uint32))


def test_cancelling_stops_between_samples_and_frees_the_frame():
    renderer, case, seen = drawing.opengl(), solid_cases.mixed(), []
    render(case)  # what stays for the next frame is there
    kept = renderer.device.bytes_allocated()
    result = renderer.render(
        case.scene,
        case.request(samples=50),
        progress=lambda fraction, text: seen.append(fraction),
        cancelled=lambda: len(seen) > 3,
    )
    assert result.cancelled
    assert result.pixels == {}
    assert len(seen) == 4
    assert renderer.device.bytes_allocated() == kept


def test_progress_rises_to_one():
    seen = []
    drawing.opengl().render(
        solid_cases.mixed().scene,
        solid_cases.mixed().request(samples=4),
        progress=lambda fraction, text: seen.append(fraction),
    )
    assert seen == [0.0, 0.25, 0.5, 0.75, 1.0]


def test_releasing_a_renderer_frees_everything():
    case = solid_cases.plain_sphere()

    def bytes_while_and_after():
        device = OpenGLDevice()
        renderer = Renderer(device, STORE)
        renderer.render(case.scene, case.request(frozenset({"combined"})))
        kept = device.bytes_allocated()
        renderer.release()
        left = device.bytes_allocated()
        device.release()
        return kept, left

    # A context of its own thread, since a new one takes the place of the one that the other tests draw with.
    with ThreadPoolExecutor(1) as thread:
        kept, left = thread.submit(bytes_while_and_after).result()
    assert kept > 0
    assert left == 0


@pytest.mark.parametrize("asked", sorted(ALL_PASSES))
def test_each_pass_can_be_asked_for_alone(asked):
    result = render(solid_cases.mixed(), frozenset({asked}))
    assert any(key.startswith(asked) for key in result.pixels)
