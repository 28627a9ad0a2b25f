"""Needles, splats without area, hierarchies of degenerate clouds, and transforms that shrink, mirror and shear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pointsplat_addon.core.lod import hierarchy
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.valid.geometry import valid_triangles
from pointsplat_addon.core.surface.area_sampling import sample_area
from pointsplat_addon.core.surface.evaluation import evaluate
from pointsplat_addon.render.passes.outputs import BACKGROUND_DEPTH
from scripts.scenes.build import mesh, moved, points, scene
from scripts.scenes.cameras import camera
from scripts.scenes.case import Case
from scripts.scenes.clouds import plane_cloud, sphere_cloud
from scripts.scenes.meshes import cube_mesh, flat_mesh
from tests.reference import opaque
from tests.support.extremes import FEW, SHADOWED, TECHNIQUES, every_pass, picture

PLAIN = Settings(use_shadows=False)

# Needles


def strips(count: int, length: float, width: float) -> tuple[np.ndarray, np.ndarray]:
    """A rectangle in XZ as needles side by side: vertices and triangles of aspect length / width."""
    x = (np.arange(count + 1) - count / 2) * width
    ends = np.array([[-0.5], [0.5]]) * length
    position = np.stack([np.tile(x, 2), np.zeros(2 * len(x)), np.repeat(ends, len(x))], axis=1).astype(np.float32)
    low = np.arange(count)
    quad = np.stack([low, low + 1, low + count + 2, low + count + 1], axis=1)
    return position, np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]]).astype(np.int32)


@pytest.mark.parametrize("technique", TECHNIQUES)
def test_needles_of_aspect_1e8_side_by_side_leave_no_gap(technique, within):
    """A thousand of 1e3 by 1e-5 units, a hundredth of a unit wide together, and that fills the picture."""
    wall = mesh(flat_mesh("needles", *strips(1000, 1e3, 1e-5)), "POLYGONS"), moved()
    case = Case(scene(wall, transparent=True), camera((0, -1, 0), resolution=FEW, parallel=0.009), PLAIN)
    alpha = picture(case, technique)[..., 3]
    within("needles of aspect 1e8 side by side", "least coverage short of 1", 1 - alpha.min(), 0.0)


@pytest.mark.parametrize("technique", TECHNIQUES)
@pytest.mark.parametrize("primitive", ["POINTS", "POLYGONS", "AUTO"])
def test_one_needle_of_aspect_1e8_covers_next_to_nothing(technique, primitive, within):
    """2 units by 2e-8, across 22 pixels of 0.06 units: what shows of it is its area, and no line."""
    position = np.array([[-1, 0, 0], [1, 0, 1e-8], [1, 0, -1e-8]], np.float32)
    needle = mesh(flat_mesh(f"needle {primitive}", position, np.array([[0, 1, 2]])), primitive), moved()
    settings = replace(PLAIN, filter_size=0.75)  # whose samples miss it: image space shows it as 0.04 pixels wide
    case = Case(scene(needle, transparent=True), camera((0, -4, 0.013), (0, 0, 0.013), resolution=FEW), settings)
    every_pass(case, technique)
    found = picture(case, technique, 16)[..., 3].sum()
    within("a needle of aspect 1e8", "pixels that it covers, of 22 that it crosses", found, 0.01)


@given(aspect=st.floats(0, 8), size=st.floats(-6, 6), turn=st.floats(0, 6.3), place=st.floats(-1e3, 1e3))
def test_splats_of_any_needle_keep_to_it(aspect, size, turn, place, within):
    """Samples lie on the triangle, and reach no farther than the spacing beyond it."""
    long, wide = 10.0**size, 10.0 ** (size - aspect)
    flat = np.array([[0, 0], [long, 0], [0.3 * long, wide]])
    spin = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    xz = flat @ spin.T
    position = np.stack([xz[:, 0], np.full(3, place * long), xz[:, 1]], axis=1).astype(np.float32)
    of = flat_mesh(f"{aspect} {size} {turn} {place}", position, np.array([[0, 1, 2]]))
    ok, _ = valid_triangles(of)
    if not ok.any():  # float32 has made it a line
        return
    samples = sample_area(of, long / 50, ok)
    found = evaluate(of, samples)
    assert np.isfinite(found.position).all()
    assert np.isfinite(found.radii).all()
    assert np.isfinite(found.normal).all()
    corner = of.position.astype(np.float64) - found.origin
    away = found.position.astype(np.float64)
    low, high = corner.min(axis=0), corner.max(axis=0)
    outside = np.maximum(np.maximum(low - away, away - high), 0).max()
    within("any needle of aspect up to 1e8", "samples beyond its box, over its length", outside / long, 1e-4)
    within("any needle of aspect up to 1e8", "radius over the spacing", found.radii.max() / (long / 50), 1.0)


# Clouds without extent in some direction


def degenerate(rank: int, count: int, rng: np.random.Generator) -> np.ndarray:
    """(count, 3) points on a point, a line or a plane, turned anyhow."""
    axes = np.linalg.qr(rng.standard_normal((3, 3)))[0][:rank]
    return rng.standard_normal((count, rank)) @ axes


@given(
    rank=st.integers(0, 3),
    count=st.integers(1, 400),
    exponent=st.floats(-9, 9),
    seed=st.integers(0, 2**31),
    normals=st.sampled_from([None, "same", "opposite", "any"]),
    shape=st.sampled_from([0, 1, 2]),
    origin=st.sampled_from([0.0, 1e8, -1e15]),
)
def test_hierarchies_of_clouds_of_any_rank(rank, count, exponent, seed, normals, shape, origin, within):
    """Moments of the root as in float64, finite nodes, unit or no normals, and bounds that hold every point."""
    rng = np.random.default_rng(seed)
    size = 10.0**exponent
    position = (degenerate(rank, count, rng) * size).astype(np.float32)
    given_normals = None
    if normals is not None:
        n = rng.standard_normal((count, 3)) if normals == "any" else np.tile([0.6, 0, 0.8], (count, 1))
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        n[::2] *= -1 if normals == "opposite" else 1
        given_normals = n.astype(np.float32)
    radii = None if shape == 0 else np.full((count, shape), 0.01 * size, np.float32)
    cloud = PointCloud(position, origin=np.full(3, origin), normal=given_normals, radii=radii)
    built = hierarchy.build(cloud, leaf_size=4)
    for name in ("center", "normal", "axis", "radii", "bound", "cone", "sphere", "size"):
        array = getattr(built, name)
        assert array is None or np.isfinite(array).all(), name
    assert (built.radii >= 0).all()
    case = "hierarchies of rank 0 to 3, extents 1e-9 to 1e9"
    lengths = np.linalg.norm(built.normal, axis=1)
    within(case, "length of a normal beside 0 and 1", np.minimum(np.abs(lengths - 1), lengths).max(), 1e-6)
    exact = position.astype(np.float64).mean(axis=0)
    within(case, "error of the root's centre over the extent", np.abs(built.center[0] - exact).max() / size, 1e-7)
    away = np.linalg.norm(position - built.center[0].astype(np.float64), axis=1)
    reach = 0 if radii is None else float(radii[0, 0])
    within(
        case, "points beyond the root's sphere, over the extent", ((away + reach) - built.sphere[0]).max() / size, 1e-5
    )


@pytest.mark.parametrize("technique", TECHNIQUES)
@pytest.mark.parametrize("radii", [[0.0], [1e-30], [1e-9], [0.3, 0.0], [0.3, 1e-9], [0.3, 1e-30]])
def test_splats_without_area_leave_the_rest(technique, radii, within):
    """Lines and points of no width before a wall; nothing is closed between them, and they cover a pixel at most."""
    count = 40
    position = np.stack([np.linspace(-0.8, 0.8, count), np.full(count, -0.5), np.zeros(count)], 1).astype(np.float32)
    normal = np.tile(np.array([0, -1, 0], np.float32), (count, 1))
    axis = np.tile(np.array([1, 0, 0], np.float32), (count, 1))
    size = np.tile(np.array(radii, np.float32), (count, 1))
    row = points(f"flat {radii}", PointCloud(position, normal=normal, axis=axis, radii=size)), moved()
    wall = points("behind flat ones", plane_cloud(24, 1.5)), moved((0, 0.5, 0))
    narrow = replace(SHADOWED, filter_size=0.75)  # two samples in a pixel: at the wall's rim wider ones are chance
    found, bare = (
        every_pass(Case(scene(*things), camera(resolution=FEW), narrow), technique, 2)
        for things in ((row, wall), (wall,))
    )
    apart = np.abs(found["combined"] - bare["combined"]).max(axis=2)
    elsewhere = np.concatenate([apart[:8], apart[17:]])
    within("splats without area before a wall", "share of pixels off by 2 % elsewhere", np.mean(elsewhere > 0.02), 0.01)
    within("splats without area before a wall", "mean difference", apart.mean(), 0.03)


# Transforms

SHEAR = np.array([[1, 0.7, 0.2, 0], [0, 1, 0.5, 0], [0.3, 0, 1, 0], [0, 0, 0, 1.0]])
TRANSFORMS = {
    "1e-6": moved(scale=1e-6),
    "mirrored": moved(scale=(-1, 1, 1)),
    "mirrored thrice": moved(scale=-1),
    "sheared": SHEAR,
    "sheared, mirrored and 1e-6": SHEAR @ moved(scale=(-1e-6, 1e-6, 1e-6)),
}


def undone(name: str) -> tuple[np.ndarray, np.ndarray]:
    """A transform, and one that takes most of it back: what is drawn has some size."""
    matrix = TRANSFORMS[name]
    return matrix, np.linalg.inv(moved(scale=np.linalg.norm(matrix[:3, :3], axis=1)))


@pytest.mark.parametrize("name", TRANSFORMS)
def test_transformed_polygons_against_the_reference(name, within):
    """A cube that is turned away, whose transform is its own."""
    matrix, back = undone(name)
    turn = np.eye(4)
    turn[:3, :3] = [[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]]
    eye = camera((0.5, -5, 1), resolution=(48, 40))
    block = cube_mesh("transformed cube", 0.8)
    case = Case(scene((mesh(block, "POLYGONS"), turn @ back @ matrix)), eye, PLAIN)
    found, exact = every_pass(case), opaque.picture(case.scene, eye)
    there = exact.depth < BACKGROUND_DEPTH
    assert there.sum() > 100
    missed = np.mean((found["depth"][..., 0] < BACKGROUND_DEPTH) != there)
    within("transforms of 1e-6, mirrors and shear", "share of pixels missed", missed, 0.0)
    error = np.abs(found["depth"][..., 0] / exact.depth - 1)[there].max()
    within("transforms of 1e-6, mirrors and shear", "relative error of the depth", error, 2e-6)
    error = np.abs(found["combined"] - exact.combined).max()
    within("transforms of 1e-6, mirrors and shear", "difference of a pixel", error, 2e-3)


@pytest.mark.parametrize("technique", TECHNIQUES)
@pytest.mark.parametrize("name", TRANSFORMS)
def test_transformed_points_are_those_of_transformed_positions(name, technique, within):
    """Balls of a millionth, under a camera of that scale, and points whose positions were turned beforehand: the disks
    of these stay round where shear makes ellipses."""
    matrix = TRANSFORMS[name]
    size = np.cbrt(abs(np.linalg.det(matrix[:3, :3])))
    cloud = replace(sphere_cloud(600), radii=np.full((600, 1), 0.12, np.float32))
    linear = matrix[:3, :3] / size
    moved_position = (cloud.position @ linear.T).astype(np.float32)
    normal = cloud.position @ np.linalg.inv(linear)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    ahead = replace(cloud, position=moved_position, normal=normal.astype(np.float32))
    eye = camera((0, -5, 0), resolution=FEW)
    view = eye.view_from_world.copy()
    view[:3, 3] *= size
    # The planes that the matrix has are those that `near` and `far` name: views are culled against them.
    clip = eye.clip_from_view.copy()
    clip[:, 3] *= size
    small = replace(eye, view_from_world=view, clip_from_view=clip, near=eye.near * size, far=eye.far * size)
    one = picture(Case(scene((points("transformed points", cloud), matrix)), small, PLAIN), technique, 4)
    other = picture(Case(scene((points(f"turned before {name}", ahead), moved())), eye, PLAIN), technique, 4)
    within("points under transforms of 1e-6, mirrors and shear", "mean difference", np.abs(one - other).mean(), 0.02)
