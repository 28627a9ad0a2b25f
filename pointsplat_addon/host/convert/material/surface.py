"""A surface by the expressions of its parameters, and how surfaces mix.

A translucent surface transmits light along a straight line: (1 - alpha) of it, times the transmission colour. Glass is
thin. Its reflection is a mirror whose coverage is Fresnel's reflectance at normal incidence; its tint is the
transmission colour of the rest, or, where it is a grey, an alpha, which costs a third.
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
COAT_ROUGHNESS = input_nodes.Constant((0.03,))  # Principled's default
SHEEN_ROUGHNESS = input_nodes.Constant((0.5,))  # Principled's default
NO_GLOSS = input_nodes.Constant((-1.0, -1.0, -1.0, 0.0))
NO_TOON = input_nodes.Constant((0.0, 0.0, 0.0))
WHITE = input_nodes.Constant((1.0, 1.0, 1.0))
GRAY = 1e-6  # difference of the channels of what counts as a grey
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
    transmission_color: Expression = WHITE
    backlit: Expression = BLACK  # share of the diffuse light that comes from behind; constant
    coat: Expression = ZERO  # weight of the clear layer; the rest of it is constant
    coat_roughness: Expression = COAT_ROUGHNESS
    coat_ior: Expression = GLASS_IOR
    coat_tint: Expression = WHITE
    tangent: Expression = BLACK  # of stretched reflections; BLACK: they are round
    # All that follows is constant
    tint: Expression = WHITE  # of the specular reflection: core.scene.materials.MaterialTable.tint
    gloss: Expression = NO_GLOSS  # of the metallic share: core.scene.materials.MaterialTable.gloss
    diffuse_roughness: Expression = ZERO
    sheen: Expression = BLACK  # colour times weight
    sheen_roughness: Expression = SHEEN_ROUGHNESS
    toon: Expression = NO_TOON  # size and smoothness of diffuse light, and 1
    holdout: Expression = ZERO  # share of what is seen that is cut out of the picture


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
    dark = replace(like, base_color=BLACK, metallic=ZERO, emission=BLACK)
    if is_gray(tint):
        transmitted = color_nodes.Gray(tint, mean=True)
        glass = replace(dark, alpha=math_nodes.Math(ONE, transmitted, ZERO, "SUBTRACT"))
    else:
        transmitted = ONE
        glass = replace(dark, alpha=ZERO, transmission_color=tint)
    index = constant(like.ior)
    if not reflects or index is None:
        return glass
    # What absorbs has a specular reflection of its own
    fresnel = input_nodes.Constant((float((index[0] - 1) / (index[0] + 1)) ** 2,))
    mirror = replace(like, base_color=WHITE, metallic=ONE, emission=BLACK, tint=WHITE, gloss=NO_GLOSS)
    return mix_surfaces(glass, mirror, multiply(fresnel, transmitted))


def mix_surfaces(a: Surface, b: Surface, factor: Expression) -> Surface:
    """(1 - factor) a + factor b: opacities mix by the factor, all else by the factor weighted with the opacities."""
    first = math_nodes.Math(ONE, factor, ZERO, "SUBTRACT")
    a_weight, b_weight = multiply(a.alpha, first), multiply(b.alpha, factor)
    passes = _mixed_transmission(a, b, first, factor)
    if is_constant(b_weight, 0):
        return replace(a, alpha=a_weight, transmission_color=passes)
    if is_constant(a_weight, 0):
        return replace(b, alpha=b_weight, transmission_color=passes)
    alpha = math_nodes.Math(a_weight, b_weight, ZERO, "ADD")
    both_opaque = is_constant(a.alpha, 1) and is_constant(b.alpha, 1)
    t = factor if both_opaque else math_nodes.Math(b_weight, alpha, ZERO, "DIVIDE")
    if not (is_constant(a.holdout, 0) and is_constant(b.holdout, 0)):
        return _mixed_holdout(a, b, first, factor)
    even = constant(t) is not None
    a, b = _with_unseen_of(a, b, even), _with_unseen_of(b, a, even)
    backlit = _mixed_backlit(t, a, b)
    names = [f.name for f in fields(Surface) if f.name not in ("base_color", "gloss")]
    mixed = {name: _mix_unless_equal(t, getattr(a, name), getattr(b, name)) for name in names}
    mixed |= {"backlit": backlit, "alpha": ONE if both_opaque else alpha, "transmission_color": passes}
    return Surface(**mixed, **_mixed_colors(t, a, b))


def _mixed_colors(t: Expression, a: Surface, b: Surface) -> dict[str, Expression]:
    """`base_color` and `gloss` of (1 - t) a + t b. Each share keeps a colour of its own where all is constant, or where
    one of both is all metal of a constant colour and the other has none; else the shares have one."""
    (color_a, even_a), (color_b, even_b) = _gloss(a), _gloss(b)
    for dull, metal, color, even in ((a, b, color_b, even_b), (b, a, color_a, even_a)):
        if is_constant(dull.metallic, 0) and is_constant(metal.metallic, 1) and color is not None:
            return {"base_color": dull.base_color, "gloss": input_nodes.Constant((*color.tolist(), even))}
    known = [constant(value) for value in (t, a.metallic, b.metallic, a.base_color, b.base_color)]
    dull = is_constant(a.metallic, 0) and is_constant(b.metallic, 0)
    if dull or color_a is None or color_b is None or any(value is None for value in known):
        alike = input_nodes.Constant((-1.0, -1.0, -1.0, max(even_a, even_b)))
        return {"base_color": _mix_unless_equal(t, a.base_color, b.base_color), "gloss": alike}
    share, metal_a, metal_b, first, second = (np.asarray(value, float)[:3] for value in known)
    shares = (1 - share) * metal_a, share * metal_b
    metallic = shares[0] + shares[1]
    gloss = shares[0] * color_a + shares[1] * color_b
    base = (1 - share - shares[0]) * first + (share - shares[1]) * second
    gloss = np.divide(gloss, metallic, np.zeros(3), where=metallic > 0)
    base = np.divide(base, 1 - metallic, np.zeros(3), where=metallic < 1)
    return {
        "base_color": input_nodes.Constant(tuple(base.tolist())),
        "gloss": input_nodes.Constant((*gloss.tolist(), max(even_a, even_b))),
    }


def _gloss(surface: Surface) -> tuple[np.ndarray | None, float]:
    """The colour (3,) of a surface's metallic share, None if it varies, and 1 if it is alike at every angle."""
    *color, even = np.asarray(constant(surface.gloss), float).tolist()
    if color[0] >= 0:
        return np.array(color), even
    base = constant(surface.base_color)
    return None if base is None else np.clip(np.broadcast_to(np.asarray(base, float)[:3], 3), 0, 1), even


