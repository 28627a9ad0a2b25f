"""Material inputs that vary over a surface: evaluated at samples, or baked into textures over a UV map."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, fields, replace

import numpy as np

from ..scene.cryptomatte import cryptomatte_hash
from .expressions import (
    UV,
    Attribute,
    Clamp,
    Color,
    ColorAttribute,
    ColorRamp,
    Component,
    Constant,
    Coordinates,
    Expression,
    Gray,
    Image,
    ImageTexture,
    Invert,
    Mapping,
    Math,
    Mix,
    NormalMap,
    SampleInputs,
    evaluate,
    normalize,
    walk,
)

__all__ = [
    "Image",
    "MaterialGraph",
    "Needs",
    "SampleInputs",
    "bake",
    "bakeable",
    "cryptomatte_hash",
    "evaluate",
    "evaluate_samples",
    "is_mask",
    "needs",
    "suggested_resolution",
    "triangle_tangents",
]

Graph = Expression

CHANNELS: dict[str, tuple[int, float | None]] = {
    # channel: (components, largest value); all but normals start at 0
    "base_color": (3, None),
    "roughness": (1, 1.0),
    "metallic": (1, 1.0),
    "alpha": (1, 1.0),
    "emission": (3, None),
    "normal": (3, None),
}
MAX_RESOLUTION = 4096  # texels along a side of a baked texture
MASK_EDGES = 0.1  # the share of a mask's texels that its smooth edges may take
MASKS = frozenset(("GREATER_THAN", "LESS_THAN", "COMPARE"))  # operations of Math that give 0 or 1
MASK_OPERATIONS = frozenset(("MULTIPLY", "MINIMUM", "MAXIMUM", "SUBTRACT"))
PROCEDURAL_RESOLUTION = 1024  # where no picture tells the resolution


@dataclass(frozen=True, eq=False)
class MaterialGraph:
    """The inputs of one material that vary; None is a constant, held by the material table."""

    base_color: Graph | None = None  # (N, 3) scene-linear
    roughness: Graph | None = None  # (N, 1)
    metallic: Graph | None = None  # (N, 1)
    alpha: Graph | None = None  # (N, 1)
    emission: Graph | None = None  # (N, 3) colour times strength
    normal: Graph | None = None  # (N, 3) unit, object space

    @property
    def channels(self) -> dict[str, Graph]:
        """The channels that vary, by name."""
        named = {f.name: getattr(self, f.name) for f in fields(self)}
        return {name: graph for name, graph in named.items() if graph is not None}

    @property
    def digest(self) -> str:
        """Content key: equal digests evaluate alike."""
        text = " ".join(f"{name} {graph.digest}" for name, graph in self.channels.items())
        return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


@dataclass(frozen=True)
class Needs:
    """What SampleInputs must hold for a graph. A None among names is the active map or attribute."""

    uv: frozenset[str | None] = frozenset()
    colors: frozenset[str | None] = frozenset()
    position: bool = False
    generated: bool = False
    normal: bool = False
    tangent: frozenset[str | None] = frozenset()  # the UV maps whose tangent is read
    pictures: bool = False  # mapped by any of these


def needs(graph: MaterialGraph) -> Needs:
    """The inputs that a graph reads; an `Attribute` may be a colour attribute or a UV map and is in both sets."""
    nodes = list(walk(*graph.channels.values()))
    attributes = {n.name for n in nodes if isinstance(n, Attribute)}
    coordinates = {n.kind for n in nodes if isinstance(n, Coordinates)}
    normal_maps = [n for n in nodes if isinstance(n, NormalMap)]
    tangents = {n.uv.name for n in normal_maps if n.uv is not None}
    return Needs(
        uv=frozenset({n.name for n in nodes if isinstance(n, UV)} | attributes | tangents),
        colors=frozenset({n.name for n in nodes if isinstance(n, ColorAttribute)} | attributes),
        position="position" in coordinates,
        generated="generated" in coordinates,
        normal="normal" in coordinates or bool(normal_maps),
        tangent=frozenset(tangents),
        pictures=any(isinstance(n, ImageTexture) and n.uv.varies for n in nodes),
    )


def evaluate_samples(graph: MaterialGraph, inputs: SampleInputs) -> dict[str, np.ndarray]:
    """Each varying channel at N samples: (N, 3) or, for scalars, (N,) float32; finite, in its range, normals unit.

    Raises ValueError when `inputs` holds neither arrays nor a count.
    """
    out = {}
    for name, output in graph.channels.items():
        components, top = CHANNELS[name]
        value = evaluate(output, inputs)
        if not np.isfinite(value).all():
            value = np.nan_to_num(value, copy=False, posinf=0.0, neginf=0.0)
        if name == "normal":
            value = normalize(value)
            flat = ~value.any(axis=1)
            value[flat] = 0 if inputs.normal is None else inputs.normal[flat]
        else:
            np.clip(value, 0, top, out=value)
        out[name] = value[:, 0] if components == 1 else value
    return out


def bake(graph: MaterialGraph, resolution: tuple[int, int]) -> dict[str, np.ndarray]:
    """Each varying channel at the texel centres of the unit square of its UV map, (H, W, C) float32.

    `resolution` is (width, height); row 0 has the smallest v. Normals are in tangent space (z outward).
    Meaningful for graphs that are `bakeable`.
    """
    width, height = resolution
    uv = np.empty((height, width, 2), np.float32)
    uv[..., 0] = (np.arange(width) + 0.5) / width
    uv[..., 1] = ((np.arange(height) + 0.5) / height)[:, None]
    uv = uv.reshape(-1, 2)
    axes = np.eye(3, dtype=np.float32)
    inputs = SampleInputs(
        uv={name or "": uv for name in needs(graph).uv},
        active_uv="",
        normal=np.broadcast_to(axes[2], (len(uv), 3)),
        tangent=np.broadcast_to(axes[0], (len(uv), 3)),
        grid=resolution,
    )
    return {name: a.reshape(height, width, -1) for name, a in evaluate_samples(graph, inputs).items()}


def bakeable(graph: MaterialGraph, unit_square: bool = False, active_uv: str | None = None) -> bool:
    """Whether `bake`, drawn with a repeating texture, shows the same as evaluating the graph at every sample.

    The graph must read exactly one UV map and nothing else, and have period 1 along u and v: pictures are
    reached by whole numbers of repetitions. `unit_square` tells that no UV of the mesh leaves [0, 1], and
    then any function of the map will do.
    """
    wanted = needs(graph)
    nodes = list(walk(*graph.channels.values()))
    object_normals = any(isinstance(n, NormalMap) and n.uv is None for n in nodes)
    maps = {active_uv if name is None else name for name in wanted.uv}
    if len(maps) != 1 or wanted.colors or wanted.position or wanted.generated or object_normals:
        return False
    if any(isinstance(n, Coordinates) for n in nodes):
        return False
    return unit_square or all(_periodic(output) for output in graph.channels.values())


def _periodic(node: Expression) -> bool:
    """Whether the value repeats with period 1 in u and v: every way to the UV map is a repeating picture."""
    if isinstance(node, UV):
        return False
    if isinstance(node, NormalMap):
        return _periodic(node.strength) and _periodic(node.color)  # its UV only names the tangent
    if isinstance(node, ImageTexture):
        matrix = _texture_from_uv(node.uv)
        if matrix is None:
            return _periodic(node.uv)
        # A mirrored picture has period 2
        period = {"REPEAT": 1, "MIRROR": 2}.get(node.extension)
        return period is not None and bool(np.all(np.abs(matrix / period - np.round(matrix / period)) < 1e-4))
    return all(_periodic(a) for a in node.arguments)


def _texture_from_uv(node: Expression) -> np.ndarray | None:
    """The linear part (2, 2) of the chain of constant mappings that leads from the UV map to `node`, else None."""
    if isinstance(node, UV):
        return np.eye(2)
    if not isinstance(node, Mapping) or any(a.varies for a in node.arguments[1:]):
        return None
    inner = _texture_from_uv(node.vector)
    if inner is None or node.kind == "NORMAL":
        return None
    moved = [replace(node, vector=Constant(p)) for p in ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))]
    origin, *axes = [evaluate(m, SampleInputs(count=1))[0, :2].astype(float) for m in moved]
    return np.stack([axis - origin for axis in axes], axis=1) @ inner


def is_mask(alpha: Expression, edges: bool = True) -> bool:
    """Whether an alpha that varies is 0 or 1 but for the edges of what it cuts out.

    True for pictures, constant ramps and comparisons of which at most MASK_EDGES lie clearly between (`edges` False:
    none), and for their products, minima, maxima and complements. Anything else may be anything.
    """
    between = MASK_EDGES if edges else 0.0

    def follow(node: Expression) -> bool:
        if isinstance(node, Constant):
            return all(v in (0.0, 1.0) for v in node.value)
        if isinstance(node, Component | Color | Gray):
            source, channels = node.source, slice(0, 3)
            if isinstance(node, Component):
                channels = slice(node.index, node.index + 1)
            if isinstance(source, Component | Color | Gray):
                return follow(source)
            if isinstance(source, ImageTexture):
                return _share_between(source.image.texels[..., channels]) <= between
            return isinstance(source, ColorRamp) and _steps(source, channels)
        if isinstance(node, Math):
            if node.operation in MASKS:
                return True
            return node.operation in MASK_OPERATIONS and follow(node.a) and follow(node.b)
        if isinstance(node, Mix) and node.blend not in ("MIX", "MULTIPLY"):
            return False
        return isinstance(node, Clamp | Mix | Invert) and all(follow(a) for a in node.arguments)

    return follow(alpha)


def _share_between(texels: np.ndarray) -> float:
    """The share of texels (H, W, C), uint8 or float32, that are clearly neither 0 nor 1 in some channel."""
    top = 255 if texels.dtype == np.uint8 else 1
    return float(((texels > 0.1 * top) & (texels < 0.9 * top)).any(axis=-1).mean())


def _steps(ramp: ColorRamp, channels: slice) -> bool:
    constant = ramp.interpolation == "CONSTANT" and ramp.mode == "RGB"
    return constant and bool(np.isin(ramp.colors[:, channels], (0, 1)).all())


def suggested_resolution(graph: MaterialGraph, largest: int = MAX_RESOLUTION) -> tuple[int, int]:
    """(width, height) at which `bake` keeps every texel of the graph's pictures, sides at most `largest`."""
    width = height = 0.0
    for node in walk(*graph.channels.values()):
        if isinstance(node, ImageTexture):
            rows, columns = node.image.texels.shape[:2]
            matrix = _texture_from_uv(node.uv)
            scale = np.eye(2) if matrix is None else np.abs(matrix)
            # Texels along u: those that one step of u crosses, on either axis of the picture
            along = np.maximum(scale[0] * columns, scale[1] * rows)
            width, height = max(width, along[0]), max(height, along[1])
    if not width or not height:
        width = height = PROCEDURAL_RESOLUTION
    return min(max(1, math.ceil(width - 1e-3)), largest), min(max(1, math.ceil(height - 1e-3)), largest)


def triangle_tangents(position: np.ndarray, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit tangent (T, 3) along growing u and bitangent sign (T,) of triangles, float32.

    `position` is (T, 3, 3), `uv` (T, 3, 2). From dP = T du + B dv on both edges (Lengyel 2001). Where the
    UVs are degenerate the tangent is the first edge. The sign is that of the UV triangle's area.
    """
    edge = (position[:, 1:] - position[:, :1]).astype(np.float64)
    duv = (uv[:, 1:] - uv[:, :1]).astype(np.float64)
    area = duv[:, 0, 0] * duv[:, 1, 1] - duv[:, 0, 1] * duv[:, 1, 0]
    tangent = edge[:, 0] * duv[:, 1, 1:] - edge[:, 1] * duv[:, 0, 1:]
    tangent = np.where(area[:, None] == 0, edge[:, 0], tangent * np.sign(area)[:, None])
    return normalize(tangent).astype(np.float32), np.where(area < 0, -1, 1).astype(np.float32)
