"""Lights larger than their distance from what they shine on: by numerical integrals in float64."""

import numpy as np
import pytest

from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from scripts.scenes import build, cameras, meshes
from scripts.scenes.case import Case
from scripts.scenes.drawing import render

SETTINGS = Settings(technique="VISIBILITY", use_adaptive_sampling=False)
# From aside: half of the light's outline is below the floor, and much of what it shines on is at its sides.
UPRIGHT = Light("AREA", np.full(3, 1.0), np.array([3.0, 0, 0.6]), np.array([-1.0, 0, 0]),
                axis_u=np.array([0, 1.2, 0]), axis_v=np.array([0, 0, 1.2]))  # fmt: skip
CEILING = Light("AREA", np.full(3, 1.0), np.array([0.0, 0, 1.6]), np.array([0, 0, -1.0]),
                axis_u=np.array([2.0, 0, 0]), axis_v=np.array([0, 1.5, 0]))  # fmt: skip
DISK = Light("AREA", np.full(3, 1.0), np.array([0.5, 0, 1.6]), np.array([0, 0, -1.0]),
             axis_u=np.array([2.0, 0, 0]), axis_v=np.array([0, 2.0, 0]), ellipse=True)  # fmt: skip
LYING = 6 * np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1 / 6]])
MIDDLE, HALF = np.array([1.4, -0.5, 0.5]), 0.5  # of a cube on the floor


def irradiance(light: Light, at: np.ndarray) -> np.ndarray:
    """(N,) of places (N, 3) of the floor, by the light for one unit of radiance: by 64 by 64 points of it, of which the
    cube hides some."""
    assert light.axis_u is not None
    assert light.axis_v is not None
    side = (np.arange(64) + 0.5) / 32 - 1
    u, v = (grid.reshape(-1, 1) for grid in np.meshgrid(side, side))
    inside = (np.hypot(u, v) <= 1) | (not light.ellipse)
    points = (light.position + u * light.axis_u + v * light.axis_v)[inside[:, 0]]
    area = 4 * np.linalg.norm(light.axis_u) * np.linalg.norm(light.axis_v) / len(u)
    found = []
    for some in np.array_split(at, -(-len(at) // 16)):  # so many places as a processor's cache holds
        x, y, z = points.T[:, None] - some.T[..., None]  # (places, points of the light) each
        received = np.maximum(z, 0) * np.maximum(-np.tensordot(light.direction, (x, y, z), 1), 0)
        enters, leaves = np.full(z.shape, -np.inf), np.full(z.shape, np.inf)
        for toward, middle, start in zip((x, y, z), MIDDLE, some.T[..., None], strict=True):
            with np.errstate(divide="ignore"):
                near, far = (middle - HALF - start) / toward, (middle + HALF - start) / toward
            enters, leaves = np.maximum(enters, np.minimum(near, far)), np.minimum(leaves, np.maximum(near, far))
        hidden = (enters < leaves) & (leaves > 1e-9) & (enters < 1)
        found.append(area * np.where(hidden, 0, received / (x**2 + y**2 + z**2) ** 2).sum(axis=1))
    return np.concatenate(found)


@pytest.mark.parametrize(
    ("light", "worst", "typical"),
    # Measured 0.0066 and 0.0015, 0.083 and 0.019, 0.050 and 0.013. By the face of the cube in which the light's middle
    # has a place, for all of its points, 0.028 and 0.0065, 0.10 and 0.041, 0.11 and 0.044.
    [(UPRIGHT, 0.009, 0.002), (CEILING, 0.1, 0.025), (DISK, 0.065, 0.016)],
    ids=("upright", "ceiling", "disk"),
)
@pytest.mark.parametrize("step", [6, pytest.param(1, marks=pytest.mark.long)])  # so few pixels are integrated
def test_a_floor_has_what_the_cube_leaves_of_the_light(light: Light, worst: float, typical: float, step: int) -> None:
    """Shares of the most light that the floor has: at the 99th percentile, and RMSE."""
    floor = meshes.plane_mesh("floor of large lights", cells=1)
    cube = meshes.cube_mesh("cube under large lights")
    scene = build.scene(
        (build.mesh(floor, "POLYGONS"), LYING),
        (build.mesh(cube, "POLYGONS"), build.moved(MIDDLE, scale=HALF)),
        lights=[light],
        table=build.materials(specular=np.zeros(1), roughness=np.ones(1)),
        world=World(np.zeros(3)),
    )
    camera = cameras.camera((-2.5, -3.5, 6.0), (0.5, 0, 0), resolution=(160, 120))
    pixels = render(Case(scene, camera, SETTINGS), frozenset({"combined", "position", "normal"})).pixels
    on_floor = (pixels["normal"][..., 2] > 0.999) & (np.abs(pixels["position"][..., 2]) < 1e-4)
    for along, by in ((0, 1), (0, -1), (1, 1), (1, -1)):  # no pixel whose filter reaches the cube
        on_floor = on_floor & np.roll(on_floor, by, axis=along)
    away = (pixels["position"] - light.position) @ light.direction
    on_floor &= np.abs(away) > 0.15  # nearer to the light, so many points of it do not make an integral
    some = np.flatnonzero(on_floor)[::step]
    expected = irradiance(light, pixels["position"].reshape(-1, pixels["position"].shape[-1])[some].astype(float))
    found = pixels["combined"][..., 0].reshape(-1)[some].astype(float)
    bright = expected > 0.2 * expected.max()
    found *= np.median(expected[bright] / found[bright])
    error = np.abs(found - expected) / expected.max()
    assert np.percentile(error, 99) < worst
    assert np.sqrt((error**2).mean()) < typical


def test_near_an_edge_and_in_the_plane_of_a_light_nothing_shines_that_the_light_does_not() -> None:
    """A floor that cuts a light has at most what half a sphere of its radiance gives, and a wall in the light's plane
    nothing, whatever rounding makes of its places."""
    floor = meshes.plane_mesh("floor at the edge of a light", cells=1)
    wall = build.mesh(meshes.plane_mesh("wall in the plane of a light", cells=1), "POLYGONS")
    turned = np.array([[0.0, 1, 0, 3], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    turned[:3, :3] *= 6
    scene = build.scene(
        (build.mesh(floor, "POLYGONS"), LYING),
        (wall, turned),
        lights=[UPRIGHT],
        table=build.materials(specular=np.zeros(1), roughness=np.ones(1)),
        world=World(np.zeros(3)),
    )
    for eye in ((-2.5, -3.5, 6.0), (1.0, -2.5, 3.0), (2.0, 1.5, 1.0)):
        camera = cameras.camera(eye, (3.0, 0.1, 0.2), resolution=(160, 120))
        pixels = render(Case(scene, camera, SETTINGS), frozenset({"combined", "normal"})).pixels
        found, normal = pixels["combined"][..., 0], pixels["normal"]
        assert found[normal[..., 2] > 0.999].max() > 0.1
        assert found[np.abs(normal[..., 0]) > 0.999].max() == 0
        assert found.max() <= 1
