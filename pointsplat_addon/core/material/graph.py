"""The inputs of a material that vary over a surface, as expressions, and what these read."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import fields, replace

import numpy as np

from ..numeric.record import record, value_record
from .expression import Expression, walk
from .nodes.input_nodes import UV, Attribute, Backfacing, ColorAttribute, Constant, Coordinates, ObjectValue
from .nodes.normal_nodes import Bump, NormalMap, Tangent
from .nodes.texture_nodes import ImageTexture
from .nodes.view_nodes import READ_EYE


@record
class MaterialGraph:
    """The inputs of one material that vary; None is a constant, held by the material table."""

    base_color: Expression | None = None  # (N, 3) scene-linear
    roughness: Expression | None = None  # (N, 1)
    metallic: Expression | None = None  # (N, 1)
    alpha: Expression | None = None  # (N, 1)
    emission: Expression | None = None  # (N, 3) colour times strength
    normal: Expression | None = None  # (N, 3) unit, object space
    transmission_color: Expression | None = None  # (N, 3)
    tangent: Expression | None = None  # (N, 3) object space, as long as `stretch`: see normal_nodes.Tangent

    @property
    def channels(self) -> dict[str, Expression]:
        """The channels that vary, by name."""
        named = {f.name: getattr(self, f.name) for f in fields(self)}
        return {name: graph for name, graph in named.items() if graph is not None}

    @property
    def digest(self) -> str:
        """Content key: graphs with equal digests have equal values at equal samples."""
        text = " ".join(f"{name} {graph.digest}" for name, graph in self.channels.items())
        return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


@value_record
class Needs:
    """What `SampleInputs` must hold for a graph. None among the names means the active map or attribute."""

    uv: frozenset[str | None] = frozenset()
    colors: frozenset[str | None] = frozenset()
    position: bool = False
    generated: bool = False
    normal: bool = False
    tangent: frozenset[str | None] = frozenset()  # the UV maps whose tangent is read
    heights: bool = False  # whether it is read how heights change
    images: bool = False  # whether images are mapped by any of these
    objects: frozenset[str] = frozenset()  # values of the object
    backfacing: bool = False
    eye: bool = False


def needs(graph: MaterialGraph) -> Needs:
    """The inputs that a graph reads. An `Attribute` may be a colour attribute or a UV map and is in both sets."""
    nodes = list(walk(*graph.channels.values()))
    attributes = {n.name for n in nodes if isinstance(n, Attribute)}
    coordinates = {n.kind for n in nodes if isinstance(n, Coordinates)}
    normal_maps = [n for n in nodes if isinstance(n, NormalMap)]
    tangents = {n.uv.name for n in normal_maps if n.uv is not None}
    grains = [n for n in nodes if isinstance(n, Tangent)]
    tangents |= {n.uv.name for n in grains if n.uv is not None}
    return Needs(
        uv=frozenset({n.name for n in nodes if isinstance(n, UV)} | attributes | tangents),
        colors=frozenset({n.name for n in nodes if isinstance(n, ColorAttribute)} | attributes),
        position="position" in coordinates,
        generated="generated" in coordinates or any(n.uv is None for n in grains),
        normal="normal" in coordinates or bool(normal_maps or grains),
        heights=any(isinstance(n, Bump) for n in nodes),
        tangent=frozenset(tangents),
        images=any(isinstance(n, ImageTexture) and n.uv.varies for n in nodes),
        objects=frozenset(n.name for n in nodes if isinstance(n, ObjectValue)),
        backfacing=any(isinstance(n, Backfacing) for n in nodes),
        eye=any(isinstance(n, READ_EYE) for n in nodes),
    )


def of_one_object(graph: MaterialGraph, values: Mapping[str, np.ndarray]) -> MaterialGraph:
    """The graph on one object, whose values (C,) by name are constants in it; those that are missing stay."""
    known: dict[int, Expression] = {}

    def bound(node: Expression) -> Expression:
        if id(node) not in known:
            known[id(node)] = with_constants(node)
        return known[id(node)]

    def with_constants(node: Expression) -> Expression:
        if isinstance(node, ObjectValue) and node.name in values:
            return Constant(tuple(map(float, values[node.name])))
        named = {f.name: getattr(node, f.name) for f in fields(node)}
        inner = {name: (value, bound(value)) for name, value in named.items() if isinstance(value, Expression)}
        changed = {name: after for name, (before, after) in inner.items() if after is not before}
        return replace(node, **changed) if changed else node

    return MaterialGraph(**{name: bound(output) for name, output in graph.channels.items()})
