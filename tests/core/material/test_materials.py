"""Material expressions against closed forms in float64, written here a second time with Python's own mathematics."""

import colorsys
import math
import struct
from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.material.baking import bake, bakeable, reading, stored, suggested_resolution
from pointsplat_addon.core.material.evaluation import evaluate_samples, triangle_tangents
from pointsplat_addon.core.material.expression import CHUNK, SampleInputs, evaluate
from pointsplat_addon.core.material.graph import MaterialGraph, Needs, needs
from pointsplat_addon.core.material.image import Image
from pointsplat_addon.core.material.nodes import (
    color_nodes,
    input_nodes,
    math_functions,
    math_nodes,
    normal_nodes,
    ramp_nodes,
    texture_nodes,
)
from pointsplat_addon.core.numeric.cryptomatte import cryptomatte_hash, murmur3

ZERO = input_nodes.Constant((0.0,))
ORIGIN = input_nodes.Constant((0.0, 0.0, 0.0))
UNIT = input_nodes.Constant((1.0, 1.0, 1.0))


def f32(values):
    return np.array(values, np.float32)


def random(shape, low=0.0, high=1.0):
    return f32(np.random.default_rng(3).uniform(low, high, shape))


def given(**arrays):
    """Expressions for arrays (N, 3 | 4), and the samples that hold them."""
    padded = {k: np.pad(f32(a), ((0, 0), (0, 4 - a.shape[1]))) for k, a in arrays.items()}
    return SampleInputs(colors=padded), {k: color_nodes.Color(input_nodes.ColorAttribute(k)) for k in arrays}


def noise(width, height, dtype=np.float32):
    texels = np.random.default_rng(5).random((height, width, 4))
    return Image(np.rint(texels * 255).astype(np.uint8) if dtype is np.uint8 else texels.astype(dtype))


# Arithmetic


MATH = {
    "ADD": lambda a, b, c: a + b,
    "SUBTRACT": lambda a, b, c: a - b,
    "MULTIPLY": lambda a, b, c: a * b,
    "DIVIDE": lambda a, b, c: a / b,
    "MULTIPLY_ADD": lambda a, b, c: a * b + c,
    "POWER": lambda a, b, c: abs(a) ** b if a > 0 else 0,
    "LOGARITHM": lambda a, b, c: math.log(a, b) if a > 0 and b > 0 else 0,
    "SQRT": lambda a, b, c: math.sqrt(a) if a > 0 else 0,
    "INVERSE_SQRT": lambda a, b, c: 1 / math.sqrt(a) if a > 0 else 0,
    "ABSOLUTE": lambda a, b, c: abs(a),
    "EXPONENT": lambda a, b, c: math.exp(a),
    "MINIMUM": lambda a, b, c: min(a, b),
    "MAXIMUM": lambda a, b, c: max(a, b),
    "LESS_THAN": lambda a, b, c: float(a < b),
    "GREATER_THAN": lambda a, b, c: float(a > b),
    "SIGN": lambda a, b, c: math.copysign(1, a),
    "COMPARE": lambda a, b, c: float(abs(a - b) <= max(c, 2**-23)),
    "ROUND": lambda a, b, c: math.floor(a + 0.5),
    "FLOOR": lambda a, b, c: math.floor(a),
    "CEIL": lambda a, b, c: math.ceil(a),
    "TRUNC": lambda a, b, c: math.trunc(a),
    "FRACT": lambda a, b, c: a - math.floor(a),
    "MODULO": lambda a, b, c: math.fmod(a, b),
    "FLOORED_MODULO": lambda a, b, c: a % b,
    "WRAP": lambda a, b, c: c + (a - c) % (b - c),
    "SNAP": lambda a, b, c: b * math.floor(a / b),
    "PINGPONG": lambda a, b, c: abs((a - b) % (2 * b) - b),
    "SINE": lambda a, b, c: math.sin(a),
    "COSINE": lambda a, b, c: math.cos(a),
    "TANGENT": lambda a, b, c: math.tan(a),
    "ARCSINE": lambda a, b, c: math.asin(max(-1, min(1, a))),
    "ARCCOSINE": lambda a, b, c: math.acos(max(-1, min(1, a))),
    "ARCTANGENT": lambda a, b, c: math.atan(a),
    "ARCTAN2": lambda a, b, c: math.atan2(a, b),
    "SINH": lambda a, b, c: math.sinh(a),
    "COSH": lambda a, b, c: math.cosh(a),
    "TANH": lambda a, b, c: math.tanh(a),
    "RADIANS": lambda a, b, c: math.radians(a),
    "DEGREES": lambda a, b, c: math.degrees(a),
}


