"""Which pages a view needs: those that may be seen and whose parents are coarser than the tolerance; no others."""

import numpy as np
import pytest

from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.stream.cut import cut_pages
from pointsplat_addon.stream.need import needed_pages, projected_spacing
from pointsplat_addon.stream.page import make_page
from pointsplat_addon.stream.tree import PageTree
from scripts.scenes import cameras
from tests.support.octrees import MemoryPages, PlainLook

COUNT, MOST = 4000, 60


def plane(count: int = COUNT) -> np.ndarray:
    return np.random.default_rng(1).uniform(0, 1, (count, 3)) * [1, 1, 0] + [0, 0, 0.3]


@pytest.fixture(scope="module")
def source() -> MemoryPages:
    return MemoryPages(plane(), MOST, 0.1)


VIEWS = {
    "whole": cameras.camera(eye=(0.5, -1.5, 1.5), target=(0.5, 0.5, 0.3), resolution=(64, 48)),
    "near": cameras.camera(eye=(0.2, 0.1, 0.4), target=(0.5, 0.5, 0.3), resolution=(64, 48)),
    "away": cameras.camera(eye=(0.5, -1.5, 1.5), target=(0.5, -4.0, 3.0), resolution=(64, 48)),
}


@pytest.mark.parametrize("name", VIEWS)
def test_a_page_is_needed_where_it_is_seen_and_its_parent_is_too_coarse(source: MemoryPages, name: str) -> None:
    camera: Camera = VIEWS[name]
    tree, matrix = PageTree(source.directory), camera.view_from_world
    spacing = projected_spacing(source.directory, matrix, camera)
    need = needed_pages(tree, matrix[None], camera, tolerance=1.0)
    parent = source.directory.parent
    expected, waiting = [], [0] if spacing[0] > 0 else []
    while waiting:
        page = waiting.pop()
        expected.append(page)
        if spacing[page] > 1.0:
            waiting += [child for child in np.flatnonzero(parent == page).tolist() if spacing[child] > 0]
    assert sorted(need.pages.tolist()) == sorted(expected)
    assert (np.diff(need.gain) <= 0).all()
    order = {page: i for i, page in enumerate(need.pages.tolist())}
    assert all(order[int(parent[page])] < i for page, i in order.items() if page)
    if name == "away":
        assert len(need.pages) == 0
    else:
        assert 1 < len(need.pages) < len(source.directory)


@pytest.mark.parametrize("name", VIEWS)
def test_no_page_with_a_point_in_the_picture_is_taken_for_unseen(source: MemoryPages, name: str) -> None:
    camera = VIEWS[name]
    spacing = projected_spacing(source.directory, camera.view_from_world, camera)
    fx, fy, cx, cy = camera.pixel_from_view()
    for page, rows in enumerate(source.rows):
        p = source.columns["position"][rows] @ camera.view_from_world[:3, :3].T + camera.view_from_world[:3, 3]
        depth = -p[:, 2]
        x, y = cx + fx * p[:, 0] / depth, cy + fy * p[:, 1] / depth
        seen = (depth > camera.near) & (x >= 0) & (x <= 64) & (y >= 0) & (y <= 48)
        if seen.any():
            # As wide on the screen as at the nearest of the points, or wider.
            least = source.directory.spacing[page] * max(abs(fx), abs(fy)) / depth[seen].min()
            assert spacing[page] >= least * (1 - 1e-6)


def test_points_lie_in_the_deepest_page_whose_cube_holds_them(source: MemoryPages) -> None:
    tree = PageTree(source.directory)
    position = source.columns["position"]
    found = tree.deepest(0, position)
    cube = source.directory.cube
    assert cube is not None
    inside = ((position >= cube[found, :3] - 1e-6) & (position <= cube[found, :3] + cube[found, 3:] + 1e-6)).all(axis=1)
    assert inside.all()
    below = np.flatnonzero(source.directory.parent == found[0])
    assert len(below) == 0 or not ((position[0] > cube[below, :3]) & (position[0] < cube[below, :3] + cube[below, 3:])
                                   ).all(axis=1).any()  # fmt: skip


def test_a_page_stands_in_for_what_is_missing_below_it(source: MemoryPages) -> None:
    tree = PageTree(source.directory)
    look = PlainLook()
    there = {page: make_page(tree, page, source.read(page), look) for page in range(len(tree))}
    assert len(cut_pages(tree, there)) == len(tree)
    inner = int(np.flatnonzero(~tree.is_leaf & (source.directory.level == 1))[0])
    del there[inner]
    cut = cut_pages(tree, there)
    below = [inner]
    for page in range(len(tree)):
        if source.directory.parent[page] in below:
            below.append(page)
    assert sorted(cut.pages) == sorted(set(range(len(tree))) - set(below))
    assert (cut.standing[below] == 0).all()
