"""Sheets of balls: which balls lie in one, how large it is, and how it is turned."""

import numpy as np
import pytest

from pointsplat_addon.core.indirect.sheets import Sheets, returned_share, sheets

RADIUS = 0.02


def sheets_of(position: np.ndarray, apart: float, look: np.ndarray | None = None) -> Sheets:
    count = len(position)
    look = np.full((count, 6), 0.5) if look is None else look
    return sheets(position, np.full(count, np.pi * RADIUS**2), look, np.full(count, apart))


def square(depth: float, rough: float = 0.0) -> np.ndarray:
    """Balls at random on a square of 1, whose pictures have so many times its area."""
    count = round(depth / (np.pi * RADIUS**2))
    rng = np.random.default_rng(3)
    return np.column_stack([rng.uniform(0, 1, (count, 2)), rough * rng.normal(size=count)])


@pytest.mark.parametrize("depth", [6.0, 12.0])
def test_a_sheet_of_balls_has_its_area(depth):
    """Of a square, 1 - exp(-depth), whatever cells cut off. Found: 2.0 and 1.4 % less."""
    position = square(depth)
    made = sheets_of(position, 0.08)
    assert abs(made.area.sum() / -np.expm1(-depth) - 1) < 0.03
    assert np.abs(made.normal[:, 2]).min() > 0.9999
    assert np.abs(made.position[:, 2]).max() < 1e-9
    np.testing.assert_allclose(made.height, RADIUS, rtol=1e-6)
    assert (made.shares(position, np.full(len(position), 0.08)) == 0).mean() > 0.99


def test_a_sheet_that_was_turned_and_moved_is_turned_with_it():
    """Found: a mean cosine of 0.997; 377 of 385 to one side; an area of 0.98."""
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    made = sheets_of(square(8.0, 0.1 * RADIUS) @ turn.T + 3.0, 0.08)
    upright = made.normal @ turn[:, 2]
    assert (abs(upright) * made.area).sum() / made.area.sum() > 0.99
    assert max((upright > 0).mean(), (upright < 0).mean()) > 0.95
    assert abs(made.area.sum() - 1) < 0.03


def test_a_sheet_has_the_mean_look_of_its_balls():
    position = square(8.0)
    look = np.repeat(position[:, :1], 6, axis=1)
    made = sheets_of(position, 0.08, look)
    np.testing.assert_allclose(made.look, np.repeat(made.position[:, :1], 6, axis=1), atol=1e-12)


def test_balls_that_lie_apart_or_in_space_are_in_no_sheet():
    """Those of a plane that leave most of it open, and most of those that fill a cube, of which as much counts as fills
    what they show. Of cells with ten, in which they lie at random, 17 % are flat."""
    assert len(sheets_of(square(0.2), 0.08).area) == 0
    cube = np.random.default_rng(7).uniform(0, 1, (40_000, 3))
    made = sheets_of(cube, 0.08)
    share = made.shares(cube, np.full(len(cube), 0.08))[(np.abs(cube - 0.5) < 0.4).all(axis=1)]
    assert (share > 0).mean() > 0.8
    assert share.mean() < 0.5
    few = cube[:500]
    assert (sheets_of(few, 0.08).shares(few, np.full(500, 0.08)) == 1).all()


def test_some_balls_stand_for_all():
    """Every third of three times as many: the same heights, and 3.0 % less of the area."""
    position = square(18.0)[::3]
    count = len(position)
    made = sheets(position, np.full(count, np.pi * RADIUS**2), np.zeros((count, 6)), np.full(count, 0.08), 3.0)
    np.testing.assert_allclose(made.height, RADIUS, rtol=1e-6)
    assert abs(made.area.sum() - 1) < 0.04


def test_what_is_no_number_is_in_no_sheet():
    position = square(6.0)
    position[::10] = np.nan
    with np.errstate(invalid="ignore"):
        made = sheets_of(position, 0.08)
    for found in (made.position, made.normal, made.area, made.look, made.height, made.returned):
        assert np.isfinite(found).all()
    assert abs(made.area.sum() - 1) < 0.07


@pytest.mark.parametrize("depth", [2.0, 5.7, 12.0])
@pytest.mark.parametrize("spread", [0.0, 0.2, 0.5])
def test_as_much_light_returns_to_balls_as_they_have_more_area_than_their_plane(depth, spread):
    """What is seen of balls from before, by 20,000 places; the mean of one over the cosine is how much more. Found: off
    by 0.0045 at most."""
    place, rng = np.random.default_rng(8).uniform(0.1, 0.9, (20_000, 2)), np.random.default_rng(9)
    position = square(depth)
    middle = np.column_stack([position[:, :2] / RADIUS, spread * rng.normal(size=len(position))])
    place = place / RADIUS
    cosine = np.full(len(place), -1.0)
    highest = np.full(len(place), -np.inf)
    cell = np.floor(place / 2).astype(int)
    of_ball = np.floor(middle[:, :2] / 2).astype(int)
    wide = int(0.5 / RADIUS) + 2
    order = np.argsort(of_ball @ [wide, 1], kind="stable")
    starts = np.searchsorted((of_ball @ [wide, 1])[order], np.arange(wide * wide + 1))
    for step in np.ndindex(3, 3):
        there = (cell + np.array(step) - 1) @ [wide, 1]
        first, end = starts[there], starts[there + 1]
        for k in range(int((end - first).max())):
            ball = middle[order[np.minimum(first + k, len(order) - 1)]]
            squared = np.square(place - ball[:, :2]).sum(axis=1)
            rise = np.sqrt(np.maximum(1 - squared, 0))
            higher = (first + k < end) & (squared < 1) & (ball[:, 2] + rise > highest)
            highest = np.where(higher, ball[:, 2] + rise, highest)
            cosine = np.where(higher, rise, cosine)
    cosine = cosine[cosine > 0]
    # Few cosines are nearly 0, and their inverses are large.
    truth = 1 - 1 / np.mean(1 / np.maximum(cosine, 0.01))
    found = returned_share(np.array([depth]), np.array([spread]))[0]
    assert abs(found - truth) < 0.008


def test_flat_or_deep_sheets_return_less_or_as_much_as_the_deepest_that_are_known():
    assert returned_share(np.array([1e-9, 1e9]), np.array([0.0, 0.0])).max() < 0.7
    deep = returned_share(np.array([5.0, 5.0]), np.array([2.0, 9.0]))
    assert deep[0] == deep[1]
