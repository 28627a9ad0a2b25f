"""Cameras: ratios of far to near, fields of view, sizes of pictures, counts of points, and eyes within splats."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.scene.scene import Geometry
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.volume import Volume
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.passes.outputs import BACKGROUND_DEPTH
from scripts.scenes import meshes
from scripts.scenes.build import mesh, moved, points, scene, strand_lines
from scripts.scenes.cameras import camera
from scripts.scenes.case import Case
from scripts.scenes.clouds import sphere_cloud
from scripts.scenes.meshes import cube_mesh
from tests.reference import opaque
from tests.support.extremes import (
    FEW,
    SHADOWED,
    TECHNIQUES,
    all_kinds,
    every_pass,
    picture,
    without,
)

# Near and far planes


@pytest.mark.parametrize("technique", TECHNIQUES)
@pytest.mark.parametrize(("near", "far"), [(1e-6, 1e3), (1.0, 1e9), (1e-9, 1e2), (1e-12, 1e12)])
def test_a_ratio_of_1e9_and_more_shows_the_same(technique, near, far, within):
    case = all_kinds("ratio")
    wide = replace(case, camera=camera((0.5, -4, 0.7), resolution=FEW, near=near, far=far))
    apart = np.abs(picture(wide, technique) - picture(case, technique)).max(axis=2)
    within("far over near of 1e9 to 1e24", "share of pixels off by 2 %", np.mean(apart > 0.02), 0.001)
    within("far over near of 1e9 to 1e24", "mean difference", apart.mean(), 1e-6)


@pytest.mark.parametrize("kind", ["POLYGONS", "POINTS"])
def test_depths_of_nine_decades_in_one_picture(kind, within):
    """Quads at 1, 10, ... 1e8, each as large in the picture as the next and beside it; depths as in float64."""
    things = []
    for decade in range(9):
        distance = 10.0**decade
        size = 0.04 * distance
        at = np.array([(decade - 4) * 0.1 * distance, distance, 0])
        quad = mesh(meshes.plane_mesh(f"decade {kind} {decade}", 1.0, 2), kind)
        things.append((quad, moved(at, size)))
    eye = camera((0, 0, 0), (0, 1, 0), resolution=(72, 12), field_of_view=50, near=0.5, far=5e8)
    case = Case(scene(*things), eye, Settings(use_shadows=False))
    found = every_pass(case)
    exact = opaque.picture(case.scene, eye)
    depth = found["depth"][..., 0]
    both = (depth < BACKGROUND_DEPTH) & (exact.depth < BACKGROUND_DEPTH)
    assert len(np.unique(exact.instance[both])) == 9
    case_name = f"nine decades of depth, {kind.lower()}"
    within(case_name, "relative error of the depth", np.abs(depth[both] / exact.depth[both] - 1).max(), 1e-5)
    missed = np.mean((depth >= BACKGROUND_DEPTH) & (exact.depth < BACKGROUND_DEPTH))
    within(case_name, "share of pixels that are missed", missed, 0.0)


# Fields of view


@pytest.mark.parametrize("angle", [0.1, 1.0, 120.0, 175.0])
def test_fields_of_view_against_the_reference(angle, within):
    """A cube that fills half of the picture, from as far as that takes."""
    distance = 1 + 0.5 / np.tan(np.radians(angle) / 2) * 2
    eye = camera(
        (0, -distance, 0), (0, 0, 0), resolution=(48, 40), field_of_view=angle, near=distance / 1e3, far=distance * 10
    )
    case = Case(
        scene((mesh(cube_mesh("seen by any lens", 1.0), "POLYGONS"), moved())), eye, Settings(use_shadows=False)
    )
    found, exact = picture(case), opaque.picture(case.scene, eye)
    there = exact.depth < BACKGROUND_DEPTH
    assert there.sum() > 300
    depth = every_pass(case)["depth"][..., 0]
    missed = np.mean((depth < BACKGROUND_DEPTH) != there)
    within("fields of view of 0.1 to 175 degrees", "share of pixels missed", missed, 0.0)
    within("fields of view of 0.1 to 175 degrees", "difference of a pixel", np.abs(found - exact.combined).max(), 1e-3)


@pytest.mark.parametrize("technique", TECHNIQUES)
@pytest.mark.parametrize("angle", [0.1, 175.0])
def test_all_kinds_are_there_in_any_field_of_view(technique, angle):
    """Aimed at the block; every pass is finite. But for the mesh that has to be points: a near plane that cuts it in so
    wide a view asks for the most samples that a mesh may have."""
    distance = 0.6 + 0.6 / np.tan(np.radians(angle) / 2)
    eye = camera((0.7, 0.2 - distance, 0), (0.7, 0.2, 0), resolution=FEW, field_of_view=angle, near=1e-3 * distance,
                 far=1e2 * distance)  # fmt: skip
    found = every_pass(without(replace(all_kinds("any lens"), camera=eye), [2]), technique, 2)
    assert (found["depth"] < BACKGROUND_DEPTH).mean() > 0.05


# Sizes


@pytest.mark.parametrize("technique", TECHNIQUES)
@pytest.mark.parametrize("size", [(1, 1), (1, 2), (2, 1), (3, 1), (1, 7), (5, 3), (1, 65), (257, 2)])
def test_pictures_of_any_shape_have_every_pass(technique, size):
    case = all_kinds("any size")
    found = every_pass(replace(case, camera=replace(camera((0.5, -4, 0.7), resolution=size))), technique, 2)
    for name, array in found.items():
        assert array.shape[:2] == size[::-1], name


@pytest.mark.parametrize("technique", TECHNIQUES)
def test_one_pixel_is_the_mean_of_many(technique, within):
    """Of a square view; its filter is as wide as the pixel."""
    case = Case(scene((mesh(cube_mesh("in one pixel", 0.6), "POLYGONS"), moved()), lights=()), camera(), SHADOWED)
    one, many = (
        picture(replace(case, camera=camera(resolution=(side, side), field_of_view=40)), technique, samples)
        for side, samples in ((1, 256), (64, 4))
    )
    within(
        "a picture of one pixel",
        "difference from the mean of 64 x 64",
        np.abs(one - many.mean(axis=(0, 1))).max(),
        0.02,
    )


@given(size=st.tuples(st.integers(1, 40), st.integers(1, 40)), border=st.tuples(*[st.floats(0, 1)] * 4))
def test_any_border_of_any_picture(size, border):
    """Finite, and of its size; tests/render/frame/test_frame.py compares borders with the whole."""
    case = all_kinds("any border")
    (left, bottom), (right, top) = (
        [min(int(f * s), s - 1) for f, s in zip(part, size, strict=True)] for part in (border[:2], border[2:])
    )
    x, y = sorted([left, right]), sorted([bottom, top])
    region = (x[0], y[0], x[1] - x[0] + 1, y[1] - y[0] + 1)
    eye = camera((0.5, -4, 0.7), resolution=size)
    found = picture(replace(case, camera=replace(eye, region=region)))
    assert found.shape[:2] == (region[3], region[2])


@pytest.mark.long
@pytest.mark.parametrize("size", [(16384, 1), (1, 16384)])
@pytest.mark.parametrize("technique", TECHNIQUES)
def test_the_longest_pictures(technique, size):
    """The largest side that Blender's gpu has textures for."""
    case = all_kinds("longest")
    found = every_pass(replace(case, camera=camera((0.5, -4, 0.7), resolution=size)), technique)
    assert (found["depth"] < BACKGROUND_DEPTH).mean() > 0.05


