"""Bakes materials into pictures over the unit square of a UV map, where that loses nothing.

Cycles interpolates the texels of images as they are stored: encoded with the sRGB curve, and multiplied by alpha. A
picture therefore holds colours in the way of the images that they come from, and is decoded after interpolation.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..numeric.record import value_record
from .color_models import srgb_from_linear
from .evaluation import evaluate_samples
from .expression import Expression, SampleInputs, evaluate, walk
from .graph import MaterialGraph, needs
from .nodes.color_nodes import Component
from .nodes.input_nodes import UV, Constant, Coordinates
from .nodes.math_nodes import Clamp, Mapping, Math
from .nodes.normal_nodes import Bump, NormalMap
from .nodes.texture_nodes import ImageTexture

MAX_RESOLUTION = 4096  # texels along a side of a baked texture
PROCEDURAL_RESOLUTION = 1024  # where no image determines the resolution
FINER = 2  # texels of a picture for one of an image with cubic interpolation: in between pictures are linear
BORDER = 2 * FINER  # texels around a picture that neither repeats nor is mirrored: as far as cubic B-splines extend


@value_record
class Reading:
    """How a picture is read between its texels and beyond them, so that it shows what the graph's images would."""

    extension: str  # REPEAT, MIRROR, or BORDER: it has a border, whose last texels go on
    closest: bool  # texels are not interpolated
    encoded: frozenset[str]  # channels that hold sRGB
    associated: frozenset[str]  # channels that are multiplied by alpha

    @property
    def border(self) -> int:
        """Texels around the unit square."""
        return BORDER if self.extension == "BORDER" else 0


def reading(graph: MaterialGraph) -> Reading:
    """Returns how the picture of a bakeable graph is read."""
    images = [node for node in walk(*graph.channels.values()) if isinstance(node, ImageTexture)]
    colors = {name: graph.channels[name] for name in ("base_color", "emission") if name in graph.channels}
    return Reading(
        _extension(graph) or "BORDER",
        closest=bool(images) and all(image.interpolation == "Closest" for image in images),
        encoded=frozenset(name for name, color in colors.items() if any(node.image.srgb for node in _images(color))),
        associated=frozenset(name for name, color in colors.items() if _shares_alpha(color, graph.alpha)),
    )


def _images(output: Expression) -> list[ImageTexture]:
    return [node for node in walk(output) if isinstance(node, ImageTexture)]


def _shares_alpha(color: Expression, alpha: Expression | None) -> bool:
    """Whether the alpha of a material is that of the one image which its colour reads, multiplied by it as stored."""
    while isinstance(alpha, Clamp):
        alpha = alpha.value
    if not (isinstance(alpha, Component) and alpha.index == 3 and isinstance(alpha.source, ImageTexture)):
        return False
    known, images = alpha.source, _images(color)
    return bool(images) and known.image.associated and all(image.digest == known.digest for image in images)


