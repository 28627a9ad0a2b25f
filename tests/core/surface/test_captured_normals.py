"""Normals of captured splats, from flat ones and from their neighbours."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.surface.neighbourhoods.captured import captured_normals
from scripts.scenes.captured_cases import captured_sphere, one_splat


def test_disks_on_a_sphere_show_its_normals():
    splats = captured_sphere(4000)
    found = captured_normals(splats)
    outward = splats.position / np.linalg.norm(splats.position, axis=1, keepdims=True)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-6)
    assert np.abs((found * outward).sum(axis=1)).min() > 0.997  # measured 0.9984


def test_round_splats_ask_their_neighbours():
    splats = captured_sphere(4000)
    rows = np.arange(0, 4000, 10)
    scale = splats.scale.copy()
    scale[rows] = 0.01
    found = captured_normals(replace(splats, scale=scale))
    outward = splats.position / np.linalg.norm(splats.position, axis=1, keepdims=True)
    assert np.abs((found * outward).sum(axis=1))[rows].min() > 0.995  # measured 0.9973


@pytest.mark.parametrize("scale", [0.1, (0.1, 0.05, 0.05)])
def test_one_that_nothing_tells_of_has_none(scale):
    """A ball, and a needle whose two shorter axes are alike."""
    np.testing.assert_array_equal(captured_normals(one_splat((0, 0, 0), scale)), 0)


def test_a_disk_lies_across_its_shortest_axis():
    c, s = np.cos(0.3), np.sin(0.3)
    found = captured_normals(one_splat((1, 2, 3), (0.1, 0.2, 0.01), rotation=(c, s, 0, 0)))
    np.testing.assert_allclose(np.abs(found[0]), [0, np.sin(0.6), np.cos(0.6)], atol=1e-6)


def test_extremes():
    splats = captured_sphere(50)
    for change in ({"scale": np.zeros((50, 3))}, {"position": np.zeros((50, 3))}, {"opacity": np.zeros(50)}):
        arrays = {name: value.astype(np.float32) for name, value in change.items()}
        assert np.isfinite(captured_normals(replace(splats, **arrays))).all()
    empty = replace(
        splats, **{n: getattr(splats, n)[:0] for n in ("position", "scale", "rotation", "base", "opacity", "sh")}
    )
    assert captured_normals(empty).shape == (0, 3)
