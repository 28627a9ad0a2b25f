"""Nodes that depend on the eye, against closed forms in float64."""

import numpy as np

from pointsplat_addon.core.material.expression import Expression, SampleInputs, evaluate
from pointsplat_addon.core.material.nodes.input_nodes import Constant, Coordinates
from pointsplat_addon.core.material.nodes.view_nodes import (
    MEAN_COSINE,
    Cosine,
    Facing,
    Incoming,
    InView,
    InWindow,
    Reflectance,
    Reflected,
)
from pointsplat_addon.core.scene.camera import Camera

POSITION, NORMAL = Coordinates("position"), Coordinates("normal")
INCOMING = Incoming(POSITION)
COSINE = Cosine(INCOMING, NORMAL)
CENTRE = np.array([0.3, -2.0, 1.0])
FRONT, BACK = Constant((0.0,)), Constant((1.0,))


def eye(perspective: bool = True) -> Camera:
    """At CENTRE, turned at random; a picture of 90 degrees, or of 4 units."""
    axes, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    axes *= np.sign(np.linalg.det(axes))
    view = np.eye(4)
    view[:3, :3], view[:3, 3] = axes, -axes @ CENTRE
    clip = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, -0.2], [0, 0, -1, 0]], float)
    return Camera(view, clip if perspective else np.diag([0.5, 0.5, -0.01, 1]), (100, 100))


def samples(of: Camera | None) -> SampleInputs:
    rng = np.random.default_rng(5)
    normal = rng.normal(size=(500, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return SampleInputs(position=rng.normal(size=(500, 3)).astype(np.float32), normal=normal.astype(np.float32), eye=of)


def toward(inputs: SampleInputs) -> np.ndarray:
    """(N, 3) float64 unit, from positions to CENTRE."""
    assert inputs.position is not None
    way = CENTRE - inputs.position
    return way / np.linalg.norm(way, axis=1, keepdims=True)


def by_snell(cosine: np.ndarray, index: float) -> np.ndarray:
    """Fresnel's reflectance of unpolarised light that meets a medium of this relative index."""
    sine2 = (1 - cosine**2) / index**2
    inside = np.sqrt(np.maximum(1 - sine2, 0))
    parallel = (index * cosine - inside) / (index * cosine + inside)
    across = (cosine - index * inside) / (cosine + index * inside)
    return np.where(sine2 >= 1, 1, 0.5 * (parallel**2 + across**2))


def worst(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.abs(found - expected).max())


def test_cosines_and_mirrored_directions_are_those_of_the_way_to_the_eye():
    inputs = samples(eye())
    way, normal = toward(inputs), np.asarray(inputs.normal, float)
    cosine = (way * normal).sum(axis=1, keepdims=True)
    assert worst(evaluate(INCOMING, inputs), way) < 1e-6  # measured 2e-7
    assert worst(evaluate(COSINE, inputs), np.abs(cosine)) < 1e-6  # measured 2e-7
    assert worst(evaluate(Reflected(INCOMING, NORMAL), inputs), 2 * cosine * normal - way) < 1e-6  # measured 3e-7


def test_in_parallel_views_all_look_one_way():
    inputs, of = samples(eye(False)), eye(False)
    assert worst(evaluate(INCOMING, inputs), of.view_from_world[2, :3]) < 1e-7  # measured 3e-8


def test_coordinates_by_the_camera_are_its_projection():
    for perspective in (True, False):
        inputs, of = samples(eye(perspective)), eye(perspective)
        assert inputs.position is not None
        view = inputs.position @ of.view_from_world[:3, :3].T + of.view_from_world[:3, 3]
        assert worst(evaluate(InView(POSITION), inputs), view * [1, 1, -1]) < 2e-6  # measured 4e-7
        x, y = view[:, :2].T / (-view[:, 2] if perspective else 2)
        seen = (-view[:, 2] > 0.2) & (np.abs(x) < 2) & (np.abs(y) < 2)
        expected = np.stack([0.5 + 0.5 * x, 0.5 + 0.5 * y, np.zeros_like(x)], axis=1)
        assert seen.sum() > 20
        assert worst(evaluate(InWindow(POSITION), inputs)[seen], expected[seen]) < 1e-5  # measured 2e-6


def test_reflectance_is_fresnels_from_both_sides():
    inputs = samples(eye())
    cosine = np.abs((toward(inputs) * np.asarray(inputs.normal, float)).sum(axis=1, keepdims=True))
    for index in (1.1, 1.5, 2.4):
        given = Constant((index,))
        front, back = (evaluate(Reflectance(COSINE, given, side), inputs) for side in (FRONT, BACK))
        assert worst(front, by_snell(cosine, index)) < 1e-5  # measured 2e-6
        total = 1 - cosine**2 > 0.999 / index**2  # near it, the curve is vertical
        assert worst(back[~total], by_snell(cosine, 1 / index)[~total]) < 1e-3  # measured 2e-4
        assert (back[1 - cosine**2 > 1.001 / index**2] == 1).all()


def test_facing_bends_the_cosine_by_its_blend():
    inputs = samples(eye())
    cosine = np.abs((toward(inputs) * np.asarray(inputs.normal, float)).sum(axis=1, keepdims=True))
    for blend, power in ((0.0, 0.0), (0.25, 0.5), (0.5, 1.0), (0.75, 2.0), (0.9, 5.0)):
        assert worst(evaluate(Facing(COSINE, Constant((blend,))), inputs), 1 - cosine**power) < 1e-4  # measured 2e-5


def test_without_an_eye_cosines_are_the_mean_over_a_balls_picture():
    inputs = samples(None)
    radius = np.sqrt((np.arange(100000) + 0.5) / 100000)  # evenly over a disk
    assert abs(np.sqrt(1 - radius**2).mean() - MEAN_COSINE) < 1e-6
    assert (evaluate(COSINE, inputs) == np.float32(MEAN_COSINE)).all()
    others: tuple[Expression, ...] = (INCOMING, InView(POSITION), InWindow(POSITION), Reflected(INCOMING, NORMAL))
    assert all((evaluate(other, inputs) == 0).all() for other in others)
