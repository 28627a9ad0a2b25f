"""Which meshes bound bodies, though they have gaps."""

import numpy as np
import pytest

from pointsplat_addon.core.indirect.closed import is_closed, is_inside_out, is_solid, winding_number
from pointsplat_addon.core.scene.mesh import Mesh
from scripts.scenes.meshes import flat_mesh, shape, sphere_mesh


def leaves(count: int, *, sheets: int, flat: bool) -> Mesh:
    """Squares at random, or pairs of them that look away from each other; flat: all turned upwards."""
    rng = np.random.default_rng(2)
    middle, turned = rng.uniform(-1, 1, (count, 1, 3)), rng.normal(size=(count, 3))
    up = np.broadcast_to([0.0, 0.0, 1.0], turned.shape) if flat else turned
    up = up / np.linalg.norm(up, axis=1, keepdims=True)
    across = np.cross(up, rng.normal(size=(count, 3)))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    other = np.cross(up, across)
    square = middle + 0.02 * np.stack([-across - other, across - other, across + other, other - across], axis=1)
    corners = [square + (0.001 if sheets == 2 else 0) * up[:, None], square - 0.001 * up[:, None]][:sheets]
    first = 4 * np.arange(count)[:, None]
    triangles = np.concatenate([first + np.array(corner) for corner in ((0, 1, 2), (0, 2, 3))])
    every = [triangles, triangles[:, ::-1] + 4 * count][:sheets]
    return flat_mesh("leaves", np.concatenate(corners).reshape(-1, 3).astype(np.float32), np.concatenate(every))


@pytest.mark.parametrize("flat", [False, True])
def test_pairs_of_sheets_are_solid_and_single_ones_are_not(flat):
    double, single = (leaves(5000, sheets=sheets, flat=flat) for sheets in (2, 1))
    assert not is_closed(double)
    assert is_solid(double)
    assert not is_solid(single)


def test_a_ball_with_a_hole_is_solid_and_half_of_one_is_not():
    ball = sphere_mesh("ball", 24)
    middle = ball.position[ball.triangles].mean(axis=1)
    assert is_solid(ball)
    assert is_solid(flat_mesh("hole", ball.position, ball.triangles[middle[:, 0] < 0.9]))
    assert not is_solid(flat_mesh("half", ball.position, ball.triangles[middle[:, 0] < 0]))
    assert not is_solid(flat_mesh("nothing", ball.position[:0], ball.triangles[:0]))


@pytest.mark.parametrize("inwards", [False, True])
def test_which_way_closed_meshes_look_and_what_is_inside(inwards):
    """A ball and a doughnut of triangles far from the origin, of which one is mirrored. Worst: 5e-12."""
    middle = np.array([1000.0, -200.0, 30.0])
    for of in (sphere_mesh("ball", 24), shape("torus")):
        triangles = of.triangles[:, ::-1] if inwards else of.triangles
        closed = flat_mesh("closed", (of.position + middle).astype(np.float32), triangles)
        assert is_closed(closed)
        assert is_inside_out(closed) == inwards
        inside, outside = (0.8, 0.0, 0.1), (0.0, 0.0, 1.2)
        found = winding_number(closed, middle + np.array([inside, outside, (7.0, 0.0, 0.0)]))
        np.testing.assert_allclose(found, [-1 if inwards else 1, 0, 0], atol=1e-9)


def test_pairs_of_sheets_are_not_inside_out():
    """What lies between them is nothing."""
    assert not is_inside_out(leaves(5000, sheets=2, flat=False))
