"""Procedural textures beside plain loops in float64, at lattice points, far away and at values that are not finite."""

import itertools
import math
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from pointsplat_addon.core.material.expression import Expression, SampleInputs, evaluate
from pointsplat_addon.core.material.masks import is_mask
from pointsplat_addon.core.material.nodes.color_nodes import Component
from pointsplat_addon.core.material.nodes.input_nodes import Constant, Coordinates
from pointsplat_addon.core.material.nodes.math_nodes import Math
from pointsplat_addon.core.material.nodes.procedural import blocks, hashes, perlin
from pointsplat_addon.core.material.nodes.procedural.noise import Noise, WhiteNoise
from pointsplat_addon.core.material.nodes.procedural.patterns import Brick, Checker, Gradient, Magic, Wave
from pointsplat_addon.core.material.nodes.procedural.voronoi import Voronoi

PLACE = Coordinates("position")
WORD = 0xFFFFFFFF
FRACTALS = ("FBM", "MULTIFRACTAL", "HYBRID_MULTIFRACTAL", "RIDGED_MULTIFRACTAL", "HETERO_TERRAIN")


def c(*value):
    return Constant(tuple(map(float, value)))


def constants(numbers: dict[str, float]) -> dict[str, Any]:
    return {name: c(value) for name, value in numbers.items()}


def noise(**changes):
    numbers = {"w": 0.3, "scale": 1, "detail": 0, "roughness": 0.5, "lacunarity": 2, "offset": 0.2, "gain": 1}
    made = Noise(PLACE, **constants(numbers), distortion=c(0))
    return replace(made, **{k: c(v) if isinstance(v, float) else v for k, v in changes.items()})


def voronoi(**changes):
    numbers = {"w": 0.3, "scale": 1, "detail": 0, "roughness": 0.5, "lacunarity": 2, "smoothness": 1, "exponent": 0.5}
    made = Voronoi(PLACE, **constants(numbers), randomness=c(1))
    return replace(made, **{k: c(v) if isinstance(v, float) else v for k, v in changes.items()})


def at(texture, points):
    return evaluate(texture, SampleInputs(position=np.asarray(points, np.float32).reshape(-1, 3)))


def somewhere(count=500, extent=20.0, seed=1):
    return np.random.default_rng(seed).uniform(-extent, extent, (count, 3)).astype(np.float32)


TEXTURES = {
    **{
        f"noise {k} {d}D": noise(kind=k, dimensions=d, detail=2.5, distortion=0.5)
        for k in FRACTALS
        for d in (1, 2, 3, 4)
    },
    **{f"white noise {d}D": WhiteNoise(PLACE, c(0.3), d) for d in (1, 2, 3, 4)},
    **{
        f"voronoi {f} {d}D {h}": voronoi(feature=f, dimensions=d, detail=1.5, congruential=h)
        for f in ("F1", "F2", "SMOOTH_F1", "DISTANCE_TO_EDGE", "N_SPHERE_RADIUS")
        for d in (1, 2, 3, 4)
        for h in (False, True)
    },
    **{f"voronoi {m}": voronoi(metric=m, normalize=True) for m in ("MANHATTAN", "CHEBYCHEV", "MINKOWSKI")},
    "checker": Checker(PLACE, c(2)),
    **{
        f"gradient {k}": Gradient(PLACE, k)
        for k in ("LINEAR", "QUADRATIC", "EASING", "DIAGONAL", "RADIAL", "SPHERICAL")
    },
    **{f"wave {r}": Wave(PLACE, c(1), c(2), c(2), c(1), c(0.5), c(0), r) for r in (False, True)},
    "magic": Magic(PLACE, c(5), c(1), 10),
    "brick": Brick(PLACE, c(1, 0, 0), c(0, 1, 0), c(0, 0, 1), c(5), c(0.02), c(0.1), c(0), c(0.5), c(0.25)),
}


# Hashes


def rotated(x, bits):
    return (x << bits | x >> (32 - bits)) & WORD


