"""The grid of media: what is shared out among its cells, and interpolated between blocks of them."""

import numpy as np
import pytest

from pointsplat_addon.core.indirect import media
from pointsplat_addon.core.indirect.media import Matter, media_grid


def lattice(count: int, turned: float = 0.0, seed: int = 0) -> Matter:
    """Voxels of a cube from -1 to 1, turned about an axis, of density 1 and with the albedo (0.2, 0.5, 1)."""
    edge = 2 / count
    middle = (np.arange(count) + 0.5) * edge - 1
    place = np.stack(np.meshgrid(middle, middle, middle, indexing="ij"), -1).reshape(-1, 3)
    cosine, sine = np.cos(turned), np.sin(turned)
    place = place @ np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]]).T
    whole = np.full(len(place), edge**3)
    scattered = whole[:, None] * np.array([0.2, 0.5, 1.0])
    return Matter(place, whole, scattered, scattered, None, edge)


@pytest.mark.parametrize("count", [7, 40, 96])
@pytest.mark.parametrize("turned", [0.0, 0.4])
def test_nothing_is_lost(count, turned):
    """All cross-sections are there, around the same middle, within 1e-5."""
    matter = lattice(count, turned)
    grid = media_grid([matter])
    assert grid is not None
    volume = grid.edge**3
    assert grid.extinction.sum(dtype=float) * volume == pytest.approx(8, rel=1e-5)
    assert grid.scattering.sum(axis=0, dtype=float) * volume == pytest.approx(8 * np.array([0.2, 0.5, 1]), rel=1e-5)
    middle = (grid.centres(np.arange(len(grid.extinction))) * grid.extinction[:, None]).sum(axis=0)
    assert np.abs(middle).max() * volume < 1e-4


@pytest.mark.parametrize(("turned", "bound"), [(0.0, 1e-5), (0.4, 0.02)])
def test_an_even_lattice_fills_cells_evenly(turned, bound):
    """Cells are whole steps of the voxels. Worst: 2e-7, and turned 0.0135."""
    grid = media_grid([lattice(96, turned)])
    assert grid is not None
    place = grid.centres(np.arange(len(grid.extinction)))
    inner = (np.hypot(place[:, 0], place[:, 1]) < 1 - 2 * grid.edge) & (np.abs(place[:, 2]) < 1 - 2 * grid.edge)
    assert inner.sum() > 10_000
    assert np.abs(grid.extinction[inner] - 1).max() < bound


def test_sizes_are_bounded(monkeypatch):
    """However long and thin a scene is."""
    monkeypatch.setattr(media, "THIN_MEDIA", (64, 1 << 17, 500))
    monkeypatch.setattr(media, "DEEP_MEDIA", (96, 1 << 19, 500))
    rng = np.random.default_rng(1)
    place = rng.uniform(-1, 1, (20_000, 3)) * np.array([1000.0, 300.0, 0.1])
    whole = np.ones(len(place))
    grid = media_grid([Matter(place, whole, np.ones((len(place), 3)), np.ones((len(place), 3)), None, 1e-3)])
    assert grid is not None
    assert grid.shape.max() <= 97
    assert 0 < len(grid.receivers) <= 500


def test_blocks_are_interpolated_as_exponentials_and_filled_at_rims():
    """What falls as an exponential is found again in cells, within 1 %; worst 0.0058."""
    grid = media_grid([lattice(64)])
    assert grid is not None
    depth = 2.0
    found = np.repeat(np.exp(depth * grid.places[:, :1]), 3, axis=1)
    cells = grid.in_cells(grid.on_blocks(found))
    place = grid.centres(np.arange(len(cells)))
    inner = np.abs(place).max(axis=1) < 1 - grid.block * grid.edge
    assert np.abs(cells[inner, 0] / np.exp(depth * place[inner, 0]) - 1).max() < 0.01
    assert (cells > 0).all()  # also where no receiver is


def test_nothing_has_no_grid():
    none = np.zeros((0, 3))
    assert media_grid([]) is None
    assert media_grid([Matter(none, none[:, 0], none, none, None, 1.0)]) is None
