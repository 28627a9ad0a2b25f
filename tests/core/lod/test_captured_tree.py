"""Nodes over captured splats against sums in float64 over the splats for which they stand."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.lod.captured.cut import EDGE, cut_captured
from pointsplat_addon.core.lod.captured.gain import splats_a_pixel
from pointsplat_addon.core.lod.captured.tree import WIDTH, build_captured_tree, surface
from pointsplat_addon.core.splat.captured import LEAST_ALPHA, bounds_of_scales
from scripts.scenes.cameras import camera
from scripts.scenes.captured_cases import SHEARED, one_splat, random_splats
from tests.reference import captured as reference

SPLATS = random_splats(3000, 8, size=0.004, spread=0.3)


def leaves(tree, level, cell):
    """Rows of all splats below a node."""
    own = tree.own[level][tree.first_own[level][cell] : tree.first_own[level][cell + 1]].tolist()
    if level < len(tree.first_child):
        first, end = tree.first_child[level][cell : cell + 2].tolist()
        for child in range(first, end):
            own += leaves(tree, level + 1, child)
    return own


def level_of(tree, node):
    level = int(np.searchsorted(tree.start, node, side="right")) - 1
    return level, int(node - tree.start[level])


def covariances(splats):
    axes = reference.rotations(splats.rotation.astype(float)) * splats.scale.astype(float)[:, None]
    return axes @ axes.swapaxes(1, 2)


@pytest.mark.parametrize("antialiased", [False, True])
def test_nodes_have_the_moments_of_their_splats(antialiased):
    """Mean and covariance, of antialiased splats weighted by opacity times surface (Kerbl et al. 2024, section 4), of
    others by opacity; and the sum of opacities times surfaces."""
    splats = replace(SPLATS, antialiased=antialiased)
    tree, own = build_captured_tree(splats), covariances(splats)
    merged = covariances(tree.nodes)
    area = surface(splats.scale.T.astype(float))
    weight = splats.opacity * (area if antialiased else 1.0)
    for node in np.linspace(0, len(tree) - 1, 60).astype(int).tolist():
        rows = leaves(tree, *level_of(tree, node))
        w = weight[rows] / weight[rows].sum()
        mean = w @ SPLATS.position[rows]
        away = SPLATS.position[rows] - mean
        covariance = np.einsum("n,nij->ij", w, own[rows] + away[:, :, None] * away[:, None])
        size = np.sqrt(np.trace(covariance))
        assert np.abs(tree.nodes.position[node] - mean).max() < 1e-6  # measured 6e-8
        assert np.abs(merged[node] - covariance).max() < 1e-5 * size**2  # measured 8e-7
        total = tree.nodes.opacity[node] * surface(tree.nodes.scale[node : node + 1].T.astype(float))[0]
        assert total == pytest.approx(splats.opacity[rows] @ area[rows], rel=1e-4)
        assert SPLATS.sh is not None
        assert tree.nodes.sh is not None
        sh = np.einsum("n,nkc->kc", w, SPLATS.sh[rows])
        assert np.abs(tree.nodes.sh[node] - sh).max() < 1e-5
        o = SPLATS.opacity[rows].astype(float)
        assert tree.means[node, 0] == pytest.approx(o.sum(), rel=1e-4)
        assert tree.means[node, 1] == pytest.approx(o @ o / o.sum(), rel=1e-4)
        assert tree.means[node, 2] == pytest.approx(o @ np.trace(own[rows], axis1=1, axis2=2) / o.sum(), rel=1e-4)
        assert tree.means[node, 3] == pytest.approx(o @ area[rows] / o.sum(), rel=1e-4)


def test_colours_are_averaged_in_linear_light():
    """A black and a white splat of one size: half of the light, not half of the display value."""
    black, white = (one_splat((x, 0, 0), 0.01, color=(c,) * 3) for x, c in ((0, 0), (1, 1)))
    names = ("position", "scale", "rotation", "base", "opacity")
    both = {name: np.concatenate([getattr(black, name), getattr(white, name)]) for name in names}
    tree = build_captured_tree(replace(black, **both))
    assert len(tree) == 1
    node = 0
    shown = reference.linear_from_display(0.28209479177387814 * tree.nodes.base[node].astype(float) + 0.5)
    assert shown == pytest.approx(np.full(3, 0.5), abs=1e-6)
    assert tree.trained_base is None


def test_colours_for_blending_display_values_are_averaged_in_these():
    """Weighted as the others; nothing else of the nodes changes."""
    plain, tree = (build_captured_tree(SPLATS, trained) for trained in (False, True))
    for name in ("position", "scale", "rotation", "base", "opacity", "sh"):
        np.testing.assert_array_equal(getattr(plain.nodes, name), getattr(tree.nodes, name))
    weight = SPLATS.opacity.astype(float)
    display = np.maximum(0.28209479177387814 * SPLATS.base.astype(float) + 0.5, 0)
    assert tree.trained_base is not None
    for node in np.linspace(0, len(tree) - 1, 60).astype(int).tolist():
        rows = leaves(tree, *level_of(tree, node))
        shown = 0.28209479177387814 * tree.trained_base[node].astype(float) + 0.5
        assert shown == pytest.approx(weight[rows] @ display[rows] / weight[rows].sum(), abs=1e-5)


@pytest.mark.parametrize("matrix", [np.eye(4), SHEARED])
@pytest.mark.parametrize("eye", [camera((0, -2, 0)), camera((0, -40, 0)), camera((0, -0.1, 0)), camera(parallel=60.0)])
def test_a_cut_shows_each_splat_once(matrix, eye):
    """And nodes where their cells, which are not smaller than their splats, are small enough."""
    tree, view = build_captured_tree(SPLATS), eye.view_from_world @ matrix
    cut = cut_captured(tree, view, eye, 1.0)
    rows = [row for node in cut.nodes.tolist() for row in leaves(tree, *level_of(tree, node))]
    np.testing.assert_array_equal(np.sort(rows + cut.splats.tolist()), np.flatnonzero(SPLATS.opacity >= LEAST_ALPHA))
    fx, fy, _, _ = eye.pixel_from_view()
    stretch = np.linalg.norm(matrix[:3, :3], 2) * max(abs(fx), abs(fy))
    for node in cut.nodes.tolist():
        level, cell = level_of(tree, node)
        depth = -(view[2, :3] @ tree.nodes.position[node] + view[2, 3]) if eye.perspective else 1.0
        assert stretch * tree.edge[level] <= EDGE * depth * (1 + 1e-5)
        assert SPLATS.scale[leaves(tree, level, cell)].max() * WIDTH <= tree.edge[level] * (1 + 1e-5)


def test_far_views_have_few_nodes_and_near_ones_none():
    tree = build_captured_tree(SPLATS)
    counts = [len(cut_captured(tree, camera((0, -y, 0)).view_from_world, camera((0, -y, 0)), 1.0)) for y in (1, 20, 90)]
    assert counts[0] == np.count_nonzero(SPLATS.opacity >= LEAST_ALPHA)
    assert counts[1] < counts[0] / 2
    assert counts[2] < counts[1] / 2


def test_splats_a_pixel_are_counted():
    """Splats in one pixel, seen from afar; from near they are too large, and beside the picture none counts."""
    largest = bounds_of_scales(SPLATS)
    found = [
        splats_a_pixel(SPLATS, largest, eye.view_from_world, eye, 1.0)
        for eye in (camera((0, -90, 0)), camera((0, -0.05, 0)), camera((0, -90, 0), (500, 0, 0)))
    ]
    shown = np.count_nonzero(largest >= 0)
    assert shown / 9 <= found[0] <= shown  # in 3 x 3 pixels at most
    assert found[1] < 0.2 * shown
    assert found[2] == 0
