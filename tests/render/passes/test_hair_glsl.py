"""The shaders' hair against the float64 reference, on random strands, and the reference against what light can do."""

from pathlib import Path

import numpy as np
import pytest

from pointsplat_addon.core.light import hair, light_table
from pointsplat_addon.core.scene.strands import Strands
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.shading.interface import Interface
from scripts.scenes.drawing import opengl
from tests.reference import hair_lighting
from tests.reference.hair_lighting import Fibre

moderngl = pytest.importorskip("moderngl")
COUNT = 4096
FRAGMENT = str(Path(__file__).resolve().parents[3] / "tests" / "support" / "shaders" / "hair.frag")


def unit(rng, *shape) -> np.ndarray:
    v = rng.normal(size=(*shape, 3))
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


@pytest.fixture(scope="module")
def inputs() -> dict:
    rng = np.random.default_rng(11)
    tangent, direction, to_eye = unit(rng, 3, COUNT).astype(np.float32)
    return {
        "tangent": tangent, "direction": direction, "to_eye": to_eye,
        "base": rng.uniform(0.02, 0.95, (COUNT, 3)), "roughness": rng.uniform(0.1, 0.9, COUNT),
        "metallic": rng.choice([0, 0.4, 1], COUNT), "eta": rng.choice([1.33, 1.55, 1.8], COUNT),
        "radial": rng.uniform(0.1, 0.9, COUNT), "tilt": rng.uniform(-0.1, 0.1, COUNT),
        "coat": rng.choice([0.0, 0.6], COUNT), "escape": rng.uniform(0.03, 0.99, COUNT),
        "lobes": rng.choice([1.0, 0.6], (COUNT, 3)), "spread": rng.choice([0, 0.001, 0.1, 0.5], COUNT),
    }  # fmt: skip


def on_device(inputs: dict, used: bool, world: np.ndarray | None = None) -> np.ndarray:
    device = opengl().device
    rows = np.zeros((6, COUNT, 4), np.float32)
    for i, name in enumerate(("tangent", "direction", "to_eye", "base")):
        rows[i, :, :3] = inputs[name]
    rows[1, :, 3] = inputs["spread"]
    rows[3, :, 3], rows[4, :, 0], rows[4, :, 1] = inputs["roughness"], inputs["metallic"], inputs["eta"]
    if used:
        names = ("radial", "coat", "tilt", "lobes", "escape")
        rows[5] = hair.hair_texels(np.ones(COUNT, bool), *(inputs[name] for name in names))
    textures = {"rows": device.texture((COUNT, 6), "RGBA32F", rows)}
    data = light_table.light_texture([], World(np.zeros(3) if world is None else world), np.eye(4))
    textures["ps_lights"] = device.texture((data.shape[1], data.shape[0]), "RGBA32F", data)
    interface = Interface("hair test", fragment=FRAGMENT, samplers=tuple(("FLOAT_2D", name) for name in textures),
                          outputs=(("vec4", "color"),))  # fmt: skip
    interface = interface.with_defines("PS_HAS_WORLD", "PS_HAS_METAL", *(["FURNACE"] if world is not None else []))
    target = device.target([device.texture((COUNT, 2), "RGBA32F")])
    device.draw(interface, target, textures=textures)
    return device.read(target.colors[0])[..., :3]


def fibre_of(inputs: dict) -> Fibre:
    return Fibre(inputs["base"], inputs["roughness"], inputs["radial"], inputs["eta"], inputs["tilt"], inputs["coat"],
                 inputs["lobes"], inputs["escape"])  # fmt: skip


def agree(got: np.ndarray, want: np.ndarray, bound: float) -> None:
    assert np.isfinite(got).all()
    assert want.mean() > 0.005
    # Measured 2.5e-4 for hair, 1.7e-4 for cylinders.
    error = np.abs(got - want) / (np.abs(want) + 0.1 * want.mean())
    assert error.max() < bound, f"worst {error.max():.2g}"


def test_hair_equals_reference(inputs):
    got = on_device(inputs, used=True)
    want = hair_lighting.scattered_radiance(
        inputs["tangent"], inputs["direction"], inputs["to_eye"], fibre_of(inputs), inputs["spread"]
    )
    agree(got, want, 1e-3)


def test_cylinders_of_other_materials_equal_reference(inputs):
    got = on_device(inputs, used=False)
    names = ("tangent", "direction", "to_eye", "base", "roughness", "metallic", "eta", "spread")
    agree(got, hair_lighting.cylinder_radiance(*(inputs[name] for name in names)), 1e-3)


