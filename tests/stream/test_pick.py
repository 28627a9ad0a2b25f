"""Picking: the point that a ray meets first, whichever page holds it, without reading all pages."""

import numpy as np
import pytest

from pointsplat_addon.stream.pick import Ray, pick
from pointsplat_addon.stream.tree import PageTree
from tests.support.octrees import MemoryPages


@pytest.fixture(scope="module")
def source() -> MemoryPages:
    random = np.random.default_rng(9)
    upper, lower = random.uniform(0, 1, (2, 3000, 3)) * [1, 1, 0] + np.array([0, 0, 0.8])[None, None]
    lower[:, 2] = 0.2
    source = MemoryPages(np.concatenate([upper, lower]), 60, 0.1)
    source.columns["intensity"] = np.arange(6000, dtype=np.float32)
    return source


def expected(source: MemoryPages, ray: Ray, height: float) -> int:
    """The point of a plane that lies nearest to a ray straight down."""
    position = source.columns["position"]
    here = np.flatnonzero(np.isclose(position[:, 2], height))
    return int(here[np.argmin(np.linalg.norm((position[here] - ray.start)[:, :2], axis=1))])


@pytest.mark.parametrize("place", [(0.31, 0.72), (0.5, 0.5), (0.9, 0.13)])
@pytest.mark.parametrize(("start", "height"), [(2.0, 0.8), (0.5, 0.2)])
def test_the_first_point_along_a_ray_is_found(source: MemoryPages, place, start: float, height: float) -> None:
    source.read_pages.clear()
    ray = Ray(np.array([*place, start]), np.array([0.0, 0.0, -1.0]), 0.03, 0.0)
    found = pick(PageTree(source.directory), source, ray)
    row = expected(source, ray, height)
    assert found is not None
    np.testing.assert_allclose(found.position, source.columns["position"][row], atol=1e-7)
    assert found.attributes == {"intensity": float(row)}
    assert found.distance == pytest.approx(start - height, abs=1e-6)
    assert len(source.read_pages) < len(source.directory) / 4


def test_what_is_filtered_out_is_looked_through(source: MemoryPages) -> None:
    ray = Ray(np.array([0.5, 0.5, 2.0]), np.array([0.0, 0.0, -1.0]), 0.03, 0.0)
    found = pick(PageTree(source.directory), source, ray, lambda c: np.flatnonzero(c["intensity"] >= 3000))
    assert found is not None
    assert found.position[2] == pytest.approx(0.2)


def test_a_ray_that_meets_nothing_finds_nothing(source: MemoryPages) -> None:
    ray = Ray(np.array([0.5, 0.5, 2.0]), np.array([0.0, 0.0, 1.0]), 0.03, 0.0)
    assert pick(PageTree(source.directory), source, ray) is None
    aside = Ray(np.array([3.0, 0.5, 2.0]), np.array([0.0, 0.0, -1.0]), 0.03, 0.0)
    assert pick(PageTree(source.directory), source, aside) is None