def jenkins(*words):
    """Jenkins' lookup3 of one to four words, as he published it."""
    a, b, c = ((0xDEADBEEF + (len(words) << 2) + 13 + (words[i] if i < len(words) else 0)) & WORD for i in range(3))
    if len(words) == 4:
        a, c = (a - c & WORD) ^ rotated(c, 4), c + b & WORD
        b, a = (b - a & WORD) ^ rotated(a, 6), a + c & WORD
        c, b = (c - b & WORD) ^ rotated(b, 8), b + a & WORD
        a, c = (a - c & WORD) ^ rotated(c, 16), c + b & WORD
        b, a = (b - a & WORD) ^ rotated(a, 19), a + c & WORD
        c, b = (c - b & WORD) ^ rotated(b, 4), b + a & WORD
        a = a + words[3] & WORD
    c = (c ^ b) - rotated(b, 14) & WORD
    a = (a ^ c) - rotated(c, 11) & WORD
    b = (b ^ a) - rotated(a, 25) & WORD
    c = (c ^ b) - rotated(b, 16) & WORD
    a = (a ^ c) - rotated(c, 4) & WORD
    b = (b ^ a) - rotated(a, 14) & WORD
    return (c ^ b) - rotated(b, 24) & WORD


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_hash_is_lookup3(count):
    words = np.random.default_rng(count).integers(0, 2**32, (count, 50), dtype=np.uint32)
    assert hashes.lookup3(list(words)).tolist() == [jenkins(*column) for column in words.T.tolist()]


def test_white_noise_is_uniform_and_has_no_negative_zero():
    value = at(WhiteNoise(PLACE, c(0)), somewhere(20_000))
    assert value.min() >= 0
    assert value.max() <= 1
    # Measured: means off by 0.005, standard deviations by 0.0015
    assert np.abs(value.mean(axis=0) - 0.5).max() < 0.01
    assert np.abs(value.std(axis=0) - 12**-0.5).max() < 0.01
    assert (at(WhiteNoise(PLACE, c(0)), [-0.0, 0, 1]) == at(WhiteNoise(PLACE, c(0)), [0.0, -0.0, 1])).all()


# Perlin noise


def reference_noise(point):
    """Improved noise at one point, in Python's own numbers (Perlin 2002)."""
    d = len(point)
    cell = [math.floor(x) for x in point]
    t = [x - i for x, i in zip(point, cell, strict=True)]
    total = 0.0
    for corner in itertools.product((0, 1), repeat=d):
        h = jenkins(*(i + k & WORD for i, k in zip(cell, corner, strict=True)))
        way = [x - k for x, k in zip(t, corner, strict=True)]
        if d == 1:
            slope = ((h & 7) + 1) * (-1 if h & 8 else 1) * way[0]
        elif d == 2:
            u, v = way if h & 7 < 4 else way[::-1]
            slope = u * (-1 if h & 1 else 1) + 2 * v * (-1 if h & 2 else 1)
        elif d == 3:
            k = h & 15
            u, v = way[0 if k < 8 else 1], way[1 if k < 4 else 0 if k in (12, 14) else 2]
            slope = u * (-1 if h & 1 else 1) + v * (-1 if h & 2 else 1)
        else:
            k = h & 31
            u, v, s = way[0 if k < 24 else 1], way[1 if k < 16 else 2], way[2 if k < 8 else 3]
            slope = u * (-1 if h & 1 else 1) + v * (-1 if h & 2 else 1) + s * (-1 if h & 4 else 1)
        weights = [x**3 * (x * (x * 6 - 15) + 10) for x in t]
        total += slope * math.prod(w if k else 1 - w for w, k in zip(weights, corner, strict=True))
    return total * (0.25, 0.6616, 0.982, 0.8344)[d - 1]


@pytest.mark.parametrize("d", [1, 2, 3, 4])
def test_noise_is_perlins(d):
    p = np.random.default_rng(d).uniform(-50, 50, (d, 60)).astype(np.float32)
    expected = [reference_noise(point) for point in p.T.tolist()]
    assert np.abs(perlin.signed_noise(p) - expected).max() < 5e-6  # measured: 8.2e-7


@pytest.mark.parametrize("d", [1, 2, 3, 4])
def test_noise_is_zero_at_lattice_points_and_periodic_and_smooth(d):
    rng = np.random.default_rng(d)
    lattice = rng.integers(-1000, 1000, (d, 200)).astype(np.float32)
    assert (perlin.signed_noise(lattice) == 0).all()
    p = rng.integers(0, 64 * 50, (d, 2000)).astype(np.float32) / 64
    value = perlin.signed_noise(p)
    assert (perlin.signed_noise(p + np.float32(100_000)) == value).all()
    assert np.abs(value).max() <= 1
    # Measured: slopes of 2.5, 3.6, 3.9 and 4.2
    assert np.abs(perlin.signed_noise(p + np.float32(1 / 1024)) - value).max() < 5 / 1024


def test_gradients_are_edges_of_cubes():
    assert {tuple(g) for g in perlin.GRADIENTS[3].T.tolist()} == {
        g for g in itertools.product((-1, 0, 1), repeat=3) if sum(map(abs, g)) == 2
    }
    assert {tuple(g) for g in perlin.GRADIENTS[4].T.tolist()} == {
        g for g in itertools.product((-1, 0, 1), repeat=4) if sum(map(abs, g)) == 3
    }