@pytest.mark.parametrize("operation", sorted(MATH))
def test_math_is_the_textbooks(operation):
    values = random((200, 3), -1.9, 1.9)
    inputs, x = given(v=values)
    a, b, c = (color_nodes.Component(x["v"], i) for i in range(3))
    found = evaluate(math_nodes.Math(a, b, c, operation), inputs)[:, 0]
    expected = [MATH[operation](*row) for row in values.astype(float).tolist()]
    # measured 2e-7 (1e-4 of the largest, 1e3, near the tangent's poles)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("operation", ["DIVIDE", "MODULO", "FLOORED_MODULO", "SNAP", "PINGPONG"])
def test_division_by_zero_is_zero(operation):
    assert evaluate(math_nodes.Math(input_nodes.Constant((3.0,)), ZERO, ZERO, operation), SampleInputs(count=1)) == 0


@pytest.mark.parametrize("k", [0.0, 0.5])
def test_smooth_extrema_touch_the_sharp_ones_beyond_their_width(k):
    values = random((200, 2), -2, 2)
    inputs, x = given(v=values)
    a, b = color_nodes.Component(x["v"], 0), color_nodes.Component(x["v"], 1)
    low = evaluate(math_nodes.Math(a, b, input_nodes.Constant((k,)), "SMOOTH_MIN"), inputs)[:, 0]
    high = evaluate(math_nodes.Math(a, b, input_nodes.Constant((k,)), "SMOOTH_MAX"), inputs)[:, 0]
    apart = np.abs(values[:, 0] - values[:, 1]) >= k
    np.testing.assert_array_equal(low[apart], values.min(axis=1)[apart])
    np.testing.assert_array_equal(high[apart], values.max(axis=1)[apart])
    assert np.all(low <= values.min(axis=1))
    # Blending two equal values lowers them by k / 6
    same = math_nodes.Math(
        input_nodes.Constant((1.0,)), input_nodes.Constant((1.0,)), input_nodes.Constant((k,)), "SMOOTH_MIN"
    )
    assert evaluate(same, SampleInputs(count=1))[0, 0] == pytest.approx(1 - k / 6)


def test_reflection_and_refraction_obey_snell():
    incident = np.stack([math_functions.normalize_rows(random((50, 3), -1, 1)), np.tile(f32([0, 0, 2]), (50, 1))])
    incident[0, :, 2] = -np.abs(incident[0, :, 2])
    inputs, x = given(i=incident[0], n=incident[1])
    ratio = 1 / 1.5
    mirrored = evaluate(math_nodes.VectorMath(x["i"], x["n"], ORIGIN, ZERO, "REFLECT"), inputs)
    np.testing.assert_allclose(mirrored, incident[0] * [1, 1, -1], atol=1e-6)  # measured 0
    bent = evaluate(math_nodes.VectorMath(x["i"], x["n"], ORIGIN, input_nodes.Constant((ratio,)), "REFRACT"), inputs)
    np.testing.assert_allclose(bent[:, :2], incident[0, :, :2] * ratio, atol=1e-6)  # measured 0
    np.testing.assert_allclose(np.linalg.norm(bent, axis=1), 1, atol=1e-6)  # measured 1e-7


def test_mapping_texture_undoes_point():
    inputs, x = given(p=random((100, 3), -2, 2))
    move, turn, scale = (input_nodes.Constant(v) for v in ((0.3, -0.2, 0.9), (0.4, 1.1, -0.7), (2.0, 0.5, -1.5)))
    there = math_nodes.Mapping(x["p"], move, turn, scale, "POINT")
    back = math_nodes.Mapping(there, move, turn, scale, "TEXTURE")
    np.testing.assert_allclose(evaluate(back, inputs), inputs.colors["p"][:, :3], atol=5e-6)  # measured 1e-6


def test_mapping_turns_about_x_then_y_then_z():
    rotation = input_nodes.Constant((math.pi / 2, 0.0, math.pi / 2))
    # X turns +Y into +Z, which Z leaves; +Z becomes -Y, which Z turns into +X
    for start, end in (((0.0, 1.0, 0.0), (0, 0, 1)), ((0.0, 0.0, 1.0), (1, 0, 0))):
        found = evaluate(math_nodes.Mapping(input_nodes.Constant(start), ORIGIN, rotation, UNIT), SampleInputs(count=1))
        np.testing.assert_allclose(found[0], end, atol=1e-6)  # measured 4e-8


def test_normals_map_by_the_inverse_scale():
    # The plane z = x is mapped by scale (2, 1, 1) to z = x / 2
    normal = input_nodes.Constant((-1.0, 0.0, 1.0))
    scale = input_nodes.Constant((2.0, 1.0, 1.0))
    found = evaluate(math_nodes.Mapping(normal, ORIGIN, ORIGIN, scale, "NORMAL"), SampleInputs(count=1))
    np.testing.assert_allclose(found[0], f32([-0.5, 0, 1]) / math.sqrt(1.25), atol=1e-6)  # measured 0


