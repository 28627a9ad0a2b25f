"""Values of objects in material graphs: looked up, or bound to those of one object."""

import numpy as np

from pointsplat_addon.core.material.evaluation import evaluate_samples
from pointsplat_addon.core.material.expression import SampleInputs
from pointsplat_addon.core.material.graph import MaterialGraph, needs, of_one_object
from pointsplat_addon.core.material.nodes.color_nodes import Color, Component
from pointsplat_addon.core.material.nodes.input_nodes import Constant, Coordinates, ObjectValue
from pointsplat_addon.core.material.nodes.world_nodes import Transformed

GRAPH = MaterialGraph(base_color=Color(ObjectValue("color")), roughness=Component(ObjectValue("color"), 3))
VALUES = np.array([[0.1, 0.2, 0.3, 0.4], [0.5, 0.6, 0.7, 0.8]], np.float32)


def test_samples_have_the_values_of_their_objects():
    found = evaluate_samples(GRAPH, SampleInputs(count=2, objects={"color": VALUES}))
    assert np.array_equal(found["base_color"], VALUES[:, :3])
    assert np.array_equal(found["roughness"], VALUES[:, 3])
    assert needs(GRAPH).objects == {"color"}


def test_one_object_holds_all_samples():
    found = evaluate_samples(GRAPH, SampleInputs(count=3, objects={"color": VALUES[1:]}))
    assert np.array_equal(found["base_color"], np.tile(VALUES[1, :3], (3, 1)))


def test_many_samples_are_taken_in_parts():
    count = 100_000
    index = np.arange(count) % 2
    found = evaluate_samples(GRAPH, SampleInputs(count=count, objects={"color": VALUES[index]}))
    assert np.array_equal(found["roughness"], VALUES[index, 3])


def test_a_graph_on_one_object_holds_its_values():
    bound = of_one_object(GRAPH, {"color": VALUES[0]})
    assert not needs(bound).objects
    assert bound.digest == of_one_object(GRAPH, {"color": VALUES[0]}).digest
    assert bound.digest != of_one_object(GRAPH, {"color": VALUES[1]}).digest
    found = evaluate_samples(bound, SampleInputs(count=1))
    assert np.array_equal(found["base_color"], VALUES[:1, :3])
    assert of_one_object(GRAPH, {}).digest == GRAPH.digest


def test_points_and_normals_are_transformed_as_their_matrices_say():
    rng = np.random.default_rng(1)
    matrices = rng.normal(size=(5, 4, 4)).astype(np.float32)
    matrices[:, 3] = 0, 0, 0, 1
    position, normal = rng.normal(size=(2, 5, 3)).astype(np.float32)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    rows = matrices[:, :3].reshape(5, 12)
    inputs = SampleInputs(position=position, normal=normal, objects={"matrix": rows})
    found = evaluate_samples(
        MaterialGraph(normal=Transformed(Coordinates("normal"), ObjectValue("matrix"), normal=True)), inputs
    )["normal"]
    exact = np.einsum("ni,nij->nj", normal.astype(float), np.linalg.inv(matrices[:, :3, :3].astype(float)))
    exact /= np.linalg.norm(exact, axis=1, keepdims=True)
    assert np.abs(found - exact).max() < 1e-5
    one = Transformed(Coordinates("position"), Constant(tuple(rows[0].tolist())))
    for transformed, each in (
        (Transformed(Coordinates("position"), ObjectValue("matrix")), matrices),
        (one, matrices[:1]),
    ):
        emission = MaterialGraph(normal=transformed)
        exact = np.einsum("nij,nj->ni", np.broadcast_to(each[:, :3, :3], (5, 3, 3)), position) + each[:, :3, 3]
        exact /= np.linalg.norm(exact, axis=1, keepdims=True)
        assert np.abs(evaluate_samples(emission, inputs)["normal"] - exact).max() < 1e-5


def test_what_is_flattened_keeps_its_normal():
    flat = np.diag([1.0, 1.0, 0.0, 1.0])[:3].reshape(1, 12).astype(np.float32)
    up = np.array([[0, 0, 1]], np.float32)
    graph = MaterialGraph(normal=Transformed(Coordinates("normal"), ObjectValue("matrix"), normal=True))
    assert np.array_equal(evaluate_samples(graph, SampleInputs(normal=up, objects={"matrix": flat}))["normal"], up)
