"""How coarse pictures get while a view moves."""

import numpy as np
import pytest

from pointsplat_addon.render.budget.viewport import FRAME_SECONDS, HASTY_PIXELS, LEAST_PAUSE, STEPS, Arrivals, Pace

COARSEST = max(times for times, _ in STEPS)


@pytest.mark.parametrize(("whole", "shared"), [(0.01, 0.005), (0.5, 0.01), (1.5, 0.05), (0.0, 0.3), (30.0, 0.0)])
def test_pictures_keep_their_time_and_do_not_flicker(whole, shared):
    """`whole`: seconds of all pixels of the finest picture; `shared`: what does not depend on pixels."""
    pace, sizes = Pace(), []
    for _ in range(12):
        sizes.append(pace.times)
        pace.measured(whole / pace.times**2 + shared)
    assert len(set(sizes[6:])) == 1
    taken = whole / sizes[-1] ** 2 + shared
    assert taken <= FRAME_SECONDS or sizes[-1] == COARSEST
    finer = sizes[-1] // 2
    assert finer == 0 or whole / finer**2 + shared > FRAME_SECONDS


@pytest.mark.parametrize("dimensions", [2, 3])  # of surfaces and of what is solid: nodes over tolerance
@pytest.mark.parametrize("whole", [1e-4, 0.02, 0.09, 0.5, 2.0, 5.0, 20.0, 1000.0])
def test_nodes_are_as_fine_as_time_allows_and_do_not_flicker(whole, dimensions):
    """`whole`: seconds of all nodes at the tolerance of a view that stands still."""

    def taken(tolerance: float) -> float:
        return whole / tolerance**dimensions

    pace, found = Pace(), []
    for _ in range(12):
        found.append(pace.tolerance * pace.times)
        pace.measured(taken(found[-1]))
    assert len(set(found[6:])) == 1
    coarsest, finest = STEPS[-1][1], STEPS[0][1]
    assert taken(found[-1]) <= FRAME_SECONDS or found[-1] == coarsest
    assert found[-1] == finest or taken(found[-1]) > 0.1 * FRAME_SECONDS


def test_the_first_picture_and_a_slow_one_are_forgotten():
    pace = Pace()
    pace.measured(3.0)  # compiles shaders
    assert (pace.times, pace.tolerance) == (1, 4.0)
    pace.measured(3.0)
    assert (pace.times, pace.tolerance) == (2, 2.0)
    for _ in range(2):
        pace.measured(0.015)
    assert (pace.times, pace.tolerance) == (1, 4.0)


@pytest.mark.parametrize("rate", [50.0, 500.0, 5000.0])  # pages a second
@pytest.mark.parametrize("took", [0.01, 0.3, 2.0])  # seconds of a picture of all pages
def test_pictures_while_pages_come_leave_time_for_them(rate, took):
    pages, begun = 1000, []
    arrivals = Arrivals()
    arrivals.drawn(-1.0, 1.0, hasty=True, there=0)  # compiles shaders
    shown, at = 64, 0.0
    for now in np.arange(0.0, pages / rate, 0.01):
        there = min(int(rate * now), pages)
        if now >= at and arrivals.are_enough(now, shown, there - shown, pages - there, there):
            seconds = took * there / pages
            known = seconds if begun else 0.0  # what the first took was compiling
            assert now + known < pages / rate + 0.01  # else all would have come before it is done
            begun.append((now, seconds))
            arrivals.drawn(now, seconds, hasty=True, there=int(rate * (now + seconds)))
            shown, at = there, now + seconds
    gaps = np.diff([now for now, _ in begun])
    assert all(gap >= 2 * seconds + LEAST_PAUSE for gap, (_, seconds) in zip(gaps, begun, strict=False))
    assert begun or pages / rate < LEAST_PAUSE or took > pages / rate / 2


def test_no_picture_is_drawn_where_pages_come_fast_while_nothing_is():
    """Drawing the first one of 64 pages has held up the others: 100 came in two seconds, and then 500 in one."""
    arrivals = Arrivals()
    arrivals.drawn(0.0, 2.0, hasty=True, there=164)
    for now in np.arange(2.0, 3.6, 0.01):
        there = 164 + int(500 * (now - 2))
        assert not arrivals.are_enough(now, 64, there - 64, 1000 - there, there)
    # Of a file from which 20 come in a second there is a picture, as soon as that is known.
    first = next(
        now
        for now in np.arange(2.0, 4.0, 0.01)
        if arrivals.are_enough(now, 64, (came := int(20 * (now - 2))) + 100, 836 - came, 164 + came)
    )
    assert first < 2.0 + 2 * LEAST_PAUSE


def test_pixels_are_coarse_while_pages_come_only_where_fine_ones_take_long():
    arrivals = Arrivals()
    arrivals.drawn(1.0, 5.0, hasty=True, there=0)  # compiles shaders
    assert arrivals.pixels == HASTY_PIXELS
    arrivals.drawn(2.0, 0.5 * LEAST_PAUSE / HASTY_PIXELS**2, hasty=True, there=0)
    assert arrivals.pixels == 1
    arrivals.drawn(3.0, 2.0 * LEAST_PAUSE, hasty=True, there=0)
    assert arrivals.pixels == HASTY_PIXELS
    arrivals.drawn(4.0, 0.1 * LEAST_PAUSE, hasty=False, there=0)  # a fine picture tells nothing of these
    assert arrivals.pixels == HASTY_PIXELS