@pytest.mark.parametrize("size", [(16384, 1), (1, 16384)])
def test_the_longest_pictures_against_the_reference(size, within):
    """As wide as a texture may be, in 64 units of which a bent wall fills half."""
    long = 0 if size[0] > 1 else 2
    corner = np.zeros((6, 3), np.float32)
    corner[:, long] = np.repeat([-16, 0, 16], 2)
    corner[:, 2 - long] = np.tile([-1, 1], 3)
    corner[2:4, 1] = 3
    wall = meshes.flat_mesh(f"longest wall {size}", corner, np.array([[0, 2, 1], [1, 2, 3], [2, 4, 3], [3, 4, 5]]))
    made = scene((mesh(wall, "POLYGONS"), moved()))
    eye = camera((0, -40, 0), (0, 0, 0), resolution=size, parallel=64.0, far=100)
    case = Case(made, eye, Settings(use_shadows=False))
    found, exact = every_pass(case), opaque.picture(made, eye)
    there = exact.depth < BACKGROUND_DEPTH
    assert there.sum() == 8192
    missed = np.mean((found["depth"][..., 0] < BACKGROUND_DEPTH) != there)
    within("pictures of 16384 x 1", "share of pixels missed", missed, 1e-3)
    error = np.abs(found["depth"][..., 0] / exact.depth - 1)[there].max()
    within("pictures of 16384 x 1", "relative error of the depth", error, 1e-5)
    within("pictures of 16384 x 1", "difference of a pixel", np.abs(found["combined"] - exact.combined).max(), 1e-3)


# Counts


def row_of(count: int) -> PointCloud:
    """So many disks side by side, of which the last is red and lies apart, in front of the eye."""
    position = np.zeros((count, 3), np.float32)
    position[:-1, 0] = np.linspace(-1, 1, max(count - 1, 1))[: count - 1]
    position[-1, 2] = 0.7
    normal = np.tile(np.array([0, -1, 0], np.float32), (count, 1))
    color = np.full((count, 3), 0.5, np.float32)
    color[-1] = 1, 0, 0
    radii = np.full((count, 1), 0.1, np.float32)
    radii[-1] = 0.3
    return PointCloud(position, normal=normal, radii=radii, color=color)