# Colour


@pytest.mark.parametrize(
    ("model", "convert"),
    [
        ("HSV_FROM_RGB", colorsys.rgb_to_hsv),
        ("RGB_FROM_HSV", colorsys.hsv_to_rgb),
        ("HSL_FROM_RGB", lambda r, g, b: tuple(np.array(colorsys.rgb_to_hls(r, g, b))[[0, 2, 1]])),
        ("RGB_FROM_HSL", lambda h, s, li: colorsys.hls_to_rgb(h, li, s)),
    ],
)
def test_color_models_are_the_standard_librarys(model, convert):
    colors = np.concatenate([random((200, 3)), f32([[0, 0, 0], [1, 1, 1], [0.5, 0.5, 0.5], [1, 0, 0], [1, 0, 1]])])
    inputs, x = given(c=colors)
    expected = [convert(*row) for row in colors.astype(float).tolist()]
    np.testing.assert_allclose(
        evaluate(color_nodes.ColorModel(x["c"], model), inputs), expected, atol=5e-6
    )  # measured 2e-7


FULL_BLEND = {  # the result of blending b over a with factor 1
    "MIX": lambda a, b: b,
    "DARKEN": min,
    "MULTIPLY": lambda a, b: a * b,
    "BURN": lambda a, b: max(0.0, 1 - (1 - a) / b),
    "LIGHTEN": max,
    "SCREEN": lambda a, b: 1 - (1 - a) * (1 - b),
    "DODGE": lambda a, b: min(1.0, a / (1 - b)),
    "ADD": lambda a, b: a + b,
    "OVERLAY": lambda a, b: 2 * a * b if a < 0.5 else 1 - 2 * (1 - a) * (1 - b),
    "LINEAR_LIGHT": lambda a, b: a + 2 * b - 1,
    "DIFFERENCE": lambda a, b: abs(a - b),
    "EXCLUSION": lambda a, b: a + b - 2 * a * b,
    "SUBTRACT": lambda a, b: a - b,
    "DIVIDE": lambda a, b: a / b,
    "SOFT_LIGHT": lambda a, b: (1 - a) * a * b + a * (1 - (1 - a) * (1 - b)),
}


@pytest.mark.parametrize("blend", sorted(FULL_BLEND))
def test_blending_fully_is_the_blend_mode(blend):
    inputs, x = given(a=random((100, 3), 0.05, 0.95), b=random((200, 3), 0.05, 0.95)[100:])
    found = evaluate(color_nodes.Mix(input_nodes.Constant((1.0,)), x["a"], x["b"], blend), inputs)
    a, b = (inputs.colors[k][:, :3].astype(float) for k in "ab")
    np.testing.assert_allclose(found, np.vectorize(FULL_BLEND[blend])(a, b), rtol=1e-5, atol=1e-6)  # measured 3e-7


@pytest.mark.parametrize("blend", sorted(color_nodes.BLEND))
def test_blending_with_factor_zero_changes_nothing(blend):
    inputs, x = given(a=random((100, 3), 0.05, 0.95), b=random((200, 3), 0.05, 0.95)[100:])
    found = evaluate(color_nodes.Mix(ZERO, x["a"], x["b"], blend), inputs)
    np.testing.assert_allclose(found, inputs.colors["a"][:, :3], atol=1e-6)  # measured 2e-7


def test_mixing_hue_takes_the_hue_and_keeps_the_rest():
    a, b = (0.8, 0.3, 0.2), (0.1, 0.4, 0.9)
    found = evaluate(
        color_nodes.Mix(input_nodes.Constant((1.0,)), input_nodes.Constant(a), input_nodes.Constant(b), "HUE"),
        SampleInputs(count=1),
    )[0]
    h, s, v = colorsys.rgb_to_hsv(*found.tolist())
    assert (h, s, v) == pytest.approx((colorsys.rgb_to_hsv(*b)[0], *colorsys.rgb_to_hsv(*a)[1:]), abs=1e-6)


def test_mixing_clamps_factor_and_result():
    two = input_nodes.Constant((2.0,))
    a, b = input_nodes.Constant((0.0,)), input_nodes.Constant((3.0,))
    once = SampleInputs(count=1)
    assert evaluate(color_nodes.Mix(two, a, b), once) == 3
    assert evaluate(color_nodes.Mix(two, a, b, clamp_factor=False), once) == 6
    assert evaluate(color_nodes.Mix(two, a, b, clamp_result=True), once) == 1


