"""Projections of images: what is seen from six sides counts once together, and nothing is not finite."""

import numpy as np
import pytest

from pointsplat_addon.core.material.expression import SampleInputs, evaluate
from pointsplat_addon.core.material.nodes.input_nodes import Constant, Coordinates
from pointsplat_addon.core.material.nodes.projection_nodes import FromSide, FromSixSides, Wrapped

AXES = np.concatenate([np.eye(3), -np.eye(3), np.zeros((1, 3))])


def inputs(rng: np.random.Generator) -> SampleInputs:
    normal = np.concatenate([rng.normal(size=(1000, 3)), AXES, rng.choice([-1, 0, 1], (100, 3))])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    return SampleInputs(position=rng.uniform(-2, 2, normal.shape).astype(np.float32), normal=normal.astype(np.float32))


@pytest.mark.parametrize("blend", [0.0, 1e-6, 0.3, 1.0])
def test_what_six_sides_show_counts_once(blend: float) -> None:
    x, y, z = (Constant((1.0, float(axis == 0), float(axis == 1), float(axis == 2))) for axis in range(3))
    samples = inputs(np.random.default_rng(1))
    found = evaluate(FromSixSides(x, y, z, Coordinates("normal"), blend), samples)
    np.testing.assert_allclose(found[:, 0], 1, atol=1e-6)  # measured 1.2e-7
    assert found[:, 1:].min() >= -1e-6
    straight = evaluate(
        FromSixSides(x, y, z, Coordinates("normal"), blend), SampleInputs(normal=AXES[:6].astype(np.float32))
    )
    np.testing.assert_array_equal(straight[:, 1:], np.abs(AXES[:6]))


@pytest.mark.parametrize("node", [
    Wrapped(Coordinates("position"), True), Wrapped(Coordinates("position"), False),
    *(FromSide(Coordinates("position"), Coordinates("normal"), axis) for axis in range(3)),
])  # fmt: skip
def test_all_places_have_finite_coordinates(node: Wrapped | FromSide) -> None:
    samples = inputs(np.random.default_rng(2))
    assert samples.position is not None
    samples.position[:3] = 0.5, 0.5, 0.5  # the middle
    samples.position[3] = 0.5, 0.5, 1  # the pole
    found = evaluate(node, samples)
    assert np.isfinite(found).all()
    if isinstance(node, Wrapped):
        assert found[:, 0].min() >= 0
        assert found[:, 0].max() <= 1
