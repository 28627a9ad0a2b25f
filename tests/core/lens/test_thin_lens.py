"""The thin lens against similar triangles: what a place on the aperture sees, and how far apart places see a point."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.lens.thin_lens import camera_through, circle_of_confusion, lens_points, widened_camera
from pointsplat_addon.core.scene.camera import Aperture, Camera
from pointsplat_addon.render.frame.sample_positions import offsets


def camera(parallel: bool = False, **aperture) -> Camera:
    """A camera of 300 x 200 pixels, shifted, turned and with a border, whose aperture is 0.3 wide and sharp at 4."""
    clip = np.diag([2.0, 3.0, -0.1 if parallel else -1.01, 1.0])
    clip[:2, 3 if parallel else 2] = 0.2, -0.3
    if not parallel:
        clip[2, 3], clip[3, 2:] = -0.2, (-1.0, 0.0)
    turn, _ = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))
    view = np.eye(4)
    view[:3, :3], view[:3, 3] = turn * np.sign(np.linalg.det(turn)), (3.0, -2.0, 1.0)
    values = {"radius": 0.3, "focus": 4.0, **aperture}
    return Camera(view, clip, (300, 200), (10, 20, 200, 150), 0.1, 100.0, aperture=Aperture(**values))


def pixels(camera: Camera, world: np.ndarray) -> np.ndarray:
    """(N, 2) places in the camera's window."""
    view = world @ camera.view_from_world[:3, :3].T + camera.view_from_world[:3, 3]
    fx, fy, cx, cy = camera.pixel_from_view()
    depth = -view[:, 2:] if camera.perspective else 1.0
    return np.array([cx, cy]) + np.array([fx, fy]) * view[:, :2] / depth


def at_depth(camera: Camera, depth: float) -> np.ndarray:
    """(40, 3) points in the world at this distance along the view."""
    view = np.random.default_rng(0).uniform(-2, 2, (40, 3))
    view[:, 2] = -depth
    return (view - camera.view_from_world[:3, 3]) @ camera.view_from_world[:3, :3]


PARALLEL = pytest.mark.parametrize("parallel", [False, True])


@PARALLEL
def test_what_is_in_focus_keeps_its_place_from_everywhere_on_the_lens(parallel):
    middle = camera(parallel)
    for point in lens_points(16, middle.aperture):
        moved = pixels(camera_through(middle, point), at_depth(middle, 4.0)) - pixels(middle, at_depth(middle, 4.0))
        assert np.abs(moved).max() < 1e-11  # measured 5e-13


@PARALLEL
@pytest.mark.parametrize("depth", [0.3, 2.0, 7.0, 1e5])
def test_seen_from_the_rim_a_point_lies_on_its_circle_of_confusion(parallel, depth):
    middle = camera(parallel)
    world = at_depth(middle, depth)
    for angle in np.linspace(0, 6, 7):
        rim = 0.3 * np.array([np.cos(angle), np.sin(angle)])
        moved = pixels(camera_through(middle, rim), world) - pixels(middle, world)
        # Pixels of this camera are as wide as high.
        found = np.hypot(*moved.T) / circle_of_confusion(middle, depth)
        assert np.abs(found - 1).max() < 1e-12  # measured 9e-15


def test_confusion_in_closed_form():
    focal = 300.0  # 2 * 300 / 2 pixels
    depth = np.array([0.5, 4.0, 8.0, np.inf])
    expected = focal * 0.3 * np.array([1 / 0.5 - 1 / 4, 0, 1 / 4 - 1 / 8, 1 / 4])
    np.testing.assert_allclose(circle_of_confusion(camera(), depth), expected, rtol=1e-12)
    np.testing.assert_allclose(
        circle_of_confusion(camera(True), depth[:3]), focal * 0.3 * np.array([7 / 8, 0, 1]), rtol=1e-12
    )


@PARALLEL
def test_confusion_of_what_has_no_sharp_picture(parallel):
    far = camera(parallel, focus=np.inf)
    if parallel:
        np.testing.assert_array_equal(circle_of_confusion(far, np.array([0.0, 1.0])), [90.0, 90.0])
    else:
        np.testing.assert_array_equal(circle_of_confusion(far, np.array([0.0, 1.0, np.inf])), [np.inf, 90.0, 0.0])
    assert circle_of_confusion(camera(parallel, radius=0.0), 0.0) == 0.0
    assert circle_of_confusion(replace(far, aperture=None), 0.0) == 0.0
    assert np.isfinite(circle_of_confusion(camera(parallel), -3.0))
    assert circle_of_confusion(camera(parallel), np.ones((3, 2))).shape == (3, 2)


@PARALLEL
def test_seen_from_the_lens_at_infinite_focus_everything_is_shifted(parallel):
    far = camera(parallel, focus=np.inf)
    seen = camera_through(far, np.array([0.1, -0.2]))
    moved = pixels(seen, at_depth(far, 2.0)) - pixels(far, at_depth(far, 2.0))
    expected = np.array([-0.1, 0.2]) * 300 / (1 if parallel else 2)
    np.testing.assert_allclose(moved, np.broadcast_to(expected, moved.shape), atol=1e-10)  # measured 6e-14


@PARALLEL
def test_the_middle_of_the_lens_is_the_camera_without_one(parallel):
    middle = camera(parallel)
    seen = camera_through(middle, lens_points(5, middle.aperture)[0])
    assert seen.view_from_world is middle.view_from_world
    assert seen.clip_from_view is middle.clip_from_view
    assert seen.aperture is None


def test_only_parallel_cameras_are_seen_askew_and_little():
    for parallel, most in ((False, 1e-12), (True, 0.3**2 / 4**2 / 2)):  # measured 4e-16, 2.4e-3
        middle = camera(parallel)
        for point in lens_points(64, middle.aperture):
            turn = camera_through(middle, point).view_from_world[:3, :3]
            assert np.abs(turn @ turn.T - np.eye(3)).max() <= most


