"""How coarse pixels get while a view moves."""

import pytest

from pointsplat_addon.render.budget.viewport import COARSEST_PIXELS, FRAME_SECONDS, PixelPace


@pytest.mark.parametrize(("whole", "shared"), [(0.01, 0.005), (0.5, 0.01), (1.5, 0.05), (0.0, 0.3), (30.0, 0.0)])
def test_pictures_keep_their_time_and_do_not_flicker(whole, shared):
    """`whole`: seconds of all pixels of the finest picture; `shared`: what does not depend on pixels."""
    pace, sizes = PixelPace(), []
    for _ in range(12):
        sizes.append(pace.times)
        pace.measured(whole / pace.times**2 + shared)
    assert len(set(sizes[6:])) == 1
    taken = whole / sizes[-1] ** 2 + shared
    assert taken <= FRAME_SECONDS or sizes[-1] == COARSEST_PIXELS
    finer = sizes[-1] // 2
    assert finer == 0 or whole / finer**2 + shared > FRAME_SECONDS


def test_the_first_picture_and_a_slow_one_are_forgotten():
    pace = PixelPace()
    pace.measured(3.0)  # compiles shaders
    assert pace.times == 1
    pace.measured(3.0)
    assert pace.times == 2
    for _ in range(2):
        pace.measured(0.01)
    assert pace.times == 1
