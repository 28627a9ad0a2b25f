"""Nodes that pages of scans hold: they cover as much of their silhouette as is told of them."""

from pathlib import Path

import numpy as np
import pytest

from pointsplat_addon.core.lod.balls.covered import node_shape
from pointsplat_addon.core.numeric.vectors import basis
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.scene import Geometry, PointSize
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.stream.cut import cut_pages, splats_of_cut
from pointsplat_addon.stream.page import Page
from pointsplat_addon.stream.tree import PageTree
from scripts.scenes import build, cameras
from scripts.scenes.drawing import opengl
from tests.support.octrees import MemoryPages

SIDE, CELLS = 96, 12  # pixels, and nodes to a side of the picture


def random_nodes(count: int, seed: int = 3):
    random = np.random.default_rng(seed)
    normal = random.normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    axis = basis(normal.T)[0].T
    radii = np.sort(random.uniform(0.1, 1.0, (count, 3)), axis=1)[:, ::-1]
    return (array.astype(np.float32) for array in (normal, axis, radii, random.uniform(0.05, 0.95, count)))


def test_shapes_have_the_half_axes_and_the_covered_fraction() -> None:
    normal, axis, radii, covered = random_nodes(50)
    shape, radius = node_shape(normal, axis, radii, covered)
    for row in range(50):
        xx, xy, xz, yy, yz, zz, area, saturation = shape[row].astype(float)
        matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        # Worst measured: 2e-7 and 4e-7, of float32.
        np.testing.assert_allclose(np.sqrt(np.linalg.eigvalsh(matrix)), np.sort(radii[row]), rtol=2e-6)
        depth = area / (np.pi * radii[row, 0] * radii[row, 1])
        assert 1 - np.exp(-depth * (1 + saturation * depth)) == pytest.approx(covered[row], rel=4e-6)
    np.testing.assert_allclose(radius**2, radii[:, 0] * radii[:, 1], rtol=1e-5)


@pytest.mark.parametrize("fraction", [0.1, 0.5, 0.9, 1.0])
def test_nodes_cover_their_fraction_of_the_picture(fraction: float) -> None:
    step = SIDE / CELLS
    place = (np.stack(np.meshgrid(*2 * [np.arange(CELLS) + 0.5]), axis=-1).reshape(-1, 2) - CELLS / 2) * step
    position = np.column_stack([place[:, 0], np.zeros(len(place)), place[:, 1]]).astype(np.float32)
    count = len(position)
    normal, axis, radii = (
        np.tile(np.array(one, np.float32), (count, 1)) for one in ([0, -1, 0], [1, 0, 0], [3.5, 2.5, 0.5])
    )
    covered = np.full(count, fraction, np.float32)
    shape, radius = node_shape(normal, axis, radii, covered)
    cloud = PointCloud(position, radii=radius[:, None], share=covered)
    geometry = Geometry(f"nodes {fraction}", "Nodes", cloud=cloud, node_shape=shape)
    scene = build.scene((geometry, np.eye(4)), world=World(np.zeros(3)), transparent=True)
    camera = cameras.camera(eye=(0, -50, 0), target=(0, 0, 0), resolution=(SIDE, SIDE), parallel=SIDE)
    request = Request(camera, Settings(technique="VISIBILITY"), frozenset({"combined"}), 17)
    alpha = opengl().render(scene, request).pixels["combined"][..., 3].astype(float)
    expected = fraction * count * np.pi * 3.5 * 2.5
    # Worst measured: 0.026, of a tenth, which is one or two of a pixel's 17 sub-samples.
    assert alpha.sum() == pytest.approx(expected, rel=0.03)


def test_a_page_shows_of_its_nodes_those_that_no_finer_page_shows(tmp_path: Path) -> None:
    source = MemoryPages(np.random.default_rng(1).uniform(0, 1, (400, 3)), 50, 0.1)
    object.__setattr__(source.directory, "additive", False)
    tree = PageTree(source.directory)
    there = {}
    for page in range(len(tree)):
        position = source.columns["position"][source.rows[page]]
        deepest = tree.deepest(page, position)
        order = np.argsort(deepest, kind="stable")
        first = np.flatnonzero(np.r_[True, np.diff(deepest[order]) > 0])
        count = np.diff(np.r_[first, len(order)])
        there[page] = Page(PointCloud(position[order]), None, deepest[order][first], count, 0.1)
    whole = splats_of_cut(tree, cut_pages(tree, there), there, PointSize()).points
    leaves = sum(len(source.rows[page]) for page in np.flatnonzero(tree.is_leaf))
    outside = sum(int((tree.deepest(p, source.columns["position"][source.rows[p]]) == p).sum())
                  for p in np.flatnonzero(~tree.is_leaf).tolist())  # fmt: skip
    assert whole is not None
    assert len(whole) == leaves + outside
    gone = int(np.flatnonzero(source.directory.parent == 0)[0])
    some = {page: there[page] for page in [0, *np.flatnonzero(source.directory.parent == 0).tolist()] if page != gone}
    shown = splats_of_cut(tree, cut_pages(tree, some), some, PointSize()).points
    assert shown is not None
    root = source.columns["position"][source.rows[0]]
    mine = np.isin(tree.deepest(0, root), [0, gone])
    others = sum(len(source.rows[page]) for page in some if page)
    assert len(shown) == int(mine.sum()) + others
