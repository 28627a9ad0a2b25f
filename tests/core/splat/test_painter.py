"""The painter's splats: what they cover alone and on lattices, and how they are laid over each other."""

import numpy as np
import pytest

from tests.reference import painter

STEPS = np.linspace(-0.5, 0.5, 21)


def lattice(reach: int = 4) -> np.ndarray:
    """(N, 2) centres of unit cells."""
    steps = np.arange(-reach, reach + 1.0)
    return np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)


def through(places: np.ndarray, centres: np.ndarray, cell: np.ndarray) -> np.ndarray:
    """(P,) what a lattice of cells (2, 2), whose ellipses reach the corners, lets through at places within a cell."""
    offset = (places[:, None] - centres) @ cell
    # Of the ellipse through the corners of a parallelogram: the image of the circle through those of the unit square.
    moments = 0.5 * cell.T @ cell
    q = np.einsum("pni,ij,pnj->pn", offset, np.linalg.inv(moments), offset)
    return np.prod(1 - painter.alpha(q), axis=1)


def test_alpha_is_whole_in_the_middle_one_half_on_the_ellipse_and_nothing_at_the_rim():
    q = np.linspace(0, painter.SUPPORT, 100)
    alpha = painter.alpha(q)
    assert alpha[0] > 1 - 1e-12  # measured 1 - 5.6e-16
    assert painter.alpha(np.ones(1))[0] == pytest.approx(0.5, abs=1e-15)
    assert (painter.alpha(np.array([painter.SUPPORT, 2 * painter.SUPPORT])) == 0).all()
    assert (np.diff(alpha) <= 0).all()


@pytest.mark.parametrize("cell", [np.eye(2), np.diag([3.0, 0.5]), np.array([[1.0, 0.0], [0.7, 0.6]])])
def test_both_sides_of_a_closed_surface_let_through_less_than_a_step_of_eight_bits(cell):
    places = np.stack(np.meshgrid(STEPS, STEPS), axis=-1).reshape(-1, 2)
    one = through(places, lattice(), cell)
    assert one.max() == pytest.approx(painter.LEAK, rel=1e-9)  # at the corners, where four splats meet
    assert one.mean() < 0.7 / 255  # measured 0.58 / 255
    assert one.max() ** 2 < 1 / 255


def test_a_straight_border_is_half_covered_a_seventh_of_a_spacing_outside():
    """Half a spacing from the outermost centres lies the border of what they are samples of."""
    centres = lattice()
    centres = centres[centres[:, 0] <= 0]
    out, along = np.linspace(0, 1.5, 301), STEPS
    places = np.stack(np.meshgrid(out, along), axis=-1).reshape(-1, 2)
    covered = 1 - through(places, centres, np.eye(2)).reshape(len(along), len(out))
    half = (covered > 0.5).mean(axis=1) * 1.5
    assert half.min() > 0.5
    assert half.mean() - 0.5 < 0.15  # of the spacing; measured 0.142
    # As far as hard disks of the same size reach.
    disks = np.sqrt(0.5 - along**2)
    assert half.mean() == pytest.approx(disks.mean(), abs=0.01)  # measured 0.0062


def test_splats_lie_over_those_before_and_leave_the_rest_to_what_is_behind():
    rng = np.random.default_rng(0)
    pixels, centre = rng.uniform(0, 8, (50, 2)), rng.uniform(0, 8, (12, 2))
    axes = rng.normal(size=(12, 2, 2))
    moments = axes.swapaxes(1, 2) @ axes
    found = painter.weights(pixels, centre, moments)
    alone = np.stack([painter.weights(pixels, centre[i : i + 1], moments[i : i + 1])[:, 0] for i in range(12)], axis=1)
    expected, over = np.zeros_like(found), np.ones(50)
    for i in reversed(range(12)):
        expected[:, i] = alone[:, i] * over
        over = over * (1 - alone[:, i])
    np.testing.assert_allclose(found, expected, atol=1e-14)
    np.testing.assert_allclose(1 - found.sum(axis=1), over, atol=1e-14)


def test_splats_smaller_than_a_pixel_keep_what_they_cover():
    """Their optical depth over the picture, which is thin enough to be what they cover."""
    steps = np.arange(-2, 2, 0.02) + 0.01
    pixels = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    small = 1e-4 * np.eye(2)[None]
    found = painter.weights(pixels, np.zeros((1, 2)), small).sum() * 0.02**2
    q = (pixels**2).sum(axis=1)
    whole = painter.depth(q).sum() * 0.02**2 * 1e-4
    assert found == pytest.approx(whole, rel=0.01)  # measured 0.0032


def test_what_stands_apart_hides_as_much_where_it_is_widened():
    """The integral of alpha over the picture, of splats from a tenth of a pixel to several, at one sample a pixel."""
    steps = (np.arange(600) + 0.5) / 600 * 12 - 6
    places = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    hard = np.pi * painter.SUPPORT * painter.hidden_share(painter.DEPTH)
    for size in (0.02, 0.1, 0.3, 0.6, 1.2):
        moments = np.diag([size**2, 0.25 * size**2])[None]
        found = {
            a: painter.weights(places, np.zeros((1, 2)), moments, disconnected=a).mean() * 144 for a in (True, False)
        }
        assert found[True] == pytest.approx(0.5 * size**2 * hard, rel=0.035)  # measured 0.029
        assert found[False] > found[True]
