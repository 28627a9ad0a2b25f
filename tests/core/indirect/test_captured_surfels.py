"""Surfels of captured splats: what they hide from before and from beside, and what light they send."""

import numpy as np
import pytest

from pointsplat_addon.core.indirect import captured
from pointsplat_addon.core.indirect.captured import captured_surfels, dilogarithm
from pointsplat_addon.core.material.color_models import linear_from_srgb
from pointsplat_addon.core.scene.captured import CapturedSplats
from scripts.scenes.build import moved


def splats_at(position: np.ndarray, scale: np.ndarray, opacity: float, rotation=(1, 0, 0, 0)) -> CapturedSplats:
    count, f = len(position), np.float32
    turn = np.tile(np.array([rotation], f), (count, 1))
    scale = np.broadcast_to(scale, (count, 3)).astype(f)
    return CapturedSplats(position.astype(f), scale, turn, np.zeros((count, 3), f), np.full(count, opacity, f))


def even(apart: float):
    return lambda at: (np.full(at.shape[1], apart), np.full(at.shape[1], np.inf))


def test_the_dilogarithm_has_its_known_values():
    """Worst: 1.1e-10 at a half, where the series is cut."""
    half = np.pi**2 / 12 - np.log(2) ** 2 / 2
    np.testing.assert_allclose(dilogarithm(np.array([0.0, 0.5, 1.0])), [0, half, np.pi**2 / 6], atol=5e-10)
    # Against the integral of -ln(1 - x) / x, by 100,000 midpoints.
    x = (np.arange(100_000) + 0.5) * 9e-6
    assert abs(dilogarithm(np.array([0.9]))[0] - (-np.log1p(-x) / x).sum() * 9e-6) < 1e-9


@pytest.mark.parametrize(("opacity", "bound"), [(0.01, 1e-3), (0.5, 0.04), (0.9, 0.04)])
def test_a_disk_hides_its_share(opacity, bound):
    """2 pi a b o of its picture, under a transform that turns and grows it. Found: 0.08, 3.4 and 3.1 % off."""
    turn = np.array([0.5, 0.5, 0.5, 0.5])
    disk = splats_at(np.zeros((1, 3)), np.array([0.02, 0.03, 0]), opacity, tuple(turn))
    made = captured_surfels(disk, moved((1, 2, 3), 2.0), even(10.0))
    assert len(made.area) == 1
    np.testing.assert_allclose(made.position, [[1, 2, 3]], atol=1e-6)
    # The turn takes z to x, and the disk is flat: a normal of full length.
    np.testing.assert_allclose(np.abs(made.normal), [[1, 0, 0]], atol=1e-6)
    assert abs(made.area[0] / (2 * np.pi * 0.04 * 0.06 * opacity) - 1) < bound
    np.testing.assert_allclose(made.color, np.broadcast_to(linear_from_srgb(np.array(0.5)), (1, 3)), rtol=1e-6)


def test_a_round_splat_hides_as_much_from_all_sides():
    """Half of the area that is counted. Found: 3.4 % off, as a disk."""
    made = captured_surfels(splats_at(np.zeros((1, 3)), np.full(3, 0.03), 0.5), np.eye(4), even(10.0))
    assert not made.normal.any()
    assert abs(0.5 * made.area[0] / (2 * np.pi * 0.03**2 * 0.5) - 1) < 0.04


@pytest.mark.parametrize(("opacity", "width"), [(0.99, 0.05), (0.1, 0.05), (0.02, 0.1)])
def test_a_sheet_hides_what_its_optical_depth_tells(opacity, width):
    """Over its middle, also by splats that are larger than cells: 1 - exp(-depth). Found: 0.04 % off at most."""
    at = (np.arange(80) + 0.5) / 80 - 0.5
    x, y = (a.ravel() for a in np.meshgrid(at, at))
    sheet = splats_at(np.stack([x, y, 0 * x], axis=1), np.array([width / 2, width / 2, 1e-5]), opacity)
    made = captured_surfels(sheet, np.eye(4), even(0.0625))
    inner = np.abs(made.position[:, :2]).max(axis=1) < 0.1875
    depth = 2 * np.pi * (width / 2) ** 2 * dilogarithm(np.array([opacity]))[0] * 80**2
    share = made.area[inner].sum() / (inner.sum() * 0.0625**2)
    assert abs(share / -np.expm1(-depth) - 1) < 1e-3


def test_what_shows_nothing_is_left_out():
    faint = splats_at(np.zeros((4, 3)), np.full(3, 0.1), 1e-3)
    assert len(captured_surfels(faint, np.eye(4), even(1.0)).area) == 0


def test_very_many_parts_are_bounded():
    """3,000 splats, each a thousand cells wide, would be cut into 7 million parts; there are 2^20 at most."""
    rng = np.random.default_rng(3)
    wide = splats_at(rng.uniform(-1, 1, (3000, 3)), np.array([1.0, 1.0, 0.01]), 0.3)
    assert len(captured_surfels(wide, np.eye(4), even(0.005)).area) <= 1 << 20


def test_cells_grow_where_there_would_be_too_many(monkeypatch):
    """20,000 splats in nearly as many cells, of which 4,000 are allowed: 729 wider ones hide as much. Found: 0.31 %."""
    rng = np.random.default_rng(9)
    some = splats_at(rng.uniform(-1, 1, (20000, 3)), np.full(3, 0.002), 0.01)
    fine = captured_surfels(some, np.eye(4), even(0.03125))
    monkeypatch.setattr(captured, "SAMPLED", 10000)
    monkeypatch.setattr(captured, "MOST_CELLS", 4000)
    coarse = captured_surfels(some, np.eye(4), even(0.03125))
    assert len(fine.area) > 15000
    assert len(coarse.area) <= 4000
    assert abs(coarse.area.sum() / fine.area.sum() - 1) < 0.005


def test_many_are_taken_in_batches(monkeypatch):
    """With the same result, but for the order of sums."""
    rng = np.random.default_rng(8)
    some = splats_at(rng.uniform(-1, 1, (5000, 3)), np.exp(rng.uniform(-6, -4, (5000, 3))), 0.5)
    at_once = captured_surfels(some, np.eye(4), even(0.0625))
    monkeypatch.setattr(captured, "BATCH", 700)
    again = captured_surfels(some, np.eye(4), even(0.0625))
    np.testing.assert_allclose(again.position, at_once.position, atol=1e-6)
    np.testing.assert_allclose(again.area, at_once.area, rtol=1e-5)
