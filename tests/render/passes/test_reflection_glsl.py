"""Tints, rough diffuse surfaces, sheen, toons and stretched lobes against float64, on random surfaces."""

from pathlib import Path

import numpy as np
import pytest

from pointsplat_addon.core.light import bsdf, light_table
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.shading.interface import Interface
from tests.reference import reflection

moderngl = pytest.importorskip("moderngl")
COUNT = 4096
FRAGMENT = str(Path(__file__).resolve().parents[3] / "tests" / "support" / "shaders" / "reflection.frag")
GLOSS, EVEN = np.array([0.3, 0.9, 0.6, 0.0]), np.array([-1.0, -1.0, -1.0, 1.0])
TINT, SHEEN, TOON = np.array([0.2, 0.9, 0.5]), np.array([0.9, 0.5, 0.2, 0.4]), np.array([0.4, 0.3])
LOOKS = {
    "plain": (),
    "tint": ("tint",),
    "gloss": ("gloss",),
    "gloss of the base colour": ("even",),
    "rough diffuse": ("diffuse_roughness",),
    "sheen": ("sheen",),
    "toon": ("toon",),
    "stretched": ("tangent",),
    "all but a toon": ("tint", "diffuse_roughness", "sheen", "tangent"),
}
VALUES = {"gloss": GLOSS, "even": EVEN, "tint": TINT, "diffuse_roughness": 0.8, "sheen": SHEEN, "toon": TOON}
FIELDS = {"even": "gloss"}  # of Look
DEFINES = {
    "gloss": (("PS_GLOSS", "1"), ("GLOSS", "vec4(0.3, 0.9, 0.6, 0.0)")),
    "even": (("PS_GLOSS", "1"), ("GLOSS", "vec4(-1.0, -1.0, -1.0, 1.0)")),
    "tint": (("PS_TINTED", "1"), ("TINT", "vec3(0.2, 0.9, 0.5)")),
    "diffuse_roughness": (("PS_ROUGH_DIFFUSE", "1"), ("DIFFUSE_ROUGHNESS", "0.8")),
    "sheen": (("PS_SHEEN", "1"), ("SHEEN", "vec4(0.9, 0.5, 0.2, 0.4)")),
    "toon": (("PS_TOON", "1"), ("TOON", "vec2(0.4, 0.3)")),
    "tangent": (("PS_TANGENT", "1"),),
}


@pytest.fixture(scope="module")
def device():
    from pointsplat_addon.devices.opengl import OpenGLDevice

    device = OpenGLDevice()
    yield device
    device.release()


@pytest.mark.parametrize("name", LOOKS)
def test_lobes_match_float64(device, name):
    rng = np.random.default_rng(5)
    normal, to_eye, grain = rng.normal(size=(3, COUNT, 3))
    normal, to_eye, grain = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (normal, to_eye, grain))
    normal *= np.where(np.einsum("nc,nc->n", normal, to_eye) < 0, -1, 1)[:, None]
    seen = np.einsum("nc,nc->n", normal, to_eye) > 0.02  # lower, float32 cancels
    grain -= np.einsum("nc,nc->n", grain, normal)[:, None] * normal
    grain *= rng.uniform(0.1, 0.6, (COUNT, 1)) / np.linalg.norm(grain, axis=1, keepdims=True)
    normal, to_eye, grain = (v.astype(np.float32).astype(float) for v in (normal, to_eye, grain))
    look = reflection.Look(
        base=rng.random((COUNT, 3)).astype(np.float32).astype(float),
        roughness=rng.uniform(0.15, 1, COUNT).astype(np.float32).astype(float),
        metallic=rng.choice([0, 0.5, 1], COUNT),
        eta=bsdf.relative_index(rng.choice([1.0, 1.1, 1.5, 2.0], COUNT), np.full(COUNT, 0.5)),
        **{str(FIELDS.get(part, part)): grain if part == "tangent" else VALUES[part] for part in LOOKS[name]},
    )
    rows = np.zeros((5, COUNT, 4), np.float32)
    rows[0, :, :3], rows[1, :, :3], rows[4, :, :3] = normal, to_eye, grain
    rows[2, :, :3], rows[2, :, 3] = look.base, look.roughness
    rows[3, :, 0], rows[3, :, 1] = look.metallic, look.eta
    direction = np.array([0.3, 0.4, -0.866])
    direction /= np.linalg.norm(direction)
    light = Light("SUN", np.ones(3), np.zeros(3), direction)
    table = light_table.light_texture([light], World(), np.eye(4), look.roughness[0], look.eta[0])
    textures = {
        "rows": device.texture((COUNT, 5), "RGBA32F", rows),
        "ps_lights": device.texture(table.shape[1::-1], "RGBA32F", table),
    }
    program = Interface(
        "reflection test",
        fragment=FRAGMENT,
        samplers=tuple(("FLOAT_2D", name) for name in textures),
        outputs=(("vec4", "color"),),
        defines=(("LIGHTS", "1"), *(one for part in LOOKS[name] for one in DEFINES[part])),
    ).with_defines("PS_HAS_SUNS", "PS_HAS_METAL")
    target = device.target([device.texture((COUNT, 1), "RGBA32F")])
    device.draw(program, target, textures=textures)
    got = device.read(target.colors[0])[0, :, :3][seen]
    want = reflection.lit(normal, to_eye, -direction, look)[seen]
    error = np.abs(got - want) / (np.abs(want) + 0.1 * want.mean())
    assert want.mean() > 0.02
    bound = 1e-3 if name == "toon" else 1e-4
    assert error.max() < bound, f"worst {error.max():.2g}"  # measured 1.6e-4 where a toon's light fades; else 2e-5


def test_what_a_rough_diffuse_surface_reflects_of_uniform_light_is_the_integral_over_it():
    cosine = np.array([0.1, 0.5, 0.95])
    light = np.random.default_rng(1).normal(size=(400000, 3))
    light /= np.linalg.norm(light, axis=1, keepdims=True)
    light[:, 2] = np.abs(light[:, 2])
    for c in cosine:
        eye = np.array([np.sqrt(1 - c * c), 0, c])
        s = light @ eye - light[:, 2] * c
        t = np.where(s > 0, np.maximum(light[:, 2], c), 1)
        found = 2 * np.pi * np.mean(s / t * light[:, 2])
        assert abs(found - reflection.extra_albedo(np.array([c]))[0]) < 0.01  # measured 0.004, by 400,000 samples