def _mixed_backlit(t: Expression, a: Surface, b: Surface) -> Expression:
    """The share of diffuse light from behind: that of each counts by its colour, or alike where colours vary."""
    if a.backlit.digest == b.backlit.digest:
        return a.backlit
    known = [constant(value) for value in (t, a.base_color, b.base_color, a.backlit, b.backlit)]
    if any(value is None for value in known):
        return color_nodes.Mix(t, a.backlit, b.backlit)
    share, first, second, behind_a, behind_b = (np.asarray(value, float)[:3] for value in known)
    colors = (1 - share) * first, share * second
    total = colors[0] + colors[1]
    behind = colors[0] * behind_a + colors[1] * behind_b
    return input_nodes.Constant(tuple(np.divide(behind, total, np.zeros(3), where=total > 0).tolist()))


def _mixed_holdout(a: Surface, b: Surface, first: Expression, factor: Expression) -> Surface:
    """The mixture of two surfaces of which a share of each is cut out: what is left of them, and the share of all."""
    held = [multiply(share, surface.holdout) for share, surface in ((first, a), (factor, b))]
    cut = math_nodes.Math(held[0], held[1], ZERO, "ADD")
    if is_constant(a.holdout, 1):
        return replace(b, holdout=cut)
    if is_constant(b.holdout, 1):
        return replace(a, holdout=cut)
    seen = math_nodes.Math(factor, held[1], ZERO, "SUBTRACT")
    share = math_nodes.Math(seen, math_nodes.Math(ONE, cut, ZERO, "SUBTRACT"), ZERO, "DIVIDE")
    return replace(mix_surfaces(replace(a, holdout=ZERO), replace(b, holdout=ZERO), share), holdout=cut)


