"""A surface by the expressions of its parameters, and how surfaces mix.

A translucent surface transmits light along a straight line and unchanged in colour: it has one alpha. Glass is thin.
Its reflection is a mirror whose coverage is Fresnel's reflectance at normal incidence; the mean of its tint is the
transmittance of the rest, and the colour that the tint has beyond its mean is shown as if it were painted on.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from ....core.material.expression import Expression, constant
from ....core.material.nodes import color_nodes, input_nodes, math_nodes
from ....core.numeric.record import record

BLACK = input_nodes.Constant((0.0, 0.0, 0.0))
ZERO, ONE = input_nodes.Constant((0.0,)), input_nodes.Constant((1.0,))
GLASS_IOR = input_nodes.Constant((1.5,))  # Principled's default index of refraction
WHITE = input_nodes.Constant((1.0, 1.0, 1.0))
SURFACE_NORMAL = input_nodes.Coordinates("normal")


@record
class Surface:
    """Parameters of the Principled model. The defaults are an opaque black surface that reflects nothing."""

    base_color: Expression = BLACK
    roughness: Expression = ONE
    metallic: Expression = ZERO
    alpha: Expression = ONE
    emission: Expression = BLACK
    normal: Expression = SURFACE_NORMAL
    ior: Expression = GLASS_IOR
    specular: Expression = ZERO


def scale_color(color: Expression, factor: Expression) -> Expression:
    """A colour or vector times a number."""
    return math_nodes.VectorMath(color, BLACK, BLACK, factor, "SCALE")


def multiply(a: Expression, b: Expression) -> Expression:
    """The product of two numbers, without factors of 0 and 1: what is left of a mask is told to be one."""
    if is_constant(a, 0) or is_constant(b, 1):
        return a
    return b if is_constant(b, 0) or is_constant(a, 1) else math_nodes.Math(a, b, ZERO, "MULTIPLY")


def divide_color(color: Expression, weight: Expression) -> Expression:
    """Color / weight; black where the weight is 0."""
    return color if is_constant(color, 0) else scale_color(color, math_nodes.Math(ONE, weight, ZERO, "DIVIDE"))


def thin_glass(tint: Expression, like: Surface, *, reflects: bool = True) -> Surface:
    """Thin glass whose transmittance is `tint`, with the roughness, normal, IOR and specular level of `like`.

    reflects: whether Fresnel reflection is added; it needs a constant IOR.
    """
    transmitted = color_nodes.Gray(tint, mean=True)
    absorbed = math_nodes.Math(ONE, transmitted, ZERO, "SUBTRACT")
    excess = math_nodes.VectorMath(tint, color_nodes.Color(transmitted), BLACK, ZERO, "SUBTRACT")
    painted = divide_color(math_nodes.VectorMath(excess, BLACK, BLACK, ZERO, "MAXIMUM"), absorbed)
    paint = replace(like, base_color=painted, metallic=ZERO, emission=BLACK, alpha=absorbed)
    index = constant(like.ior)
    if not reflects or index is None:
        return paint
    # The painted part has a specular reflection of its own
    fresnel = input_nodes.Constant((float((index[0] - 1) / (index[0] + 1)) ** 2,))
    mirror = replace(like, base_color=WHITE, metallic=ONE, emission=BLACK)
    return mix_surfaces(paint, mirror, multiply(fresnel, transmitted))


def mix_surfaces(a: Surface, b: Surface, factor: Expression) -> Surface:
    """(1 - factor) a + factor b: opacities mix by the factor, all else by the factor weighted with the opacities."""
    first = math_nodes.Math(ONE, factor, ZERO, "SUBTRACT")
    a_weight, b_weight = multiply(a.alpha, first), multiply(b.alpha, factor)
    if is_constant(b_weight, 0):
        return replace(a, alpha=a_weight)
    if is_constant(a_weight, 0):
        return replace(b, alpha=b_weight)
    alpha = math_nodes.Math(a_weight, b_weight, ZERO, "ADD")
    both_opaque = is_constant(a.alpha, 1) and is_constant(b.alpha, 1)
    t = factor if both_opaque else math_nodes.Math(b_weight, alpha, ZERO, "DIVIDE")
    mixed = {f.name: _mix_unless_equal(t, getattr(a, f.name), getattr(b, f.name)) for f in fields(Surface)}
    return Surface(**{**mixed, "alpha": ONE if both_opaque else alpha})


def _mix_unless_equal(t: Expression, a: Expression, b: Expression) -> Expression:
    return a if a.digest == b.digest else color_nodes.Mix(t, a, b)


def is_constant(value: Expression, number: float) -> bool:
    """Whether an expression is the same everywhere and all its channels equal `number`."""
    found = constant(value)
    return found is not None and bool(np.all(found == number))


def only_emits(surface: Surface) -> bool:
    """Whether a surface is opaque and reflects nothing."""
    opaque_black = is_constant(surface.base_color, 0) and is_constant(surface.alpha, 1)
    return opaque_black and is_constant(surface.specular, 0)