def sphere(count: int) -> np.ndarray:
    """(count, 3) directions, evenly over the sphere."""
    i = np.arange(count) + 0.5
    z, turn = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    across = np.sqrt(1 - z * z)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)


def received(to_eye: np.ndarray, scatter) -> np.ndarray:
    """(3,) radiance of one strand in uniform light, by adding up directions."""
    directions = sphere(100_000)
    tangent = np.tile([0.0, 0, 1], (len(directions), 1))
    found = scatter(tangent, directions, np.tile(to_eye, (len(directions), 1)))
    return found.sum(axis=0).mean(axis=0) * 4 * np.pi


@pytest.mark.parametrize(("radial", "escape"), [(0.15, 1.0), (0.3, 1.0), (0.3, 0.1), (0.8, 0.5)])
@pytest.mark.parametrize("sine", [0.0, 0.5, -0.9])
def test_a_white_strand_scatters_all_that_it_receives(sine, radial, escape):
    to_eye = np.array([np.sqrt(1 - sine**2), 0, sine])
    white = Fibre(np.ones((1, 3)), np.array([0.3]), np.array([radial]), 1.55, 0.035, escape=escape)

    def scatter(tangent, directions, eye):
        return hair_lighting.scattered_radiance(tangent, directions, eye, white)

    assert np.abs(received(to_eye, scatter) - 1).max() < 2e-3  # measured 1e-3


@pytest.mark.parametrize("metallic", [0.0, 1.0])
@pytest.mark.parametrize("roughness", [0.3, 1.0])
def test_a_white_cylinder_scatters_no_more_than_it_receives(roughness, metallic):
    def scatter(tangent, directions, eye):
        one = np.ones(len(tangent))
        return hair_lighting.cylinder_radiance(
            tangent, directions, eye, np.ones((len(tangent), 3)), roughness * one, metallic * one, 1.5 * one
        )

    for sine in (0.0, 0.6):
        total = received(np.array([np.sqrt(1 - sine**2), 0, sine]), scatter)
        assert total.max() < 1 + 2e-3  # measured 1 + 1e-3
        assert total.min() > 0.99


def test_in_a_uniform_world_strands_are_their_energy(inputs):
    world = np.array([1.0, 0.5, 2.0])
    got = on_device(inputs, True, world)[0]
    sine = np.einsum("nc,nc->n", inputs["tangent"], inputs["to_eye"]).astype(float)
    want = world * hair_lighting.radiance_in_uniform_light(fibre_of(inputs), sine)
    assert np.abs(got - want).max() < 1e-4  # measured 2e-5
    assert (got <= world * (1 + 1e-5)).all()


def test_light_from_behind_shines_through_and_dark_hair_keeps_only_its_gloss():
    eye, tangent = np.array([[1.0, 0, 0]]), np.array([[0.0, 0, 1]])
    blond, black = (Fibre(np.full((1, 3), c), np.array([0.3]), np.array([0.3]), 1.55, 0.0) for c in (0.8, 1e-4))
    behind, before = (
        hair_lighting.scattered_radiance(tangent, np.array([[x, 0.05, 0]]), eye, blond)[1].max() for x in (-1.0, 1.0)
    )
    assert behind > 2 * before
    reflected, rest = hair_lighting.scattered_radiance(tangent, eye, eye, black)
    assert rest.max() < 0.05 * reflected.max()


def test_the_diffuse_part_of_a_cylinder_is_the_mean_of_lamberts_over_its_width():
    h = (np.arange(20000) + 0.5) / 10000 - 1
    normal = np.stack([np.sqrt(1 - h * h), h, 0 * h], axis=1)  # across the z axis, seen from x
    rng = np.random.default_rng(2)
    for direction in unit(rng, 50):
        mean = np.maximum(normal @ direction, 0).mean()
        theta, _, phi = hair_lighting.angles(np.array([[0.0, 0, 1]]), direction[None], np.array([[1.0, 0, 0]]))
        assert abs(hair_lighting.cylinder_cosine(theta, phi)[0] - mean) < 1e-4  # measured 3e-6


