"""Boxes lie in the picture where the device draws what is in them, whatever it rounds."""

import numpy as np
import pytest

from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.render.frame.visibility.boxes_in_picture import places_in_picture
from pointsplat_addon.render.passes.uniforms import SampleView
from pointsplat_addon.render.passes.visibility.polygon_draw import MOST_RUNS, chunk_runs
from pointsplat_addon.render.passes.visibility.polygon_mesh import CHUNK, Group
from scripts.scenes import cameras

NEAR, FAR = 0.05, 1e4
VIEWS = {
    "perspective": cameras.camera(resolution=(96, 72), near=NEAR, far=FAR, shift=(0.2, -0.1)),
    "parallel": cameras.camera(resolution=(96, 72), near=NEAR, far=FAR, parallel=8.0),
}
COUNT, INSIDE = 400, 200


def sample_view(camera: Camera) -> SampleView:
    return SampleView(camera, camera.near, camera.far, (0.2, -0.3))


def turns(rng: np.random.Generator) -> np.ndarray:
    return np.linalg.qr(rng.normal(size=(COUNT, 3, 3)))[0] * rng.uniform(0.5, 2, (COUNT, 1, 1))


@pytest.mark.parametrize("size", [1.0, 1e4, 1e6])
@pytest.mark.parametrize("view", VIEWS)
def test_what_float32_makes_of_points_in_a_box_lies_in_its_rectangle(view, size):
    """Boxes about the eye and before it, of meshes `size` wide, whose terms cancel where they are near: float32 brings
    points by up to 0.2 elsewhere."""
    rng, camera = np.random.default_rng(3), VIEWS[view]
    low = rng.uniform(-size, size, (COUNT, 3))
    box = np.stack([low, low + rng.uniform(0, 2, (COUNT, 3))], axis=1)
    matrix = np.tile(np.eye(4), (COUNT, 1, 1))
    matrix[:, :3, :3] = turns(rng)
    middle = rng.normal(size=(COUNT, 3)) * (3, 3, 2) - (0, 0, 3)
    matrix[:, :3, 3] = middle - (matrix[:, :3, :3] @ low[..., None])[..., 0]
    rectangle, depth = places_in_picture(box, matrix, sample_view(camera))
    points = (box[:, None, 0] + rng.random((COUNT, INSIDE, 3)) * (box[:, 1] - box[:, 0])[:, None]).astype(np.float32)
    rows = matrix.astype(np.float32)
    p = np.repeat(rows[:, None, :3, 3], INSIDE, axis=1)
    for axis in range(3):
        p += rows[:, None, :3, axis] * points[..., axis : axis + 1]
    depths = -p[..., 2].astype(np.float64)
    drawn = (depths >= NEAR) & (depths <= FAR)
    assert (drawn.any(axis=1) & ~drawn.all(axis=1)).sum() > (20 if view == "perspective" else 10)
    assert ((depths >= depth[:, :1]) | ~drawn).all()
    pixels = p[..., :2].astype(np.float64) * camera.pixel_from_view()[:2]
    if camera.perspective:
        pixels /= np.where(drawn, depths, 1.0)[..., None]
    place = (pixels + sample_view(camera).principal_point) / (96, 72)
    seen = drawn & (place >= 0).all(axis=2) & (place <= 1).all(axis=2)
    assert seen.sum() > 1000
    found = (place >= rectangle[:, None, :2]).all(axis=2) & (place <= rectangle[:, None, 2:]).all(axis=2)
    assert found[seen].all()


def test_rectangles_are_no_wider_than_they_need_be():
    """Of unit cubes straight ahead, before the eye and across the near plane: within two pixels of closed forms."""
    camera = cameras.camera((0, 0, 0), (0, 1, 0), resolution=(96, 96), near=NEAR, far=FAR)
    matrix = np.tile(np.eye(4), (3, 1, 1))
    matrix[:, :3, 3] = (0, 0, -5), (0, 0, 5), (0.6, 0, 0)
    half = np.array([[-0.5] * 3, [0.5] * 3])
    rectangle, depth = places_in_picture(half, matrix, SampleView(camera, NEAR, FAR))
    share = 0.5 / 4.5 / np.tan(np.radians(20)) / 2
    np.testing.assert_allclose(rectangle[0], [0.5 - share, 0.5 - share, 0.5 + share, 0.5 + share], atol=2 / 96)
    np.testing.assert_allclose(depth[0], [4.5, 5.5], rtol=1e-4)
    assert (rectangle[1, 2:] <= rectangle[1, :2]).all()
    # From 0.1 to the right of the axis on, up to a depth of 0.5: no nearer to the axis than there.
    assert rectangle[2, 0] > 0.5 + 0.1 / 0.5 / np.tan(np.radians(20)) / 2 - 2 / 96
    assert depth[2, 0] == -np.inf


def test_chunks_are_drawn_in_few_runs():
    """Of every third and of random chunks of two materials, all are drawn, in at most so many runs, in order."""
    counts = 3 * (CHUNK * 900 - 7), 3 * CHUNK * 300
    boxes = [np.zeros((-(-count // (3 * CHUNK)), 2, 3)) for count in counts]
    groups = [Group(0, 0, counts[0], False, (), chunks=boxes[0])]
    groups.append(Group(1, counts[0], counts[1], False, (), chunks=boxes[1]))
    rng = np.random.default_rng(2)
    for chunks in (np.arange(0, 1200, 5), np.sort(rng.choice(1200, 150, replace=False)), np.array([899])):
        drawn = np.zeros(sum(counts), bool)
        for group in groups:
            runs = chunk_runs(groups, group, chunks)
            assert len(runs) <= MOST_RUNS
            for run in runs:
                assert group.first <= run.first
                assert run.first + run.count <= group.first + group.count
                assert not drawn[run.first :].any()
                drawn[run.first : run.first + run.count] = True
        starts = np.where(chunks < 900, 3 * CHUNK * chunks, counts[0] + 3 * CHUNK * (chunks - 900))
        assert drawn[starts].all()
        assert drawn[starts + 3].all()