def test_invert_gamma_contrast_and_hue_shift():
    inputs, x = given(c=random((50, 3)))
    c = inputs.colors["c"][:, :3].astype(float)
    one = input_nodes.Constant((1.0,))
    np.testing.assert_allclose(evaluate(color_nodes.Invert(one, x["c"]), inputs), 1 - c, atol=1e-6)  # measured 3e-8
    np.testing.assert_allclose(
        evaluate(color_nodes.Gamma(x["c"], input_nodes.Constant((2.2,))), inputs), c**2.2, atol=1e-6
    )
    contrast = color_nodes.BrightContrast(x["c"], input_nodes.Constant((0.1,)), input_nodes.Constant((0.5,)))
    np.testing.assert_allclose(
        evaluate(contrast, inputs), np.maximum(1.5 * (c - 0.5) + 0.6, 0), atol=1e-6
    )  # measured 8e-8
    # Half a turn of hue on saturated colours
    third = color_nodes.HueSaturation(
        input_nodes.Constant((0.5 + 1 / 3,)), one, one, one, input_nodes.Constant((0.9, 0.2, 0.2))
    )
    np.testing.assert_allclose(evaluate(third, SampleInputs(count=1))[0], (0.2, 0.9, 0.2), atol=1e-6)  # measured 3e-7


@pytest.mark.parametrize(("ordered", "expected"), [(False, 0.3), (True, 0.5)])
def test_clamping_between_exchanged_limits(ordered, expected):
    clamp = math_nodes.Clamp(
        input_nodes.Constant((0.5,)), input_nodes.Constant((0.7,)), input_nodes.Constant((0.3,)), ordered
    )
    assert evaluate(clamp, SampleInputs(count=1))[0, 0] == np.float32(expected)


@pytest.mark.parametrize(
    ("kind", "shape"),
    [
        ("LINEAR", lambda t: t),
        ("STEPPED", lambda t: min(math.floor(5 * t) / 4, 1)),
        ("SMOOTHSTEP", lambda t: 3 * t**2 - 2 * t**3),
        ("SMOOTHERSTEP", lambda t: 6 * t**5 - 15 * t**4 + 10 * t**3),
    ],
)
def test_map_range(kind, shape):
    inputs, x = given(v=random((300, 1), -0.5, 2.5))
    low, high, to_low, to_high, steps = (input_nodes.Constant((v,)) for v in (0.2, 1.7, 3.0, -1.0, 4.0))
    mapped = math_nodes.MapRange(color_nodes.Component(x["v"], 0), low, high, to_low, to_high, steps, kind)
    found = evaluate(mapped, inputs)[:, 0]
    t = np.clip((inputs.colors["v"][:, 0].astype(float) - 0.2) / 1.5, 0, 1)
    np.testing.assert_allclose(found, [3 - 4 * shape(s) for s in t], atol=1e-5)  # measured 3e-6


def test_a_ramp_meets_its_stops_and_jumps_at_constant_ones():
    positions, colors = f32([0.2, 0.5, 0.8]), random((3, 4))
    at_stops = SampleInputs(colors={"x": np.repeat(positions[:, None], 4, axis=1)})
    for kind in ("LINEAR", "EASE", "CONSTANT", "CARDINAL"):
        found = evaluate(ramp_nodes.ColorRamp(input_nodes.ColorAttribute(), positions, colors, kind), at_stops)
        np.testing.assert_allclose(found, colors, atol=1e-6)  # measured 0
    before = SampleInputs(colors={"x": np.full((1, 4), np.nextafter(np.float32(0.5), np.float32(0)))})
    found = evaluate(ramp_nodes.ColorRamp(input_nodes.ColorAttribute(), positions, colors, "CONSTANT"), before)
    np.testing.assert_array_equal(found[0], colors[0])


def test_curve_tables_interpolate_and_continue():
    curve = ramp_nodes.CurveTable(-1.0, 1.0, (0.0, 2.0, 3.0), slopes=(0.5, -1.0))
    x = f32([-3, -1, -0.5, 0, 0.5, 1, 2])
    np.testing.assert_allclose(curve(x), [-1, 0, 1, 2, 2.5, 3, 2], atol=1e-7)  # measured 0


# Pictures


def look_up(image, uv, **properties):
    texture = texture_nodes.ImageTexture(input_nodes.UV(), image, **properties)
    return evaluate(texture, SampleInputs(uv={"": f32(uv)}, active_uv=""))


def test_texel_centres_show_their_texel_exactly():
    image = noise(4, 8)  # powers of two: the centres are exact in float32
    v, u = np.mgrid[:8, :4]
    centres = np.stack([(u.ravel() + 0.5) / 4, (v.ravel() + 0.5) / 8], axis=1)
    for interpolation in ("Linear", "Closest"):
        found = look_up(image, centres, interpolation=interpolation)
        np.testing.assert_array_equal(found, image.texels.reshape(-1, 4))


