"""Voxels within closed meshes, against volumes and lengths in closed form."""

import numpy as np
import pytest

from pointsplat_addon.core.volume.filling import CELLS, LEAST, Filling, fill_mesh

UNIT = np.ones(3)


def box() -> tuple[np.ndarray, np.ndarray]:
    """The unit cube: vertices (8, 3) and outward triangles (12, 3)."""
    vertices = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    quads = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
    return vertices, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def ball(rings: int) -> tuple[np.ndarray, np.ndarray]:
    """A sphere of radius 1: vertices and outward triangles."""
    polar, turn = np.meshgrid(
        np.linspace(0, np.pi, rings), np.linspace(0, 2 * np.pi, 2 * rings, endpoint=False), indexing="ij"
    )
    vertices = np.stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], axis=-1)
    i, j = np.arange(rings - 1)[:, None], np.arange(2 * rings)[None]
    k = (j + 1) % (2 * rings)
    a, b, c, d = i * 2 * rings + j, (i + 1) * 2 * rings + j, (i + 1) * 2 * rings + k, i * 2 * rings + k
    triangles = [np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))]
    return vertices.reshape(-1, 3), np.concatenate(triangles)


def turned(seed: int) -> np.ndarray:
    return np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]


def volume(filling: Filling) -> float:
    return float(filling.share.sum(dtype=float) * np.linalg.det(filling.object_from_index[:3, :3]))


@pytest.mark.parametrize("size", [(1.0, 1.0, 1.0), (3.0, 2.0, 0.01), (1e-6, 2e-6, 1e-6), (1e7, 1e7, 1e6)])
def test_a_box_along_the_axes_is_full_to_its_faces(size):
    vertices, triangles = box()
    filling = fill_mesh(vertices * size + 7.0 * np.array(size), triangles, UNIT)
    assert filling.closed
    assert (filling.share == 1).all()
    assert volume(filling) == pytest.approx(np.prod(size), rel=1e-9)  # measured 3.7e-15
    low = filling.object_from_index[:3, :3] @ filling.index.min(axis=0) + filling.object_from_index[:3, 3]
    np.testing.assert_allclose(low, 7.0 * np.array(size) + np.diag(filling.object_from_index)[:3] / 2, rtol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_turned_boxes_have_their_volume(seed):
    vertices, triangles = box()
    filling = fill_mesh(vertices @ turned(seed).T, triangles, UNIT)
    assert filling.closed
    assert volume(filling) == pytest.approx(1, abs=2e-5)  # measured 4.3e-6


def test_shares_of_a_balls_voxels_are_those_of_many_points():
    vertices, triangles = ball(400)
    filling = fill_mesh(vertices, triangles, UNIT, cells=24**3)
    assert volume(filling) == pytest.approx(4 / 3 * np.pi, rel=2e-4)  # measured 8.6e-5, the mesh itself 2.6e-5
    part = (np.arange(16) + 0.5) / 16 - 0.5
    offset = np.stack(np.meshgrid(part, part, part, indexing="ij"), axis=-1).reshape(-1, 3)
    step = np.diag(filling.object_from_index)[:3]
    centre = filling.index * step + filling.object_from_index[:3, 3]
    inside = []
    for some in np.array_split(centre, 200):  # so many points at once as a processor's cache holds
        square = sum((some[:, None, axis] + offset[:, axis] * step[axis]) ** 2 for axis in range(3))
        inside.append((square < 1).mean(axis=1))
    error = filling.share - np.concatenate(inside)
    assert np.sqrt((error**2).mean()) < 0.02  # measured 0.0137
    assert np.abs(error).max() < 0.12  # measured 0.093


def test_triangles_may_all_face_inwards_and_solids_overlap():
    vertices, triangles = box()
    tilted = vertices @ turned(5).T
    once = fill_mesh(tilted, triangles, UNIT)
    np.testing.assert_array_equal(fill_mesh(tilted, triangles[:, ::-1], UNIT).share, once.share)
    both = np.concatenate([vertices, vertices + np.array([0.5, 0.0, 0.0])])
    filling = fill_mesh(both, np.concatenate([triangles, triangles + 8]), UNIT)
    assert volume(filling) == pytest.approx(1.5, rel=1e-9)  # measured 4.4e-16
    # A hole: the inner box faces inwards.
    hollow = fill_mesh(
        np.concatenate([vertices, 0.25 + vertices / 2]), np.concatenate([triangles, triangles[:, ::-1] + 8]), UNIT
    )
    assert volume(hollow) == pytest.approx(1 - 1 / 8, rel=1e-9)  # measured 2.2e-16


def test_lines_that_leave_a_mesh_open_are_left_out_and_that_is_said():
    vertices, triangles = box()
    lid = (vertices[triangles][..., 2] == 1).all(axis=1)
    open_box = fill_mesh(vertices, triangles[~lid], UNIT)
    assert not open_box.closed
    assert len(open_box.index) == 0
    half = fill_mesh(vertices, np.delete(triangles, np.flatnonzero(lid)[0], axis=0), UNIT)
    assert not half.closed
    assert volume(half) == pytest.approx(0.5, abs=0.01)  # measured 0.0015


def test_a_mesh_without_an_inside_has_no_voxels():
    vertices, triangles = box()
    for flat in (vertices * [1, 1, 0], vertices * np.nan):
        assert len(fill_mesh(flat, triangles, UNIT).index) == 0
    assert len(fill_mesh(vertices, np.zeros((0, 3), int), UNIT).index) == 0


def test_voxels_are_cubes_where_the_scale_says_so_and_as_long_as_asked():
    vertices, triangles = box()
    filling = fill_mesh(vertices, triangles, np.array([4.0, 2.0, 1.0]))
    step = np.diag(filling.object_from_index)[:3] * [4, 2, 1]
    assert np.ptp(step) < 0.03 * step.max()  # measured 0.012
    assert CELLS * 0.9 < len(filling.index) < CELLS * 1.1
    filling = fill_mesh(vertices, triangles, UNIT, edge=0.1)
    assert len(filling.index) == 1000
    thin = fill_mesh(vertices * [1, 1, 1e-4], triangles, UNIT)
    assert np.ptp(thin.index[:, 2]) + 1 == LEAST
    assert len(thin.index) < CELLS * 1.1
