"""The shaders' light against the float64 reference, on random surfaces."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pointsplat_addon.core.light import bsdf, environment, light_table
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.shading.interface import Interface
from tests.reference import lighting

moderngl = pytest.importorskip("moderngl")
COUNT = 4096
# measured 9.2e-4 (sun) and 7e-4 (soft spot) where the light touches the horizon and float32 cancels; others 6e-4
TOLERANCE = 2e-3
FRAGMENT = str(Path(__file__).resolve().parents[3] / "tests" / "support" / "shaders" / "shading.frag")


@pytest.fixture(scope="module")
def device():
    from pointsplat_addon.devices.opengl import OpenGLDevice
    from pointsplat_addon.render.device.protocol import DeviceError

    try:
        device = OpenGLDevice()
    except DeviceError as error:
        pytest.skip(f"no OpenGL: {error}")
    yield device
    device.release()


@pytest.fixture(scope="module")
def inputs():
    """Random position, normal, direction to the eye, plane (every other one known), surface."""
    rng = np.random.default_rng(3)
    unit = rng.normal(size=(2, COUNT, 3))
    unit /= np.linalg.norm(unit, axis=2, keepdims=True)
    surface = lighting.Surface(
        base=rng.random((COUNT, 3)),
        emission=rng.random((COUNT, 3)) * (rng.random((COUNT, 1)) > 0.5),
        roughness=rng.uniform(0.15, 1, COUNT),
        metallic=rng.choice([0, 0.3, 1], COUNT),
        ior=rng.choice([1.0, 1.1, 1.45, 2.0], COUNT),
        specular=rng.choice([0, 0.5, 1.0], COUNT),
    )
    plane = unit[0] + 0.8 * rng.permutation(unit[0])
    plane /= np.linalg.norm(plane, axis=1, keepdims=True)
    side = np.where((plane * unit[1]).sum(axis=1) < 0, -1, 1)[:, None]
    unit[0] *= side
    plane *= side * (np.arange(COUNT) % 2)[:, None]
    return (
        rng.uniform(-2, 2, (COUNT, 3)).astype(np.float32),
        *unit.astype(np.float32),
        plane.astype(np.float32),
        surface,
    )


VIEW = np.eye(4)
VIEW[:3, :3] = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
VIEW[:3, :3] *= np.linalg.det(VIEW[:3, :3])
VIEW[:3, 3] = 0.3, -0.2, 0.1


def shade_on_device(device, inputs, lights, world, defines) -> np.ndarray:
    position, normal, to_eye, plane, surface = inputs
    eta = bsdf.relative_index(surface.ior, surface.specular)
    rotation = VIEW[:3, :3].T
    rows = np.zeros((6, COUNT, 4), np.float32)
    rows[0, :, :3] = position @ rotation + VIEW[:3, 3]
    rows[0, :, 3] = surface.spread
    rows[1, :, :3], rows[2, :, :3] = normal @ rotation, to_eye @ rotation
    rows[3, :, :3], rows[3, :, 3] = surface.base, surface.roughness
    rows[4, :, :3], rows[4, :, 3] = surface.emission, surface.metallic
    rows[5, :, 0], rows[5, :, 1:] = eta, plane @ rotation
    textures = {"rows": device.texture((COUNT, 6), "RGBA32F", rows)}
    if defines:
        data = light_table.light_texture(lights, world, VIEW, surface.roughness[0], eta[0])
        textures["ps_lights"] = device.texture(data.shape[1::-1], "RGBA32F", data)
    if "PS_HAS_ENVIRONMENT" in defines:
        atlas = environment.build_atlas(world.image)
        textures["ps_environment"] = device.texture(atlas.shape[1::-1], "RGBA32F", atlas)
    interface = Interface(
        "shading test",
        fragment=FRAGMENT,
        samplers=tuple(("FLOAT_2D", name) for name in textures),
        outputs=(("vec4", "color"),),
        defines=(("LIGHTS", str(len(lights))),),
    ).with_defines(*defines)
    target = device.target([device.texture((COUNT, 1), "RGBA32F")])
    device.draw(interface, target, textures=textures)
    return device.read(target.colors[0])[0, :, :3]


def compare(device, inputs, lights, world, defines):
    position, normal, to_eye, plane, surface = inputs
    got = shade_on_device(device, inputs, lights, world, defines)
    want = lighting.shade(position, normal, to_eye, surface, lights, world, plane=plane)
    assert np.isfinite(got).all()
    error = np.abs(got - want) / (np.abs(want) + 0.1 * want.mean())
    assert want.mean() > 0.05
    assert error.max() < TOLERANCE, f"worst {error.max():.2g}, 99.9 %: {np.quantile(error, 0.999):.2g}"


AXIS = np.array([0.0, 0.0, -1.0])
POINT = Light("POINT", np.array([30.0, 20, 10]), np.array([0.5, 0.2, 3.0]), AXIS)
AREA = replace(
    POINT, kind="AREA", axis_u=np.array([1.5, 0.0, 0.0]), axis_v=np.array([0.0, 0.7, 0.0]), diffuse=0.7, specular=0.4
)
SPOT = replace(
    POINT,
    kind="SPOT",
    spot_cos=0.6,
    spot_blend=0.5,
    axis_u=np.array([1.0, 0.0, 0.0]),
    axis_v=np.array([0.0, 2.0, 0.0]),
)
LIGHTS = {
    "point": POINT,
    "soft point": replace(POINT, radius=0.8),
    "sphere": replace(POINT, radius=0.8, soft=False),
    "enclosing sphere": replace(POINT, radius=8.0, soft=False),
    "sun": replace(POINT, kind="SUN", radius=0.2),
    "spot": SPOT,
    "soft spot": replace(SPOT, radius=0.4),
    "rectangle": AREA,
    "ellipse": replace(AREA, ellipse=True),
    "narrow rectangle": replace(AREA, spread=1.0),
    "narrow ellipse": replace(AREA, ellipse=True, spread=1.0),
}


@pytest.mark.parametrize("name", LIGHTS)
def test_light_equals_reference(device, inputs, name):
    compare(device, inputs, [LIGHTS[name]], World(), names([LIGHTS[name]], inputs))


@pytest.mark.parametrize("name", ["point", "sun", "soft spot", "rectangle"])
def test_light_on_spread_normals_equals_reference(device, inputs, name):
    *geometry, surface = inputs
    spread = np.where(np.arange(COUNT) % 4 == 0, 0, np.random.default_rng(5).uniform(0, 0.3, COUNT))
    inputs = *geometry, replace(surface, spread=spread.astype(np.float32))
    # Where lobes are as wide as they can be, a sun of 0.2 is on the brink between one point and seven.
    light = [replace(LIGHTS[name], radius=0.25) if name == "sun" else LIGHTS[name]]
    compare(device, inputs, light, World(), (*names(light, inputs), "PS_SPREAD"))


ONE_SURFACE = {"roughness": 0.4, "metallic": 0.0, "ior": 1.45, "specular": 0.5}


@pytest.mark.parametrize("name", ["point", "distant sun", "rectangle"])
def test_dielectrics_of_one_kind_equal_reference(device, inputs, name):
    *seen, surface = inputs
    plain = replace(surface, **{name: np.full(COUNT, value) for name, value in ONE_SURFACE.items()})
    lights = [LIGHTS.get(name) or replace(POINT, kind="SUN", radius=0.005)]
    defines = [*light_table.light_names(lights, 0.4), "PS_ONE_SURFACE", "PS_HAS_WORLD"]
    assert "PS_HAS_WIDE_LIGHTS" not in defines
    compare(device, (*seen, plain), lights, World(color=np.full(3, 0.5)), defines)


def names(lights, inputs):
    return [*light_table.light_names(lights, inputs[-1].roughness.min()), "PS_HAS_METAL"]


def test_all_lights_and_colour_world_equal_reference(device, inputs):
    lights = list(LIGHTS.values())
    world = World(color=np.array([0.3, 0.5, 0.9]))
    compare(device, inputs, lights, world, [*names(lights, inputs), "PS_HAS_WORLD"])


def test_picture_world_equals_reference(device, inputs):
    image = np.random.default_rng(5).random((32, 64, 3)).astype(np.float32) ** 4
    turn = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    compare(device, inputs, [], World(image=image, world_rotation=turn), ["PS_HAS_ENVIRONMENT", "PS_HAS_METAL"])


def test_without_light_only_emission_is_left(device, inputs):
    got = shade_on_device(device, inputs, [], World(), [])
    assert np.abs(got - inputs[-1].emission).max() < 1e-6  # measured 3e-8