def test_linear_look_up_reproduces_planes_between_the_outer_centres():
    height, width = 7, 5
    v, u = np.mgrid[:height, :width]
    plane = 0.3 * (u + 0.5) / width - 0.2 * (v + 0.5) / height + 0.5
    image = Image(f32(np.repeat(plane[..., None], 4, axis=2)))
    uv = random((500, 2)) * [1 - 1 / width, 1 - 1 / height] + [0.5 / width, 0.5 / height]
    expected = 0.3 * uv[:, 0] - 0.2 * uv[:, 1] + 0.5
    for interpolation in ("Linear", "Cubic"):
        inside = (np.abs(uv - 0.5) < 0.5 - 1.5 / np.array([width, height])).all(axis=1)
        part = slice(None) if interpolation == "Linear" else inside
        found = look_up(image, uv[part], interpolation=interpolation)[:, 0]
        np.testing.assert_allclose(found, expected[part], atol=1e-6)  # measured 1e-7


@pytest.mark.parametrize(
    ("extension", "origin"),
    [
        ("REPEAT", lambda x: x - math.floor(x)),
        ("MIRROR", lambda x: 1 - abs(x % 2 - 1)),
        ("EXTEND", lambda x: min(max(x, 0.0), 1 - 1e-6)),
    ],
)
def test_outside_the_picture_stands_what_its_extension_says(extension, origin):
    image = noise(6, 6)
    outside = random((300, 2), -3, 4)
    inside = np.vectorize(origin)(outside.astype(float))
    far = np.abs(inside * 6 - np.round(inside * 6)).min(axis=1) > 1e-3  # not on an edge between texels
    found = look_up(image, outside, interpolation="Closest", extension=extension)
    expected = look_up(image, inside, interpolation="Closest", extension="EXTEND")
    if extension != "EXTEND":
        found, expected = found[far], expected[far]
    np.testing.assert_array_equal(found, expected)


def test_clipped_pictures_fade_out_over_half_a_texel():
    image = Image(np.ones((2, 2, 4), np.float32))
    u = f32([-0.3, -0.25, -0.125, 0.0, 0.25, 1.0, 1.125, 1.3])
    found = look_up(image, np.stack([u, np.full_like(u, 0.5)], axis=1), extension="CLIP")
    np.testing.assert_allclose(found[:, 3], [0, 0, 0.25, 0.5, 1, 0.5, 0.25, 0], atol=1e-6)  # measured 0


def test_bytes_are_decoded_after_interpolation():
    image = Image(np.array([[[0] * 4, [255] * 4]], np.uint8), srgb=True)
    found = look_up(image, [(0.5, 0.5)])[0]
    # IEC 61966-2-1 at one half; alpha is not encoded
    np.testing.assert_allclose(found, [((0.5 + 0.055) / 1.055) ** 2.4] * 3 + [0.5], atol=1e-6)  # measured 3e-9


def test_straight_colour_does_not_bleed_from_transparent_texels():
    texels = f32([[[1, 0.5, 0.25, 1], [0, 0, 0, 0]]])
    image = Image(texels, associated=True)
    np.testing.assert_allclose(
        look_up(image, [(0.5, 0.5)], straight=True)[0], [1, 0.5, 0.25, 0.5], atol=1e-7
    )  # measured 0
    np.testing.assert_allclose(look_up(image, [(0.75, 0.5)], straight=True)[0], 0, atol=1e-7)


@pytest.mark.parametrize(
    "texels", [np.zeros((2, 2, 3), np.float32), np.zeros((2, 2, 4)), np.zeros((0, 2, 4), np.uint8)]
)
def test_images_refuse_other_texels(texels):
    with pytest.raises(ValueError, match="texels"):
        Image(texels)


def test_uvs_that_are_no_numbers_read_some_texel():
    image = noise(4, 4)
    for interpolation in ("Linear", "Closest", "Cubic"):
        found = look_up(image, [(np.nan, 0.5), (np.inf, 1e30), (-1e30, 3e9)], interpolation=interpolation)
        assert np.isfinite(found).all()


# Normals


