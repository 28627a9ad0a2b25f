"""What strands show to a lamp, as the pieces that cast their shadow."""

import numpy as np
import pytest

from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.strands import Strands
from pointsplat_addon.core.shadow.strand_casters import StrandSegments, cut_strands
from pointsplat_addon.core.strand.preparation import with_levels


def cut(points: np.ndarray, radius: float, step: float, matrix: np.ndarray | None = None, **more) -> StrandSegments:
    count = len(points)
    lines = Strands(
        "cast", "cast", points.astype(np.float32), np.array([0, count]), np.full(count, radius, "f4"), **more
    )
    return cut_strands(with_levels(lines), np.eye(4) if matrix is None else matrix, step)


def sun(direction) -> Light:
    d = np.asarray(direction, float)
    return Light("SUN", np.ones(3), np.zeros(3), d / np.linalg.norm(d))


STICK = np.array([[0.0, 0, 0], [0, 0, 1], [0, 0, 3]])


@pytest.mark.parametrize("angle", [0.1, 0.7, np.pi / 2])
def test_a_thin_strand_shows_its_width_times_its_length_times_the_sine(angle):
    light = sun([np.sin(angle), 0, np.cos(angle)])
    found = cut(STICK, 0.001, 0.1).casters_toward(light)
    assert found.kind == "OPAQUE"
    assert found.radius is not None
    area = np.pi * (found.radius.astype(float) ** 2).sum()
    assert abs(area / (2 * 0.001 * 3 * np.sin(angle)) - 1) < 1e-5  # measured 2e-7
    assert len(found) == 30


def test_a_lamp_sees_each_piece_from_where_it_is():
    lamp = Light("POINT", np.ones(3), np.array([1.0, 0, 0]), np.array([0.0, 0, -1]))
    found = cut(STICK, 0.001, 0.01).casters_toward(lamp)
    assert found.radius is not None
    height = found.origin[2] + found.position[:, 2]
    want = 2 * 0.001 * 0.01 / np.sqrt(1 + height**2)
    assert np.abs(np.pi * found.radius**2 / want - 1).max() < 1e-3  # measured 2e-5


def test_scaled_instances_cast_scaled_shadows():
    matrix = np.diag([2.0, 2, 2, 1])
    small, large = cut(STICK, 0.001, 0.1), cut(STICK, 0.001, 0.1, matrix)
    a, b = (np.pi * (p.casters_toward(sun([1, 0, 0])).radius ** 2).sum() for p in (small, large))  # pyright: ignore[reportOptionalOperand]
    assert abs(b / a - 4) < 1e-4  # measured 1e-6


def test_a_wide_strand_is_closed_across():
    """Balls lie in rows across the light, and each reaches the corners of its share."""
    found = cut(STICK, 0.5, 0.1).casters_toward(sun([1, 0, 0]))
    assert found.radius is not None
    assert np.abs(found.position[:, 0]).max() < 1e-6
    assert len(np.unique(found.position[:, 1].round(4))) == 10
    assert np.allclose(found.radius, np.hypot(0.05, 0.05), rtol=1e-5)


def test_a_ribbon_shows_nothing_edge_on():
    normal = np.tile(np.array([0, -1, 0], np.float32), (3, 1))
    ribbon = cut(STICK, 0.01, 0.1, normal=normal)
    face, edge = (ribbon.casters_toward(sun(d)) for d in ([0, 1, 0], [1, 0, 0]))
    assert face.radius is not None
    assert abs(np.pi * (face.radius**2).sum() / (2 * 0.01 * 3) - 1) < 1e-4  # measured 1e-6
    assert len(edge) == 0