def stored(graph: MaterialGraph, picture: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Returns the channels of a picture as they are interpolated: `reading` says which are encoded."""
    how, found = reading(graph), dict(picture)
    for name in how.encoded:
        found[name] = srgb_from_linear(found[name])
    for name in how.associated:
        found[name] = found[name] * picture["alpha"]
    return found


def bake(graph: MaterialGraph, resolution: tuple[int, int]) -> dict[str, np.ndarray]:
    """Each varying channel at the texel centres of the unit square of its UV map, (H, W, C) float32, and of a border.

    `resolution` is (width, height) of the square; row 0 has the smallest v. Normals are in tangent space (z outward),
    without bumps; `height` has these: heights in object units, and strengths.
    Meaningful for graphs that are `bakeable`.
    """
    border = reading(graph).border
    width, height = (side + 2 * border for side in resolution)
    uv = np.empty((height, width, 2), np.float32)
    uv[..., 0] = (np.arange(width) - border + 0.5) / resolution[0]
    uv[..., 1] = ((np.arange(height) - border + 0.5) / resolution[1])[:, None]
    uv = uv.reshape(-1, 2)
    axes = np.eye(3, dtype=np.float32)
    inputs = SampleInputs(
        uv={name or "": uv for name in needs(graph).uv},
        active_uv="",
        normal=np.broadcast_to(axes[2], (len(uv), 3)),
        tangent=np.broadcast_to(axes[0], (len(uv), 3)),
        grid=None if border else resolution,
    )
    below, heights, strength = split_bumps(graph.normal)
    found = evaluate_samples(replace(graph, normal=below), inputs)
    if heights is not None and strength is not None:
        found["height"] = np.concatenate([evaluate(heights, inputs), evaluate(strength, inputs)], axis=1)
    return {name: a.reshape(height, width, -1) for name, a in found.items()}


def split_bumps(normal: Expression | None) -> tuple[Expression | None, Expression | None, Expression | None]:
    """(what is raised, heights times distances, strength) of a normal that bump nodes make; None for the surface's own
    normal, and where there are no bumps. Heights of several add up, each times its strength."""
    bumps: list[Bump] = []
    while isinstance(normal, Bump):
        bumps.append(normal)
        normal = normal.normal
    if isinstance(normal, Coordinates) and normal.kind == "normal":
        normal = None
    if not bumps:
        return normal, None, None
    zero = Constant((0.0,))
    heights = [Math(bump.height, bump.distance, zero, "MULTIPLY") for bump in bumps]
    if len(bumps) == 1:
        return normal, heights[0], bumps[0].strength
    total: Expression = zero
    for bump, height in zip(bumps, heights, strict=True):
        total = Math(total, Math(height, bump.strength, zero, "MULTIPLY"), zero, "ADD")
    return normal, total, Constant((1.0,))


def bakeable(graph: MaterialGraph, unit_square: bool = False, active_uv: str | None = None) -> bool:
    """Whether `bake`, drawn as `reading` says, shows the same as evaluating the graph at every sample.

    The graph must read exactly one UV map and nothing else, and go on beyond the unit square in a way that a picture
    can. unit_square: no UV of the mesh leaves [0, 1]; then any function of the map will do.
    """
    wanted = needs(graph)
    nodes = list(walk(*graph.channels.values()))
    object_normals = any(isinstance(n, NormalMap) and n.uv is None for n in nodes)
    object_normals |= any(isinstance(n, Bump) for n in walk(split_bumps(graph.normal)[0]))  # below mixtures of normals
    maps = {active_uv if name is None else name for name in wanted.uv}
    if len(maps) != 1 or wanted.colors or wanted.position or wanted.generated or wanted.objects or object_normals:
        return False
    if (
        wanted.backfacing
        or wanted.eye
        or graph.tangent is not None
        or any(isinstance(n, Bump) and n.of_object for n in nodes)
    ):
        return False
    if any(isinstance(n, Coordinates) for n in nodes if not _is_own_normal(n, nodes)):
        return False
    return unit_square or _extension(graph) is not None


def _is_own_normal(node: Expression, nodes: list[Expression]) -> bool:
    """Whether nothing but bump nodes read a node, which is the surface's own normal."""
    readers = [n for n in nodes if any(a is node for a in n.arguments)]
    own = isinstance(node, Coordinates) and node.kind == "normal"
    return own and bool(readers) and all(isinstance(n, Bump) and n.normal is node for n in readers)


def _extension(graph: MaterialGraph) -> str | None:
    """Returns the extension with which a picture shows a graph everywhere; None: there is none."""
    ways: dict[str, Callable[[ImageTexture], bool]] = {
        "REPEAT": _repeats,
        "MIRROR": lambda image: image.extension == "MIRROR" and isinstance(image.uv, UV),
        "BORDER": lambda image: image.extension in ("EXTEND", "CLIP") and isinstance(image.uv, UV),
    }
    for name, goes_on in ways.items():
        if all(_goes_on(output, goes_on) for output in graph.channels.values()):
            return name
    return None


def _goes_on(node: Expression, image_goes_on: Callable[[ImageTexture], bool]) -> bool:
    """Whether a value goes on beyond the unit square in a certain way: every path to the UV map passes an image that
    does."""
    if isinstance(node, UV):
        return False
    if isinstance(node, Coordinates):  # below bumps: see `bakeable`
        return True
    if isinstance(node, NormalMap):  # its UV only names the tangent
        return _goes_on(node.strength, image_goes_on) and _goes_on(node.color, image_goes_on)
    if isinstance(node, ImageTexture) and _texture_from_uv(node.uv) is not None:
        return image_goes_on(node)
    return all(_goes_on(a, image_goes_on) for a in node.arguments)


def _repeats(image: ImageTexture) -> bool:
    """Whether an image at a mapped UV has period 1 in u and v: it repeats a whole number of times."""
    matrix = _texture_from_uv(image.uv)
    period = {"REPEAT": 1, "MIRROR": 2}.get(image.extension)  # a mirrored image has period 2
    return (
        matrix is not None
        and period is not None
        and bool(np.all(np.abs(matrix / period - np.round(matrix / period)) < 1e-4))
    )


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


def suggested_resolution(graph: MaterialGraph, largest: int = MAX_RESOLUTION) -> tuple[int, int]:
    """(width, height) at which `bake` keeps every texel of the graph's images, sides at most `largest`."""
    width = height = 0.0
    for node in walk(*graph.channels.values()):
        if isinstance(node, ImageTexture):
            rows, columns = node.image.texels.shape[:2]
            matrix = _texture_from_uv(node.uv)
            scale = np.eye(2) if matrix is None else np.abs(matrix)
            # Texels along u: those that one step of u crosses, on either axis of the image
            along = np.maximum(scale[0] * columns, scale[1] * rows) * (FINER if node.interpolation == "Cubic" else 1)
            width, height = max(width, along[0]), max(height, along[1])
    if not width or not height:
        width = height = PROCEDURAL_RESOLUTION
    return min(max(1, math.ceil(width - 1e-3)), largest), min(max(1, math.ceil(height - 1e-3)), largest)