def test_a_flat_normal_map_changes_nothing_and_a_tilted_one_leans_along_the_tangent():
    normal, tangent = math_functions.normalize_rows(random((50, 3), -1, 1)), random((100, 3), -1, 1)[50:]
    tangent = math_functions.normalize_rows(tangent - normal * (normal * tangent).sum(axis=1, keepdims=True))
    inputs = SampleInputs(uv={"m": np.zeros((50, 2))}, normal=normal, tangent=tangent, bitangent_sign=-np.ones(50))
    one = input_nodes.Constant((1.0,))
    flat = normal_nodes.NormalMap(one, input_nodes.Constant((0.5, 0.5, 1.0)), input_nodes.UV("m"))
    np.testing.assert_allclose(evaluate(flat, inputs), normal, atol=1e-6)  # measured 6e-8
    along_u = normal_nodes.NormalMap(one, input_nodes.Constant((1.0, 0.5, 0.5)), input_nodes.UV("m"))
    np.testing.assert_allclose(evaluate(along_u, inputs), tangent, atol=1e-6)  # measured 6e-8
    along_v = normal_nodes.NormalMap(one, input_nodes.Constant((0.5, 1.0, 0.5)), input_nodes.UV("m"))
    np.testing.assert_allclose(evaluate(along_v, inputs), np.cross(tangent, normal), atol=1e-6)  # measured 2e-7
    off = normal_nodes.NormalMap(ZERO, input_nodes.Constant((1.0, 0.2, 0.5)), input_nodes.UV("m"))
    np.testing.assert_allclose(evaluate(off, inputs), normal, atol=1e-6)  # measured 6e-8


def test_tangents_follow_growing_u():
    position = random((40, 3, 3), -1, 1)
    gradient = random((80, 2, 3), -1, 1)[40:]
    uv = np.einsum("tcx,tkx->tck", position, gradient)  # linear in position, so du along T must be positive
    tangent, sign = triangle_tangents(position, f32(uv))
    normal = np.cross(position[:, 1] - position[:, 0], position[:, 2] - position[:, 0])
    np.testing.assert_allclose((tangent * normal).sum(axis=1), 0, atol=1e-5)  # measured 1e-7
    u, v = (np.einsum("tx,tx->t", tangent, gradient[:, k]) for k in (0, 1))
    assert np.all(u > 0)
    np.testing.assert_allclose(v, 0, atol=1e-4)  # measured 2e-7: v does not change along the tangent
    bitangent = np.cross(normal, tangent) * sign[:, None]
    assert np.all(np.einsum("tx,tx->t", bitangent, gradient[:, 1]) > 0)


def test_degenerate_uvs_still_give_a_unit_tangent():
    tangent, sign = triangle_tangents(f32([[(0, 0, 0), (0, 2, 0), (0, 0, 1)]]), np.zeros((1, 3, 2), np.float32))
    np.testing.assert_array_equal(tangent, [(0, 1, 0)])
    assert sign[0] == 1


# Graphs


def test_missing_inputs_read_as_zero():
    inputs = SampleInputs(count=3)
    sources = (
        input_nodes.UV(),
        input_nodes.UV("absent"),
        input_nodes.ColorAttribute("absent"),
        input_nodes.Coordinates("generated"),
    )
    for source in sources:
        assert not evaluate(source, inputs).any()
    np.testing.assert_array_equal(evaluate(input_nodes.Attribute("absent"), inputs), [[0, 0, 0, 1, 0]] * 3)


def test_samples_without_arrays_need_a_count():
    with pytest.raises(ValueError, match="count"):
        evaluate(input_nodes.UV(), SampleInputs())


def test_long_arrays_are_evaluated_in_parts_that_join():
    count = 2 * CHUNK + 17
    inputs = SampleInputs(position=random((count, 3)), colors={"Col": random((count, 4))})
    total = math_nodes.VectorMath(
        input_nodes.Coordinates("position"), color_nodes.Color(input_nodes.ColorAttribute()), ORIGIN, ZERO, "ADD"
    )
    assert inputs.position is not None
    np.testing.assert_array_equal(evaluate(total, inputs), inputs.position + inputs.colors["Col"][:, :3])
    assert evaluate(total, inputs.take(slice(0, 0))).shape == (0, 3)


def test_channels_are_finite_and_in_range():
    inputs, x = given(v=f32([[np.nan, np.inf, -np.inf], [2, -3, 0.5]]))
    scalar = color_nodes.Component(x["v"], 0)
    graph = MaterialGraph(x["v"], scalar, scalar, color_nodes.Component(x["v"], 1), x["v"], x["v"])
    out = evaluate_samples(graph, inputs)
    np.testing.assert_array_equal(out["base_color"], [[0, 0, 0], [2, 0, 0.5]])
    np.testing.assert_array_equal(out["roughness"], [0, 1])
    np.testing.assert_array_equal(out["alpha"], [0, 0])
    assert all(np.isfinite(a).all() for a in out.values())
    assert {a.shape for a in out.values()} == {(2,), (2, 3)}


