"""Shadow look-ups on the device against numpy's over the same tables."""

from pathlib import Path

import numpy as np
import pytest

from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.shadow import builder
from pointsplat_addon.render.shadow import packed_tables
from pointsplat_addon.shading.interface import Interface
from scripts.common.shadow_truth import transmittance

moderngl = pytest.importorskip("moderngl")
COUNT = 1024
TAPS = 8
FRAGMENT = str(Path(__file__).resolve().parents[3] / "tests" / "support" / "shaders" / "shadow.frag")
RNG = np.random.default_rng(4)
VIEW = np.eye(4)
VIEW[:3, :3] = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
VIEW[:3, :3] *= np.linalg.det(VIEW[:3, :3])
VIEW[:3, 3] = 0.3, -0.2, 0.1
DOWN = np.array([0.0, 0.0, -1.0])
SIDES = np.array([[0.3, 0.0, 0.0], [0.0, 0.1, 0.0]])
LIGHTS = {
    "sun": Light("SUN", np.ones(3), np.zeros(3), np.array([0.36, 0.48, -0.8])),
    "far point": Light("POINT", np.ones(3), np.array([4.0, 1.0, 5.0]), DOWN),
    "inside": Light("POINT", np.ones(3), np.array([0.05, 0.1, 0.0]), DOWN),
    "spot": Light("SPOT", np.ones(3), np.array([0.0, 0.2, 3.0]), DOWN, spot_cos=0.95),
    "soft sun": Light("SUN", np.ones(3), np.zeros(3), np.array([0.36, 0.48, -0.8]), radius=0.05),
    "soft point": Light("POINT", np.ones(3), np.array([0.0, 0.2, 2.0]), DOWN, radius=0.2),
    "soft inside": Light("POINT", np.ones(3), np.array([0.05, 0.1, 0.0]), DOWN, radius=0.1),
    "area": Light("AREA", np.ones(3), np.array([0.0, 0.2, 2.0]), DOWN, axis_u=SIDES[0], axis_v=SIDES[1]),
    "ellipse": Light(
        "AREA", np.ones(3), np.array([0.0, 0.2, 2.0]), DOWN, axis_u=SIDES[0], axis_v=SIDES[1], ellipse=True
    ),
}

SOFT = ("soft sun", "soft point", "soft inside", "area", "ellipse")


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


def matter(colored: bool) -> list[builder.Casters]:
    """Some of each kind, in a cube."""
    rng = np.random.default_rng(1)
    position = rng.uniform(-1, 1, (3, 2000, 3)).astype(np.float32)
    axes = rng.normal(size=(3, 2000, 3, 3)).astype(np.float32) * 0.01
    mass = rng.uniform(0, 3e-3, (2000, 3) if colored else 2000).astype(np.float32)
    zero = np.zeros(3)
    return [
        builder.Casters("VOLUME", zero, position[0], radius=np.full(2000, 0.02, np.float32), mass=mass),
        builder.Casters("SHELL", zero, position[1], axes=axes[1, :, :2], mass=rng.random(2000).astype(np.float32)),
        builder.Casters("OPAQUE", zero, position[2][:500], axes=axes[2, :500, :2]),
    ]


def on_device(device, packed, light, position, normal):
    rows = np.zeros((2, COUNT, 4), np.float32)
    rows[0, :, :3] = position @ VIEW[:3, :3].T + VIEW[:3, 3]
    rows[1, :, :3] = normal @ VIEW[:3, :3].T
    records = packed.records(VIEW)
    textures = {
        "rows": device.texture((COUNT, 2), "RGBA32F", rows),
        "ps_shadow_tables": device.texture(packed.data.shape[1::-1], "RGBA32F", packed.data),
        "ps_shadow_lights": device.texture(records.shape[1::-1], "RGBA32F", records),
    }
    interface = Interface(
        "shadow test",
        fragment=FRAGMENT,
        samplers=tuple(("FLOAT_2D", name) for name in textures),
        outputs=(("vec4", "color"),),
        defines=(("LIGHT", str(light)), ("PS_SHADOW_TAPS", str(TAPS))),
    ).with_defines("PS_SHADOWS", "PS_SHADOW_TABLES", *(["PS_SHADOW_COLORED"] if packed.colored else []))
    target = device.target([device.texture((COUNT, 1), "RGBA32F")])
    device.draw(interface, target, textures=textures)
    return device.read(target.colors[0])[0, :, :3]


@pytest.mark.parametrize("colored", [False, True])
def test_device_equals_numpy(device, colored):
    tables = [builder.build_table(light, matter(colored), 64) for light in LIGHTS.values()]
    packed = packed_tables.pack([None, *tables])
    position = RNG.uniform(-1.5, 1.5, (COUNT, 3))
    normal = RNG.normal(size=(COUNT, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normal[::3] = 0
    position = position.astype(np.float32).astype(float)
    assert (on_device(device, packed, 0, position, normal) == 1).all()
    for i, (name, table) in enumerate(zip(LIGHTS, tables, strict=True), start=1):
        got = on_device(device, packed, i, position, normal)
        want = transmittance(table, position, normal, TAPS).reshape(COUNT, -1)
        assert np.isfinite(got).all()
        assert 0.1 < want.mean() < 0.95
        error = np.abs(got - want).max(axis=1)
        # measured 1.4e-4 (the driver's atan); soft: where a tap rounds to another cell, or an entry lies at the very
        # distance that it is compared with, float32 decides either way, in 1 of 8 taps
        assert np.quantile(error, 0.99) < 5e-4, name
        assert error.max() < (1 / TAPS if name in SOFT else 1e-3), name


def test_integers_beyond_2_24_survive_as_floats():
    integers = np.array([0, 1, 2**24 + 1, 2**31 - 2**24 - 1])
    code = packed_tables.coded(integers)
    assert np.isfinite(code).all()
    assert (np.abs(code) >= np.finfo(np.float32).tiny).all()
    assert (code.view(np.int32).astype(np.int64) - 0x00800000 == integers).all()


def test_lamps_without_casters_have_a_record():
    nothing = builder.build_table(Light("POINT", np.ones(3), np.zeros(3), np.array([0, 0, -1.0])), [], 64)
    assert packed_tables.pack([None, nothing]).records(np.eye(4)).shape == (2, packed_tables.HEADER_TEXELS, 4)
