"""Which meshes bound bodies, though they have gaps."""

import numpy as np
import pytest

from pointsplat_addon.core.indirect.closed import is_closed, is_solid
from pointsplat_addon.core.scene.mesh import Mesh
from scripts.scenes.meshes import flat_mesh, sphere_mesh


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
