"""Which segments a view draws: what is known of a whole geometry against what is found segment by segment."""

from __future__ import annotations

from dataclasses import fields
from unittest import mock

import numpy as np
import pytest

from pointsplat_addon.core.scene.strands import Strands
from pointsplat_addon.core.strand import levels, projection, selection
from pointsplat_addon.core.strand.preparation import with_levels
from pointsplat_addon.core.strand.segments import Segments
from pointsplat_addon.core.strand.selection import select
from scripts.scenes import build, cameras

CAMERA = cameras.camera((0, -4, 0), resolution=(200, 160))
WIDE = cameras.camera((0, -1.6, 0), resolution=(200, 160), field_of_view=130)
PARALLEL = cameras.camera((0, -4, 0), resolution=(200, 160), parallel=3.0)


def tuft(points: int, length: float, radius: float, ribbon: bool, count: int = 300) -> levels.StrandLevels:
    """Straight strands of chance directions that begin in a cube of half a unit."""
    random = np.random.default_rng(4)
    root = random.uniform(-0.25, 0.25, (count, 1, 3))
    toward = random.normal(size=(count, 1, 3))
    toward *= length / np.linalg.norm(toward, axis=2, keepdims=True)
    position = (root + np.linspace(0, 1, points)[:, None] * toward).reshape(-1, 3).astype(np.float32)
    normal = random.normal(size=(len(position), 3)).astype(np.float32) if ribbon else None
    start = np.arange(count + 1) * points
    widths = np.full(len(position), radius, np.float32)
    return with_levels(Strands("tuft", "tuft", position, start, widths, normal=normal))


def views() -> list[np.ndarray]:
    """view_from_object matrices of a tuft within the picture, across each border, outside it, at the eye and beyond."""
    places = [(0, 0, 0), (1.3, 0, 0), (0, 0, -1.1), (2.2, 0, 0), (0, 0, 2), (0, -3.9, 0), (0, -5, 0), (0, 200, 0)]
    found = []
    for k, place in enumerate(places):
        matrix = build.moved(place, (1.2, 0.7, 1 + 0.1 * k))
        matrix[:3, :3] @= np.linalg.qr(np.random.default_rng(k).normal(size=(3, 3)))[0]
        found.append(matrix)
    return found


def same(a: Segments, b: Segments) -> bool:
    return all(np.array_equal(getattr(a, f.name), getattr(b, f.name)) for f in fields(Segments))


@pytest.mark.parametrize("camera", [CAMERA, PARALLEL], ids=["perspective", "parallel"])
@pytest.mark.parametrize("ribbon", [False, True])
@pytest.mark.parametrize("points", [2, 9])
def test_what_a_ball_tells_leaves_out_nothing_that_is_seen(camera, ribbon, points):
    strands = tuft(points, 0.4, 0.002, ribbon)
    empty = 0
    for world in views():
        view = camera.view_from_world @ world
        with mock.patch.object(selection, "_all_outlined", return_value=False):
            found = select(strands, view, 3, camera, 1.0)
            with mock.patch.object(selection, "_scale", return_value=selection._Scale(0.0, np.inf, False)):
                assert same(found, select(strands, view, 3, camera, 1.0))
        empty += len(found) == 0
    assert 2 <= empty < len(views())


@pytest.mark.parametrize("camera", [CAMERA, WIDE, PARALLEL], ids=["perspective", "wide", "parallel"])
def test_the_scale_of_a_whole_bounds_that_of_each_segment(camera):
    strands = tuft(2, 0.4, 0.002, True)
    steps = np.linalg.norm(np.diff(strands.position, axis=0), axis=1)[::2]
    for world in views()[:3]:
        view = camera.view_from_world @ world
        scale = selection._scale(strands.bounds, view, camera)
        picture = projection.project(strands, view, camera)
        assert scale is not None
        assert (picture.length[::2] <= scale.most * steps * (1 + 1e-5)).all()
        assert (picture.width <= 2 * scale.most * strands.radius * (1 + 1e-5)).all()
        assert scale.least < scale.most


def test_short_strands_of_few_points_are_drawn_whole():
    strands = tuft(2, 0.05, 0.004, True)  # 3 pixels by half of one
    view = CAMERA.view_from_world
    found = select(strands, view, 5, CAMERA, 1.0)
    assert len(found) == found.strands == 300
    assert len(found.narrow) == 300
    assert (found.instance == 5).all()
    np.testing.assert_array_equal(found.ends, np.arange(600).reshape(-1, 2))
    # Not where they are thinner, longer, or of many points
    for other in (tuft(2, 0.05, 0.0005, True), tuft(2, 0.5, 0.004, True), tuft(9, 0.05, 0.004, True)):
        scale = selection._scale(other.bounds, view, CAMERA)
        assert scale is not None
        assert not selection._all_outlined(other, scale)


def test_a_short_thin_strand_has_its_outline_and_a_long_one_is_a_line_of_one_pixel():
    focal = CAMERA.pixel_from_view()[0]
    pixel = 4 / focal
    for length, width, thin in ((10, 0.5, 0), (10, 0.1, 1), (40, 0.5, 1)):
        position = np.array([[0, 0, 0], [length * pixel, 0, 0]], np.float32)
        radius = np.full(2, 0.5 * width * pixel, np.float32)
        strands = with_levels(Strands("one", "one", position, np.array([0, 2]), radius))
        found = select(strands, CAMERA.view_from_world, 0, CAMERA, 1.0)
        assert (len(found.thin), len(found.narrow)) == (thin, 1 - thin)


def test_a_geometry_without_strands_has_no_segments():
    none = with_levels(
        Strands("none", "none", np.zeros((0, 3), np.float32), np.zeros(1, np.int64), np.zeros(0, np.float32))
    )
    assert len(select(none, CAMERA.view_from_world, 0, CAMERA, 1.0)) == 0
