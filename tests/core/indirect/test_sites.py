"""Sites of receivers: pictures from other cameras find them again."""

import numpy as np

from pointsplat_addon.core.indirect.sites import FINE, quantised_directions, sites


def plane(seed: int, normal: np.ndarray) -> np.ndarray:
    """(500, 3) places of a plane through (0.3, 0.2, 0.1)."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-1, 1, (500, 3))
    return places - ((places - (0.3, 0.2, 0.1)) @ normal)[:, None] * normal


def test_a_plane_has_one_site_in_each_cell():
    """Whichever places of it ask: their middles, within a 128th of an edge of the plane. Worst: 0.0067 edges."""
    normal = np.array([0.48, 0.36, 0.8])
    places, level = plane(1, normal), np.full(500, -2.0)
    made = sites(places, np.tile(normal, (500, 1)), level)
    other = sites(plane(2, normal), np.tile(normal, (500, 1)), level)
    assert len(np.unique(made.key)) < 100
    common, mine, theirs = np.intersect1d(made.key, other.key, return_indices=True)
    assert len(common) > 40
    assert np.array_equal(made.position[mine], other.position[theirs])
    assert np.array_equal(made.normal[mine], other.normal[theirs])
    off = np.abs((made.position - (0.3, 0.2, 0.1)) @ normal) / 0.25
    assert off.max() < 1 / 128
    assert np.abs((made.position - places)[:, :2]).max() <= 0.125 + 1e-12


def test_fine_sites_are_next_to_what_asks():
    """Within a half of the FINE-th part of an edge."""
    up = np.tile([0.0, 0.0, 1.0], (500, 1))
    places = plane(3, up[0])
    made = sites(places, up, np.full(500, -1.0), FINE)
    assert np.abs((made.position - places)[:, :2]).max() <= 0.25 / FINE + 1e-12


def test_directions_are_quantised_to_a_degree():
    """In 256 steps each way; those along axes stay. Worst: 0.92 degrees."""
    rng = np.random.default_rng(4)
    given = rng.normal(size=(20_000, 3))
    given /= np.linalg.norm(given, axis=1, keepdims=True)
    code, found = quantised_directions(given, 256)
    assert np.degrees(np.arccos(np.clip((given * found).sum(axis=1), -1, 1))).max() < 1
    again, same = quantised_directions(found, 256)
    lower = found[:, 2] > 0  # codes of the rim stand for one direction on either side
    assert np.array_equal(code[lower], again[lower])
    np.testing.assert_allclose(found, same, atol=1e-12)
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    np.testing.assert_allclose(quantised_directions(axes, 256)[1], axes, atol=1e-12)
