"""What is measured of many small meshes together is what is measured of each by itself."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene import mesh as mesh_module
from pointsplat_addon.core.scene.bounds import (
    bounding_box,
    triangle_boxes,
    triangles_ball,
    triangles_balls,
    used_positions,
)
from pointsplat_addon.core.scene.mesh import FEW_TRIANGLES, Mesh, joined
from pointsplat_addon.core.scene.valid.geometry import valid_mesh, valid_meshes
from pointsplat_addon.core.surface.seen import sketch_of_triangles, sketches_of_meshes

F = np.float32


def mesh(number: int, triangles: int) -> Mesh:
    """Triangles at random, with as many vertices more that none of them has."""
    rng = np.random.default_rng(number)
    position = (rng.normal(size=(6 * triangles + 3, 3)) * 10.0 ** rng.integers(-3, 4)).astype(F)
    rows = rng.permutation(3 * triangles).reshape(-1, 3).astype(np.int32)
    return Mesh(f"mesh {number}", "Mesh", position, rows)


def meshes() -> list[Mesh]:
    return [mesh(number, count) for number, count in enumerate((1, 200, FEW_TRIANGLES, 7, FEW_TRIANGLES + 1, 300, 2))]


def with_faults() -> list[Mesh]:
    """Each third has something to leave out, of every kind: one only that another mesh's vertices would hide."""
    found = meshes() * 3
    for row, bad in ((0, len(found[0].position)), (3, -1)):
        triangles = found[row].triangles.copy()
        triangles[0, 0] = bad
        found[row] = replace(found[row], triangles=triangles)
    for row, value in ((9, np.nan), (12, 1e20), (15, np.inf)):
        position = found[row].position.copy()
        position[found[row].triangles[0, 1]] = value
        found[row] = replace(found[row], position=position)
    position = found[20].position.copy()
    position[-1] = np.nan  # a vertex that no triangle has
    found[20] = replace(found[20], position=position)
    triangles = found[17].triangles.copy()
    triangles[0] = triangles[0, 0]
    found[17] = replace(found[17], triangles=triangles)
    return found


@pytest.fixture(params=[1, 500, 1 << 16])
def together(request, monkeypatch):
    monkeypatch.setattr(mesh_module, "TOGETHER", request.param)


@pytest.mark.usefixtures("together")
def test_each_small_mesh_is_there_once():
    given = [*meshes(), Mesh("", "", np.zeros((0, 3), F), np.zeros((0, 3), np.int32))]
    found = list(joined(given))
    assert [row for some in found for row in some.rows] == [0, 1, 2, 3, 5, 6]
    for some in found:
        for row, first, last in zip(some.rows, some.first, some.first[1:], strict=False):
            assert (some.corners[3 * first : 3 * last] == given[row].position[given[row].triangles.reshape(-1)]).all()


@pytest.mark.usefixtures("together")
@pytest.mark.parametrize("given", [meshes(), with_faults()], ids=["whole", "with faults"])
def test_the_same_triangles_are_left_out(given):
    for (found, dropped), one in zip(valid_meshes(given), given, strict=True):
        expected, count = valid_mesh(one)
        assert dropped == count
        assert (found is one) == (expected is one)
        assert (found.triangles == expected.triangles).all()
        assert (found.position == expected.position).all()


@pytest.mark.usefixtures("together")
def test_boxes_and_balls_are_the_same_to_the_bit():
    given = meshes()
    for one, box, (middle, radius) in zip(given, triangle_boxes(given), triangles_balls(given), strict=True):
        assert (np.array(box) == bounding_box(used_positions(one))).all()
        assert (middle == triangles_ball(one)[0]).all()
        assert radius == triangles_ball(one)[1]


@pytest.mark.usefixtures("together")
def test_sketches_are_the_same():
    given = meshes()
    for one, found in zip(given, sketches_of_meshes(given), strict=True):
        expected = sketch_of_triangles(one.position, one.triangles)
        assert (found.points == expected.points).all()
        assert sorted(found.large.tolist()) == sorted(expected.large.tolist())
        assert (found.middle == expected.middle).all()
        assert abs(found.radius - expected.radius) <= 1e-15 * expected.radius  # worst 0
