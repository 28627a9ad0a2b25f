"""What stands apart: light passes between leaves, near and far, and surfaces pay nothing for it."""

# pyright: reportOptionalMemberAccess=false, reportOptionalSubscript=false, reportOptionalOperand=false
# Attributes may be None by type; the clouds here have those that are asked for.
from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.numeric.vectors import basis
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.devices.null import NullDevice
from pointsplat_addon.devices.opengl import OpenGLDevice
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes import build, clouds, detailed_cases, drawing, meshes, solid_cases
from scripts.scenes.build import moved, points
from scripts.scenes.cameras import camera
from scripts.scenes.clouds import leaves
from scripts.scenes.store import STORE
from tests.support.transmittance import cards, crown, mean_transmittance, medium, voxel_ball

COMBINED = frozenset({"combined"})


def let_through(renderer, seen, diameter, samples):
    """What passes the square about a crown that is so many pixels wide, and how many splats were drawn."""
    # The filter blurs over the square's rim, too.
    size = round(1.15 * diameter) + 8
    eye = camera((0, -5, 0), resolution=(size, size), parallel=2 * size / diameter)
    settings = Settings(technique="IMAGE_SPACE", use_shadows=False)
    renderer.device.context.__enter__()  # there may be another
    result = renderer.render(seen, Request(eye, settings, COMBINED, samples))
    hidden = result.pixels["combined"][..., 3].astype(np.float64).sum() * (2 / diameter) ** 2
    return 1 - hidden / 2.3**2, result.report["points"]["cut"]


@pytest.fixture(scope="module")
def rasterising():
    """A renderer without image atomics."""
    device = OpenGLDevice()
    device.limits = replace(device.limits, image_atomics=False)
    renderer = Renderer(device, STORE)
    yield renderer
    renderer.release()
    device.release()


# A leaf is 3.2, 0.8, 0.2 and 0.1 pixels wide with a depth of 0.5, half as wide again with 1.5.
@pytest.mark.parametrize(("diameter", "samples"), [(320, 4), (80, 16), (20, 64), (10, 96)])
@pytest.mark.parametrize("depth", [0.5, 1.5])
def test_a_crown_of_leaves_lets_as_much_light_through_at_any_distance(diameter, samples, depth):
    count = 20000
    exact = mean_transmittance(leaves(count, depth), 1.15, (0.0, 1.0, 0.0), pixels=768, hard=True)
    found, cut = let_through(drawing.opengl(), crown(count, depth), diameter, samples)
    assert found == pytest.approx(exact, abs=0.01)  # measured 0.0088
    assert (cut < count) == (diameter == 10)


@pytest.mark.parametrize("diameter", [160, 20])
def test_devices_without_image_atomics_let_as_much_through(rasterising, diameter):
    found, _ = let_through(rasterising, crown(5000, 1.0), diameter, 8)
    expected, _ = let_through(drawing.opengl(), crown(5000, 1.0), diameter, 8)
    assert found == pytest.approx(expected, abs=1e-3)  # measured 0


def card_mesh(count, depth):
    """The same crown of square cards, of two triangles each."""
    cloud = leaves(count, depth)
    u, v = (a.T[:, None] for a in basis(cloud.normal.T.astype(float)))
    half = cloud.radii[:, :1, None] * np.sqrt(np.pi) / 2
    corner = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    position = cloud.position[:, None] + half * (u * corner[:, :1] + v * corner[:, 1:])
    triangles = 4 * np.arange(count)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    return meshes.flat_mesh(f"cards {count} {depth}", position.reshape(-1, 3).astype("f4"), triangles.reshape(-1, 3))


@pytest.mark.parametrize("diameter", [240, 60, 15])
def test_a_mesh_of_cards_lets_as_much_light_through_at_any_distance(diameter):
    count, depth = 5000, 1.0
    exact = mean_transmittance(leaves(count, depth), 1.15, (0.0, 1.0, 0.0), pixels=768, hard=True)
    crown_of_cards = build.scene((build.mesh(card_mesh(count, depth)), moved()), lights=(), transparent=True)
    found, _ = let_through(drawing.opengl(), crown_of_cards, diameter, 16)
    assert found == pytest.approx(exact, abs=0.01)  # measured 0.0043


@pytest.mark.parametrize("diameter", [100, 25])
@pytest.mark.parametrize("kind", ["cards", "smoke"])
def test_what_is_translucent_lets_as_much_light_through_at_any_distance(kind, diameter):
    """Splats below a pixel are not widened where they add up evenly: deep ones would hide more."""
    if kind == "cards":
        cloud, lattice = cards(3000, 0.9, 0.06, 3), ""
    else:
        cloud, lattice = medium(voxel_ball(48), 50 / 48), "voxels of a ball"
        cloud = replace(cloud, **{name: getattr(cloud, name) / np.float32(24) for name in ("position", "radii")})
        cloud = replace(cloud, extinction=cloud.extinction * np.float32(24))
    exact = mean_transmittance(cloud, 1.15, (0.0, 1.0, 0.0), pixels=512)
    geometry = replace(points(f"translucent {kind}", cloud), lattice=lattice)
    seen = build.scene((geometry, moved()), lights=(), transparent=True)
    found, _ = let_through(drawing.opengl(), seen, diameter, 16)
    assert found == pytest.approx(exact, abs=0.005)  # measured 0.0023; 0.046 with splats at least 0.2 pixels wide


def test_surfaces_have_no_variant_for_it():
    for case, there in ((solid_cases.plain_sphere(), False), (detailed_cases.foliage(), True)):
        device = NullDevice()
        Renderer(device, STORE).render(case.scene, case.request(COMBINED))
        names = {name for interface in device.interfaces for name, _ in interface.defines}
        assert ("PS_DISCONNECTED" in names) == there


def test_what_is_seen_through_leaves_is_closed():
    """A crown before a wall hides parts of it, and nothing is seen between the two."""
    wall = points("wall behind leaves", clouds.plane_cloud(60, 2.0))
    made = build.scene((points("leaves before a wall", leaves(2000, 0.7)), moved((0, -2, 0))), (wall, moved()))
    result = drawing.opengl().render(
        replace(made, transparent=True),
        Request(
            camera((0, -6, 0), field_of_view=30), Settings(technique="IMAGE_SPACE", use_shadows=False), COMBINED, 4
        ),
    )
    assert result.pixels["combined"][..., 3].min() == 1.0
