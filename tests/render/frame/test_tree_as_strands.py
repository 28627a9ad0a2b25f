"""A tree whose branches and leaves are strands, against its polygons."""

import pytest

from pointsplat_addon.core.strand.fit.from_mesh import fit_strands
from scripts.scenes import drawing
from scripts.studies import tree_as_strands as tree

pytest.importorskip("moderngl")


@pytest.fixture(scope="module")
def maple():
    """The tree, and its strands."""
    read = tree.maple()
    return read, fit_strands(read.position, read.triangles)


def test_as_lines_the_tree_has_two_fifths_of_its_vertices(maple):
    ours, every = tree.vertices(*maple)
    assert ours <= 0.4 * every  # measured 0.393
    assert maple[1].remaining_parts <= 0.015 * maple[1].parts  # measured 57 of 5,256


@pytest.mark.parametrize(
    "leaf", [pytest.param(2.4, marks=pytest.mark.long), 4.3, pytest.param(7.9, marks=pytest.mark.long)]
)
def test_leaves_below_eight_pixels_look_as_their_polygons_do(maple, leaf):
    row, *_ = tree.compared(drawing.opengl(), maple[0], maple[1], leaf, shadows=True)
    assert row.psnr >= 30  # dB; measured 33.0 at 2.4 pixels, 32.3 at 4.3, 30.9 at 7.9
    assert row.area == pytest.approx(1, abs=0.01)  # measured 0.994, 0.995, 0.994