def assert_counted(count: int, technique: str, within) -> None:
    """The last point of all is where it should be, in its own colour."""
    made = scene((points(f"row of {count}", row_of(count)), moved()), lights=(), world=World(np.ones(3)))
    case = Case(made, camera(resolution=(24, 24), parallel=2.4), Settings(use_shadows=False, tolerance=0.05))
    found = picture(case, technique)
    red = found[19, 12]
    assert red[0] > 3 * red[1]
    if count > 100:
        uneven = np.ptp(found[12, 6:18, :3], axis=0).max()
        within(f"rows of up to {'2^16 + 1' if count < 1 << 20 else '2^24 + 1'} disks", "unevenness", uneven, 0.02)
        assert np.ptp(found[12, 6:18, :3], axis=1).max() < 0.02
        assert found[12, 6:18, 0].max() < 0.8


@pytest.mark.parametrize("technique", TECHNIQUES)
@pytest.mark.parametrize("count", [1, 2, 4095, 4096, 4097, 65535, 65536, 65537])
def test_counts_about_powers_of_two(technique, count, within):
    assert_counted(count, technique, within)


@pytest.mark.long
def test_one_more_point_than_float32_counts(within):
    """2^24 + 1: the last index is no float32."""
    assert_counted((1 << 24) + 1, "IMAGE_SPACE", within)


NOTHING = {
    "no points": points("no points", sphere_cloud(3).take(slice(0, 0))),
    "no medium": points("no medium", replace(sphere_cloud(3), extinction=np.ones(3, np.float32)).take(slice(0, 0))),
    "no triangles": mesh(Mesh("none", "none", np.zeros((3, 3), np.float32), np.zeros((0, 3), np.int32))),
    "no vertices": mesh(Mesh("nowhere", "nowhere", np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32)), "POINTS"),
    "no strands": strand_lines("no strands", [np.zeros((0, 3))], 0.1),
    "one end": strand_lines("one end", [np.zeros((1, 3))], 0.1),
    "no voxels": Geometry("no voxels", "no voxels", volume=Volume("v", "v", np.zeros((0, 3), np.int32), np.eye(4),
                                                                  {"density": np.zeros(0, np.float32)})),
}  # fmt: skip


@pytest.mark.parametrize("technique", TECHNIQUES)
@pytest.mark.parametrize("name", NOTHING)
def test_nothing_is_drawn_as_nothing(technique, name):
    case = Case(scene((NOTHING[name], moved())), camera(resolution=FEW), SHADOWED)
    np.testing.assert_array_equal(
        every_pass(case, technique)["combined"], np.array([0.1, 0.12, 0.15, 1], np.float32) + 0 * picture(case)
    )


# Eyes within splats


def at_the_eye(kind: str, radius: float) -> PointCloud:
    one = np.zeros((1, 3), np.float32)
    radii = np.full((1, 1), radius, np.float32)
    towards = np.array([[0, -1, 0]], np.float32)
    if kind == "ball":
        return PointCloud(one, radii=radii)
    if kind == "medium":
        return PointCloud(one, radii=radii, extinction=np.array([2 / radius], np.float32))
    opacity = np.array([0.5], np.float32) if kind == "shell" else None
    return PointCloud(one, normal=towards, radii=radii, opacity=opacity)


@pytest.mark.parametrize(
    ("kind", "technique"),
    [*product(["disk", "ball"], TECHNIQUES), *product(["medium", "shell"], TECHNIQUES)],
)
@pytest.mark.parametrize("radius", [1e-6, 0.5, 1e6])
@pytest.mark.parametrize("eye", [(0, 0, 0), (0, -1e-9, 0), (0, 1e-9, 0), (1e-7, -0.05, 1e-7)])
def test_an_eye_within_a_splat(technique, kind, radius, eye, within):
    """Near planes of 1e-3; what lies behind is there where a splat is smaller than that, and every pass is finite."""
    cloud = at_the_eye(kind, radius)
    behind = points("behind the eye's splat", sphere_cloud(200)), moved((0, 3, 0))
    view = camera(eye, (0, 1, 0), resolution=FEW, near=1e-3)
    made = scene((points(f"at the eye {kind} {radius}", cloud), moved()), behind)
    every_pass(Case(made, view, SHADOWED), technique)
    if radius == 1e-6:
        plain = Settings(use_shadows=False)
        found, bare = (every_pass(Case(s, view, plain), technique) for s in (made, scene(behind)))
        # A speck where the eye stands off; around it, holes between wide splats are filled from nearer pixels.
        apart = np.abs(found["combined"] - bare["combined"]).max(axis=2)
        within("an eye at a splat of 1e-6", "mean difference from the picture without it", apart.mean(), 0.01)
