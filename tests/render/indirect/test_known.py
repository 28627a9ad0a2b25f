"""Receivers that speak for others: where light is even, and not near what is near, nor where surfaces turn."""

import numpy as np

from pointsplat_addon.render.frame.indirect.known import Known
from pointsplat_addon.render.frame.indirect.receivers import Receivers

SIDE, TILES = 8, 10  # pixels, of which each is one unit of a plane


def known(light: np.ndarray, nearness: float, normal: np.ndarray) -> tuple[Known, np.ndarray]:
    """One receiver in the middle of each square, with light (TILES^2,); and all groups' pixels (N, 2), row by row."""
    y, x = (a.ravel() for a in np.mgrid[0 : SIDE * TILES, 0 : SIDE * TILES])
    pixels = np.stack([x, y], axis=1) + np.float32(0.5)
    of_tile = np.arange(TILES) * SIDE + SIDE // 2
    rows = (of_tile[:, None] * SIDE * TILES + of_tile).ravel()
    entries = np.stack([np.arange(TILES**2), np.ones(TILES**2)], axis=1).reshape(TILES, TILES, 2)
    found = np.zeros((TILES**2, 8), np.float32)
    found[:, :3], found[:, 3] = light[:, None], nearness
    made = Known(np.column_stack([pixels, 0 * x]).astype(np.float32), normal)
    made.add(
        Receivers(rows, pixels[rows], np.zeros(len(rows)), entries.astype(np.float32)),
        SIDE,
        found,
        np.ones(TILES**2, bool),
    )
    return made, pixels


UP = np.broadcast_to(np.array([0, 0, 1], np.float32), ((SIDE * TILES) ** 2, 3))


def inner(pixels: np.ndarray) -> np.ndarray:
    return np.flatnonzero(((pixels > SIDE) & (pixels < SIDE * (TILES - 1))).all(axis=1))


def test_even_and_slowly_changing_light_is_interpolated():
    """Even light exactly; of a ramp of 1 to 1.5 the worst error found is 8.8e-6: slopes are flattened."""
    ramp = np.tile(np.linspace(1, 1.5, TILES), TILES)
    for light, worst in ((np.ones(TILES**2), 1e-6), (ramp, 2e-5)):
        made, pixels = known(light, 0.0, UP)
        rows = inner(pixels)
        found, valid = made.interpolated(rows, pixels[rows])
        truth = np.interp(pixels[rows, 0], np.arange(TILES) * SIDE + SIDE // 2 + 0.5, light[:TILES])
        assert valid.all()
        assert np.abs(found[:, 0] - truth).max() < worst


def test_light_that_changes_fast_is_not():
    made, pixels = known(np.arange(TILES**2) % 2 + 1.0, 0.0, UP)
    rows = inner(pixels)
    assert not made.interpolated(rows, pixels[rows])[1].any()


def test_receivers_near_things_do_not_speak_for_others():
    """Things at a mean distance of 4 pixels: a receiver speaks for what is within 0.6 pixels."""
    made, pixels = known(np.ones(TILES**2), 0.25, UP)
    rows = inner(pixels)
    assert not made.interpolated(rows, pixels[rows])[1].any()


def test_receivers_that_are_turned_do_not():
    """By more than 26 degrees."""
    turned = UP.copy()
    turned[::2] = np.array([np.sin(0.5), 0, np.cos(0.5)], np.float32)
    made, pixels = known(np.ones(TILES**2), 0.0, turned)
    rows = inner(pixels)
    odd = rows % 2 == 1  # receivers have even rows
    assert not made.interpolated(rows[odd], pixels[rows[odd]])[1].any()
    assert made.interpolated(rows[~odd], pixels[rows[~odd]])[1].all()