def square_of_light(cells: int, side: float, height: float, beside: float) -> tuple[np.ndarray, np.ndarray]:
    """Directions (C, 3) to the cells of a square of that side, and their solid angles (C,)."""
    at = ((np.arange(cells) + 0.5) / cells - 0.5) * side
    x, y = (a.ravel() for a in np.meshgrid(at + beside, at))
    offset = np.stack([x, y, np.full(len(x), height)], axis=1)
    far = np.linalg.norm(offset, axis=1)
    return offset / far[:, None], (side / cells) ** 2 * height / far**3


@pytest.mark.parametrize("height", [1.0, 3.0, 8.0])
@pytest.mark.parametrize("kind", ["hair", "smooth hair", "diffuse", "metal"])
def test_light_of_a_wide_square_is_nearer_to_its_parts_than_to_its_middle(kind, height):
    """A lamp of 2 m from a metre and more: RMS of the error over the mean."""
    rng = np.random.default_rng(6)
    tangent, to_eye = unit(rng, 2, 300)
    one, color = np.ones(300), np.tile([0.5, 0.3, 0.15], (300, 1))

    def lit(direction: np.ndarray, spread: float = 0.0) -> np.ndarray:
        toward = np.tile(direction, (300, 1))
        if "hair" in kind:
            fibre = Fibre(color, (0.15 if "smooth" in kind else 0.3) * one, 0.3 * one, 1.55, 0.035)
            return hair_lighting.scattered_radiance(tangent, toward, to_eye, fibre, spread).sum(axis=0)
        metallic, roughness = (1.0, 0.3) if kind == "metal" else (0.0, 1.0)
        return hair_lighting.cylinder_radiance(
            tangent, toward, to_eye, color, roughness * one, metallic * one, 1.5 * one, spread
        ).sum(axis=0)  # fmt: skip

    parts, solid_angle = square_of_light(24, 2.0, height, 0.0)
    want = sum(w * lit(d) for w, d in zip(solid_angle, parts, strict=True))
    whole, middle = solid_angle.sum(), np.array([0.0, 0, 1])
    point, wide = (
        np.sqrt(np.mean((whole * lit(middle, s) - want) ** 2)) / want.mean() for s in (0.0, whole / (4 * np.pi))
    )
    # Measured 0.095 at most for what is diffuse, else 0.56, where the middle alone is off by 0.18 and 4.1
    assert wide < (0.12 if kind == "diffuse" else 0.7)
    assert wide < (1.0 if kind == "diffuse" else 0.4) * point  # measured 0.94 and 0.24


@pytest.mark.parametrize("color", [(0.45, 0.22, 0.08), (0.8, 0.6, 0.4), (0.15, 0.08, 0.05)])
def test_hair_of_an_endless_mass_has_nearly_its_colour_and_a_single_one_hardly_any(color):
    def seen(escape: float) -> np.ndarray:
        fibre = Fibre(np.array([color]), np.array([0.3]), np.array([0.3]), 1.55, 0.0, escape=escape)
        return hair_lighting.radiance_in_uniform_light(fibre, np.array([0.2]))[0]

    # Measured 0.033, 0.118 and 0.026.
    assert np.abs(seen(hair.LEAST_ESCAPE) - color).max() < 0.13
    every, some = seen(1.0), seen(0.4)
    assert (every > some).all()
    assert every[0] / every[2] < some[0] / some[2] < color[0] / color[2]


def test_lines_of_sight_through_a_ball_of_strands_are_counted():
    """Strands of random directions in a ball, by the number that random lines through its middle part meet."""
    rng = np.random.default_rng(4)
    way = unit(rng, 4000)
    middle = unit(rng, 4000) * rng.random((4000, 1)) ** (1 / 3)
    points = np.stack([middle - 0.05 * way, middle + 0.05 * way], axis=1).reshape(-1, 3).astype(np.float32)
    lines = Strands("ball", "ball", points, np.arange(0, 8001, 2), np.full(8000, 0.005, np.float32))
    # All that they cover over what the ball does: 4000 times 0.01 times 0.1 times pi / 4, over pi.
    assert (
        abs(hair.strands_crossed(lines) / (4000 * 0.01 * 0.1 / 4) - 1) < 0.04
    )  # measured 0.030; the box is wider by their length
    bad = Strands("bad", "bad", np.full((2, 3), np.nan, np.float32), np.array([0, 2]), np.ones(2, np.float32))
    assert hair.strands_crossed(bad) == 0
    assert hair.escape_share(np.array([0.0, 1e9])).tolist() == [1, hair.LEAST_ESCAPE]