def test_needs_name_what_is_read():
    image = noise(2, 2)
    normal_map = normal_nodes.NormalMap(
        input_nodes.Constant((1.0,)),
        color_nodes.Color(texture_nodes.ImageTexture(input_nodes.UV("a"), image)),
        input_nodes.UV(),
    )
    graph = MaterialGraph(base_color=color_nodes.Color(input_nodes.ColorAttribute("Col")), normal=normal_map)
    expected = Needs(
        uv=frozenset({"a", None}), colors=frozenset({"Col"}), normal=True, tangent=frozenset({None}), images=True
    )
    assert needs(graph) == expected
    named = MaterialGraph(
        roughness=color_nodes.Component(input_nodes.Attribute("x"), 4), emission=input_nodes.Coordinates("position")
    )
    assert needs(named) == Needs(uv=frozenset({"x"}), colors=frozenset({"x"}), position=True)


def test_digests_depend_on_content_alone():
    def graph(seed, factor):
        texels = np.random.default_rng(seed).random((2, 2, 4)).astype(np.float32)
        color = color_nodes.Color(texture_nodes.ImageTexture(input_nodes.UV(), Image(texels)))
        return MaterialGraph(base_color=color_nodes.Mix(input_nodes.Constant((factor,)), color, UNIT))

    assert graph(1, 0.5).digest == graph(1, 0.5).digest
    assert len({graph(1, 0.5).digest, graph(2, 0.5).digest, graph(1, 0.25).digest}) == 3


def scaled(scale, angle=0.0):
    return math_nodes.Mapping(
        input_nodes.UV(),
        input_nodes.Constant((0.2, 0.1, 0.0)),
        input_nodes.Constant((0.0, 0.0, angle)),
        input_nodes.Constant((*scale, 1.0)),
    )


@pytest.mark.parametrize(
    ("uv", "extension", "expected"),
    [
        (input_nodes.UV(), "REPEAT", "REPEAT"),
        (input_nodes.UV("map"), "REPEAT", "REPEAT"),
        (input_nodes.UV(), "MIRROR", "MIRROR"),
        (input_nodes.UV(), "CLIP", "BORDER"),
        (input_nodes.UV(), "EXTEND", "BORDER"),
        (scaled((3.0, 2.0)), "REPEAT", "REPEAT"),
        (scaled((3.0, 2.0)), "MIRROR", None),
        (scaled((4.0, 2.0)), "MIRROR", "REPEAT"),
        (scaled((1.5, 2.0)), "REPEAT", None),
        (scaled((2.0, 3.0)), "EXTEND", None),
        (scaled((2.0, 3.0), math.pi / 2), "REPEAT", "REPEAT"),
        (scaled((1.0, 1.0), 0.3), "REPEAT", None),
        (input_nodes.Coordinates("generated"), "REPEAT", None),
    ],
)
def test_pictures_go_on_beyond_the_square_as_their_images_do(uv, extension, expected):
    graph = MaterialGraph(
        base_color=color_nodes.Color(texture_nodes.ImageTexture(uv, noise(4, 4), extension=extension))
    )
    assert bakeable(graph) is (expected is not None)
    assert bakeable(graph, unit_square=True) is not isinstance(uv, input_nodes.Coordinates)
    if bakeable(graph, unit_square=True):
        assert reading(graph).extension == (expected or "BORDER")
    if expected == "REPEAT":
        # A period further the graph shows the same
        uv_here = random((50, 2))
        here, there = (
            evaluate_samples(graph, SampleInputs(uv={"map": uv_here + shift}, active_uv="map"))["base_color"]
            for shift in (0, np.array([2, -1]))
        )
        np.testing.assert_allclose(here, there, atol=1e-4)  # measured 2e-6: float32 UVs


def test_two_names_of_one_map_are_one_map():
    image = noise(4, 4)
    first, second = (
        color_nodes.Color(texture_nodes.ImageTexture(uv, image)) for uv in (input_nodes.UV(), input_nodes.UV("map"))
    )
    graph = MaterialGraph(base_color=first, emission=second)
    assert not bakeable(graph)
    assert bakeable(graph, active_uv="map")


@pytest.mark.parametrize(
    ("uv", "expected"),
    [(input_nodes.UV(), (6, 4)), (scaled((3.0, 2.0)), (18, 8)), (scaled((2.0, 3.0), math.pi / 2), (8, 18))],
)
def test_the_suggested_resolution_keeps_every_texel(uv, expected):
    graph = MaterialGraph(alpha=color_nodes.Component(texture_nodes.ImageTexture(uv, noise(6, 4)), 3))
    assert suggested_resolution(graph) == expected
    assert suggested_resolution(graph, largest=7) == tuple(min(s, 7) for s in expected)


