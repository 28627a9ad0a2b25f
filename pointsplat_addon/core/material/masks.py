"""Recognises alphas that are masks: 0 or 1 everywhere but at edges."""

from __future__ import annotations

import numpy as np

from .expression import Expression
from .nodes.color_nodes import Color, Component, Gray, Invert, Mix
from .nodes.input_nodes import Constant
from .nodes.math_nodes import Clamp, Math
from .nodes.procedural.patterns import Checker
from .nodes.ramp_nodes import ColorRamp
from .nodes.texture_nodes import ImageTexture

MASK_EDGES = 0.1  # the share of a mask's texels that its smooth edges may take
COMPARISONS = frozenset(("GREATER_THAN", "LESS_THAN", "COMPARE"))  # operations of Math that give 0 or 1
MASK_OPERATIONS = frozenset(("MULTIPLY", "MINIMUM", "MAXIMUM", "SUBTRACT"))


def is_mask(alpha: Expression) -> bool:
    """Whether an alpha that varies is 0 or 1 but for the edges of what it cuts out.

    True for checkers, images, constant ramps and comparisons of which at most MASK_EDGES lie clearly between, and for
    their products, minima, maxima and complements. Anything else may be anything.
    """

    def follow(node: Expression) -> bool:
        if isinstance(node, Constant):
            return all(v in (0.0, 1.0) for v in node.value)
        if isinstance(node, Checker):
            return True
        if isinstance(node, Component | Color | Gray):
            source, channels = node.source, slice(0, 3)
            if isinstance(node, Component):
                channels = slice(node.index, node.index + 1)
            if isinstance(source, Component | Color | Gray):
                return follow(source)
            if isinstance(source, ImageTexture):
                return _share_between(source.image.texels[..., channels]) <= MASK_EDGES
            return isinstance(source, ColorRamp) and _steps(source, channels)
        if isinstance(node, Math):
            if node.operation in COMPARISONS:
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
