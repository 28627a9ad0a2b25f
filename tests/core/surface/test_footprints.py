"""Material graphs over footprints on triangles."""

import numpy as np
import pytest

from pointsplat_addon.core.material.graph import MaterialGraph
from pointsplat_addon.core.material.nodes import color_nodes, input_nodes, math_nodes
from pointsplat_addon.core.scene.materials import default_materials
from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.surface.footprints import footprints, over_footprints

POSITION = np.array([[-9, -9, 0.5], [9, -9, 0.5], [0, 18, 0.5]], np.float32)
TRIANGLE = np.array([[0, 1, 2]], np.int32)
ZERO = input_nodes.Constant((0.0,))


def triangle(position=POSITION) -> Mesh:
    return Mesh("triangle", "Triangle", position, TRIANGLE)


def half(edge: float) -> MaterialGraph:
    """1 where x is above an edge, 0 elsewhere."""
    x = color_nodes.Component(input_nodes.Coordinates("position"), 0)
    above = math_nodes.Math(x, input_nodes.Constant((edge,)), ZERO, "GREATER_THAN")
    return MaterialGraph(base_color=color_nodes.Color(above))


def over(graph: MaterialGraph, mesh: Mesh, position: np.ndarray, across, along) -> np.ndarray:
    count = len(position)
    ways = (np.broadcast_to(way, (count, 3)) for way in (across, along))
    samples = footprints(mesh, np.zeros(count, np.int64), position, *ways)
    color = over_footprints(mesh, samples, {0: graph}, default_materials(), np.ones(count, np.float32))[0].color
    assert color is not None
    return color[:, 0]


def test_an_edge_through_a_footprint_counts_by_the_share_beyond_it():
    """A square of two by two about x, of which (x + 1 - edge) / 2 lies beyond the edge."""
    x = np.linspace(-1.3, 1.3, 261)
    position = np.column_stack([x, 0 * x + 0.3, 0 * x + 0.5])
    found = over(half(0.0), triangle(), position, [1.0, 0, 0], [0, 1.0, 0])
    error = found - np.clip((x + 1) / 2, 0, 1)
    # Measured: 0.031 at most where places on both sides were seen; an eighth, where the edge cuts off less than the
    # first two places see.
    assert np.abs(error[np.abs(x) < 0.74]).max() < 0.032
    assert np.abs(error).max() < 0.13
    assert abs(error.mean()) < 1e-3


def test_a_value_that_changes_evenly_is_that_of_the_middle():
    graph = MaterialGraph(base_color=color_nodes.Color(color_nodes.Component(input_nodes.Coordinates("position"), 0)))
    position = np.array([[1.5, 2.0, 0.5], [3.0, -4.0, 0.5]])
    found = over(graph, triangle(), position, [0.3, 0.2, 0], [0.1, -0.4, 0])
    np.testing.assert_allclose(found, position[:, 0], rtol=0, atol=1e-6)  # measured: 1.2e-7


def test_normals_that_turn_have_a_shorter_mean():
    """Those of a fan, which turn evenly by twice the angle a, have a mean of the length sin(a) / a."""
    angle = 0.4
    position = color_nodes.Component(input_nodes.Coordinates("position"), 0)
    sine, cosine = (math_nodes.Math(position, ZERO, ZERO, name) for name in ("SINE", "COSINE"))
    graph = MaterialGraph(normal=color_nodes.Combine(sine, ZERO, cosine))
    ways = np.array([[angle, 0, 0]]), np.array([[0, angle, 0]])
    samples = footprints(triangle(), np.zeros(1, np.int64), np.array([[0, 0, 0.5]]), *ways)
    normal = over_footprints(triangle(), samples, {0: graph}, default_materials(), np.ones(1, np.float32))[0].normal
    assert normal is not None
    truth = np.sin(angle) / angle
    assert abs(normal[0, 2] - truth) < 0.002  # measured: 0.0012
    assert abs(normal[0, 0]) < 1e-3


@pytest.mark.parametrize("scale", [1e-15, 1e-3, 1e3, 1e15])
def test_places_hold_at_all_scales(scale):
    position = np.array([[1.5, 2.0, 0.5]])
    mesh = triangle((scale * POSITION).astype(np.float32))
    across, along = np.array([[1.0, 0, 0]]), np.array([[0, 1.0, 0]])
    samples = footprints(mesh, np.zeros(1, np.int64), scale * position, scale * across, scale * along)
    once = footprints(triangle(), np.zeros(1, np.int64), position, across, along)
    assert once.ellipse is not None
    assert samples.ellipse is not None
    np.testing.assert_allclose(samples.barycentric, once.barycentric, rtol=1e-6)
    np.testing.assert_allclose(samples.ellipse, once.ellipse, rtol=1e-6, atol=1e-7)


def test_triangles_without_an_area_have_the_value_of_a_corner():
    flat = triangle(np.array([[1, 2, 3], [1, 2, 3], [4, 5, 6]], np.float32))
    found = over(half(0.0), flat, np.array([[1.0, 2.0, 3.0]]), [1.0, 0, 0], [0, 1.0, 0])
    assert found[0] == 1.0