def leaf(**properties):
    """An image whose colour is multiplied by its alpha, as Cycles stores it where both are used."""
    texels = np.array([[[200, 100, 50, 255], [0, 0, 0, 0]]], np.uint8)
    image = Image(texels, srgb=True, associated=True)
    return texture_nodes.ImageTexture(input_nodes.UV(), image, straight=True, **properties)


def test_pictures_hold_colours_as_their_images_do():
    """What is interpolated are encoded colours, multiplied by alpha where the image is."""
    graph = MaterialGraph(base_color=color_nodes.Color(leaf()), alpha=color_nodes.Component(leaf(), 3))
    how = reading(graph)
    assert how.encoded == how.associated == {"base_color"}
    picture = stored(graph, bake(graph, (2, 1)))
    np.testing.assert_allclose(picture["base_color"][0] * 255, [[200, 100, 50], [0, 0, 0]], atol=1e-4)  # measured 1e-5

    other = MaterialGraph(
        base_color=color_nodes.Color(leaf()), alpha=color_nodes.Component(leaf(interpolation="Closest"), 3)
    )
    assert reading(other).associated == frozenset()


def test_baking_evaluates_at_texel_centres_with_normals_in_tangent_space():
    image = noise(8, 4)
    tilted = normal_nodes.NormalMap(
        input_nodes.Constant((1.0,)), input_nodes.Constant((1.0, 0.5, 0.5)), input_nodes.UV()
    )
    graph = MaterialGraph(
        base_color=color_nodes.Color(texture_nodes.ImageTexture(input_nodes.UV(), image)), normal=tilted
    )
    baked = bake(graph, (8, 4))
    np.testing.assert_array_equal(baked["base_color"], image.texels[..., :3])
    np.testing.assert_allclose(baked["normal"], np.broadcast_to([1, 0, 0], (4, 8, 3)), atol=1e-7)  # measured 0


@pytest.mark.parametrize("straight", [False, True])
@pytest.mark.parametrize("interpolation", ["Linear", "Closest", "Cubic"])
@pytest.mark.parametrize(("srgb", "associated"), [(True, False), (True, True), (False, True)])
@pytest.mark.parametrize("bytewise", [True, False])
def test_texels_that_are_read_are_those_that_would_be_interpolated(straight, interpolation, srgb, associated, bytewise):
    width, height = 300, 231  # more samples than are evaluated at once
    texels = np.random.default_rng(5).integers(64, 256, (height, width, 4)).astype(np.uint8)
    texels[..., :3] = texels[..., :3].astype(np.uint16) * texels[..., 3:] // 255
    image = Image(texels if bytewise else texels / np.float32(255), srgb, associated)
    direct = texture_nodes.ImageTexture(input_nodes.UV(), image, interpolation, straight=straight)
    mapped = replace(direct, uv=math_nodes.Mapping(input_nodes.UV(), ORIGIN, ORIGIN, UNIT))
    found, expected = (
        bake(MaterialGraph(base_color=color_nodes.Color(node), alpha=color_nodes.Component(node, 3)), (width, height))
        for node in (direct, mapped)
    )
    # Places that are interpolated at are rounded (by 1e-5 of a texel): measured 8.4e-5
    for name in ("base_color", "alpha"):
        np.testing.assert_allclose(found[name], expected[name], rtol=0, atol=3e-4)


# Cryptomatte


@pytest.mark.parametrize(
    ("name", "value"),
    [  # the examples of the specification, version 1.2
        ("hello", 6.0705627102400005616e-17),
        ("cube", -4.08461912519e15),
        ("sphere", 2.79018604383e15),
        ("plane", 3.66557617593e-11),
    ],
)
def test_cryptomatte_identifiers_are_the_specifications(name, value):
    found = struct.unpack("<f", struct.pack("<I", cryptomatte_hash(name)))[0]
    assert found == pytest.approx(value, rel=1e-11)  # measured 2e-12: the specification prints twelve digits


def test_murmur_hash_has_its_published_values():
    assert murmur3(b"") == 0
    assert murmur3(b"", seed=1) == 0x514E28B7
    assert murmur3(b"hello, world") == 0x149BBB7F
    assert murmur3(b"The quick brown fox jumps over the lazy dog") == 0x2E4FF723


def test_identifiers_are_ordinary_floats():
    hashes = np.array([cryptomatte_hash(f"name {i}") for i in range(3000)], np.uint32)
    assert np.isfinite(hashes.view(np.float32)).all()
    exponents = hashes >> 23 & 255
    assert exponents.min() > 0
    # Without the correction about 23 of 3000 names would have an exponent of 0 or 255
    raw = np.array([murmur3(f"name {i}".encode()) for i in range(3000)], np.uint32) >> 23 & 255
    assert np.isin(raw, (0, 255)).any()
