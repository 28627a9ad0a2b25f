"""Material graphs over the footprints of pixels on triangles: a mean of few places where a graph hardly changes, and of
more where it does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..material.evaluation import Appearance
from ..material.expression import walk
from ..material.graph import MaterialGraph
from ..material.nodes.color_nodes import Color, Combine, Component, Gray, Mix
from ..material.nodes.input_nodes import Backfacing, Constant, ObjectValue, Source
from ..material.nodes.math_nodes import Mapping, Math
from ..material.nodes.texture_nodes import ImageTexture
from ..scene.materials import MaterialTable
from ..scene.mesh import Mesh
from .appearance import at_places
from .samples import Samples, material_ids, take_samples

THROUGH = "through"
Look = dict[str, np.ndarray]  # attributes by their names in Appearance, (P, N, C), and THROUGH: see over_footprints
# Places in a footprint, in its half-diameters; two on opposite sides, two more, and a place in each of 4 by 4 squares.
FEW = np.array([[-0.75, -0.25], [0.75, 0.25]])
MIDDLE = np.zeros((1, 2))
MORE = np.array([[0.25, -0.75], [-0.25, 0.75]])
MANY = np.stack(np.meshgrid(*2 * [np.arange(4)], indexing="ij"), axis=-1).reshape(-1, 2)
MANY = (2 * (MANY + (MANY[:, ::-1] + 0.5) / 4) / 4) - 1  # of which no two lie in one row or column
EVEN = frozenset(("ADD", "SUBTRACT", "MULTIPLY", "MULTIPLY_ADD", "DIVIDE"))  # operations of Math that do not jump
CHANGE = 1 / 64  # of an attribute: places that differ by more are not enough


def footprints(
    mesh: Mesh, triangle: np.ndarray, position: np.ndarray, across: np.ndarray, along: np.ndarray
) -> Samples:
    """Returns footprints around positions (N, 3) float64 in the planes of triangles (N,) of a mesh, in object space.

    across, along: (N, 3) float64, half-diameters of the footprints.
    """
    first, second, third = mesh.position[mesh.triangles[triangle]].astype(np.float64).transpose(1, 0, 2)
    a, b = second - first, third - first
    place, *ends = (_weights(a, b, way) for way in (position - first, across, along))
    return Samples(
        "PATCHES",
        triangle.astype(np.int32),
        np.clip(place, 0, 1).astype(np.float32),
        np.stack(ends, axis=1).astype(np.float32),
    )


def _weights(a: np.ndarray, b: np.ndarray, way: np.ndarray) -> np.ndarray:
    """(N, 2) of a and b, whose sum is nearest to `way`, all (N, 3); zeros where a and b are parallel."""
    aa, ab, bb = (np.einsum("nc,nc->n", *pair) for pair in ((a, a), (a, b), (b, b)))
    along_a, along_b = (np.einsum("nc,nc->n", edge, way) for edge in (a, b))
    det = aa * bb - ab * ab
    found = np.stack([bb * along_a - ab * along_b, aa * along_b - ab * along_a], axis=1)
    return np.divide(found, det[:, None], out=np.zeros_like(found), where=det[:, None] > 0)


def over_footprints(
    mesh: Mesh,
    samples: Samples,
    graphs: dict[int, MaterialGraph],
    table: MaterialTable,
    scale: np.ndarray,
    translucent: bool = False,
) -> tuple[Appearance, np.ndarray | None]:
    """Returns the appearance of a mesh without alpha, its mean over each sample's footprint, and where `translucent`
    what passes, (N, 4) float32: the share of light of each channel, and alpha. What then shows counts by alpha. The
    mean of normals is the shorter the more they turn. scale: (N,), see at_places."""
    if not translucent:
        graphs = {row: replace(graph, alpha=None, transmission_color=None) for row, graph in graphs.items()}
    seen, triangle = np.unique(samples.triangle, return_inverse=True)
    mesh = mesh.take(seen)
    samples = replace(samples, triangle=triangle.reshape(-1).astype(np.int32))

    def at(rows: np.ndarray, places: np.ndarray, share: float) -> Look:
        return _at(mesh, take_samples(samples, rows), graphs, table, scale[rows], places, share, translucent)

    even = not any(map(_varies_within_object, graphs.values()))
    look = at(np.arange(len(samples)), MIDDLE if even else FEW, 0.6)
    found = _means(look)
    # Two places do not tell how far normals turn.
    rows = np.arange(len(samples)) if "normal" in look else _uneven(look)
    if even or (translucent and all(map(_only_images, graphs.values()))):
        rows = rows[:0]
    if len(rows):
        again = at(rows, MORE, 0.5)
        four = {name: np.concatenate([values[:, rows], again[name]]) for name, values in look.items()}
        uneven = _uneven(four)
        for name, values in _means(four).items():
            found[name][rows] = values
        if len(uneven):
            uneven = rows[uneven]
            for name, values in _means(at(uneven, MANY, 0.25)).items():
                found[name][uneven] = values
    through = found.pop(THROUGH, None)
    return Appearance(**found), through


def _varies_within_object(graph: MaterialGraph) -> bool:
    """Whether anything but values of the object, and the side of it that is seen, varies it."""
    nodes = walk(*graph.channels.values())
    return any(isinstance(node, Source) and not isinstance(node, ObjectValue | Backfacing) for node in nodes)


def _only_images(graph: MaterialGraph) -> bool:
    """Whether all that varies within a triangle comes evenly from images, which are filtered wherever they are read."""
    even = ImageTexture, Source, Constant, Color, Component, Gray, Combine, Mix, Mapping, Math
    nodes = list(walk(*graph.channels.values()))
    jumps = any(isinstance(node, Math) and node.operation not in EVEN for node in nodes)
    return (
        graph.normal is None and graph.tangent is None and not jumps and all(isinstance(node, even) for node in nodes)
    )


def through_at(
    mesh: Mesh, samples: Samples, graphs: dict[int, MaterialGraph], table: MaterialTable, scale: np.ndarray
) -> np.ndarray:
    """Returns what passes in the middle of each sample's footprint, (N, 4) float32, as `over_footprints` has it, with
    images filtered over it."""
    graphs = {r: MaterialGraph(alpha=g.alpha, transmission_color=g.transmission_color) for r, g in graphs.items()}
    graphs = {row: graph for row, graph in graphs.items() if graph.channels}
    return _at(mesh, samples, graphs, table, scale, np.zeros((1, 2)), 1.0, True)[THROUGH][0]


def _means(look: Look) -> Look:
    """The means over places, (N, C), of what shows by alpha."""
    through = look.get(THROUGH)
    if through is None:
        return {name: values.mean(axis=0) for name, values in look.items()}
    weight = through[..., 3:] + np.float32(1e-6)
    weight /= weight.sum(axis=0)
    return {
        name: values.mean(axis=0) if name in (THROUGH, "normal", "tangent") else (weight * values).sum(axis=0)
        for name, values in look.items()
    }


def _at(
    mesh: Mesh,
    samples: Samples,
    graphs: dict[int, MaterialGraph],
    table: MaterialTable,
    scale: np.ndarray,
    places: np.ndarray,
    share: float,
    translucent: bool,
) -> Look:
    """The appearance at P places of each of N footprints. `share`: of a footprint, that each place stands for.
    `translucent`: with THROUGH."""
    assert samples.ellipse is not None
    moved = places[:, :1, None] * samples.ellipse[:, 0] + places[:, 1:, None] * samples.ellipse[:, 1]
    whole = Samples(
        samples.method,
        np.tile(samples.triangle, len(places)),
        (samples.barycentric + moved).reshape(-1, 2).astype(np.float32),
        np.tile(np.float32(share) * samples.ellipse, (len(places), 1, 1)),
        None if samples.object is None else np.tile(samples.object, len(places)),
        None if samples.backfacing is None else np.tile(samples.backfacing, len(places)),
        samples.eye,
    )
    look = at_places(mesh, whole, graphs, table, np.tile(scale, len(places)))
    named = {name: getattr(look, name) for name in ("color", "surface", "emission", "normal", "tangent")}
    if translucent:
        named[THROUGH] = _through(look, material_ids(mesh, whole), table)
    return {n: a.reshape(len(places), len(samples), -1) for n, a in named.items() if a is not None}


def _through(look: Appearance, rows: np.ndarray, table: MaterialTable) -> np.ndarray:
    """What passes at samples of materials `rows` (N,), (N, 4) float32: see over_footprints."""
    alpha = table.alpha[rows] if look.alpha is None else look.alpha
    found = np.repeat(1 - alpha[:, None], 4, axis=1).astype(np.float32)
    if look.transmission_color is not None:
        found[:, :3] *= look.transmission_color
    elif table.transmission_color is not None:
        found[:, :3] *= table.transmission_color[rows]
    found[:, 3] = alpha
    return found


def _uneven(look: Look) -> np.ndarray:
    """The rows (K,) int of footprints in which an attribute changes."""
    found = np.zeros(0, np.bool_)
    for values in look.values():
        least, most = values.min(axis=0), values.max(axis=0)
        change = (most - least > CHANGE * np.maximum(most, 1)).any(axis=1)
        found = change if not len(found) else found | change
    return np.flatnonzero(found)
