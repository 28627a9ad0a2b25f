"""Which points of a mesh cast its shadow."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.materials import default_materials
from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.scene.valid.geometry import valid_mesh
from pointsplat_addon.core.shadow.samples import (
    FEW_TRIANGLES,
    SURFACE_POINTS,
    MeshExtents,
    caster_clouds,
    mesh_extents,
    surface_points,
)
from pointsplat_addon.core.surface.area_sampling import sample_area
from pointsplat_addon.core.surface.evaluation import evaluate
from pointsplat_addon.core.surface.sampling import choose_method

STEPS = 300  # squares along a side: more than MANY triangles
SIDE = 1 / STEPS
TABLE = default_materials()


def sheet(steps: int = STEPS, corner: float = 0.0) -> Mesh:
    """The unit square in XY as steps^2 squares, two triangles each; and, `corner` long, a triangle beside it."""
    x, y = (a.ravel() for a in np.meshgrid(*2 * [np.linspace(0, 1, steps + 1)], indexing="ij"))
    low = (np.arange(steps)[:, None] * (steps + 1) + np.arange(steps)).ravel()
    triangles = np.concatenate([[low, low + steps + 1, low + 1], [low + 1, low + steps + 1, low + steps + 2]], axis=1).T
    position = np.stack([x, y, np.zeros_like(x)], axis=1)
    if corner:
        triangles = np.append(triangles, len(position) + np.arange(3)[None], axis=0)
        position = np.append(position, [2, 0, 0] + corner * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]]), axis=0)
    return Mesh("sheet", "sheet", position.astype(np.float32), triangles.astype(np.int32))


def radii(cloud: PointCloud) -> np.ndarray:
    assert cloud.radii is not None
    return cloud.radii


def shape(mesh: Mesh) -> MeshExtents:
    return mesh_extents(mesh)


def test_an_outline_leaves_out_what_is_no_triangle():
    mesh = sheet(4)
    position = np.append(mesh.position, [[np.nan, 0, 0], [9, 9, 9]], axis=0).astype(np.float32)
    last = len(position) - 1
    bad = np.array([[0, 1, last - 1], [last, last, last]], np.int32)
    whole = replace(mesh, position=position, triangles=np.append(mesh.triangles, bad, axis=0))
    found = shape(valid_mesh(whole)[0])
    assert found.size == pytest.approx(1, rel=1e-6)
    assert (found.low == [0, 0, 0]).all()
    assert (found.high == [1, 1, 0]).all()
    assert found.longest == pytest.approx(np.full(32, np.sqrt(2) / 4), rel=1e-6)


def test_places_are_spread_evenly_whatever_the_triangles():
    mesh = sheet(50, corner=np.sqrt(2))  # a triangle of the same area as the sheet
    found = surface_points(mesh, shape(mesh))
    left = found[:, 0] < 1.5
    assert abs(left.sum() - SURFACE_POINTS / 2) <= 1
    # measured 0.0034 of a sheet of side 1
    assert np.abs(found[left].mean(axis=0) - [0.5, 0.5, 0]).max() < 0.01
    assert np.abs(found[~left].mean(axis=0) - [2 + np.sqrt(2) / 3, np.sqrt(2) / 3, 0]).max() < 0.01
    assert (found[~left, 0] - 2 + found[~left, 1]).max() <= np.sqrt(2) * (1 + 1e-6)


def test_a_mesh_without_triangles_has_one_place():
    mesh = Mesh("none", "none", np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32))
    assert surface_points(mesh, shape(mesh)).tolist() == [[0, 0, 0]]


def test_many_small_triangles_cast_from_their_vertices():
    mesh = sheet()
    assert len(mesh.triangles) >= FEW_TRIANGLES
    # The diagonals are longer than one sample serves.
    spacing = np.sqrt(2) * SIDE / 1.2
    (cloud,) = caster_clouds(mesh, shape(mesh), spacing, TABLE)
    assert choose_method(mesh, spacing) == "AREA"
    assert len(cloud) == len(mesh.position)
    area = evaluate(mesh, sample_area(mesh, spacing))
    assert len(area.position) >= 1.9 * len(cloud)
    # As fine as samples at the spacing are promised to be.
    assert radii(cloud).max() <= spacing / np.sqrt(2)
    # Where tables tell more apart than vertices do, there are samples.
    (fine,) = caster_clouds(mesh, shape(mesh), spacing / 4, TABLE)
    assert np.median(radii(fine)[:, 0]) < np.median(radii(cloud))


def test_a_wide_triangle_among_small_ones_is_sampled():
    mesh = sheet(corner=0.5)
    spacing = np.sqrt(2) * SIDE / 1.2
    vertices, samples = caster_clouds(mesh, shape(mesh), spacing, TABLE)
    assert len(vertices) == len(mesh.position) - 3
    assert (vertices.position + vertices.origin)[:, 0].max() < 1.5 < (samples.position + samples.origin)[:, 0].min()
    # measured 1 + 1.4e-4: rounding of weights and of positions
    assert radii(samples).max() <= spacing / np.sqrt(2) * (1 + 1e-3)
    # Every one of its parts is covered once at least.
    assert (np.pi * radii(samples).prod(axis=1)).sum() >= 0.5**2 / 2


def test_translucent_meshes_are_cast_from_one_kind_of_points():
    mesh = sheet(corner=0.5)
    some = np.ones(len(TABLE), bool)
    glass = replace(TABLE, alpha=np.full_like(TABLE.alpha, 0.5), translucent=some)
    spacing = np.sqrt(2) * SIDE / 1.2
    (cloud,) = caster_clouds(mesh, shape(mesh), spacing, glass)
    assert cloud.opacity is not None
    assert len(cloud) > 1.9 * len(mesh.position)


def test_vertices_of_edged_meshes_do_not_widen_shadows():
    """Disks at sharp edges reach farther than the samples of the triangles: then there are samples."""
    mesh = sheet()
    bent = mesh.position.copy()
    bent[:, 2] = 2 * SIDE * (np.arange(len(bent)) // (STEPS + 1) % 2)
    mesh = replace(mesh, position=bent)
    found = shape(mesh)
    spacing = float(found.longest.max()) / 1.2
    clouds = caster_clouds(mesh, found, spacing, TABLE)
    assert sum(len(c) for c in clouds) > 1.9 * len(mesh.position)


def test_disks_of_leaves_have_the_leaves_area():
    """Triangles that share no edge, and 0.01 to 0.05 long."""
    rng = np.random.default_rng(0)
    side = rng.uniform(0.01, 0.05, (2000, 1, 1))
    corners = rng.uniform(-1, 1, (2000, 1, 3)) + side * rng.normal(size=(2000, 3, 3))
    mesh = Mesh("leaves", "leaves", corners.reshape(-1, 3).astype(np.float32), np.arange(6000).reshape(-1, 3))
    (cloud,) = caster_clouds(mesh, shape(mesh), 1.0, TABLE)
    area = float((np.pi * radii(cloud).prod(axis=1, dtype=np.float64)).sum())
    assert area == pytest.approx(shape(mesh).size, rel=1e-4)  # measured 1 - 5e-8
    # However coarse the table, most leaves are told apart.
    assert np.median(radii(cloud)[:, 0]) < np.median(shape(mesh).longest)