# Fractals


def reference_fbm(point, octaves, roughness, lacunarity):
    values = [reference_noise([x * lacunarity**k for x in point]) * roughness**k for k in range(octaves)]
    return 0.5 + 0.5 * sum(values) / sum(roughness**k for k in range(octaves))


def test_octaves_add_up_and_fractions_lie_between():
    points = somewhere(30, 3)
    made = noise(roughness=0.6, lacunarity=2.5, colored=False)
    two, three, between = (at(replace(made, detail=c(d)), points)[:, 0] for d in (1, 2, 1.25))
    expected = [reference_fbm(p, 3, 0.6, 2.5) for p in points.tolist()]
    assert np.abs(three - expected).max() < 1e-6  # measured: 3.2e-7
    assert np.abs(between - (0.75 * two + 0.25 * three)).max() < 1e-6  # measured: 6e-8


@pytest.mark.parametrize("kind", FRACTALS)
def test_inputs_may_vary(kind):
    """A sample has the value that it would have with its own detail, roughness and so on everywhere."""
    points = somewhere(64, 3)
    points[:, 0] = np.repeat(np.arange(4), 16) / 2
    x = Component(PLACE, 0)
    varying = noise(kind=kind, detail=Math(x, c(2), c(0.3), "MULTIPLY_ADD"), roughness=x, gain=x, lacunarity=x)
    found = at(varying, points)
    for value in np.unique(points[:, 0]).tolist():
        which = points[:, 0] == value
        constant = noise(
            kind=kind,
            detail=float(np.float32(value) * 2 + np.float32(0.3)),
            roughness=value,
            gain=value,
            lacunarity=value,
        )
        assert np.abs(found[which] - at(constant, points[which])).max() < 1e-6  # measured: 2.4e-7


@pytest.mark.parametrize("name", [name for name in TEXTURES if "4D" not in name and "1D" not in name])
def test_any_input_may_vary_alone(name):
    """With a constant vector and one input that varies, samples have the values that constants give."""
    texture = replace(TEXTURES[name], vector=c(0.3, 0.4, 0.5))
    x, numbers = Component(PLACE, 0), np.array([0.25, 1.5], np.float32)
    for field in fields(texture):
        given = getattr(texture, field.name)
        if field.name == "vector" or not isinstance(given, Constant) or len(given.value) > 1:
            continue
        found = at(replace(texture, **{field.name: x}), numbers[:, None] * [1, 0, 0])
        for number, value in zip(numbers.tolist(), found, strict=True):
            expected = evaluate(replace(texture, **{field.name: c(number)}), SampleInputs(count=1))[0]
            # Measured: 0 by NumPy 1.26, 6e-8 by NumPy 2.5, whose powers depend on the length of arrays
            assert np.abs(value - expected).max() < 1e-6, field.name


def test_noise_fills_its_range_and_colours_differ():
    color = at(noise(detail=2.0), somewhere(20_000))
    # Measured: 0.20 to 0.81, correlations to 0.009
    assert 0 <= color.min() < 0.25
    assert 0.75 < color.max() <= 1
    assert np.abs(np.corrcoef(color.T) - np.eye(3)).max() < 0.05


# Voronoi


@pytest.mark.parametrize("d", [1, 2, 3])
@pytest.mark.parametrize("congruential", [False, True])
def test_points_of_a_regular_lattice(d, congruential):
    """Without randomness, points lie at whole numbers."""
    p = somewhere(300)
    if d == 1:
        p[:, 1:] = 0
    cells = replace(voronoi(randomness=0.0, dimensions=d, congruential=congruential), w=Component(PLACE, 0))
    flat = p[:, :d].astype(np.float64)
    away = np.sort(np.abs(flat - np.round(flat)), axis=1)
    first = np.sqrt((away**2).sum(axis=1))
    second = np.sqrt(first**2 - away[:, -1] ** 2 + (1 - away[:, -1]) ** 2)
    found = at(cells, p)
    assert np.abs(found[:, 0] - first).max() < 1e-6  # measured: 6e-8, below as well
    position = found[:, 7:8] if d == 1 else found[:, 4 : 4 + d]
    assert np.abs(position - np.round(flat)).max() < 1e-5
    assert np.abs(at(replace(cells, feature="F2"), p)[:, 0] - second).max() < 1e-6
    assert np.abs(at(replace(cells, feature="DISTANCE_TO_EDGE"), p)[:, 0] - (0.5 - away[:, -1])).max() < 1e-6
    assert np.abs(at(replace(cells, feature="N_SPHERE_RADIUS"), p)[:, 0] - 0.5).max() < 1e-6


