"""The median distance to the nearest neighbour, against closed forms and all pairs."""

import numpy as np
import pytest

from pointsplat_addon.core.surface.nearest import QUERIES, median_spacing


def lattice(n: int, spacing: float) -> np.ndarray:
    return spacing * np.stack(np.meshgrid(*[np.arange(n)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)


def all_pairs(points: np.ndarray) -> float:
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    distance[distance == 0] = np.inf
    return float(np.median(distance.min(axis=1)))


@pytest.mark.parametrize("spacing", [1e-6, 0.25, 3e4])
@pytest.mark.parametrize("away", [0.0, 100.0])
def test_a_lattice_has_its_spacing(spacing, away):
    points = lattice(20, spacing) + away * spacing
    assert median_spacing(points.astype(np.float32)) == pytest.approx(spacing, rel=1e-4)  # rounding of positions


def test_more_points_than_are_asked():
    points = np.random.default_rng(0).permutation(lattice(64, 0.5))
    assert len(points) > 4 * QUERIES
    assert median_spacing(points) == pytest.approx(0.5)


@pytest.mark.parametrize("seed", range(4))
def test_points_anywhere_against_all_pairs(seed):
    rng = np.random.default_rng(seed)
    clump = rng.normal(size=(700, 3)) * 10 ** rng.uniform(-3, 0, (700, 1))
    sheet = np.column_stack([rng.random((700, 2)), np.zeros(700)])
    points = np.concatenate([clump, sheet])
    assert median_spacing(points) == pytest.approx(all_pairs(points), rel=1e-9)


def test_points_at_one_position_and_outliers_do_not_count():
    points = lattice(12, 0.1)
    outliers = np.array([[1e18, 0, 0], [0, -1e12, 3], [np.nan, 0, 0], [np.inf, 1, 1]])
    doubled = np.concatenate([points, points, points[:50], outliers])
    assert median_spacing(doubled) == pytest.approx(0.1)


def test_nothing_has_no_spacing():
    assert median_spacing(np.zeros((0, 3))) == 0
    assert median_spacing(np.ones((5, 3))) == 0
    assert median_spacing(np.full((3, 3), np.nan)) == 0
    assert median_spacing(np.array([[0, 0, 0], [0, 0, 2.0]])) == 2