def _with_unseen_of(surface: Surface, other: Surface, even: bool) -> Surface:
    """A surface that has the other's parameters where none of it shows its own, so that mixtures do not mix them.

    `even`: the mixture is the same everywhere. Where it is not, a dielectric's reflection fades by its roughness alone.
    """
    unseen: list[str] = []
    metal, dark = is_constant(surface.metallic, 1), is_constant(surface.base_color, 0)
    if is_constant(surface.coat, 0):
        unseen += ["coat_roughness", "coat_ior", "coat_tint"]
    if is_constant(surface.sheen, 0):
        unseen += ["sheen_roughness"]
    if metal:
        unseen += ["ior", "specular"]
    elif is_constant(surface.metallic, 0) and is_constant(surface.specular, 0):
        unseen += ["tint", "tangent"]
        unseen += ["roughness"] if even or is_constant(other.metallic, 1) else []
    if metal or dark:
        unseen += ["diffuse_roughness", "toon"]
    return replace(surface, **{name: getattr(other, name) for name in unseen})


def faded(surface: Surface, alpha: Expression) -> Surface:
    """A surface of which a share `alpha` is there, and the rest is clear."""
    clear = Surface(alpha=ZERO)
    passes = _mixed_transmission(clear, surface, math_nodes.Math(ONE, alpha, ZERO, "SUBTRACT"), alpha)
    return replace(surface, alpha=multiply(alpha, surface.alpha), transmission_color=passes)


def _mixed_transmission(a: Surface, b: Surface, first: Expression, second: Expression) -> Expression:
    """The transmission colour of `first` a + `second` b: that of each counts by how much passes."""
    if a.transmission_color.digest == b.transmission_color.digest or is_constant(b.alpha, 1) or is_constant(second, 0):
        return a.transmission_color
    if is_constant(a.alpha, 1) or is_constant(first, 0):
        return b.transmission_color
    of_a, of_b = (
        multiply(share, math_nodes.Math(ONE, alpha, ZERO, "SUBTRACT"))
        for share, alpha in ((first, a.alpha), (second, b.alpha))
    )
    t = math_nodes.Math(of_b, math_nodes.Math(of_a, of_b, ZERO, "ADD"), ZERO, "DIVIDE")
    return color_nodes.Mix(t, a.transmission_color, b.transmission_color)


def _mix_unless_equal(t: Expression, a: Expression, b: Expression) -> Expression:
    return a if a.digest == b.digest else color_nodes.Mix(t, a, b)


def is_constant(value: Expression, number: float) -> bool:
    """Whether an expression is the same everywhere and all its channels equal `number`."""
    found = constant(value)
    return found is not None and bool(np.all(found == number))


def is_gray(color: Expression) -> bool:
    """Whether a colour is the same everywhere and has equal channels."""
    found = constant(color)
    return found is not None and bool(np.ptp(found[:3]) <= GRAY)


def only_emits(surface: Surface) -> bool:
    """Whether a surface is opaque and reflects nothing."""
    opaque_black = is_constant(surface.base_color, 0) and is_constant(surface.alpha, 1)
    return opaque_black and is_constant(surface.specular, 0)
