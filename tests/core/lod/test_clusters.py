"""Meshes whose vertices are merged cell by cell."""

from dataclasses import replace

import numpy as np

from pointsplat_addon.core.lod.nodes.clusters import area, clustered
from scripts.scenes.meshes import plane_mesh, sphere_mesh


def test_a_sphere_stays_within_a_cell_and_is_closed():
    """Radii of the means of vertices, in cells of 0.1: 0.998 of the sphere's at the least, the area 1.01 of it."""
    mesh = sphere_mesh("sphere", 96)
    found = clustered(mesh, 0.1)
    radius = np.linalg.norm(found.position, axis=1)
    assert len(found.triangles) < len(mesh.triangles) / 8
    assert radius.min() > 0.995
    assert radius.max() <= 1 + 1e-6
    assert abs(area(found) / area(mesh) - 1) < 0.02
    edges = np.sort(found.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, uses = np.unique(edges, axis=0, return_counts=True)
    assert (uses % 2 == 0).all()


def test_each_cell_has_the_mean_of_its_vertices():
    mesh = sphere_mesh("sphere", 40)
    found = clustered(mesh, 0.23)
    cell = np.floor((mesh.position - mesh.position.min(axis=0)) / 0.23).astype(int) @ [1, 100, 10_000]
    expected = np.array([mesh.position[cell == one].mean(axis=0) for one in np.unique(cell)])
    assert len(found.position) == len(expected)
    order = [np.lexsort(np.round(at, 4).T) for at in (found.position, expected)]
    np.testing.assert_allclose(found.position[order[0]], expected[order[1]], atol=1e-6)


def test_vertices_that_are_alone_stay_and_materials_go_with_triangles():
    mesh = plane_mesh("plane", 1.0, 8)
    rows = (np.arange(len(mesh.triangles)) % 2).astype(np.uint16)
    mesh = replace(mesh, material=rows, materials=(0, 1))
    found = clustered(mesh, 1e-3)
    corners = np.sort(found.position[found.triangles].reshape(len(mesh.triangles), -1), axis=0)
    np.testing.assert_array_equal(corners, np.sort(mesh.position[mesh.triangles].reshape(len(corners), -1), axis=0))
    assert found.material is not None
    np.testing.assert_array_equal(found.material, rows)
    assert len(clustered(mesh, 100.0).triangles) == 0


def test_area_by_some_triangles():
    """Of a plane all triangles are alike."""
    mesh = plane_mesh("plane", 1.0, 64)
    assert abs(area(mesh, np.arange(0, len(mesh.triangles), 8)) / area(mesh) - 1) < 1e-6
