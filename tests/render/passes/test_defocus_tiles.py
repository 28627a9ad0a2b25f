"""Tiles list every splat that one of their pixels shows, the nearest first (render/passes/defocus/gather.py)."""

import numpy as np
import pytest

from pointsplat_addon.core.lens import kernel
from pointsplat_addon.render.passes.defocus.tile_lists import TRANSLUCENT, Planes, tile_lists
from tests.reference import defocus

SIZE = (61, 43)  # neither is a multiple of a tile


def splats(count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Place and shape (N, 4) as the pass `light` leaves them, with covariances (N, 2, 2) and exponents (N,); some lie
    beside the picture, some are not seen."""
    random = np.random.default_rng(seed)
    centre = random.uniform(-20, 80, (count, 2))
    axes = np.exp(random.uniform(-1, 2.5, (count, 2)))
    turn = random.uniform(0, np.pi, count)
    rotation = np.stack([np.cos(turn), -np.sin(turn), np.sin(turn), np.cos(turn)], axis=1).reshape(-1, 2, 2)
    covariance = np.einsum("nij,nj,nkj->nik", rotation, axes**2, rotation)
    inverse = np.linalg.inv(covariance)
    k = np.where(random.random(count) < 0.3, 0.0, random.uniform(0, 4, count))
    place = np.stack([*centre.T, random.uniform(1, 9, count), 10 ** random.uniform(-2, 2, count)], axis=1)
    place[random.random(count) < 0.05, 3] = 0
    place[random.random(count) < 0.02, 0] = np.nan
    kind = 8.0 * random.integers(0, 4, count)
    shape = np.stack([inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 1], k + kind], axis=1)
    return place.astype(np.float32), shape.astype(np.float32), covariance, k


@pytest.mark.parametrize("seed", range(4))
def test_no_pixel_misses_a_splat(seed: int) -> None:
    place, shape, covariance, k = splats(300, seed)
    corner = np.array([3.25, -1.5])
    lists = tile_lists(place, shape, np.array([1.0, 1.0, *corner]), SIZE)
    x, y = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    pixels = np.stack([x.ravel(), y.ravel()], axis=1) + 0.5
    count = len(place)
    of = defocus.Splats(
        place[:, :2] + corner, place[:, 2], covariance, k, np.ones(count), np.ones((count, 3)), np.ones(count),
        np.zeros(count, bool), np.zeros(count, bool), np.zeros(count, bool),
    )  # fmt: skip
    peak = defocus.kernel(np.zeros(count), k, np.linalg.det(covariance))
    with np.errstate(invalid="ignore"):
        shown = defocus.drawn_kernel(pixels, of) > kernel.NEGLIGIBLE * peak / np.maximum(place[:, 3], 1)
    shown &= place[:, 3] > 0
    assert shown.any(axis=1).mean() > 0.9
    owner = np.zeros((len(lists.tiles) * lists.tiles.shape[1], count), bool)
    first, amount = lists.tiles.reshape(-1, 2).T
    owner[np.repeat(np.arange(len(amount)), amount), lists.entries[: amount.sum()]] = True
    tile = (pixels // lists.tile).astype(int) @ [1, lists.tiles.shape[1]]
    assert not (shown & ~owner[tile]).any()
    # Rectangles around circles around ellipses are more than what is shown, by what long ellipses leave of them.
    assert (owner.sum() / _tiles(shown, tile, len(owner))) < 1.8  # measured 1.61
    assert (first[1:] == np.cumsum(amount)[:-1]).all()


@pytest.mark.parametrize("seed", range(2))
def test_the_nearest_come_first(seed: int) -> None:
    place, shape, _, _ = splats(300, seed)
    lists = tile_lists(place, shape, np.array([1.0, 1, 0, 0]), SIZE)
    depth = place[lists.entries, 2]
    ends = np.cumsum(lists.tiles.reshape(-1, 2)[:, 1])
    within = np.setdiff1d(np.arange(1, len(depth)), ends)
    assert len(within) > 100
    assert (depth[within] >= depth[within - 1]).all()


@pytest.mark.parametrize("perspective", [True, False])
def test_what_light_passes_comes_in_the_order_of_planes(perspective: bool) -> None:
    """Splats of two planes at a slant, one 1/500 of its depth behind the other, whose middles mix."""
    random = np.random.default_rng(3)
    place, shape, _, _ = splats(400, 3)
    place = np.nan_to_num(place)
    behind = random.random(400) < 0.5
    # A plane's inverse depth changes evenly in perspective; its depth does for parallel rays.
    across = 0.2 + place[:, :2] @ [0.001, -0.0004]
    plane = (1 / across if perspective else 25 * across) * np.where(behind, 1.002, 1.0)
    slope = -np.outer(plane * plane, [0.001, -0.0004]) * np.where(behind, 1 / 1.002, 1.0)[:, None]
    slope = slope if perspective else np.outer(25 * np.where(behind, 1.002, 1.0), [0.001, -0.0004])
    beside = random.uniform(-2, 2, (400, 2))  # their kernels lie beside their middles
    place[:, 2] = plane
    place[:, :2] += beside
    shape[:, 3] = shape[:, 3] % 8 + TRANSLUCENT
    planes = Planes(np.hstack([slope, beside]).astype(np.float32), perspective)
    lists = tile_lists(place, shape, np.array([1.0, 1, 0, 0]), SIZE, planes)
    first, amount = lists.tiles.reshape(-1, 2).T
    mixed = 0
    for at, count in zip(first, amount, strict=True):
        mine = lists.entries[at : at + count]
        assert (np.diff(behind[mine].astype(int)) >= 0).all()
        mixed += bool(count) and place[mine[behind[mine]], 2].min(initial=9) < place[mine[~behind[mine]], 2].max(
            initial=0
        )
    assert mixed > 100


def _tiles(shown: np.ndarray, tile: np.ndarray, tiles: int) -> int:
    """Pairs of a tile and a splat that one of its pixels shows."""
    found = np.zeros((tiles, shown.shape[1]), bool)
    np.logical_or.at(found, tile, shown)
    return int(found.sum())
