"""Samples for light: their areas add up to the mesh, they lie on it, and are as far apart as they are asked to be."""

import numpy as np
import pytest

from pointsplat_addon.core.indirect.closed import is_closed
from pointsplat_addon.core.indirect.sampling import light_samples
from pointsplat_addon.core.surface.triangles import triangle_areas
from scripts.scenes import meshes


def even(apart: float):
    return lambda place: (np.full(place.shape[1], apart), np.full(place.shape[1], np.inf))


def from_eye(eye: np.ndarray, share: float):
    def spacing(place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        away = np.linalg.norm(place - eye[:, None], axis=0)
        return share * away, away

    return spacing


@pytest.mark.parametrize("mesh", [meshes.cube_mesh("cube"), meshes.sphere_mesh("sphere", 64)], ids=["cube", "sphere"])
@pytest.mark.parametrize("apart", [0.5, 0.1, 0.03, 0.01])
def test_areas_add_up_and_lie_on_the_mesh(mesh, apart):
    """Worst: 4e-16 of the area; a tenth of a spacing from the surface, where triangles are taken together."""
    made = light_samples(mesh, even(apart))
    whole = triangle_areas(mesh, np.arange(len(mesh.triangles))).sum()
    assert abs(made.area.sum() / whole - 1) < 1e-12
    assert np.allclose(np.linalg.norm(made.normal, axis=1), 1)
    number = whole / apart**2
    assert min(number, len(mesh.triangles)) * 0.4 < len(made.area) < 4 * number + len(mesh.triangles)
    half = np.abs(mesh.position).max()
    if mesh.name == "cube":
        off = np.abs(np.abs(made.position).max(axis=1) - half)
    else:
        off = np.abs(np.linalg.norm(made.position, axis=1) - half)
    assert off.max() < 0.15 * apart


def test_samples_are_denser_near_the_eye():
    """A floor seen from a height of 1: at the distance r, samples are r / 20 apart. Found: 0.56 to 1.19 of that."""
    mesh, eye = meshes.plane_mesh("floor", 20.0), np.array([0.0, -1.0, 0.0])
    made = light_samples(mesh, from_eye(eye, 0.05))
    assert abs(made.area.sum() / 1600 - 1) < 1e-12
    away = np.linalg.norm(made.position - eye, axis=1)
    ratio = np.sqrt(made.area) / (0.05 * away)
    assert ratio.min() > 0.5
    assert ratio.max() < 1.2


def test_pieces_of_triangles_tile_them():
    """Rectangles, and a triangle at the end of each row: their areas and first moments are those of what they cover.
    Worst: 2e-15."""
    mesh = meshes.plane_mesh("tiled floor", 1.0)
    made = light_samples(mesh, even(0.07))
    along = np.linalg.norm(made.edge, axis=1)
    across = made.area * np.where(made.half, 2, 1) / along
    assert (along > 0).all()
    np.testing.assert_allclose(along, across, rtol=1e-9)  # both triangles of the plane have equal legs
    other = np.cross(made.normal, made.edge) * (across / along)[:, None]
    corner = made.position - np.where(made.half, 1 / 3, 1 / 2)[:, None] * (made.edge + other)
    far = [corner, corner + made.edge, corner + other, corner + np.where(made.half[:, None], 0, made.edge + other)]
    assert np.abs(np.concatenate(far)).max() < 1 + 1e-9
    squares = (made.area[:, None] * made.position).sum(axis=0)
    assert np.abs(squares).max() < 1e-12


def test_closed_meshes_are_known():
    cube = meshes.cube_mesh("cube")
    assert is_closed(cube)
    assert not is_closed(meshes.plane_mesh("plane"))
    assert not is_closed(cube.take(np.arange(11)))
    turned = cube.triangles.copy()
    turned[0] = turned[0, ::-1]
    assert not is_closed(type(cube)("turned", "turned", cube.position, turned))
    apart = type(cube)(
        "apart", "apart", cube.position[cube.triangles.ravel()], np.arange(36, dtype=np.int32).reshape(12, 3)
    )
    assert is_closed(apart)
