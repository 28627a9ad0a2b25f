"""Which flat meshes may have something behind them, seen from a lamp."""

import numpy as np
import pytest

from pointsplat_addon.core.scene.bounds import bounding_box
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.shadow.floor import (
    light_is_above,
    lowest_box_height,
    lowest_height,
    plane_of_mesh,
)
from scripts.scenes import build, meshes

UP = np.array([0.0, 0.0, 1.0])


def plane(mesh: Mesh) -> tuple[np.ndarray, np.ndarray] | None:
    return plane_of_mesh(mesh, *bounding_box(mesh.position))


def flat(key: str) -> Mesh:
    """A grid in XY."""
    mesh = meshes.plane_mesh(key, cells=5)
    return Mesh(key, key, np.ascontiguousarray(mesh.position[:, [0, 2, 1]]), mesh.triangles)


def turned(mesh: Mesh, normal: np.ndarray, offset: np.ndarray) -> Mesh:
    """A mesh whose z axis points along a unit normal."""
    side = np.cross(normal, [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    position = mesh.position @ np.stack([np.cross(side, normal), side, normal]) + offset
    return Mesh("turned", "turned", position.astype(np.float32), mesh.triangles)


def test_the_plane_of_a_flat_mesh_is_found_whatever_its_place():
    normal, offset = np.array([0.36, 0.48, 0.8]), np.array([5.0, -7.0, 2.0])
    found = plane(turned(flat("leaning floor"), normal, offset))
    assert found is not None
    point, along = found
    assert abs(along @ normal) == pytest.approx(1, abs=1e-6)  # measured 4e-14
    assert (point - offset) @ normal == pytest.approx(0, abs=1e-5)  # measured 7e-7, float32's


def test_what_is_not_flat_has_no_plane():
    bumpy = flat("bumpy floor")
    position = bumpy.position.copy()
    position[7, 2] += 1e-3
    assert plane(meshes.cube_mesh("no floor")) is None
    assert plane(Mesh("bumpy", "bumpy", position, bumpy.triangles)) is None
    assert plane(Mesh("none", "none", np.zeros((3, 3), np.float32), np.array([[0, 1, 2]], np.int32))) is None


@pytest.mark.parametrize("offset", [(5.0, -7.0, 2.0), (3000.0, 400.0, -50.0)])
def test_small_triangles_lie_in_one_plane_whatever_their_own_normals(offset):
    """Of 80,000 triangles, whose corners float32 moves by up to an eighth of their size."""
    grid = meshes.plane_mesh("fine floor", cells=200)
    fine = Mesh("fine", "fine", np.ascontiguousarray(grid.position[:, [0, 2, 1]]), grid.triangles)
    normal = np.array([0.36, 0.48, 0.8])
    found = plane(turned(fine, normal, np.array(offset)))
    assert found is not None
    assert abs(found[1] @ normal) == pytest.approx(1, abs=1e-6)  # measured 7e-10
    bumpy = fine.position.copy()
    bumpy[7, 2] += 1e-4
    assert plane(Mesh("fine and bumpy", "bumpy", bumpy, fine.triangles)) is None


@pytest.mark.parametrize(
    ("light", "above"),
    [
        (build.sun(direction=(0.5, 0, -1)), True),
        (build.sun(direction=(0.5, 0, 1)), False),
        (build.sun(direction=(1, 0, 0)), False),
        (Light("SUN", np.ones(3), np.zeros(3), np.array([0.6, 0, -0.8]), radius=0.9), True),  # 0.927 high
        (Light("SUN", np.ones(3), np.zeros(3), np.array([0.6, 0, -0.8]), radius=1.0), False),
        (Light("POINT", np.ones(3), np.array([9.0, 9.0, 1.5]), -UP, radius=0.4), True),
        (Light("POINT", np.ones(3), np.array([9.0, 9.0, 1.5]), -UP, radius=0.6), False),
        (Light("AREA", np.ones(3), np.array([0, 0, 2.0]), -UP, axis_u=3 * UP[[2, 0, 1]], axis_v=0.9 * UP), True),
        (Light("AREA", np.ones(3), np.array([0, 0, 2.0]), -UP, axis_u=3 * UP[[2, 0, 1]], axis_v=1.1 * UP), False),
    ],
)
def test_a_lamp_shines_from_above_where_all_of_it_is_above(light, above):
    assert light_is_above(light, UP, UP) == above  # a plane at height 1


def test_heights_of_boxes_are_below_those_of_what_they_hold():
    rng = np.random.default_rng(11)
    position = rng.normal(size=(50, 3))
    matrices = np.stack([build.moved(rng.normal(size=3), rng.uniform(0.5, 2)) for _ in range(4)])
    matrices[:, :3, :3] @= np.linalg.qr(rng.normal(size=(4, 3, 3)))[0]
    normal, point = np.array([0.36, 0.48, 0.8]), rng.normal(size=3)
    world = np.einsum("iab,nb->ina", matrices[:, :3, :3], position) + matrices[:, None, :3, 3]
    expected = ((world - point) @ normal).min()
    assert lowest_height(position, matrices, point, normal) == pytest.approx(expected, abs=1e-12)  # measured 9e-16
    assert lowest_box_height(position.min(axis=0), position.max(axis=0), matrices, point, normal) <= expected
    matrices[2, 0, 0] = np.nan
    assert not lowest_height(position, matrices, point, normal) >= 0