@PARALLEL
def test_the_wide_picture_shows_what_any_place_of_the_lens_does(parallel):
    middle = camera(parallel)
    wide = widened_camera(middle, 1.0, 12.0)
    margin = (wide.window[2] - middle.window[2]) // 2
    assert margin > 0
    assert pixels(wide, at_depth(middle, 3.0)) - pixels(middle, at_depth(middle, 3.0)) == pytest.approx(margin)
    low, high = np.zeros(2), np.array(middle.window[2:])
    for depth in (1.0, 4.0, 12.0):
        for point in lens_points(64, middle.aperture):
            seen = pixels(camera_through(middle, point), at_depth(middle, depth))
            inside = ((seen >= low) & (seen <= high)).all(axis=1)
            place = pixels(wide, at_depth(middle, depth))[inside]
            assert (place >= 0).all()
            assert (place <= wide.window[2:]).all()


def test_the_wide_picture_is_bounded():
    assert widened_camera(camera(radius=1e6), 0.1, 100.0).resolution == (900, 800)
    pinhole = replace(camera(), aperture=None)
    assert widened_camera(pinhole, 0.1, 100.0) is pinhole


# Places on the aperture


def test_the_disk_is_filled_evenly():
    points = lens_points(4096, Aperture(2.0, 1.0))
    radius, angle = np.hypot(*points.T) / 2, np.arctan2(points[:, 1], points[:, 0])
    # Shares of the area within a radius, and of the turn.
    for values in (radius**2, angle / (2 * np.pi) + 0.5):
        rank = (np.arange(4096) + 0.5) / 4096
        assert np.abs(np.sort(values) - rank).max() < 4e-3  # measured 3.1e-3, of the first


def test_any_first_places_lie_around_the_middle():
    assert np.abs(lens_points(9, Aperture(1.0, 1.0))[0]).max() == 0
    for count in (3, 9, 17, 33, 65):
        points = lens_points(65, Aperture(1.0, 1.0))[:count]
        assert np.abs(points.mean(axis=0)).max() < 1e-12  # pairs face each other
        # A uniform disk has 1/4 along every axis.
        assert np.abs((points**2).mean(axis=0) - 0.25).max() < 0.9 / count  # measured 0.68 / 9


@pytest.mark.parametrize(("blades", "rotation"), [(3, 0.3), (4, 0.0), (5, 1.0), (6, -0.4), (16, 0.0)])
def test_polygons_are_filled_evenly_and_reach_their_corners(blades, rotation):
    points = lens_points(8193, Aperture(1.0, 1.0, blades, rotation))
    normals = rotation + 2 * np.pi * np.arange(blades) / blades
    across = points @ np.array([np.cos(normals), np.sin(normals)])
    edge = np.cos(np.pi / blades)
    assert across.max() <= edge + 1e-12
    side = across.argmax(axis=1)
    shares = np.bincount(side, minlength=blades) / len(points)
    assert np.abs(shares * blades - 1).max() < 0.02  # measured 0.0155 with 16 sides
    # Within s times the polygon's size lie s^2 of its places.
    size = np.sort(across.max(axis=1) / edge) ** 2
    assert np.abs(size - (np.arange(len(points)) + 0.5) / len(points)).max() < 4e-3  # measured 2.5e-3
    corners = normals + np.pi / blades
    assert (points @ np.array([np.cos(corners), np.sin(corners)])).max(axis=0).min() > 0.96  # measured 0.975


def test_an_anamorphic_aperture_is_narrower_by_its_ratio():
    round_one, oval = (lens_points(64, Aperture(0.5, 1.0, ratio=ratio)) for ratio in (1.0, 2.0))
    np.testing.assert_allclose(oval, round_one * [0.5, 1.0])


@pytest.mark.parametrize("count", [3, 4, 8, 16, 17, 256])
def test_places_lie_around_the_middle_of_a_round_aperture_and_within_it(count):
    places = lens_points(count, Aperture(1.0, 1.0))
    assert np.hypot(*places.mean(axis=0)) < 0.02  # measured 0.0149 of four, one of which is on the rim
    assert np.hypot(*places.T).max() <= 1 + 1e-12


def test_a_blurred_edge_converges_faster_than_random_samples_would():
    """Half-planes at all angles, blurred by 1.5 to 30 pixels, seen by pixels at all places of the blur. Places in the
    pixel and on the lens belong together: were they alike, the error would stay at 2 %."""
    rng = np.random.default_rng(5)
    angle, blur = rng.uniform(0, 2 * np.pi, 1500), np.exp(rng.uniform(np.log(1.5), np.log(30), 1500))
    normal, edge = np.array([np.cos(angle), np.sin(angle)]), 0.95 * rng.uniform(-1, 1, 1500) * blur

    def seen(count: int) -> np.ndarray:
        return (offsets(count, 0.75) @ normal + lens_points(count, Aperture(1.0, 1.0)) @ normal * blur < edge).mean(
            axis=0
        )

    # Share of a disk on one side of a chord, for each place in the pixel.
    chord = np.clip((edge - offsets(4096, 0.75) @ normal) / blur, -1, 1)
    exact = (0.5 + (chord * np.sqrt(1 - chord**2) + np.arcsin(chord)) / np.pi).mean(axis=0)
    errors = [np.sqrt(((seen(count) - exact) ** 2).mean()) for count in (16, 64, 256)]
    assert np.less(errors, (0.06, 0.021, 0.009)).all()  # measured 0.050, 0.018, 0.0075; random ones have 0.108 to 0.037
    assert errors[2] < errors[0] / 16**0.6  # measured 16^0.68
