"""Facts about splats that stand apart: which do, and how much light their nodes let through."""

# pyright: reportOptionalMemberAccess=false, reportArgumentType=false, reportOptionalSubscript=false
# pyright: reportOptionalOperand=false
# Attributes may be None by type; the clouds here have those that are asked for.
from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.lod import hierarchy, node_splats
from pointsplat_addon.core.lod.foliage import disconnected_splats, is_foliage
from pointsplat_addon.core.scene.cloud import PointCloud
from scripts.scenes.meshes import plane_mesh, sphere_mesh
from tests.support.transmittance import levels, mean_transmittance


def leaves(count: int, depth: float, flat: float = 0.0) -> PointCloud:
    """Disks strewn over the unit ball, of seen areas that add up to `depth` times its silhouette where they are turned
    in all directions; `flat` of 1: all of them face along z."""
    rng = np.random.default_rng(0)
    p, normal = rng.standard_normal((2, count, 3))
    p *= np.cbrt(rng.random((count, 1))) / np.linalg.norm(p, axis=1, keepdims=True)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normal = (1 - flat) * normal + flat * np.array([0, 0, 1.0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    # Of two sizes, in any order.
    area = 2 * np.pi * depth / count * rng.choice([0.5, 1.5], (count, 1))
    return PointCloud(p.astype(np.float32), normal=normal.astype(np.float32), radii=np.sqrt(area / np.pi).astype("f4"))


def sphere(count: int, radius: float = 1.0) -> PointCloud:
    """Disks on a spiral, of twice the area of the sphere together, as samples that cover their cells have."""
    i = np.arange(count) + 0.5
    polar, around = np.arccos(1 - 2 * i / count), np.pi * (1 + 5**0.5) * i
    n = np.stack([np.cos(around) * np.sin(polar), np.sin(around) * np.sin(polar), np.cos(polar)], axis=1).astype("f4")
    radii = np.full((count, 1), radius * np.sqrt(2 * 4 / count), np.float32)
    return PointCloud(n * np.float32(radius), normal=n, radii=radii)


def square(cells: int, origin: tuple, u: tuple, v: tuple, area: float = np.pi / 2) -> PointCloud:
    """A lattice of disks over the square between `u` and `v`, each of `area` cells."""
    x, y = ((a.reshape(-1, 1) + 0.5) / cells for a in np.meshgrid(np.arange(cells), np.arange(cells)))
    p = np.array(origin) + x * np.array(u) + y * np.array(v)
    side = np.linalg.norm(u) / cells
    normal = np.tile(np.cross(u, v) / np.linalg.norm(np.cross(u, v)), (len(p), 1))
    radii = np.full((len(p), 1), side * np.sqrt(area / np.pi))
    return PointCloud(p.astype(np.float32), normal=normal.astype("f4"), radii=radii.astype("f4"))


def together(*clouds: PointCloud) -> PointCloud:
    arrays = {name: np.concatenate([getattr(c, name) for c in clouds]) for name in clouds[0].arrays()}
    return PointCloud(**arrays)


def cube(cells: int, thick: float = 1.0) -> PointCloud:
    x, y, z = (1, 0, 0), (0, 1, 0), (0, 0, 1)
    slim = max(round(cells * thick), 1)
    top = [square(cells, (0, 0, at), x, y) for at in (0, thick)]
    rim = square(cells, (0, 0, 0), x, z)
    rim = rim.take(rim.position[:, 2] < slim / cells)
    back = replace(rim, position=rim.position + np.float32([0, 1, 0]))
    return together(*top, rim, back)


def noisy(cloud: PointCloud, share: float) -> PointCloud:
    """Points moved by so much of their radius, as a scanner's are."""
    step = np.random.default_rng(1).standard_normal(cloud.position.shape) * cloud.radii[:, :1] * share
    return replace(cloud, position=(cloud.position + step).astype(np.float32))


CLOSED: dict[str, Callable[[], PointCloud]] = {
    "sphere": lambda: sphere(5000),
    "coarse sphere": lambda: sphere(60),
    "sphere of the least cover": lambda: replace(sphere(5000), radii=sphere(5000).radii / np.float32(np.sqrt(2))),
    "plane": lambda: square(60, (0, 0, 0), (1, 0, 0), (0, 1, 0)),
    "plane of disks without overlap": lambda: square(60, (0, 0, 0), (1, 0, 0), (0, 1, 0), area=np.pi / 4),
    "cube": lambda: cube(40),
    "thin box": lambda: cube(40, 0.05),
    "sheet with two sides": lambda: cube(40, 1e-4),
    "scan": lambda: noisy(sphere(5000), 0.5),
    "in any order": lambda: sphere(5000).take(np.random.default_rng(2).permutation(5000)),
    "wire": lambda: replace(square(1000, (0, 0, 0), (1, 0, 0), (0, 1, 0)).take(slice(1000))),
    "two points": lambda: sphere(2),
}


@pytest.mark.parametrize("name", CLOSED)
def test_no_splat_of_a_surface_stands_apart(name: str) -> None:
    assert disconnected_splats(CLOSED[name]()) is None


def test_leaves_stand_apart_and_their_trunk_does_not() -> None:
    crown, trunk = leaves(20000, 1.0), sphere(4000, 0.2)
    trunk = replace(trunk, position=trunk.position - np.float32([0, 0, 2]))
    found = disconnected_splats(together(crown, trunk))
    assert found[:20000].mean() > 0.99
    assert not found[20000:].any()


def test_light_passes_what_is_not_of_opaque_disks() -> None:
    cloud = leaves(5000, 1.0)
    assert disconnected_splats(cloud) is not None
    assert disconnected_splats(replace(cloud, opacity=np.ones(5000, np.float32))) is None
    assert disconnected_splats(replace(cloud, normal=None)) is None
    assert disconnected_splats(cloud.take(slice(0))) is None


@pytest.mark.parametrize(("depth", "flat"), [(0.5, 0.0), (1.5, 0.0), (0.5, 1.0)])
def test_a_crown_of_leaves_is_as_dark_from_afar(depth: float, flat: float) -> None:
    cloud = leaves(40000, depth, flat)
    built = hierarchy.build(replace(cloud, disconnected=disconnected_splats(cloud)))
    splats, cuts = node_splats.points_and_nodes(built), list(levels(built, 2000))
    assert len(cuts) >= 2
    for view in ((0.0, 0.0, 1.0), (1.0, 0.4, 0.7)):
        near = mean_transmittance(cloud, 1.15, view, pixels=384, hard=True)
        assert 0.2 < near < 0.9
        for cut in cuts:
            far = mean_transmittance(splats.take(cut), 1.15, view, pixels=384, hard=True)
            assert far == pytest.approx(near, abs=0.01)  # measured 0.007


def test_poses_of_leaves_are_refitted_to_the_same_nodes() -> None:
    cloud = leaves(3000, 1.0)
    cloud = replace(cloud, disconnected=disconnected_splats(cloud), color=np.full((3000, 3), 0.5, np.float32))
    built = hierarchy.build(cloud)
    painted = replace(cloud, color=np.full((3000, 3), 0.2, np.float32))
    for again in (hierarchy.refit(built, cloud), hierarchy.recolor(built, painted)):
        np.testing.assert_array_equal(again.section, built.section)
        np.testing.assert_array_equal(again.disconnected, built.disconnected)


def strips(count: int, cells: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of so many loose strips of quads."""
    position = np.random.default_rng(3).random((count * (cells + 1) * 2, 3)).astype(np.float32)
    quad = np.array([[0, 1, 2], [1, 3, 2]])
    one = (2 * np.arange(cells)[:, None, None] + quad).reshape(-1, 3)
    return position, (2 * (cells + 1) * np.arange(count)[:, None, None] + one).reshape(-1, 3)


def test_meshes_are_of_leaves_where_many_edges_are_open() -> None:
    assert is_foliage(*strips(100, 1))
    assert is_foliage(*strips(100, 8))
    closed = sphere_mesh("closed", 20)
    assert not is_foliage(closed.position, closed.triangles)
    # Each triangle with vertices of its own, as some files have them.
    assert not is_foliage(
        closed.position[closed.triangles].reshape(-1, 3), np.arange(closed.triangles.size).reshape(-1, 3)
    )
    grid = plane_mesh("grid", cells=40)
    assert not is_foliage(grid.position, grid.triangles)
    both = np.concatenate([closed.position, strips(400, 1)[0]])
    assert is_foliage(both, np.concatenate([closed.triangles, strips(400, 1)[1] + len(closed.position)]))
