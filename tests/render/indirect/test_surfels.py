"""Surfels of a scene: of single instances and of many that share samples, turned, mirrored and sheared."""

import numpy as np
import pytest

from pointsplat_addon.core.indirect.surfels import Surfels
from pointsplat_addon.core.indirect.surfels import joined as joined_surfels
from pointsplat_addon.render.cache.store import Store
from pointsplat_addon.render.indirect.bake import bounce_receivers
from pointsplat_addon.render.indirect.surfels import MANY_INSTANCES, scene_density, scene_surfels
from scripts.scenes import build, cameras, meshes


def made(*things) -> Surfels:
    eye = cameras.camera((0.4, -6.0, 0.8))
    scene, store = build.scene(*things), Store()
    found = scene_surfels(scene, *scene_density(scene, eye, store), store, lambda: None)
    assert found is not None
    return found


def transforms(count: int) -> np.ndarray:
    """(count, 4, 4): every other one mirrors."""
    rng = np.random.default_rng(2)
    found = np.tile(np.eye(4), (count, 1, 1))
    sheared = np.eye(3) + rng.uniform(-0.2, 0.2, (count, 3, 3))
    found[:, :3, :3] = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0] @ sheared
    found[:, :3, 3] = rng.uniform(-2, 2, (count, 3))
    mirrors = np.linalg.det(found[:, :3, :3]) < 0
    found[mirrors == (np.arange(count) % 2 == 0), :3, 0] *= -1
    return found


@pytest.mark.parametrize("count", [1, 2, MANY_INSTANCES + 4])
def test_surfels_bound_the_volume_of_their_bodies(count):
    """By the divergence theorem, sums of area times normal are 0, and of that times position three times the volume,
    whose sign mirrors keep. Worst: 6.5e-9 of the area, 1e-7 of the volume."""
    body = meshes.cube_mesh("cube of many", 0.5)
    cube = build.mesh(body, "POLYGONS")
    matrices = transforms(count)
    surfels = made(*((cube, matrix) for matrix in matrices))
    weighted = surfels.area[:, None].astype(float) * surfels.normal
    assert np.abs(weighted.sum(axis=0)).max() < 1e-7 * surfels.area.sum()
    volume = np.abs(np.linalg.det(matrices[:, :3, :3])).sum() * np.ptp(body.position[:, 0]) ** 3
    assert abs((weighted * surfels.position).sum() / (3 * volume) - 1) < 1e-6
    assert surfels.closed.all()


def test_balls_keep_their_whole_surface():
    """As many as there are, or fewer that stand for them; under a uniform scale. Worst: 1.2e-7."""
    position = np.random.default_rng(1).uniform(-1, 1, (5000, 3)).astype(np.float32)
    cloud = build.PointCloud(position, radii=np.full((5000, 1), 0.004, np.float32))
    surfels = made((build.points("many small balls", cloud), build.moved(scale=2.0)))
    assert len(surfels) < 2500
    np.testing.assert_allclose(surfels.area.sum(dtype=float), 5000 * 4 * np.pi * 0.008**2, rtol=1e-6)


def scattered_pieces(position: np.ndarray, normal: np.ndarray, size: np.ndarray) -> Surfels:
    count, f = len(position), np.float32
    no, none = np.zeros(count, bool), np.zeros((count, 3), f)
    normals = np.broadcast_to(normal, (count, 3)).astype(f)
    area = (size * size).astype(f)
    return Surfels(np.zeros(3), position.astype(f), normals, area, no, no, none + f(0.5), none, none, no)


def test_pieces_of_fine_meshes_leave_receivers_to_floors():
    """A floor of 1,600 surfels, and 60,000 pieces of a hundredth of their area at most: of 1,116 receivers the floor
    has 576; where pieces are told apart, 1 of 1,258."""
    rng = np.random.default_rng(7)
    at = 0.1 * np.stack(np.meshgrid(np.arange(40), np.arange(40)), axis=-1).reshape(-1, 2)
    floor = scattered_pieces(np.column_stack([at, 0 * at[:, :1]]), np.array([0, 0, 1]), np.full(1600, 0.1))
    normal = rng.normal(size=(60000, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    size = 0.01 * np.exp2(-6 * rng.uniform(size=60000))
    surfels = joined_surfels([floor, scattered_pieces(rng.uniform(1, 1.4, (60000, 3)), normal, size)])
    rows = [bounce_receivers(surfels, 3000, np.full(len(surfels), apart)).rows for apart in (0.0, 0.1)]
    assert np.count_nonzero(rows[0] < 1600) < 20
    assert np.count_nonzero(rows[1] < 1600) > 500