def test_distances_are_those_to_the_position():
    p = somewhere(2000)
    for feature in ("F1", "F2"):
        found = at(voronoi(feature=feature), p)
        assert np.abs(found[:, 0] - np.linalg.norm(found[:, 4:7] - p, axis=1)).max() < 1e-5  # measured: 1.2e-6
    first, second = (at(voronoi(feature=f), p)[:, 0] for f in ("F1", "F2"))
    edge, smooth = (at(voronoi(feature=f), p)[:, 0] for f in ("DISTANCE_TO_EDGE", "SMOOTH_F1"))
    assert (first <= second).all()
    assert (smooth <= first + 1e-6).all()
    assert (edge >= -1e-6).all()
    assert (edge <= 0.5 * (first + second) + 1e-5).all()
    sharp = at(voronoi(feature="SMOOTH_F1", smoothness=0.0), p)
    assert (sharp == at(voronoi(), p)).all()


def test_colours_are_those_of_cells():
    found = at(voronoi(), somewhere(3000, 2))
    cells, which = np.unique(np.round(found[:, 4:7], 3), axis=0, return_inverse=True)
    assert 50 < len(cells) < 500
    for k in range(1, 4):
        low, high = np.full(len(cells), np.inf), np.full(len(cells), -np.inf)
        np.minimum.at(low, which.ravel(), found[:, k])
        np.maximum.at(high, which.ravel(), found[:, k])
        assert (low == high).all()


# Patterns


def test_checker_changes_with_every_unit():
    x, y, z = np.meshgrid(*(np.arange(-3, 4) + 0.5,) * 3)
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    expected = np.floor(points).sum(axis=1) % 2
    assert (at(Checker(PLACE, c(1)), points)[:, 0] == expected).all()
    # The faces of the unit cube belong to it
    assert (at(Checker(PLACE, c(1)), list(itertools.product((0, 0.5, 1), repeat=3))) == 0).all()


def test_checkers_are_masks():
    assert is_mask(Checker(PLACE, c(1)))
    assert not is_mask(noise())


def test_waves_have_their_period():
    turn = 2 * np.pi / 20
    for profile in ("SIN", "SAW", "TRI"):
        wave = Wave(PLACE, c(1), c(0), c(0), c(1), c(0.5), c(0), profile=profile)
        p = np.linspace(0.01, 0.3, 50)[:, None] * [1, 0, 0]
        assert np.abs(at(wave, p) - at(wave, p + np.array([turn, 0, 0]))).max() < 1e-5  # measured: 3.2e-6
        assert at(wave, p).min() >= 0
        assert at(wave, p).max() <= 1


def test_bricks_have_mortar_between_them():
    brick = Brick(PLACE, c(1, 0, 0), c(1, 0, 0), c(0, 0, 1), c(1), c(0.1), c(0), c(0), c(1), c(0.5), 0.5, 2)
    found = at(
        brick, [(0.5, 0.25, 0), (0.95, 0.25, 0), (0.5, 0.45, 0), (0.5, 0.75, 0), (-0.05, 0.75, 0), (1.05, 0.75, 0)]
    )
    # The first row, whose number is even, is moved by half a brick
    assert found[:, 3].tolist() == [1, 0, 1, 0, 1, 1] or found[:, 3].tolist() == [1, 0, 1, 0, 0, 0]


# All


@pytest.mark.parametrize("name", TEXTURES)
def test_values_are_finite_wherever_points_are(name):
    texture: Expression = TEXTURES[name]
    extreme = [0.0, -0.0, 1e-40, 1e6, -1e6, 1e9, -3e38, np.inf, -np.inf, np.nan]
    points = np.array(list(itertools.product(extreme, repeat=3)), np.float32)
    assert np.isfinite(at(texture, points)).all()
    nowhere = at(replace(texture, scale=c(0)) if hasattr(texture, "scale") else texture, somewhere(10))
    assert np.isfinite(nowhere).all()


@pytest.mark.parametrize("name", TEXTURES)
def test_values_do_not_depend_on_blocks(name, monkeypatch):
    points = somewhere(75)
    whole = at(TEXTURES[name], points)
    monkeypatch.setattr(blocks, "BLOCK", 32)
    assert (at(TEXTURES[name], points) == whole).all()


@pytest.mark.parametrize("name", TEXTURES)
def test_textures_of_constants_do_not_vary(name):
    texture = replace(TEXTURES[name], vector=c(0.3, 0.4, 0.5))
    assert not texture.varies
    value = evaluate(texture, SampleInputs(count=3))
    same = at(TEXTURES[name], np.tile([0.3, 0.4, 0.5], (3, 1)))
    assert np.abs(value - same).max() < 1e-6
